"""Where drives disagree so that nobody can tell which of two answers is right: errors cover both.

One that stands alone costs its weight in the network, and the errors of drives do not grow by it.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.field.align.drives import Role, SubmapDrive
from fieldgrid.field.align.matches import ALIKE, Match, information_of
from fieldgrid.maps import Transform

CONTRADICTS_SIGMAS = 4.0
"""What is left of a match, in its sigmas, that its two axes have by chance in one of 3,000."""

FAR_SIGMAS = 3.0
"""Drives that lie farther from each other than this number of stated errors contradict what their
receivers state."""


MEDIAN_OF_TWO = 1.386
"""The median of chi squared of two degrees of freedom."""

SCATTER_M = 0.09
"""The shifts that matches tell of drives that lie where they should: canopies that grew, other
faces, other views."""

RECEIVER_VOTES = 2.0
"""What a receiver counts for beside the matches of one submap: it knows how this lies to the one
before and to the one after."""


def between_camps(matches: Sequence[Match], left_m: Float64, information: Float64) -> Float64:
    """The variance [n], m², of the shift between the two drives of each match, where some of their
    matches contradict the others; by what is left of shifts [n, 2] and their information."""
    by_pair = defaultdict[tuple[int, int], list[int]](list)
    for n, match in enumerate(matches):
        by_pair[match.a, match.b].append(n)
    variance = np.zeros(len(matches))
    for own in by_pair.values():
        variance[own] = _other_camp(left_m[own], information[own], 0.0, min(len(own), ALIKE))
    return variance


def _other_camp(left_m: Float64, information: Float64, votes: float, power: int) -> float:
    """The mean square, m², of what lies between matches that agree and the camp that contradicts
    them, which is as probable as its number beside theirs and other `votes`, to a power: that of
    how many do not err together."""
    misfit_squared = np.einsum("ni,nij,nj->n", left_m, information, left_m)
    agree = max(float(np.exp(-misfit_squared / 2.0).sum()) + votes, 1.0)
    worst = 0.0
    for k in np.flatnonzero(misfit_squared > CONTRADICTS_SIGMAS**2):
        away = left_m - left_m[k]
        camp = np.exp(-np.einsum("ni,ij,nj->n", away, information[k], away) / 2.0).sum()
        odds = float(camp / agree) ** power
        # As far as the match tells it: along a ridge it may say anything.
        far_squared = float(misfit_squared[k]) / np.linalg.norm(information[k], 2)
        worst = max(worst, float(far_squared * odds / (1.0 + odds)))
    return worst


def bent_m(drive: SubmapDrive, transform: Transform) -> Float64:
    """By how much a transform moves each submap of a drive [n, 2], less the median of them."""
    if drive.role is not Role.MOVES:
        return np.zeros((len(drive.submaps), 2))
    east_m, north_m = drive.middle_m.T
    moved_m = np.column_stack(transform.points(east_m, north_m, drive.time_ns)) - drive.middle_m
    return np.asarray(moved_m - np.median(moved_m, axis=0))


def contradict(one: SubmapDrive, other: SubmapDrive, bent_m: Float64) -> bool:
    """Whether two drives cannot be bent so far against each other [2], as their receivers state."""
    return math.hypot(*bent_m) > FAR_SIGMAS * math.hypot(one.wander_m, other.wander_m)


def undecided(
    drives: Sequence[SubmapDrive],
    transforms: Sequence[Transform],
    matches: Sequence[Match],
    left_m: Float64,
    information: Float64,
) -> Float64:
    """The errors [drives, drives], m, of drives, on the diagonal, and of each two, where these are
    bent against each other by more than they state, or where most matches of one submap contradict
    the drives; 0 where they do not. By what is left of shifts [n, 2] and their information.

    If one of two is wrong, what the other was bent by is an error of both.
    """
    found = np.zeros((len(drives), len(drives)))

    def cover(a: int, b: int, error_m: float) -> None:
        for pair in ((a, b), (b, a), (a, a), (b, b)):
            found[pair] = max(found[pair], error_m)

    bent = [bent_m(*one) for one in zip(drives, transforms, strict=True)]
    between = [(m.a, m.b, bent[m.a][m.k], bent[m.b][m.l]) for m in matches if m.a != m.b]
    far = [one for one in between if contradict(drives[one[0]], drives[one[1]], one[2] - one[3])]
    # A receiver that states little may leap as any other.
    wrong = wrong_ones([0.0] * len(drives), {(a, b): 0.0 for a, b, *_ in far})
    for a, b, by_a, by_b in far:
        cover(a, b, max(math.hypot(*by) for n, by in ((a, by_b), (b, by_a)) if n in wrong))
    by_submap = defaultdict[tuple[int, int], list[int]](list)
    for k, match in enumerate(matches):
        if match.a != match.b:
            by_submap[match.a, match.k].append(k)
            by_submap[match.b, match.l].append(k)
    for (n, _), own in by_submap.items():
        error_m = math.sqrt(_other_camp(left_m[own], information[own], RECEIVER_VOTES, ALIKE))
        cover(n, n, error_m)
        for other in {m for k in own for m in (matches[k].a, matches[k].b)}:
            found[[n, other], [other, n]] = max(found[n, other], error_m)
    return found


def left_between(matches: Sequence[Match], left_m: Float64) -> dict[tuple[int, int], float]:
    """What is left of the shifts [n, 2] of matches between each two drives, root mean square, m, as
    far as each match tells it, beyond what matches scatter by. A few that contradict have no say.
    """
    by_pair = defaultdict[tuple[int, int], list[float]](list)
    every = information_of(matches, [1] * len(matches))
    for match, information, left in zip(matches, every, left_m, strict=True):
        if match.a != match.b and information.any():
            told = float(left @ information @ left) / float(np.trace(information))
            by_pair[match.a, match.b].append(told)
    return {
        pair: math.sqrt(max(4.0 * np.median(told) / MEDIAN_OF_TWO - SCATTER_M**2, 0.0))
        for pair, told in by_pair.items()
    }


def wrong_ones(
    stated_m: Sequence[float], apart_m: Mapping[tuple[int, int], float]
) -> dict[int, float]:
    """By how much drives are wrong, of those that contradict each other by `apart_m`: the one that
    contradicts most others, of several the one whose receiver states most (`stated_m`, of each
    drive); where that is the same, all of them."""
    found = dict[int, float]()
    while apart_m:
        counts = Counter(n for pair in apart_m for n in pair)
        worst = max((count, stated_m[n]) for n, count in counts.items())
        wrong = {n for n, count in counts.items() if (count, stated_m[n]) == worst}
        for n in wrong:
            found[n] = max(size for pair, size in apart_m.items() if n in pair)
        apart_m = {pair: size for pair, size in apart_m.items() if not wrong & set(pair)}
    return found
