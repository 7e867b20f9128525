"""What it means that a receiver's solution has leapt by more than it states.

One of the two solutions was wrong by as much, and nobody told. Which one is not known; the longer
it lasted, the better the receiver says it is, and the more often a drive comes back to it, the
likelier it is the right one. A wrong one may have got there bit by bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.poses.faults.leaps.leaps import TORN_S, leaps, usual_period_s

LEAST_M = 0.1
"""A smaller leap is none."""

FREE_SIGMAS = 3.0
"""Largest step that motion and noise explain at a leap, in sigmas of its size."""

RETURN_TRUST, MOST_RETURNS = 10.0, 3.0
"""A solution is right with the probability of its share of the drive, but one that a drive comes
back to from another is likelier by this factor for each return, up to this number of returns: a
wrong one is seldom found twice."""

SAME_SHARE = 0.3
"""Solutions are the same when they lie apart by this share of the usual leap between them."""

MOST_AT_ONCE = 1000
"""Number of solutions that are compared with all others at once."""

BRIEF_S = 3.0
"""What lasted no longer is an excursion: after it the error is that of before."""

LEAP_S = 1e-3
"""Nothing of an error outlasts a leap to another solution."""


class SeamDoubt(NamedTuple):
    """What leaps add to n fixes: `sigma_m` [n] along one axis, and `lasting_s` [n], for how long
    the error that they show stays the same (infinite without any)."""

    sigma_m: Float64
    lasting_s: Float64


class SeenLeap(NamedTuple):
    """A leap that something else than fixes saw: how far east and north of where the vehicle went
    the fix of `time_ns` and what follows it lie, and the error of that along one axis."""

    time_ns: int
    east_m: float
    north_m: float
    sigma_m: float


class _Stretch(NamedTuple):
    """Fixes of one solution, rows from `first` to before `stop`, and for how long it was followed;
    where it lies beside the first one (east and north), and how well that is known (variance).
    Excursions from it lie between."""

    first: int
    stop: int
    lasted_s: float
    place_m: Float64
    unsure_m2: float


class _Solutions(NamedTuple):
    """s stretches that lasted: the first fix of each, for how long, where it lies beside the others
    (east and north [s, 2]), and how well that is known beside the first (variance)."""

    first: Int64
    lasted_s: Float64
    place_m: Float64
    unsure_m2: Float64


def seam_doubt(
    points_m: Float64,
    time_s: Float64,
    stated_m: Float64,
    noise_m: float,
    denied: Bool,
    seen: Mapping[int, SeenLeap] = MappingProxyType({}),
) -> SeamDoubt:
    """The doubt of n fixes in order of time that are fit but for how they lie. Those that were
    `denied` for it by conditioning, or are seams, tell of a solution like the others; where none
    was, a vehicle may have driven. `stated_m` is what each states, `noise_m` what is usual of one
    to the next, `seen` are leaps that something else saw, by the row after them."""
    n = len(time_s)
    found = _solutions(points_m, time_s, noise_m, denied, seen)
    first = found.first
    if len(first) < 2:
        return SeamDoubt(np.zeros(n), np.full(n, np.inf))
    count = np.diff(np.append(first, n))
    usual_m = np.add.reduceat(stated_m, first) / count
    away_m, apart_m = _away(found, usual_m)
    # An error that grew up in a stretch, or fades in it: that of its two ends is independent.
    lasting_s = np.repeat(np.where(away_m > usual_m, 2.0 * found.lasted_s, np.inf), count)
    lasting_s[first[1:][apart_m > np.hypot(usual_m[1:], usual_m[:-1])] - 1] = LEAP_S
    return SeamDoubt(np.repeat(away_m, count), lasting_s)


def _solutions(
    points_m: Float64,
    time_s: Float64,
    noise_m: float,
    denied: Bool,
    seen: Mapping[int, SeenLeap],
) -> _Solutions:
    """The stretches between leaps."""
    disputed = denied.copy()
    disputed[1:] |= denied[:-1]
    noise = np.full(len(time_s), noise_m)
    # The pace beside a leap must not hold another leap.
    rough = leaps(points_m, time_s, noise, disputed, LEAST_M)
    taken_m = np.where((rough.torn & disputed[1:])[:, None], rough.off_m, 0.0)
    mended = points_m - np.concatenate([[[0.0, 0.0]], np.cumsum(taken_m, axis=0)])
    steps = leaps(mended, time_s, noise, disputed, LEAST_M)
    steps = steps._replace(off_m=steps.off_m + taken_m)
    torn = steps.torn & disputed[1:]
    for row, leap in seen.items():
        torn[row - 1] = True
        steps.off_m[row - 1] = leap.east_m, leap.north_m
        steps.free_m[row - 1] = FREE_SIGMAS * leap.sigma_m
    at = np.flatnonzero(torn)
    first, stop = np.concatenate([[0], at + 1]), np.append(at + 1, len(time_s))
    place_m = np.concatenate([[[0.0, 0.0]], np.cumsum(steps.off_m[at], axis=0)])
    unsure_m2 = np.concatenate([[0.0], np.cumsum((steps.free_m[at] / FREE_SIGMAS) ** 2)])
    # A single fix is followed, too: for the period of the receiver.
    period_s = usual_period_s(np.diff(time_s))
    found: list[_Stretch] = []
    shift_m = np.zeros(2)
    for k in range(len(first)):
        lasted_s = float(time_s[stop[k] - 1] - time_s[first[k]]) + period_s
        place = place_m[k] + shift_m
        one = _Stretch(int(first[k]), int(stop[k]), lasted_s, place, float(unsure_m2[k]))
        # After a leap a drive goes on elsewhere, or with what was before an excursion. What the
        # estimate saw leap does not come back so soon.
        before = (
            None if one.first in seen else _same(found, one, points_m, time_s, BRIEF_S + period_s)
        )
        if before is None:
            found.append(one)
        else:
            last = found[before]
            shift_m += last.place_m - place
            found[before:] = [
                one._replace(
                    first=last.first, place_m=last.place_m, lasted_s=last.lasted_s + lasted_s
                )
            ]
    lasting = [one for one in found if one.lasted_s > BRIEF_S]
    starts = np.array([one.first for one in lasting], dtype=np.int64)
    starts[:1] = 0  # what is brief belongs to what lasted before it, or after it at the beginning
    return _Solutions(
        starts,
        np.array([one.lasted_s for one in lasting]),
        np.array([one.place_m for one in lasting]).reshape(-1, 2),
        np.array([one.unsure_m2 for one in lasting]),
    )


def _same(
    found: list[_Stretch], one: _Stretch, points_m: Float64, time_s: Float64, most_s: float
) -> int | None:
    """Which of the stretches before `one`, that ended no longer ago, is of the same solution: by
    the leaps on the way or by the motion on both sides it lies no farther off than a vehicle and
    noise may make."""
    for k in reversed(range(len(found))):
        last = found[k]
        begins_s, ends_s = time_s[one.first], time_s[last.stop - 1]
        if begins_s - ends_s > most_s:
            return None
        early, late = np.searchsorted(time_s, (ends_s - TORN_S, begins_s + TORN_S))
        before = slice(max(last.first, int(early)), last.stop)
        across_m = _across_m(points_m, time_s, before, slice(one.first, min(one.stop, int(late))))
        off_m = min(np.hypot(*(one.place_m - last.place_m)), np.hypot(*across_m))
        if off_m <= FREE_SIGMAS * np.sqrt(one.unsure_m2 - last.unsure_m2):
            return k
    return None


def _across_m(points_m: Float64, time_s: Float64, before: slice, after: slice) -> Float64:
    """East and north by which the fixes in the rows `after` lie beside where the motion of both
    sides leads from those `before`: medians, as a fix or two may be misplaced."""
    paces = []
    for rows in (before, after):
        step_s = np.diff(time_s[rows])[:, None]
        if len(step_s):
            # A log may stamp several fixes alike.
            paces.append(
                np.median(np.diff(points_m[rows], axis=0) / np.maximum(step_s, 1e-3), axis=0)
            )
    pace = np.mean(paces, axis=0) if paces else np.zeros(2)
    places_m = points_m - pace * time_s[:, None]
    return np.asarray(np.median(places_m[after], axis=0) - np.median(places_m[before], axis=0))


def _away(found: _Solutions, stated_m: Float64) -> tuple[Float64, Float64]:
    """How far each solution [s] may lie from the right one, 1-sigma along one axis, and how far
    each lies from the next [s - 1]."""
    count, lasted_s = len(found.first), found.lasted_s
    mass = lasted_s / lasted_s.max() * (stated_m.min() / stated_m) ** 2
    apart_m = np.sqrt([_apart2(found, slice(k, k + 1))[0, k + 1] for k in range(count - 1)])
    same_m = np.maximum(SAME_SHARE * float(np.median(apart_m)), stated_m)
    away_m, trust = np.zeros(count), np.zeros(count)
    blocks = [slice(k, k + MOST_AT_ONCE) for k in range(0, count, MOST_AT_ONCE)]
    for rows in blocks:
        alike = _apart2(found, rows) < np.minimum(same_m[rows, None], same_m) ** 2
        left_and_back = np.diff(alike.astype(np.int8), axis=1, prepend=0) > 0
        returns = np.minimum(np.count_nonzero(left_and_back, axis=1) - 1.0, MOST_RETURNS)
        trust[rows] = mass[rows] * RETURN_TRUST**returns
    for rows in blocks:
        away_m[rows] = np.sqrt(_apart2(found, rows) @ (trust / trust.sum()) / 2.0)
    return away_m, apart_m


def _apart2(found: _Solutions, rows: slice) -> Float64:
    """Squared distances from some solutions to all, without what is not known of them."""
    apart2 = np.sum((found.place_m[rows, None] - found.place_m) ** 2, axis=2)
    unsure_m2 = np.abs(found.unsure_m2[rows, None] - found.unsure_m2)
    return np.asarray(np.maximum(apart2 - unsure_m2, 0.0))
