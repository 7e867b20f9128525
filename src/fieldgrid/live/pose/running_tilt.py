"""How the vehicle leans while it drives: the latest estimate, carried on by the IMU's rates or by
recorded angles.

An estimate is always some tenths of a second older than the frame that is gridded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import (
    Pose,
    R_enu_level,
    R_level_vehicle,
    Tilt,
    from_vectors,
    roll_pitch_deg,
    to_vectors,
)
from fieldgrid.live.pose.sensor_rows import RecentRows, SensorTrack
from fieldgrid.poses import Attitude

BIAS_S, PIECE_NS, LEAST_PIECES = 10.0, 1_000_000_000, 3
"""Over the last seconds of an estimate the bias of the rates is told, in pieces, and of no less."""

CARRIED_S = 5.0
"""Time after the end of the estimate for which the lean is known."""

DRIFT_DEG = 0.2
"""How far carried angles are off after a second, 1 sigma."""

_TICK_S = 0.02
_COLUMNS = {"inertial": 1, "tilt": 2, "orientation": 2}
"""Number of the columns that tell how the lean changes, by the part that has them."""


class _LatestEstimate(NamedTuple):
    """The latest estimate, and the bias of the rates by it, rad/s [3]."""

    attitude: Attitude
    bias_rad_s: Float64


class RunningTilt(RecentRows):
    """Takes rows and estimates, and gives the tilt of the vehicle. Safe from any thread."""

    def __init__(self) -> None:
        super().__init__(_COLUMNS)
        self._known: _LatestEstimate | None = None

    def know(self, attitude: Attitude | None) -> None:
        """The latest estimate; None where nothing tells how the vehicle leans."""
        self._known = None
        if attitude is not None:
            self._known = _LatestEstimate(attitude, self._bias_rad_s(attitude))

    def _bias_rad_s(self, attitude: Attitude) -> Float64:
        """How far the rates are off by an estimate over its last seconds, [3]; 0 where they are
        missing or too few to tell."""
        until_ns = int(attitude.time_ns[-1])
        since_ns = max(int(attitude.time_ns[0]), until_ns - round(BIAS_S * 1e9))
        pieces = int((until_ns - since_ns) // PIECE_NS)
        track = self.track("inertial")
        if pieces < LEAST_PIECES or not track.holds(since_ns, until_ns):
            return np.zeros(3)
        edges_ns = until_ns - PIECE_NS * np.arange(pieces, -1, -1)
        ends = attitude.at(edges_ns)
        R = R_enu_level(ends.heading_deg) @ R_level_vehicle(ends.roll_deg, ends.pitch_deg)
        # Piece by piece: over more, a turn moves the bias from one axis to another.
        by_rates = [_turned(track, *edges) for edges in pairwise(edges_ns.tolist())]
        off_rad = to_vectors(
            np.stack(by_rates).transpose(0, 2, 1) @ R[:-1].transpose(0, 2, 1) @ R[1:]
        )
        bias = -off_rad.mean(axis=0) / (PIECE_NS / 1e9)
        return bias if np.isfinite(bias).all() else np.zeros(3)

    def at(self, time_ns: int) -> Tilt | None:
        """The tilt at an instant; None where nothing tells it."""
        known = self._known
        if known is None:
            return None
        attitude, end_ns = known.attitude, int(known.attitude.time_ns[-1])
        late_s = (time_ns - end_ns) / 1e9
        if late_s <= 0.0:
            return attitude.tilt_at(time_ns)
        if late_s > CARRIED_S:
            return None
        roll, pitch, sigma = attitude.tilt_at(end_ns)
        sigma = math.hypot(sigma, DRIFT_DEG * late_s)
        for told in (self.track("tilt"), self.track("orientation")):
            if told.holds(end_ns, time_ns):
                (roll_0, pitch_0), (roll_1, pitch_1) = told.at(np.array([end_ns, time_ns]))
                return Tilt(float(roll + roll_1 - roll_0), float(pitch + pitch_1 - pitch_0), sigma)
        track = self.track("inertial")
        if not track.holds(end_ns, time_ns):
            return attitude.tilt_at(time_ns)
        turned = _turned(track._replace(values=track.values - known.bias_rad_s), end_ns, time_ns)
        roll_deg, pitch_deg = roll_pitch_deg(R_level_vehicle(roll, pitch) @ turned)
        return Tilt(float(roll_deg), float(pitch_deg), sigma)


def _turned(rates: SensorTrack, from_ns: int, to_ns: int) -> Float64:
    """The vehicle's axes at the later instant, seen from those at the earlier one [3, 3], by rates
    of turn [n, 3]."""
    count = math.ceil((to_ns - from_ns) / 1e9 / _TICK_S)
    edges_ns = from_ns + np.rint(np.linspace(0, to_ns - from_ns, count + 1)).astype(np.int64)
    middle = rates.at((edges_ns[1:] + edges_ns[:-1]) // 2)
    R = from_vectors(middle * (np.diff(edges_ns) / 1e9)[:, None])
    while len(R) > 1:  # the product in order, neighbours first
        even = np.concatenate([R, np.eye(3)[None]]) if len(R) % 2 else R
        R = even[0::2] @ even[1::2]
    return np.asarray(R[0])


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


TellTilt = Callable[[int], Tilt | None]
"""Gives the tilt of the vehicle at an instant, None where nothing tells it."""
