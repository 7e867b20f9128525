"""Sweeps: clouds that a moving vehicle took point by point, and what brings them to one instant.

A lidar takes a tenth of a second for a turn. At 2 m/s and 30°/s what is 10 m away is half a metre
off at its end, unless each point is carried to where it lies as seen at the sweep's stamp.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Float32, Float64, Int64
from fieldgrid.geometry import Trajectory

TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_offset", "gps_time")
"""What drivers call the time of a point."""

SHORTEST_S, LONGEST_S = 5e-4, 0.5
"""How long sweeps take. Units are a thousandfold apart, and so is this: it tells the unit."""

FARTHEST_S = 1.0
"""A point that is farther from its sweep's stamp is of another clock."""

FEWEST_TIMES = 100
"""Fewer points than this do not tell the unit of their times."""

_UNITS_S = (1.0, 1e-3, 1e-6, 1e-9)


class Sweep(NamedTuple):
    """Points [n, 3] of the sensor's frame, metres, and by how much later than the stamp of the
    frame each was taken, seconds [n]; None where nothing tells it."""

    points_m: Float32
    after_s: Float32 | None = None


class RawSweep(NamedTuple):
    """Points [n, 3] as a file has them, and what it says of their times [n]; None without."""

    points: npt.NDArray[np.generic]
    times: npt.NDArray[np.generic] | None = None


class OriginTrack(NamedTuple):
    """Where the grid origin was at n instants in order of time: LTP metres, and the heading in
    radians, clockwise from north, without a jump."""

    time_ns: Int64
    east_m: Float64
    north_m: Float64
    heading_rad: Float64

    @classmethod
    def of(cls, trajectory: Trajectory) -> OriginTrack:
        """The accepted poses of a trajectory."""
        ok = trajectory.accepted
        heading = np.unwrap(np.radians(trajectory.heading_deg[ok]))
        columns = (trajectory.east_m[ok], trajectory.north_m[ok], heading)
        return cls(trajectory.time_ns[ok], *columns)

    def carried(self, sweep: Sweep, time_ns: int, R_vehicle_sensor: Float64) -> Float32:
        """The points of a sweep with the stamp `time_ns` as they were seen at that instant.

        The vehicle moves in the plane: how it leans changes little in a sweep. Points without
        times stay as they are, and so do all where the way is not known.
        """
        points_m, after_s = sweep
        if after_s is None or not len(self.time_ns) or not len(points_m):
            return points_m
        # Nanoseconds since 1970 are too large for a float; since the stamp they are not.
        known_s = (self.time_ns - time_ns) / 1e9
        east, north, heading = (
            np.interp(after_s, known_s, column) - np.interp(0.0, known_s, column)
            for column in self[1:]
        )
        start_rad = float(np.interp(0.0, known_s, self.heading_rad))
        sin, cos = np.sin(start_rad), np.cos(start_rad)
        x, y, z = (points_m @ R_vehicle_sensor.T.astype(np.float32)).astype(np.float64).T
        turned_sin, turned_cos = np.sin(heading), np.cos(heading)
        carried = np.stack(
            [
                x * turned_cos + y * turned_sin + east * cos - north * sin,
                y * turned_cos - x * turned_sin + east * sin + north * cos,
                z,
            ],
            axis=1,
        )
        return np.ascontiguousarray(carried @ R_vehicle_sensor, dtype=np.float32)


def seconds_after(times: npt.NDArray[np.generic], stamp_ns: int) -> Float32 | None:
    """By how much later than a stamp points were taken, seconds [n].

    `times` [n] count s, ms, µs or ns, which their span tells, from the stamp or by the clock of
    the stamp. None where they are not times of a sweep: all the same, too few to tell the unit, or
    of another clock.
    """
    if len(times) < FEWEST_TIMES:
        return None
    first = times.min()
    since = (times - first).astype(np.float64)
    span = float(since.max())
    if not np.isfinite(span):
        return None
    unit_s = next((u for u in _UNITS_S if SHORTEST_S <= span * u <= LONGEST_S), None)
    if unit_s is None:
        return None
    begun_s = float(first) * unit_s
    for start_s in (begun_s, begun_s - stamp_ns / 1e9):
        if abs(start_s) <= FARTHEST_S:
            return np.asarray(since * unit_s + start_s, dtype=np.float32)
    return None
