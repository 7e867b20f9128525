"""A verdict on every fix: which are fit to map with, and why the others are not.

The gates are physical. A receiver's own confidence widens them at most; a jump with a confident
covariance is still a jump. A fix is asked in this order: its place, what the receiver says of it,
its time, whether it is one at all or a repeat, and whether a vehicle drove there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from fieldgrid.core import CARRIER, CODE, Bool, GateLimits, Index, Quality
from fieldgrid.geometry import NOT_SAID, Datum, FixColumns
from fieldgrid.poses.gates.motion_gate import (
    MotionEnvelope,
    Transition,
    follow,
    motion_envelope,
    transition,
)
from fieldgrid.poses.gates.repeats import held_ns
from fieldgrid.poses.gates.verdict import DEFAULT_LIMITS, REPEATS, Gate, Verdicts

_LAST_NS = 2**62  # differences of such times still fit into 64 bits
NO_STRAYS: Mapping[int, str] = MappingProxyType({})
_LOWEST_M, _HIGHEST_M = -1000.0, 10_000.0

_Verdict = tuple[int, Gate, str]
"""A row, the gate that it failed, and why: a clause for people."""


def condition(
    fixes: FixColumns,
    limits: GateLimits = DEFAULT_LIMITS,
    strays: Mapping[int, str] = NO_STRAYS,
) -> Verdicts:
    """The verdicts on fixes in order of time. Accepted fixes increase strictly in it.

    The whole drive is judged at once, so a fix may be rejected for what came after it. Where the
    solution has moved, the fix from which it is followed is accepted with a reason: the seam.
    `strays` are rows that an estimate of the drive denies, with the reason of each: the others are
    judged without them.
    """
    ok = np.ones(len(fixes), dtype=np.bool_)
    gate, reason = [Gate.NONE] * len(fixes), [""] * len(fixes)

    def judge(found: Iterable[_Verdict]) -> None:
        for row, failed, why in found:
            if ok[row]:
                ok[row], gate[row], reason[row] = failed is Gate.SEAM, failed, why

    judge(_unfit(fixes, limits))
    judge(_repeats(fixes, np.flatnonzero(ok)))
    judge((row, Gate.STRAY, why) for row, why in strays.items())
    judge(_undriven(fixes, np.flatnonzero(ok), limits))
    return Verdicts(ok, tuple(gate), tuple(reason))


def _unfit(fixes: FixColumns, limits: GateLimits) -> Iterator[_Verdict]:
    """Places and times that cannot be those of a vehicle, and what the receiver itself says."""
    lat, lon, height, time_ns = fixes.lat_deg, fixes.lon_deg, fixes.height_m, fixes.time_ns
    quality, satellites, hdop, age_s = fixes.quality, fixes.satellites, fixes.hdop, fixes.age_s
    # A receiver may still write the age of a correction that it does not use.
    with_correction = [np.isin(quality, list(kinds)) for kinds in (CARRIER, CODE)]
    most_s = np.select(with_correction, [limits.max_age_s, limits.max_code_age_s], np.inf)
    rules: tuple[tuple[Bool, Gate, Callable[[int], str]], ...] = (
        (
            ~(np.isfinite(lat) & np.isfinite(lon) & np.isfinite(height)),
            Gate.PLACE,
            lambda k: (
                f"latitude {lat[k]}, longitude {lon[k]}, height {height[k]} m are not all numbers"
            ),
        ),
        (
            ~((np.abs(lat) <= 90.0) & (np.abs(lon) <= 180.0)),
            Gate.PLACE,
            lambda k: f"latitude {lat[k]:.6f}, longitude {lon[k]:.6f} are not on Earth",
        ),
        (
            ~((height >= _LOWEST_M) & (height <= _HIGHEST_M)),
            Gate.PLACE,
            lambda k: f"height {height[k]:.1f} m is outside {_LOWEST_M:.0f}..{_HIGHEST_M:.0f} m",
        ),
        (
            (lat == 0.0) & (lon == 0.0),
            Gate.PLACE,
            lambda _: "latitude 0, longitude 0 is what a receiver writes without a position",
        ),
        (
            (time_ns >= _LAST_NS) | (time_ns <= -_LAST_NS),
            Gate.TIME,
            lambda k: f"time {time_ns[k]} ns is in no year from 1824 to 2116",
        ),
        (
            ~np.isin(quality, list(limits.allowed_quality)),
            Gate.QUALITY,
            lambda k: f"{_named(Quality(int(quality[k])))} is not allowed",
        ),
        (
            (satellites != NOT_SAID) & (satellites < limits.min_satellites),
            Gate.SATELLITES,
            lambda k: f"{satellites[k]} satellites < {limits.min_satellites}",
        ),
        (hdop > limits.max_hdop, Gate.HDOP, lambda k: f"HDOP {hdop[k]:g} > {limits.max_hdop:g}"),
        (
            age_s > most_s,
            Gate.AGE,
            lambda k: f"differential age {age_s[k]:g} s > {most_s[k]:g} s",
        ),
    )
    for failing, gate, why in rules:
        yield from ((row, gate, why(row)) for row in np.flatnonzero(failing).tolist())


def _named(quality: Quality) -> str:
    code = "" if quality is Quality.UNKNOWN else f" {quality:d}"
    return f"quality{code} ({quality.label})"


def _repeats(fixes: FixColumns, rows: Index) -> Iterator[_Verdict]:
    """Rows that are no positions of their own."""
    used = fixes[rows]
    age_ns = held_ns(used.time_ns, used.lat_deg, used.lon_deg, used.speed_mps)
    for k in np.flatnonzero(age_ns >= 0):
        ago = f"position of the fix {age_ns[k] / 1e9:.2f} s before"
        yield (
            int(rows[k]),
            Gate.REPEAT,
            f"{REPEATS} {ago if age_ns[k] else 'fix before it, place and time'}",
        )


def _undriven(fixes: FixColumns, rows: Index, limits: GateLimits) -> Iterator[_Verdict]:
    """Rows, which are ordered by time, that no vehicle drove through, by the motion of the whole
    drive, and seams."""
    if not len(rows):
        return
    used = fixes[rows]
    # A latitude and a longitude of the log: a mean of two would be half round the Earth at 180°.
    lat, lon = (float(np.sort(one)[len(rows) // 2]) for one in (used.lat_deg, used.lon_deg))
    place = Datum(lat, lon, 0.0).to_enu(used.lat_deg, used.lon_deg, used.height_m)
    envelope = motion_envelope(used.time_ns, *place[:2], used.position_sigma_m(), limits)
    is_kept, seam = follow(envelope)
    kept = np.flatnonzero(is_kept)
    jump_at = -1  # where the run of rejected fixes that agree with each other began
    for k in np.flatnonzero(~is_kept).tolist():
        after = int(np.searchsorted(kept, k))
        last = int(kept[after - 1]) if after else -1
        carried_on = jump_at > last and transition(envelope, k - 1, k).strain <= 1.0
        jump_at = jump_at if carried_on else k
        yield int(rows[k]), *_off_verdict(envelope, k, jump_at, last, kept[after:])
    parts = [*np.flatnonzero(seam).tolist(), len(rows)]
    for first, end in pairwise(parts):
        agree = int(np.count_nonzero(is_kept[first:end]))
        before = int(kept[np.searchsorted(kept, first) - 1])
        _, reason = _break(transition(envelope, before, first))
        on_it = "1 fix agrees" if agree == 1 else f"{agree} fixes agree"
        moved = f"the solution has moved: {on_it} on it; {reason}"
        yield int(rows[first]), Gate.SEAM, moved


def _off_verdict(
    envelope: MotionEnvelope, k: int, jump_at: int, last: int, later: Index
) -> tuple[Gate, str]:
    """Why row `k` is not one of those that the vehicle drove through.

    `last` is the accepted row before it (-1 for none) and `later` are those after it; rows
    from `jump_at` on agree with each other.
    """
    if last < 0:
        agree = f"{len(later)} later {'fix agrees' if len(later) == 1 else 'fixes agree'} elsewhere"
        return Gate.ALONE, f"stands alone: {agree}"
    if envelope.time_ns[k] == envelope.time_ns[last]:
        return Gate.TIME, "time is that of the last accepted fix"
    if jump_at < k:
        before = f"{k - jump_at} {'fix' if k - jump_at == 1 else 'fixes'} before"
        return Gate.JUMP, f"carries on from the jump {before}"
    step = transition(envelope, last, k)
    if step.strain > 1.0:
        return _break(step)
    if len(later) and (onward := transition(envelope, k, int(later[0]))).strain > 1.0:
        gate, reason = _break(onward)
        return gate, f"{reason}, to the next accepted fix"
    return Gate.JUMP, f"lies {step.off_m:.2f} m off the way between its neighbours"


def _break(step: Transition) -> tuple[Gate, str]:
    """Which kind of motion a step would have been that no vehicle makes, and the sentence."""
    seconds, explained_m = max(step.seconds, 1e-9), f"{step.explained_m:.2f} m"
    off = f"{step.off_m:.2f} m off the way driven, where speed and accuracy explain {explained_m}"
    speed_mps, usual_mps = step.moved_m / seconds, step.distance_m / seconds
    if step.moved_m > step.distance_m + step.explained_m or step.off_m <= step.explained_m:
        jump = f"jump of {step.moved_m:.2f} m in {seconds:.2f} s implies {speed_mps:.0f} m/s"
        return Gate.JUMP, f"{jump}; {off}"
    if abs(step.along_m) >= abs(step.across_m):
        change = f"speed would go from {usual_mps:.1f} to {speed_mps:.1f} m/s in {seconds:.2f} s"
        return Gate.ACCELERATION, f"{change}; {off}"
    turn_deg = math.degrees(math.atan2(abs(step.across_m), step.distance_m + step.along_m))
    turn = f"course would turn by {turn_deg:.0f}° in {seconds:.2f} s at {usual_mps:.1f} m/s"
    return Gate.TURN_RATE, f"{turn}; {off}"
