"""A verdict on every fix: which are fit to map with, and why the others are not.

The gates are physical. A receiver's own confidence widens them at most; a jump with a confident
covariance is still a jump. A fix is asked in this order: its place, what the receiver says of it,
its time, whether it is one at all or a repeat, and whether a vehicle drove there, up and along.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fieldgrid.array_types import Float64, Index, Int64
from fieldgrid.geodesy import Datum
from fieldgrid.gnss.climb import SPOILT_S, climb_mps, spoilt
from fieldgrid.gnss.fix import QUALITY_NAMES, Fix, position_sigma_m
from fieldgrid.gnss.motion_gate import Course, Step, course_of, follow, step_between
from fieldgrid.gnss.repeats import held_ns
from fieldgrid.gnss.verdict import DEFAULT_LIMITS, Kind, Verdict
from fieldgrid.settings import GateLimits
from fieldgrid.trajectory import Status

__all__ = ["DEFAULT_LIMITS", "GateLimits", "Kind", "Verdict", "condition"]


_WITH_CARRIER, _WITH_CODE = frozenset({4, 5}), frozenset({2, 9})
_LAST_NS = 2**62  # differences of such times still fit into 64 bits
_LOWEST_M, _HIGHEST_M = -1000.0, 10_000.0


def condition(fixes: Sequence[Fix], limits: GateLimits = DEFAULT_LIMITS) -> list[Verdict]:
    """One verdict per fix, in their order. Accepted fixes increase strictly in time.

    The whole drive is judged at once, so a fix may be rejected for what came after it. Where the
    solution has moved, the fix from which it is followed is accepted with a reason: the seam.
    """
    verdicts = [
        _place_verdict(fix) or _receiver_verdict(fix, limits) or Verdict(Status.OK) for fix in fixes
    ]
    rows = _accepted(verdicts)
    rows = _in_time(fixes, rows, verdicts)
    rows = _without_repeats(fixes, rows, verdicts)
    rows = _on_ground(fixes, rows, verdicts, limits)
    _follow_motion(fixes, rows, verdicts, limits)
    return verdicts


def _accepted(verdicts: Sequence[Verdict]) -> Index:
    return np.array([k for k, v in enumerate(verdicts) if v.status is Status.OK], dtype=np.intp)


def _rejected(kind: Kind, reason: str) -> Verdict:
    return Verdict(Status.REJECTED, reason, kind)


# --- what a fix says of itself


def _place_verdict(fix: Fix) -> Verdict | None:
    """Why place and time cannot be those of a vehicle, or nothing."""
    lat, lon, height = fix.lat_deg, fix.lon_deg, fix.height_m
    if not math.isfinite(lat + lon + height):
        reason = f"latitude {lat}, longitude {lon}, height {height} m are not all numbers"
    elif not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
        reason = f"latitude {lat:.6f}, longitude {lon:.6f} are not on Earth"
    elif not _LOWEST_M <= height <= _HIGHEST_M:
        reason = f"height {height:.1f} m is outside {_LOWEST_M:.0f}..{_HIGHEST_M:.0f} m"
    elif lat == 0.0 and lon == 0.0:
        reason = "latitude 0, longitude 0 is what a receiver writes without a position"
    elif abs(fix.time_ns) >= _LAST_NS:
        return _rejected(Kind.TIME, f"time {fix.time_ns} ns is in no year from 1824 to 2116")
    else:
        return None
    return _rejected(Kind.PLACE, reason)


def _receiver_verdict(fix: Fix, limits: GateLimits) -> Verdict | None:
    """Why the fix is unfit by what the receiver itself says, or nothing."""
    quality, age_s = fix.quality, fix.age_s
    if quality not in limits.allowed_quality:
        name = QUALITY_NAMES.get(quality, "unknown")
        return _rejected(Kind.QUALITY, f"quality {quality} ({name}) is not allowed")
    if fix.satellites is not None and fix.satellites < limits.min_satellites:
        reason = f"{fix.satellites} satellites < {limits.min_satellites}"
        return _rejected(Kind.SATELLITES, reason)
    if fix.hdop is not None and not fix.hdop <= limits.max_hdop:
        return _rejected(Kind.HDOP, f"HDOP {fix.hdop:g} > {limits.max_hdop:g}")
    if age_s is not None and (quality in _WITH_CARRIER or quality in _WITH_CODE):
        # A receiver may still write the age of a correction that it does not use.
        most_s = limits.max_age_s if quality in _WITH_CARRIER else limits.max_code_age_s
        if not age_s <= most_s:
            return _rejected(Kind.AGE, f"differential age {age_s:g} s > {most_s:g} s")
    return None


# --- when it was taken


def _in_time(fixes: Sequence[Fix], rows: Index, verdicts: list[Verdict]) -> Index:
    """The rows that are left when as few as possible are dropped for the time not to go back.

    One stamp far in the future condemns itself, not all that follow it.
    """
    time_ns = [fixes[k].time_ns for k in rows]
    kept = _longest_rising(time_ns)
    wrong = np.setdiff1d(np.arange(len(rows)), kept)
    for k in wrong:
        after = int(np.searchsorted(kept, k))
        before_ns = time_ns[kept[after - 1]] if after else None
        if before_ns is not None and time_ns[k] < before_ns:
            reason = f"time is {(before_ns - time_ns[k]) / 1e9:g} s before the last accepted fix"
        else:
            reason = (
                f"time is {(time_ns[k] - time_ns[kept[after]]) / 1e9:g} s after that of the next "
                "fix"
            )
        verdicts[rows[k]] = _rejected(Kind.TIME, reason)
    return rows[kept]


def _longest_rising(values: Sequence[int]) -> Index:
    """Indices of the longest subsequence that never falls."""
    if all(a <= b for a, b in pairwise(values)):
        return np.arange(len(values))
    # Of the subsequences of each length the one that ends lowest: its last value, and where.
    least_end: list[int] = []
    ends_at: list[int] = []
    before: list[int] = []
    for k, value in enumerate(values):
        length = bisect_right(least_end, value)
        before.append(ends_at[length - 1] if length else -1)
        least_end[length : length + 1] = [value]
        ends_at[length : length + 1] = [k]
    found = []
    k = ends_at[-1]
    while k >= 0:
        found.append(k)
        k = before[k]
    return np.array(found[::-1], dtype=np.intp)


def _without_repeats(fixes: Sequence[Fix], rows: Index, verdicts: list[Verdict]) -> Index:
    """The rows that are positions of their own."""
    time_ns, lat_deg, lon_deg = _times(fixes, rows), *_degrees(fixes, rows)
    age_ns = held_ns(time_ns, lat_deg, lon_deg, _speeds(fixes, rows))
    for k in np.flatnonzero(age_ns >= 0):
        reason = (
            f"repeats the position of the fix {age_ns[k] / 1e9:.2f} s before"
            if age_ns[k]
            else "repeats the fix before it, place and time"
        )
        verdicts[rows[k]] = _rejected(Kind.REPEAT, reason)
    return rows[age_ns < 0]


# --- whether a vehicle drove through it


def _on_ground(
    fixes: Sequence[Fix], rows: Index, verdicts: list[Verdict], limits: GateLimits
) -> Index:
    """The rows that do not climb or sink faster than a vehicle, nor lie near such."""
    time_ns = _times(fixes, rows)
    rate_mps = climb_mps(time_ns, np.array([fixes[k].height_m for k in rows], dtype=np.float64))
    away = spoilt(time_ns, np.abs(rate_mps) > limits.max_climb_mps)
    for k in np.flatnonzero(away).tolist():
        steep = "climbs" if rate_mps[k] >= 0.0 else "sinks"
        reason = f"height {steep} at {abs(rate_mps[k]):.1f} m/s: the solution has come apart"
        if abs(rate_mps[k]) <= limits.max_climb_mps:
            reason = f"height runs away within {SPOILT_S:g} s: the solution has come apart"
        verdicts[rows[k]] = _rejected(Kind.CLIMB, reason)
    return rows[~away]


def _follow_motion(
    fixes: Sequence[Fix], rows: Index, verdicts: list[Verdict], limits: GateLimits
) -> None:
    """Judge the rows, which are ordered by time, by the motion of the whole drive."""
    if not len(rows):
        return
    east_m, north_m = _metres(fixes, rows)
    sigma_m = np.array([position_sigma_m(fixes[k]) for k in rows])
    course = course_of(_times(fixes, rows), east_m, north_m, sigma_m, _speeds(fixes, rows), limits)
    followed = follow(course)
    kept = np.flatnonzero(followed.kept)
    jump_at = -1  # where the run of rejected fixes that agree with each other began
    for k in np.flatnonzero(~followed.kept).tolist():
        after = int(np.searchsorted(kept, k))
        last = int(kept[after - 1]) if after else -1
        carried_on = jump_at > last and step_between(course, k - 1, k).strain <= 1.0
        jump_at = jump_at if carried_on else k
        verdicts[rows[k]] = _off_verdict(course, k, jump_at, last, kept[after:])
    parts = [*np.flatnonzero(followed.seam).tolist(), len(course.time_ns)]
    for first, end in pairwise(parts):
        agree = int(np.count_nonzero(followed.kept[first:end]))
        before = int(kept[np.searchsorted(kept, first) - 1])
        verdicts[rows[first]] = _seam_verdict(step_between(course, before, first), agree)


def _off_verdict(course: Course, k: int, jump_at: int, last: int, later: Index) -> Verdict:
    """Why row `k` is not one of those that the vehicle drove through.

    `last` is the accepted row before it (-1 for none) and `later` are those after it; rows
    from `jump_at` on agree with each other.
    """
    if last < 0:
        agree = f"{len(later)} later {'fix agrees' if len(later) == 1 else 'fixes agree'} elsewhere"
        return _rejected(Kind.ALONE, f"stands alone: {agree}")
    if course.time_ns[k] == course.time_ns[last]:
        return _rejected(Kind.TIME, "time is that of the last accepted fix")
    if jump_at < k:
        before = f"{k - jump_at} {'fix' if k - jump_at == 1 else 'fixes'} before"
        return _rejected(Kind.JUMP, f"carries on from the jump {before}")
    step = step_between(course, last, k)
    if step.strain > 1.0:
        return _rejected(*_break(step))
    if len(later) and (onward := step_between(course, k, int(later[0]))).strain > 1.0:
        kind, reason = _break(onward)
        return _rejected(kind, f"{reason}, to the next accepted fix")
    return _rejected(Kind.JUMP, f"lies {step.off_m:.2f} m off the way between its neighbours")


def _seam_verdict(step: Step, agree: int) -> Verdict:
    _, reason = _break(step)
    fixes = "1 fix agrees" if agree == 1 else f"{agree} fixes agree"
    return Verdict(Status.OK, f"the solution has moved: {fixes} on it; {reason}", Kind.SEAM)


def _break(step: Step) -> tuple[Kind, str]:
    """Which kind of motion a step would have been that no vehicle makes, and the sentence."""
    seconds, explained_m = max(step.seconds, 1e-9), f"{step.explained_m:.2f} m"
    off = f"{step.off_m:.2f} m off the way driven, where speed and accuracy explain {explained_m}"
    speed_mps, way_mps = step.moved_m / seconds, step.way_m / seconds
    if step.moved_m > step.way_m + step.explained_m or step.off_m <= step.explained_m:
        jump = f"jump of {step.moved_m:.2f} m in {seconds:.2f} s implies {speed_mps:.0f} m/s"
        return Kind.JUMP, f"{jump}; {off}"
    if abs(step.along_m) >= abs(step.across_m):
        change = f"speed would go from {way_mps:.1f} to {speed_mps:.1f} m/s in {seconds:.2f} s"
        return Kind.ACCELERATION, f"{change}; {off}"
    turn_deg = math.degrees(math.atan2(abs(step.across_m), step.way_m + step.along_m))
    turn = f"course would turn by {turn_deg:.0f}° in {seconds:.2f} s at {way_mps:.1f} m/s"
    return Kind.TURN_RATE, f"{turn}; {off}"


def _times(fixes: Sequence[Fix], rows: Index) -> Int64:
    return np.array([fixes[k].time_ns for k in rows], dtype=np.int64)


def _degrees(fixes: Sequence[Fix], rows: Index) -> tuple[Float64, Float64]:
    return (
        np.array([fixes[k].lat_deg for k in rows], dtype=np.float64),
        np.array([fixes[k].lon_deg for k in rows], dtype=np.float64),
    )


def _speeds(fixes: Sequence[Fix], rows: Index) -> Float64:
    return np.array([fixes[k].speed_mps for k in rows], dtype=np.float64)  # None becomes NaN


def _metres(fixes: Sequence[Fix], rows: Index) -> tuple[Float64, Float64]:
    """Metres east and north of the middle of the log."""
    lat_deg, lon_deg = _degrees(fixes, rows)
    # A latitude and a longitude of the log: a mean of two would be half round the Earth at 180°.
    middle = len(rows) // 2
    datum = Datum(float(np.sort(lat_deg)[middle]), float(np.sort(lon_deg)[middle]), 0.0)
    height_m = np.array([fixes[k].height_m for k in rows], dtype=np.float64)
    east_m, north_m, _ = datum.to_enu(lat_deg, lon_deg, height_m)
    return east_m, north_m
