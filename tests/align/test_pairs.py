"""Which submaps are compared: each shift within reach has ground that speaks for it or against."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.align.pairs import LEAST_SHARE, Overlap, for_every_shift, overlapping, placed
from fieldgrid.align.submaps import Picture
from fieldgrid.lattice import Lattice, Window

CELL_M, WIDE_M, LONG_M, APART_M = 0.2, 3.6, 8.0, 3.0


def lane(east_m: float, north_m: float) -> Picture:
    """What is seen from a part of a lane; north of it."""
    window = Window(
        round((east_m - WIDE_M / 2) / CELL_M), round(north_m / CELL_M),
        round(WIDE_M / CELL_M), round(LONG_M / CELL_M),
    )  # fmt: skip
    seen = np.ones(window.shape, np.bool_)
    track = np.array([[east_m, north_m], [east_m, north_m + 4.0]])
    return Picture(
        Lattice(CELL_M), window, seen.astype(np.uint8), seen, track, np.array([0.0, 1.0]), seen.size
    )


def pictures(displaced_m: float) -> list[list[Picture]]:
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
