"""How the vehicle leans while it drives: the latest estimate, carried on by the IMU's rates or by
recorded angles.

An estimate is always some tenths of a second older than the frame that is gridded.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import reduce

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import (
    Pose,
    R_enu_level,
    R_level_vehicle,
    Tilt,
    from_vectors,
    roll_pitch_deg,
)
from fieldgrid.live.pose.sensor_rows import RecentRows, SensorTrack, ticks
from fieldgrid.poses import Attitude

CARRIED_S = 5.0
"""Time after the end of the estimate for which the lean is known."""

DRIFT_DEG = 0.2
"""How far carried angles are off after a second, 1 sigma."""


class RunningTilt:
    """Takes estimates, and gives the tilt of the vehicle by the rows of now. Safe from any
    thread."""

    def __init__(self, rows: RecentRows) -> None:
        self._rows = rows
        self._known: Attitude | None = None

    def know(self, attitude: Attitude | None) -> None:
        """The latest estimate; None where nothing tells how the vehicle leans."""
        self._known = attitude

    def at(self, time_ns: int) -> Tilt | None:
        """The tilt at an instant; None where nothing tells it."""
        attitude = self._known
        if attitude is None:
            return None
        end_ns = int(attitude.time_ns[-1])
        late_s = (time_ns - end_ns) / 1e9
        if late_s <= 0.0:
            return attitude.tilt_at(time_ns)
        if late_s > CARRIED_S:
            return None
        roll, pitch, sigma = attitude.tilt_at(end_ns)
        sigma = math.hypot(sigma, DRIFT_DEG * late_s)
        for told in (self._rows.track("tilt", 2), self._rows.track("orientation", 2)):
            if told.holds(end_ns, time_ns):
                (roll_0, pitch_0), (roll_1, pitch_1) = told.at(np.array([end_ns, time_ns]))
                return Tilt(float(roll + roll_1 - roll_0), float(pitch + pitch_1 - pitch_0), sigma)
        track = self._rows.track("inertial", 1)
        if not track.holds(end_ns, time_ns):
            return attitude.tilt_at(time_ns)
        if attitude.gyro_bias_rad_s is not None:
            track = track._replace(values=track.values - attitude.gyro_bias_rad_s)
        turned = _turned(track, end_ns, time_ns)
        roll_deg, pitch_deg = roll_pitch_deg(R_level_vehicle(roll, pitch) @ turned)
        return Tilt(float(roll_deg), float(pitch_deg), sigma)


def _turned(rates: SensorTrack, from_ns: int, to_ns: int) -> Float64:
    """The vehicle's axes at the later instant, seen from those at the earlier one [3, 3], by rates
    of turn [n, 3]."""
    edges_ns = ticks(from_ns, to_ns)
    middle = rates.at((edges_ns[1:] + edges_ns[:-1]) // 2)
    R = from_vectors(middle * (np.diff(edges_ns) / 1e9)[:, None])
    return np.asarray(reduce(np.matmul, R))


def square_to_ground(pose: Pose, tilt: Tilt, sensor_m: float) -> Pose:
    """The pose of a level grid's origin, vertically below a sensor `sensor_m` high, as that of a
    grid that is perpendicular to the ground: below the sensor along the vehicle's own axis."""
    R = R_level_vehicle(tilt.roll_deg, tilt.pitch_deg)
    east, north, _ = R_enu_level(pose.heading_deg) @ (np.eye(3) - R) @ [0.0, 0.0, sensor_m]
    return replace(pose, east_m=pose.east_m + float(east), north_m=pose.north_m + float(north))


def lean_advice(attitude: Attitude | None, time_ns: int, antenna_m: float, most_m: float) -> str:
    """The advice where poses are in doubt mainly because nothing but the camera tells the lean: the
    uncertainty of the `attitude` moves an antenna of `antenna_m` height by more than its part of
    `most_m`, the error that a cell may have. Empty otherwise."""
    sigma_deg = 0.0 if attitude is None else attitude.tilt_at(time_ns).sigma_deg
    off_m = abs(antenna_m) * math.radians(sigma_deg)
    if off_m <= most_m / math.sqrt(2.0):
        return ""
    return (
        f"Roll or pitch is known to {sigma_deg:.0f}° only, by which the antenna, "
        f"{abs(antenna_m):.1f} m up, may be {off_m:.2f} m off. Turns make it surer; an "
        "accelerometer (all axes of an IMU) or recorded roll and pitch tell it at once."
    )
