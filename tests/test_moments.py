from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldgrid.lattice import TILE_CELLS, Lattice, Window
from fieldgrid.moments import (
    FRAMES,
    HIGHEST,
    PLANES,
    SQUARES,
    SUM,
    WEIGHT,
    accumulate_moments,
    accumulate_moments_reference,
    add_to_tiles,
    finished,
    merge_moments,
)
from fieldgrid.transfer import AREA_SHIFT, CELL_WEIGHT, MeanFold, Transfer, universal_axes
from tests.mapfile.maps import CELL_M, SPEC, drive, grid_of, one_cell, pose_at

SLOTS = np.array([[3, 0], [2, 1]], dtype=np.int32)
WINDOW = Window(-TILE_CELLS, -TILE_CELLS, 2 * TILE_CELLS, 2 * TILE_CELLS)


def empty() -> np.ndarray:
    return np.zeros((4, TILE_CELLS, TILE_CELLS, PLANES), dtype=np.uint64)


@settings(max_examples=15, deadline=None)
@given(
    east=st.floats(-25.0, 25.0),
    north=st.floats(-25.0, 25.0),
    heading=st.floats(-180.0, 180.0),
    shift=st.sampled_from([0, AREA_SHIFT]),
    cell_m=st.sampled_from([0.1, 0.13, 0.25]),
)
def test_the_kernel_is_its_reference(
    east: float, north: float, heading: float, shift: int, cell_m: float
) -> None:
    pools = [empty(), empty()]
    for number, seed in enumerate((1, 2, 1), 1):
        grid, pose = grid_of(seed), pose_at(east, north, heading + 7.0 * number)
        axes = universal_axes(SPEC, pose, Lattice(cell_m), shift)
        for pool, work in zip(
            pools, (accumulate_moments, accumulate_moments_reference), strict=True
        ):
            work(
                grid.density, grid.observed, *axes, shift, WINDOW.i0, WINDOW.j0, SLOTS, number, pool
            )
    np.testing.assert_array_equal(*pools)


@pytest.mark.parametrize("transfer", Transfer)
def test_weight_and_sum_are_those_of_the_mean(transfer: Transfer) -> None:
    lattice, pool = Lattice(CELL_M), empty()
    fold = MeanFold(lattice, WINDOW, transfer)
    for number, (grid, pose) in enumerate(drive(5), 1):
        add_to_tiles(pool, SLOTS, WINDOW, grid, pose, lattice, transfer, number)
        fold.add(grid, pose)
    rows = [np.concatenate([pool[slot] for slot in row], axis=1) for row in SLOTS]
    np.testing.assert_array_equal(np.concatenate(rows)[..., WEIGHT : SUM + 1], fold.sums)


def test_a_cell_says_how_often_how_much_and_how_high() -> None:
    lattice, pool = Lattice(CELL_M), empty()
    for number, density in enumerate((10, 200, 7), 1):
        grid, pose = one_cell(1.05, -2.05, density)
        add_to_tiles(pool, SLOTS, WINDOW, grid, pose, lattice, Transfer.CENTRE, number)
    moments = finished(pool[1 * 0 + SLOTS[0, 1]])
    (cell,) = moments[moments[..., WEIGHT] > 0]
    assert cell[WEIGHT] == 3 * CELL_WEIGHT
    assert cell[SUM] == 217 * CELL_WEIGHT
    assert cell[SQUARES] == (100 + 40000 + 49) * CELL_WEIGHT
    assert (cell[FRAMES], cell[HIGHEST]) == (3, 200)


def test_a_frame_counts_once_in_a_cell_that_several_of_its_cells_fall_into() -> None:
    lattice, pool = Lattice(0.5), empty()
    grid = grid_of(1)
    add_to_tiles(pool, SLOTS, WINDOW, grid, pose_at(0.01, 0.02, 30.0), lattice, Transfer.CENTRE, 1)
    moments = finished(pool[SLOTS[1, 1]])
    assert moments[..., FRAMES].max() == 1
    assert moments[..., WEIGHT].max() > 9 * CELL_WEIGHT


def test_two_parts_together_are_the_whole() -> None:
    lattice, frames = Lattice(CELL_M), drive(6, step_m=0.7)
    parts = [empty(), empty()]
    whole = empty()
    for number, (grid, pose) in enumerate(frames, 1):
        for pool in (parts[number % 2], whole):
            add_to_tiles(pool, SLOTS, WINDOW, grid, pose, lattice, Transfer.AREA, number)
    merged = merge_moments(finished(parts[0]), finished(parts[1]))
    np.testing.assert_array_equal(merged, finished(whole))
