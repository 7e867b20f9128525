"""Blocks of cells: where they lie, and where a frame is looked up for them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.geometry import TILE_CELLS, GridSpec, Lattice, Pose, Window
from fieldgrid.maps import open_map, to_local, to_universal
from fieldgrid.maps.layers.blocks import (
    COLUMN_BITS,
    block_points,
    block_side,
    blocks_of,
    blocks_under,
    session_means,
)
from fieldgrid.maps.layers.window import at_cells
from tests.maps.file.maps import drive, write_map

SPEC = GridSpec(width_m=6.0, length_m=8.0, cell_m=0.1)


def pose(heading_deg: float) -> Pose:
    return Pose(10**9, 3.137, -40.221, 0.0, heading_deg, 0.02, 0.3, 1.0)


@pytest.mark.parametrize(
    ("cell_m", "side"),
    [(0.02, 8), (0.05, 4), (0.0625, 4), (0.1, 2), (0.125, 2), (0.2, 1), (0.25, 1), (5.0, 1)],
)
def test_a_block_is_at_most_a_quarter_of_a_metre(cell_m: float, side: int) -> None:
    assert block_side(Lattice(cell_m)) == side
    assert TILE_CELLS % side == 0


@pytest.mark.parametrize("side", [1, 2, 4])
def test_cells_have_the_value_of_their_block(side: int) -> None:
    window = Window(-7, 5, 13, 10)
    under = blocks_under(window, side)
    values = np.arange(under.width * under.height, dtype=np.uint64).reshape(under.shape)
    found = at_cells(values, window, side)
    assert found.shape == window.shape
    for row, column in np.ndindex(window.shape):
        j, i = (window.j0 + row) // side - under.j0, (window.i0 + column) // side - under.i0
        assert found[row, column] == values[j, i]
    # Nothing but the blocks that the window touches.
    assert set(found.reshape(-1).tolist()) == set(range(values.size))


@pytest.mark.parametrize("cell_m", [0.1, 0.5])
@pytest.mark.parametrize("heading_deg", [0.0, 33.0, 90.0, -160.0])
def test_a_frame_is_looked_up_in_the_middle_of_blocks(cell_m: float, heading_deg: float) -> None:
    at, lattice = pose(heading_deg), Lattice(cell_m)
    side = block_side(lattice)
    window = Window(-200, -600, 420, 700)
    under, side_m = blocks_under(window, side), side * cell_m
    block, cell = block_points(SPEC, at, lattice, window)
    assert np.unique(block).size == block.size
    points = math.isqrt(cell.shape[1])
    assert points == max(1, round(side_m / 0.2))
    row, column = np.divmod(block, under.width)
    p = (np.arange(points) + 0.5) / points
    east = (under.i0 + column[:, None, None] + p[None, None, :]) * side_m
    north = (under.j0 + row[:, None, None] + p[None, :, None]) * side_m
    x, y = to_local(*np.broadcast_arrays(east, north), at)
    inside = (np.abs(x) < 3.0) & (y >= 0.0) & (y < 8.0)
    expected = (np.floor(y / 0.1).astype(int) << COLUMN_BITS) | np.floor((x + 3.0) / 0.1).astype(
        int
    )
    np.testing.assert_array_equal(cell, np.where(inside, expected, -1).reshape(cell.shape))
    # No block whose middle lies in the grid is missing.
    centres = to_universal(0.0, np.arange(0.5, 7.5, 0.1), at)
    i, j = (np.floor(v / side_m).astype(int) for v in centres)
    assert np.isin((j - under.j0) * under.width + i - under.i0, block).all()


def test_a_part_of_a_window_is_looked_up_like_the_whole() -> None:
    at, lattice = pose(33.0), Lattice(0.1)
    whole, part = Window(-200, -600, 420, 700), Window(21, -391, 37, 30)
    found = {}
    for window in (whole, part):
        under = blocks_under(window, 2)
        block, cell = block_points(SPEC, at, lattice, window)
        row, column = np.divmod(block, under.width)
        found[window] = {
            (j, i): tuple(one)
            for j, i, one in zip(row + under.j0, column + under.i0, cell.tolist(), strict=True)
        }
    assert len(found[part]) > 100
    assert found[part].items() <= found[whole].items()
    assert block_points(SPEC, at, lattice, Window(5000, 0, 10, 10)).block.size == 0


def test_the_blocks_of_cells() -> None:
    window = Window(-3, 5, 9, 7)  # blocks -2..2 east, 2..5 north
    cells = np.array([0, 1, 9, 62], np.int32)  # (5, -3), (5, -2), (6, -3), (11, 5)
    found = blocks_of(cells, Lattice(0.1), window)
    np.testing.assert_array_equal(found, [0, 1, 5, 3 * 5 + 4])


def test_means_are_whole_and_rounded_half_up() -> None:
    total, count = np.array([5, -5, 7, 0, -7]), np.array([2, 2, 3, 0, 3])
    np.testing.assert_array_equal(session_means(total, count), [3, -2, 2, 0, -2])


def test_a_drive_whose_frames_reach_into_a_single_block_is_mapped(tmp_path: Path) -> None:
    """The corner of a tile that frames without heights reach is one block of channels of zeros."""
    path = write_map(tmp_path / "map.gpkg", [drive(200)])
    with open_map(path) as universal:
        assert universal.verify(deep=True).problems == ()
