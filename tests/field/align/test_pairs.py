"""Which submaps are compared: each shift within reach has ground that speaks for it or against."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import Float64
from fieldgrid.field.align.pairs import (
    APART,
    LEAST_SHARE,
    Overlap,
    _shares,
    for_every_shift,
    of_nearest,
    overlapping,
    placed,
)
from fieldgrid.field.align.submaps import SubmapImage
from fieldgrid.geometry import Lattice, Window

CELL_M, WIDE_M, LONG_M, APART_M = 0.2, 3.6, 8.0, 3.0


def lane(east_m: float, north_m: float) -> SubmapImage:
    """What is seen from a part of a lane; north of it."""
    window = Window(
        round((east_m - WIDE_M / 2) / CELL_M), round(north_m / CELL_M),
        round(WIDE_M / CELL_M), round(LONG_M / CELL_M),
    )  # fmt: skip
    seen = np.ones(window.shape, np.bool_)
    track = np.array([[east_m, north_m], [east_m, north_m + 4.0]])
    return SubmapImage(
        Lattice(CELL_M), window, seen.astype(np.uint8), seen, track, np.array([0.0, 1.0]), seen.size
    )


def pictures(displaced_m: float) -> list[list[SubmapImage]]:
    """Two drives through two lanes, the second one displaced to the east."""
    parts = [(lane_no * APART_M, 9.0 * part) for lane_no in (0, 1) for part in (0, 1, 2)]
    return [[lane(e, n) for e, n in parts], [lane(e + displaced_m, n) for e, n in parts]]


def compared(reach_m: float, displaced_m: float) -> list[Overlap]:
    """The pairs of them."""
    both = pictures(displaced_m)
    own = [one for one in overlapping(both, lambda a, b: True) if one.a != one.b]
    return for_every_shift(own, both, reach_m)


def test_a_lane_aside_is_not_the_only_one_that_is_compared() -> None:
    """Displaced by a lane, the second lane of the one lies on the first of the other."""
    pairs = compared(APART_M + 0.5, APART_M)
    same = {(one.k, one.l) for one in pairs if one.k == one.l}
    assert same == {(n, n) for n in range(6)}
    assert all(one.share >= LEAST_SHARE for one in pairs)
    assert len({one[:4] for one in pairs}) == len(pairs)
    # Those that the reach does not bring together are left out.
    assert not {(one.k, one.l) for one in compared(0.2, APART_M) if one.k == one.l}


def test_drives_that_lie_where_they_should_are_compared_as_they_lie() -> None:
    assert {(0, n, 1, n) for n in range(6)} <= {one[:4] for one in compared(2.5, 0.0)}


def test_a_pair_that_shares_nothing_as_it_lies_has_its_place_between() -> None:
    both = pictures(6.0)
    pair = placed(Overlap(0, 0, 1, 0, 0.5), both)
    assert pair.at_m == pytest.approx([3.0, 4.0])
    assert pair.across == pytest.approx([1.0, 0.0])


def test_the_three_that_share_most_are_taken_of_each_other_drive() -> None:
    """Against all pairs, counted cell by cell."""
    random = np.random.default_rng(3)
    drives = []
    for count in (5, 12, 9):
        own = []
        for east, north, wide, long in random.integers((0, 0, 8, 8), (30, 30, 24, 24), (count, 4)):
            seen = random.random((long, wide)) < 0.6
            own.append(
                SubmapImage(
                    Lattice(CELL_M), Window(*map(int, (east, north, wide, long))),
                    seen.astype(np.uint8), seen, np.zeros((1, 2)), np.array([0.0, 1.0]),
                    int(seen.sum()),
                )
            )  # fmt: skip
        drives.append(own)

    def share(one: SubmapImage, other: SubmapImage) -> float:
        ground = np.zeros((2, 60, 60), np.bool_)
        for of, drawn in zip(ground, (one, other), strict=True):
            i0, j0, wide, long = drawn.window
            of[j0 : j0 + long, i0 : i0 + wide] = drawn.seen
        return np.count_nonzero(ground[0] & ground[1]) / min(one.cells, other.cells)

    expected = set()
    for a, of_a in enumerate(drives):
        for k, one in enumerate(of_a):
            for b in range(a, 3):
                shares = [
                    (share(one, other), l)
                    for l, other in enumerate(drives[b])  # noqa: E741
                    if (b > a or l >= k + APART) and (a, b) != (0, 1)
                ]
                best = sorted((s for s in shares if s[0] >= LEAST_SHARE), reverse=True)[:3]
                expected |= {(a, k, b, l, s) for s, l in best}  # noqa: E741
    found = list(overlapping(drives, lambda a, b: (a, b) != (0, 1)))
    assert len(found) == len(expected) > 20
    assert {tuple(one) for one in found} == expected


def test_what_submaps_share_at_each_shift_is_counted_in_blocks() -> None:
    """Of blocks of 5 by 5 cells: the product of what was seen of either."""
    random = np.random.default_rng(6)

    def drawn(i0: int, j0: int, wide: int, long: int) -> tuple[SubmapImage, Float64]:
        seen = random.random((long, wide)) < 0.5
        ground = np.zeros((80, 80))
        ground[j0 : j0 + long, i0 : i0 + wide] = seen
        some = SubmapImage(
            Lattice(CELL_M), Window(i0, j0, wide, long), seen.astype(np.uint8), seen,
            np.zeros((1, 2)), np.zeros(2), int(seen.sum()),
        )  # fmt: skip
        return some, ground

    (a, ground_a), (b, ground_b) = drawn(22, 21, 33, 19), drawn(27, 23, 21, 34)
    shares = _shares(a, b, 2.0)
    # Blocks begin at the south-west corner of both windows.
    blocks = [g[21:76, 22:77].reshape(11, 5, 11, 5).sum(axis=(1, 3)) for g in (ground_a, ground_b)]
    expected = []
    for j in range(-2, 3):
        for i in range(-2, 3):
            if np.hypot(i, j) <= 2.0:
                there = np.roll(blocks[1], (j, i), (0, 1))
                expected.append((blocks[0] * there).sum() / 25.0 / min(a.cells, b.cells))
    assert np.sort(shares) == pytest.approx(np.sort(expected), rel=1e-12)


def test_a_drive_is_compared_with_those_that_it_shares_most_with() -> None:
    shares = {(0, 1): 0.5, (0, 2): 0.9, (1, 2): 0.4, (0, 3): 0.3, (2, 3): 0.8, (1, 3): 0.35}
    pairs = [Overlap(a, 0, b, 0, share) for (a, b), share in shares.items()]
    pairs += [Overlap(0, 1, 1, 1, 0.45), Overlap(2, 0, 2, 5, 0.3)]

    def kept(moving: list[int], most: int) -> set[tuple[int, int]]:
        return {(one.a, one.b) for one in of_nearest(pairs, moving, most)}

    # Of 0 and 1 two submaps each: together they share most.
    assert kept([0], 1) == {(0, 1), (2, 2)}
    assert kept([3], 1) == {(2, 3), (2, 2)}
    # New ones do not take the place of older ones.
    assert kept([0, 1], 1) == {(0, 1), (0, 2), (1, 2), (2, 2)}
    assert kept([0, 3], 2) == {(0, 1), (0, 2), (0, 3), (2, 3), (1, 3), (2, 2)}
    assert kept([0, 1, 2, 3], 3) == {*shares, (2, 2)}
    assert of_nearest(pairs, [0, 1, 2, 3], 3) == pairs
