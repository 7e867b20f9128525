"""Which submaps saw the same ground, and how they do so."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.spatial import cKDTree

from fieldgrid.core import Float64
from fieldgrid.field.align.submaps import SubmapImage

LEAST_SHARE = 0.25
"""Submaps are compared when this share of the smaller one was seen by the other, too."""

MOST_OF_A_DRIVE, MOST_OF_ALL = 3, 5
"""The number of submaps of one other drive, and of all drives, that a submap is compared with:
those that share most ground with it."""

MOST_OF_TWO = 16
"""The number of overlapping pairs that show whether two drives agree as wholes, and of further
pairs for other shifts."""

COARSE_M = 1.0
"""How finely it is told which shifts make submaps overlap."""

MOST_LOOKED_AT = 96
"""Pairs of two drives of which this is told, from all along them."""

APART = 3
"""Submaps of one drive are compared when their numbers differ by this or more; nearer ones see the
same ground from the same way."""

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


class SubmapPair(NamedTuple):
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
    pictures: Sequence[Sequence[SubmapImage]], compared: Callable[[int, int], bool]
) -> Iterator[Overlap]:
    """The pairs worth comparing, of different drives and of the same one, as far as these are to be
    `compared`; `pictures` has those of each drive."""
    every = [(n, k) for n, of_one in enumerate(pictures) for k in range(len(of_one))]
    places = np.array(every)
    count = len(pictures)
    worth = np.array([[b >= a and compared(a, b) for b in range(count)] for a in range(count)])
    windows = np.array([pictures[n][k].window for n, k in every])
    cells = np.array([pictures[n][k].cells for n, k in every])
    low, high = windows[:, :2], windows[:, :2] + windows[:, 2:]
    middles, reach = (low + high) / 2.0, np.hypot(*windows[:, 2:].T) / 2.0
    tree = cKDTree(middles)
    for at, (a, k) in enumerate(every):
        near = np.array(tree.query_ball_point(middles[at], reach[at] + reach.max()))
        drives, parts = places[near].T
        near = np.sort(near[worth[a, drives] & ((drives > a) | (parts >= k + APART))])
        # What lies in both windows is the most that both can have seen.
        both = np.minimum(high[at], high[near]) - np.maximum(low[at], low[near])
        smaller = np.maximum(np.minimum(cells[at], cells[near]), 1)
        most = np.where((both > 0).all(axis=1), both.prod(axis=1) / smaller, 0.0)
        best = defaultdict[int, list[tuple[float, int]]](list)
        for order in np.argsort(-most, kind="stable"):
            b, l = every[near[order]]  # noqa: E741
            own = best[b]
            if most[order] >= (own[-1][0] if len(own) == MOST_OF_A_DRIVE else LEAST_SHARE):
                share = _shared(pictures[a][k], pictures[b][l])
                if share >= LEAST_SHARE:
                    best[b] = sorted([*own, (share, l)], reverse=True)[:MOST_OF_A_DRIVE]
        for b in sorted(best):
            for share, l in best[b]:  # noqa: E741
                yield Overlap(a, k, b, l, share)


def placed(of: Overlap, pictures: Sequence[Sequence[SubmapImage]]) -> SubmapPair:
    """The pair, with where it lies and how its submaps look at it."""
    one, other = pictures[of.a][of.k], pictures[of.b][of.l]
    # The direction in which the track of `a` runs; across it lies that of `b`.
    centred = one.track_m - one.track_m.mean(axis=0)
    along = np.linalg.svd(centred, full_matrices=False)[2][0] if len(centred) > 1 else np.zeros(2)
    left = np.array([-along[1], along[0]])
    apart_m = float(left @ (other.track_m.mean(axis=0) - one.track_m.mean(axis=0)))
    return SubmapPair(
        *of[:4],
        _middle(one, other),
        left * np.sign(apart_m) if abs(apart_m) > SAME_LANE_M else np.zeros(2),
        one.facing - other.facing,
        of.share,
    )


def of_nearest(pairs: Iterable[Overlap], moving: Collection[int], most: int) -> list[Overlap]:
    """The pairs within drives, and those of each `moving` drive with the `most` others that move
    and the `most` that do not: those that it shares most ground with. Drives of one day may share
    one error, which only older drives show."""
    every = list(pairs)
    shared = defaultdict[tuple[int, int], float](float)
    for pair in every:
        for one, other in ((pair.a, pair.b), (pair.b, pair.a)):
            shared[one, other] += pair.share
    kept = {(n, n) for n, _ in shared}
    for n in moving:
        others = sorted((-shared[a, b], b) for a, b in shared if a == n != b)
        for moves in (True, False):
            of_kind = [b for _, b in others if (b in moving) == moves]
            kept |= {(min(n, b), max(n, b)) for b in of_kind[:most]}
    return [pair for pair in every if (pair.a, pair.b) in kept]


def for_every_shift(
    pairs: Iterable[Overlap], pictures: Sequence[Sequence[SubmapImage]], reach_m: float
) -> list[Overlap]:
    """A few overlaps of each two drives, from all along them, with further ones of the same drives
    that exist where these lie elsewhere by up to `reach_m`, so that each such shift has ground that
    would speak for it or against it.

    Drives that lie a lane aside overlap most there, and pairs that overlap as they lie would all
    be those that a slip by a row brings together.
    """
    by_drives = defaultdict[tuple[int, int], list[Overlap]](list)
    for pair in pairs:
        by_drives[pair.a, pair.b].append(pair)
    found = list[Overlap]()
    for (a, b), members in by_drives.items():
        own = members[:: -(-len(members) // MOST_OF_TWO)]
        found += own
        if a != b:
            found += _others(own, pictures[a], pictures[b], reach_m)
    return found


def _others(
    own: Sequence[Overlap], of_a: Sequence[SubmapImage], of_b: Sequence[SubmapImage], reach_m: float
) -> Iterator[Overlap]:
    """Further pairs of two drives: again and again the one that shares most at the shift at which
    least ground is shared."""
    a, b = own[0].a, own[0].b
    ways = np.array([_shares(of_a[one.k], of_b[one.l], reach_m) for one in own])
    known = {(one.k, one.l) for one in own}
    cells = round(reach_m / of_a[0].lattice.cell_m)
    near = [
        (k, l)
        for k, one in enumerate(of_a)
        for l, other in enumerate(of_b)  # noqa: E741
        if (k, l) not in known and one.window.grown(cells).intersect(other.window) is not None
    ]
    near = near[:: max(-(-len(near) // MOST_LOOKED_AT), 1)]
    if not near:
        return
    further = np.array([_shares(of_a[k], of_b[l], reach_m) for k, l in near])  # noqa: E741
    further[further < LEAST_SHARE] = 0.0
    ways[ways < LEAST_SHARE] = 0.0
    shared = ways.sum(axis=0)
    enough = float(shared.max())
    for _ in range(MOST_OF_TWO):
        lacking = np.where(further.max(axis=0) > 0.0, shared, np.inf)
        shift = int(lacking.argmin())
        if lacking[shift] >= enough:
            return
        n = int(further[:, shift].argmax())
        yield Overlap(a, near[n][0], b, near[n][1], float(further[n].max()))
        shared = shared + further[n]
        further[n] = 0.0


def _shares(a: SubmapImage, b: SubmapImage, reach_m: float) -> Float64:
    """The share of the smaller picture that both saw at each shift of `b` within reach [n],
    `COARSE_M` apart."""
    step = max(round(COARSE_M / a.lattice.cell_m), 1)
    most = int(reach_m / (step * a.lattice.cell_m))
    window = a.window.union(b.window)
    rows, columns = -(-window.height // step), -(-window.width // step)
    shape = rows + 2 * most, columns + 2 * most
    seen = np.zeros((2, *shape))
    for of, picture in zip(seen, (a, b), strict=True):
        whole = np.zeros((rows * step, columns * step), np.uint8)
        whole[window.slices_of(picture.window)] = picture.seen
        of[:rows, :columns] = whole.reshape(rows, step, columns, step).sum(axis=(1, 3))
    spectra = fft.rfft2(seen)
    # The sums are whole numbers: shifts and pairs that are equal are so to the last bit.
    shared = np.rint(fft.irfft2(spectra[0] * np.conj(spectra[1]), shape))
    every = np.arange(-most, most + 1)
    near = shared[np.ix_(every, every)]
    inside = np.hypot(*np.meshgrid(every, every)) * step * a.lattice.cell_m <= reach_m
    return np.asarray(near[inside] / step**2 / max(min(a.cells, b.cells), 1))


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


def _shared(a: SubmapImage, b: SubmapImage) -> float:
    """The share of the smaller picture that both saw."""
    part = a.window.intersect(b.window)
    if part is None:
        return 0.0
    both = a.seen[a.window.slices_of(part)] & b.seen[b.window.slices_of(part)]
    return np.count_nonzero(both) / max(min(a.cells, b.cells), 1)


def _middle(a: SubmapImage, b: SubmapImage) -> Float64:
    """Of the ground that both saw, or between them where there is none as they lie."""
    part = a.window.intersect(b.window)
    if part is not None:
        both = a.seen[a.window.slices_of(part)] & b.seen[b.window.slices_of(part)]
        n = np.count_nonzero(both)
        if n:
            east, north = a.lattice.centres(part)
            across, along = both.sum(axis=0) * east, both.sum(axis=1) * north
            return np.array([across.sum() / n, along.sum() / n])
    corners = [(w.i0 + w.width / 2.0, w.j0 + w.height / 2.0) for w in (a.window, b.window)]
    return np.asarray(np.mean(corners, axis=0) * a.lattice.cell_m)
