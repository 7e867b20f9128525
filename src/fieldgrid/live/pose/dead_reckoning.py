"""Motion since the latest estimate by gyro and wheels: for sweeps, and frames without a step.

An estimate is always some tenths of a second old and lacks the newest measurements.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.live.pose.sensor_rows import RecentRows, SensorTrack, ticks
from fieldgrid.perception import LONGEST_S, CameraStep, OriginTrack
from fieldgrid.poses import Estimate

KNOWN_S, ROLLED_S = 1.5, 1.0
"""The time for which the speed of an estimate holds where there are no wheels, and the time over
which a frame is placed by it and the gyro."""

WHEEL_SHARE = 0.03
"""The error of the wheels' way, 1 sigma: as the smoother takes their scale."""

ACCELERATION_MPS2, TURN_DEG, SLIDE_M = 1.0, 0.3, 0.01
"""How much speed and heading may change in a second beside what is measured, and how far a vehicle
slides on a metre, 1 sigma: the smoother's."""


class _EstimateEnd(NamedTuple):
    """The end of an estimate: when, the speed then, and the gyro's bias."""

    time_ns: int
    speed_mps: float
    bias_rad_s: float


class DeadReckoning:
    """Takes estimates, and gives short motions of the grid origin by the gyro and wheels of the
    rows of now. Can be used from any thread."""

    def __init__(self, rows: RecentRows, rear_axle_forward_m: float | None) -> None:
        self._rows = rows
        self._axle_m = rear_axle_forward_m or 0.0
        self._known: _EstimateEnd | None = None

    def know(self, estimate: Estimate) -> None:
        """The latest estimate."""
        track, bias_dps = estimate.trajectory, estimate.report.gyro_bias_dps
        ok = track.accepted
        if ok.any():
            bias_rad_s = 0.0 if math.isnan(bias_dps) else math.radians(bias_dps)
            end = int(track.time_ns[ok][-1]), float(track.speed_mps[ok][-1])
            self._known = _EstimateEnd(*end, bias_rad_s)

    def _track(self, part: str) -> SensorTrack:
        return self._rows.track(part, 1)

    def around(self, time_ns: int) -> OriginTrack | None:
        """The way around an instant, as far as a sweep may reach; None where nothing tells how
        the vehicle goes then."""
        return self._way(time_ns, time_ns, round(LONGEST_S * 1e9))

    def step(self, from_ns: int, to_ns: int) -> CameraStep | None:
        """The motion from one instant to a later one; None where that is long or nothing tells
        it."""
        took_s = (to_ns - from_ns) / 1e9
        way = self._way(from_ns, to_ns, 0) if 0.0 < took_s <= ROLLED_S else None
        if way is None:
            return None
        right_m, forward_m = float(way.east_m[-1]), float(way.north_m[-1])
        gone_m = math.hypot(right_m, forward_m)
        along_m = ACCELERATION_MPS2 * math.sqrt(took_s**3 / 3.0)
        if self._track("wheels").holds(from_ns, to_ns):
            along_m = WHEEL_SHARE * gone_m
        return CameraStep(
            *(forward_m, right_m, math.degrees(float(way.heading_rad[-1]))),
            math.hypot(along_m, SLIDE_M * math.sqrt(gone_m)),
            TURN_DEG * math.sqrt(took_s),
            *(math.nan, math.nan, math.nan, math.nan),
            0,
        )

    def _way(self, from_ns: int, to_ns: int, beyond_ns: int) -> OriginTrack | None:
        """The way from one instant to another and `beyond_ns` beyond both, which begins at 0, 0
        with the heading 0."""
        gyro, wheels, known = self._track("gyro"), self._track("wheels"), self._known
        if not gyro.holds(from_ns, to_ns):
            return None
        at_ns = ticks(from_ns - beyond_ns, to_ns + beyond_ns)
        if wheels.holds(from_ns, to_ns):
            speed_mps = wheels.at(at_ns)[:, 0]
        elif known is not None and abs(to_ns - known.time_ns) <= KNOWN_S * 1e9:
            speed_mps = np.full(len(at_ns), known.speed_mps)
        else:
            return None
        rate_rad_s = gyro.at(at_ns)[:, 0] - (known.bias_rad_s if known is not None else 0.0)
        heading_rad = _summed(rate_rad_s, at_ns)
        # The axle goes straight ahead; the origin, which lies off it, slides in turns.
        across_mps = -self._axle_m * rate_rad_s
        sin, cos = np.sin(heading_rad), np.cos(heading_rad)
        east_m = _summed(speed_mps * sin + across_mps * cos, at_ns)
        north_m = _summed(speed_mps * cos - across_mps * sin, at_ns)
        return OriginTrack(at_ns, east_m, north_m, heading_rad)


def _summed(rate: Float64, time_ns: Int64) -> Float64:
    """The integral of a rate per second, 0 at the first instant."""
    added = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time_ns) / 1e9
    return np.concatenate([[0.0], np.cumsum(added)])
