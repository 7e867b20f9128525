"""Which submaps saw the same ground, and how they do so."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fieldgrid.align.submaps import Picture
from fieldgrid.array_types import Float64

LEAST_SHARE = 0.25
"""Submaps are compared when this share of the smaller one was seen by the other, too."""

MOST_OF_A_DRIVE, MOST_OF_ALL = 3, 5
"""A submap is compared with so many of one other drive, and with so many in all: those that share
most."""

MOST_OF_TWO = 16
"""To see whether two drives agree as wholes so many pairs are enough."""

APART = 3
"""Submaps of one drive are compared when so many lie between them: before, they see the same from
the same way."""

SAME_LANE_M = 1.2
"""Vehicles whose tracks lie farther apart see the opposite faces of what stands between them."""


class Overlap(NamedTuple):
    """Submap `k` of drive `a` and submap `l` of drive `b`: `share` of the smaller one was seen by
    both."""

    a: int
    k: int
    b: int
    l: int  # noqa: E741 - the letter after k
    share: float


class Pair(NamedTuple):
    """Submap `k` of drive `a` and submap `l` of drive `b`. `at_m` [2] is the middle of the ground
    that both saw; `across` [2] the unit vector from the track of the one to that of the other
    where they lie in different lanes, else zero; `facing` [2] the way that `a` looks less that of
    `b`, as unit vectors; `share` of the smaller one was seen by both."""

    a: int
    k: int
    b: int
    l: int  # noqa: E741
    at_m: Float64
    across: Float64
    facing: Float64
    share: float


def overlapping(
    pictures: Sequence[Sequence[Picture]], compared: Callable[[int, int], bool]
) -> Iterator[Overlap]:
    """The pairs worth comparing, of different drives and of the same one, as far as these are to be
    `compared`; `pictures` has those of each drive."""
    places = [(n, k) for n, of_one in enumerate(pictures) for k in range(len(of_one))]
    windows = np.array([pictures[n][k].window for n, k in places], np.float64)
    middles, reach = windows[:, :2] + windows[:, 2:] / 2.0, np.hypot(*windows[:, 2:].T) / 2.0
    tree = cKDTree(middles)
    for (a, k), middle, own_reach in zip(places, middles, reach, strict=True):
        one = pictures[a][k]
        shared = defaultdict[int, list[tuple[float, int]]](list)
        for n in sorted(tree.query_ball_point(middle, own_reach + reach.max())):
            b, l = places[n]  # noqa: E741
            if (b > a or (b == a and l >= k + APART)) and compared(a, b):
                share = _shared(one, pictures[b][l])
                if share >= LEAST_SHARE:
                    shared[b].append((share, l))
        for b, told in shared.items():
            for share, l in sorted(told, reverse=True)[:MOST_OF_A_DRIVE]:  # noqa: E741
                yield Overlap(a, k, b, l, share)


def placed(of: Overlap, pictures: Sequence[Sequence[Picture]]) -> Pair:
    """The pair, with where it lies and how its submaps look at it."""
    one, other = pictures[of.a][of.k], pictures[of.b][of.l]
    return Pair(*of[:4], *_place(one, other), one.facing - other.facing, of.share)


def thinned(pairs: Iterable[Overlap]) -> list[Overlap]:
    """Of each two drives a few pairs from all along them."""
    by_drives = defaultdict[tuple[int, int], list[Overlap]](list)
    for pair in pairs:
        by_drives[pair.a, pair.b].append(pair)
    chosen = []
    for members in by_drives.values():
        step = max(-(-len(members) // MOST_OF_TWO), 1)
        chosen += members[::step]
    return chosen


def bounded(pairs: Iterable[Overlap]) -> list[Overlap]:
    """Of each submap the pairs that share most ground with it, as far as it needs any."""
    counts = Counter[tuple[int, int]]()
    chosen = []
    for pair in sorted(pairs, key=lambda pair: -pair.share):
        ends = (pair.a, pair.k), (pair.b, pair.l)
        if min(counts[end] for end in ends) < MOST_OF_ALL:
            chosen.append(pair)
            counts.update(ends)
    return sorted(chosen, key=lambda pair: pair[:4])


def _shared(a: Picture, b: Picture) -> float:
    """The share of the smaller picture that both saw."""
    part, cells = a.window.intersect(b.window), max(min(a.cells, b.cells), 1)
    if part is None or part.width * part.height < LEAST_SHARE * cells:
        return 0.0
    both = a.seen[a.window.slices_of(part)] & b.seen[b.window.slices_of(part)]
    return np.count_nonzero(both) / cells


def _place(a: Picture, b: Picture) -> tuple[Float64, Float64]:
    part = a.window.intersect(b.window)
    assert part is not None  # they share cells
    both = a.seen[a.window.slices_of(part)] & b.seen[b.window.slices_of(part)]
    east, north = a.lattice.centres(part)
    n = both.sum()
    at = np.array([(both.sum(axis=0) * east).sum() / n, (both.sum(axis=1) * north).sum() / n])
    # The direction in which the track of `a` runs; across it lies that of `b`.
    centred = a.track_m - a.track_m.mean(axis=0)
    along = np.linalg.svd(centred)[2][0] if len(centred) > 1 else np.zeros(2)
    left = np.array([-along[1], along[0]])
    apart_m = float(left @ (b.track_m.mean(axis=0) - a.track_m.mean(axis=0)))
    return at, left * np.sign(apart_m) if abs(apart_m) > SAME_LANE_M else np.zeros(2)
