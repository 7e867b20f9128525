"""A verdict on every fix: which are fit to map with, and why the others are not.

The gates are physical. A receiver's own confidence widens them at most; a jump with a confident
covariance is still a jump.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fieldgrid.geodesy import Datum
from fieldgrid.gnss.fix import QUALITY_NAMES, Fix, position_sigma_m
from fieldgrid.trajectory import Status


class Verdict(NamedTuple):
    """What conditioning made of a fix; a rejected one has its reason in words."""

    status: Status
    reason: str = ""


@dataclass(frozen=True, slots=True)
class GateLimits:
    """What a fix must satisfy.

    `allowed_quality` are GGA codes; `max_age_s` is the age of the differential correction,
    asked of the qualities that use one. Between two fixes a vehicle may move at the larger of
    their recorded speeds plus `speed_margin_mps`, or at `max_speed_mps` where none is recorded,
    and `sigmas` standard deviations of the displacement more.

    When `moved_fixes` fixes over `moved_s` seconds are rejected as a jump and agree with each
    other, it is the solution that has moved, and they are followed. Multipath that lasts a
    second or two must not reach that.
    """

    allowed_quality: frozenset[int] = frozenset({1, 2, 3, 4, 5, 9})
    min_satellites: int = 5
    max_hdop: float = 4.0
    max_age_s: float = 10.0
    speed_margin_mps: float = 1.0
    max_speed_mps: float = 20.0
    sigmas: float = 4.0
    moved_fixes: int = 10
    moved_s: float = 3.0


DEFAULT_LIMITS = GateLimits()

_WITH_CORRECTION = frozenset({2, 4, 5})
_LOWEST_M, _HIGHEST_M = -1000.0, 10_000.0


def condition(fixes: Sequence[Fix], limits: GateLimits = DEFAULT_LIMITS) -> list[Verdict]:
    """One verdict per fix, in their order. Accepted fixes increase strictly in time.

    Where the solution has moved, the fix from which it is followed is accepted with a reason:
    the seam.
    """
    gate = _MotionGate(limits, fixes)
    return [
        _rejected(_place_reason(fix) or _receiver_reason(fix, limits)) or gate.verdict(k)
        for k, fix in enumerate(fixes)
    ]


def _rejected(reason: str) -> Verdict | None:
    return Verdict(Status.REJECTED, reason) if reason else None


def _place_reason(fix: Fix) -> str:
    """Why the coordinates cannot be those of a vehicle, or nothing."""
    lat, lon, height = fix.lat_deg, fix.lon_deg, fix.height_m
    if not all(math.isfinite(v) for v in (lat, lon, height)):
        return f"latitude {lat}, longitude {lon}, height {height} m are not all numbers"
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
        return f"latitude {lat:.6f}, longitude {lon:.6f} are not on Earth"
    if not _LOWEST_M <= height <= _HIGHEST_M:
        return f"height {height:.1f} m is outside {_LOWEST_M:.0f}..{_HIGHEST_M:.0f} m"
    if lat == 0.0 and lon == 0.0:
        return "latitude 0, longitude 0 is what a receiver writes without a position"
    return ""


def _receiver_reason(fix: Fix, limits: GateLimits) -> str:
    """Why the fix is unfit by what the receiver itself says, or nothing."""
    if fix.quality not in limits.allowed_quality:
        name = QUALITY_NAMES.get(fix.quality, "unknown")
        return f"quality {fix.quality} ({name}) is not allowed"
    if fix.satellites is not None and fix.satellites < limits.min_satellites:
        return f"{fix.satellites} satellites < {limits.min_satellites}"
    if fix.hdop is not None and not fix.hdop <= limits.max_hdop:
        return f"HDOP {fix.hdop:g} > {limits.max_hdop:g}"
    age_s = fix.age_s if fix.quality in _WITH_CORRECTION else None
    if age_s is not None and not age_s <= limits.max_age_s:
        return f"differential age {age_s:g} s > {limits.max_age_s:g} s"
    return ""


class _MotionGate:
    """Judges fixes in turn by when and where the last accepted one was."""

    def __init__(self, limits: GateLimits, fixes: Sequence[Fix]) -> None:
        self._limits = limits
        self._fixes = fixes
        self._east_m, self._north_m = _positions(fixes)
        self._last: int | None = None
        self._elsewhere: list[int] = []  # jumps since then that agree with each other

    def verdict(self, k: int) -> Verdict:
        """The verdict on fix `k`, whose place and quality are in order."""
        reason = self._time_reason(k)
        if reason:
            return Verdict(Status.REJECTED, reason)
        jump = self._jump_reason(k)
        if jump:
            if not (self._elsewhere and self._strain(self._elsewhere[-1], k) <= 1.0):
                self._elsewhere.clear()
            self._elsewhere.append(k)
            if not self._has_moved():
                return Verdict(Status.REJECTED, jump)
            jump = f"the solution has moved: {len(self._elsewhere)} fixes agree on it; {jump}"
        self._last = k
        self._elsewhere.clear()
        return Verdict(Status.OK, jump)

    def _time_reason(self, k: int) -> str:
        now_ns = self._fixes[k].time_ns
        last_ns = None if self._last is None else self._fixes[self._last].time_ns
        if last_ns is not None and now_ns <= last_ns:
            if now_ns == last_ns:
                return "time is that of the last accepted fix"
            return f"time is {(last_ns - now_ns) / 1e9:g} s before the last accepted fix"
        # One stamp far in the future would condemn everything that follows it.
        next_ns = self._fixes[k + 1].time_ns if k + 1 < len(self._fixes) else now_ns
        if next_ns < now_ns and (last_ns is None or last_ns < next_ns):
            return f"time is {(now_ns - next_ns) / 1e9:g} s after that of the next fix"
        return ""

    def _jump_reason(self, k: int) -> str:
        """Why the vehicle did not drive from the last accepted fix to `k`, or nothing."""
        if self._last is None:
            return ""
        strain = self._strain(self._last, k)
        if not strain <= 1.0:
            a, b = self._fixes[self._last], self._fixes[k]
            seconds, moved_m = _seconds(a, b), self._distance_m(self._last, k)
            return (
                f"jump of {moved_m:.2f} m in {seconds:.2f} s implies {moved_m / seconds:.0f} m/s; "
                f"speed and accuracy explain {self._explained_m(a, b):.2f} m"
            )
        # In time a vehicle could have driven to where the solution jumped. As long as a fix
        # carries on from the jumped ones better than from the good ones, it is one of them.
        if self._elsewhere and self._strain(self._elsewhere[-1], k) < strain:
            n = len(self._elsewhere)
            return f"carries on from the jump {n} {'fix' if n == 1 else 'fixes'} before"
        return ""

    def _strain(self, a: int, b: int) -> float:
        """Distance of two fixes over what explains it: a drive is 1 at most."""
        if self._fixes[b].time_ns <= self._fixes[a].time_ns:
            return math.inf
        return self._distance_m(a, b) / self._explained_m(self._fixes[a], self._fixes[b])

    def _explained_m(self, a: Fix, b: Fix) -> float:
        limits = self._limits
        if a.speed_mps is None or b.speed_mps is None:
            speed_mps = limits.max_speed_mps
        else:
            speed_mps = max(a.speed_mps, b.speed_mps) + limits.speed_margin_mps
        sigma_m = max(position_sigma_m(a), position_sigma_m(b))
        return speed_mps * _seconds(a, b) + limits.sigmas * math.sqrt(2.0) * sigma_m

    def _distance_m(self, a: int, b: int) -> float:
        east, north = self._east_m, self._north_m
        return math.hypot(east[b] - east[a], north[b] - north[a])

    def _has_moved(self) -> bool:
        first, last = self._fixes[self._elsewhere[0]], self._fixes[self._elsewhere[-1]]
        return (
            len(self._elsewhere) >= self._limits.moved_fixes
            and _seconds(first, last) >= self._limits.moved_s
        )


def _seconds(a: Fix, b: Fix) -> float:
    return (b.time_ns - a.time_ns) / 1e9


def _positions(fixes: Sequence[Fix]) -> tuple[list[float], list[float]]:
    """Metres east and north of the first fix on Earth; 0 for those that are not on it."""
    placed = [not _place_reason(fix) for fix in fixes]
    if not any(placed):
        return [0.0] * len(fixes), [0.0] * len(fixes)
    first = fixes[placed.index(True)]
    usable = [fix if ok else first for fix, ok in zip(fixes, placed, strict=True)]
    lat, lon, height = (np.array(column) for column in list(zip(*usable, strict=True))[1:4])
    east, north, _ = Datum(first.lat_deg, first.lon_deg, first.height_m).to_enu(lat, lon, height)
    return east.tolist(), north.tolist()
