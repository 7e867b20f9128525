"""Cells, windows and tiles of the one lattice."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import ConfigError
from fieldgrid.geometry import TILE_CELLS, Bounds, Lattice, TileIndex, Window, tile_window

cell_sizes = st.sampled_from([0.02, 0.05, 0.07, 0.1, 0.25, 0.3, 1.0, 2.5])
indices = st.integers(-400_000, 400_000)
windows = st.builds(
    Window,
    st.integers(-2000, 2000),
    st.integers(-2000, 2000),
    st.integers(1, 1500),
    st.integers(1, 1500),
)
metres = st.floats(-50_000.0, 50_000.0)


@given(cell_sizes, indices, indices, st.integers(1, 400), st.integers(1, 400))
def test_cells_to_metres_and_back(cell_m: float, i0: int, j0: int, width: int, height: int) -> None:
    lattice, window = Lattice(cell_m), Window(i0, j0, width, height)
    assert lattice.window(lattice.bounds(window)) == window
    east, north = lattice.centres(window)
    assert lattice.index(east, np.zeros(width))[0].tolist() == list(range(i0, i0 + width))
    assert lattice.index(np.zeros(height), north)[1].tolist() == list(range(j0, j0 + height))


@given(cell_sizes, metres, metres)
def test_a_position_lies_in_its_cell(cell_m: float, east_m: float, north_m: float) -> None:
    lattice = Lattice(cell_m)
    i, j = lattice.index(east_m, north_m)
    bounds = lattice.bounds(Window(int(i), int(j), 1, 1))
    assert bounds.west_m - 1e-9 <= east_m <= bounds.east_m + 1e-9
    assert bounds.south_m - 1e-9 <= north_m <= bounds.north_m + 1e-9


@pytest.mark.parametrize("per_m", [20, 10, 4, 5, 1])
def test_a_decimal_on_an_edge_opens_its_own_cell(per_m: int) -> None:
    """0.15 // 0.05 is 2: positions must not be divided by the cell size."""
    k = np.arange(-2000, 2001)
    edges = np.array([float(f"{n / per_m:.2f}") for n in k])
    i, j = Lattice(float(f"{1 / per_m:.2f}")).index(edges, edges)
    assert i.tolist() == j.tolist() == k.tolist()


def test_negative_positions_round_down() -> None:
    i, j = Lattice(0.25).index([-0.01, -0.25, -0.26, 0.0], [0.24, -1.0, -1.01, 0.25])
    assert i.tolist() == [-1, -1, -2, 0]
    assert j.tolist() == [0, -4, -5, 1]


@given(
    cell_sizes, metres, metres, st.floats(0.01, 100.0), st.floats(0.01, 100.0)
)  # fmt: skip
def test_the_window_of_bounds_covers_them_with_no_cell_too_many(
    cell_m: float, west: float, south: float, width: float, height: float
) -> None:
    lattice = Lattice(cell_m)
    wanted = Bounds(west, south, west + width, south + height)
    window = lattice.window(wanted)
    covered = lattice.bounds(window)
    slack = 2e-6 * cell_m
    for low, high, outer_low, outer_high in (
        (wanted.west_m, wanted.east_m, covered.west_m, covered.east_m),
        (wanted.south_m, wanted.north_m, covered.south_m, covered.north_m),
    ):
        assert low - cell_m - slack < outer_low <= low + slack
        assert high - slack <= outer_high < high + cell_m + slack
    assert window.width == round((covered.east_m - covered.west_m) / cell_m)


@pytest.mark.parametrize("cell_m", [0.07, 0.3, 0.11])
def test_a_bound_on_an_edge_up_to_rounding_opens_no_more_cells(cell_m: float) -> None:
    lattice = Lattice(cell_m)
    for k in range(-3000, 3000, 7):
        bounds = Bounds(k * cell_m, -k * cell_m, (k + 3) * cell_m, (5 - k) * cell_m)
        assert lattice.window(bounds) == Window(k, -k, 3, 5)


@pytest.mark.parametrize(
    "bounds",
    [Bounds(1.0, 0.0, 1.0, 1.0), Bounds(0.0, 2.0, 1.0, 1.0), Bounds(0.0, 0.0, math.nan, 1.0)],
)
def test_empty_bounds_are_refused(bounds: Bounds) -> None:
    with pytest.raises(ConfigError, match=str(bounds.east_m)):
        Lattice(0.05).window(bounds)


@pytest.mark.parametrize("cell_m", [0.0, -0.05, 0.004, 101.0, math.nan])
def test_a_cell_size_that_cannot_be_is_refused(cell_m: float) -> None:
    with pytest.raises(ConfigError, match=str(cell_m)):
        Lattice(cell_m)


@given(windows)
def test_tiles_cover_the_window_and_none_is_idle(window: Window) -> None:
    tiles = list(window.tiles())
    assert tiles == sorted(set(tiles))
    parts = [window.intersect(tile_window(tile)) for tile in tiles]
    assert all(part is not None for part in parts)
    count = np.zeros(window.shape, dtype=int)
    for part in parts:
        count[window.slices_of(part)] += 1  # type: ignore[arg-type]
    assert count.min() == count.max() == 1


def test_tiles_of_negative_cells() -> None:
    assert list(Window(-1, -257, 2, 2).tiles()) == [
        TileIndex(ty=-2, tx=-1),
        TileIndex(ty=-2, tx=0),
        TileIndex(ty=-1, tx=-1),
        TileIndex(ty=-1, tx=0),
    ]
    assert list(Window(0, 256, TILE_CELLS, TILE_CELLS).tiles()) == [TileIndex(ty=1, tx=0)]
    assert tile_window(TileIndex(ty=-1, tx=2)) == Window(512, -256, 256, 256)


def cells(window: Window | None) -> set[tuple[int, int]]:
    if window is None:
        return set()
    return {
        (i, j)
        for i in range(window.i0, window.i0 + window.width)
        for j in range(window.j0, window.j0 + window.height)
    }


small_windows = st.builds(
    Window, st.integers(-6, 6), st.integers(-6, 6), st.integers(1, 7), st.integers(1, 7)
)


@given(small_windows, small_windows)
def test_the_intersection_holds_the_common_cells(a: Window, b: Window) -> None:
    common = a.intersect(b)
    assert cells(common) == cells(a) & cells(b)
    assert common == b.intersect(a)
    if common is not None:
        assert common.width > 0
        assert common.height > 0


@given(small_windows, small_windows)
def test_slices_point_at_the_cells_of_the_part(a: Window, b: Window) -> None:
    part = a.intersect(b)
    if part is None:
        return
    i, j = np.meshgrid(np.arange(a.i0, a.i0 + a.width), np.arange(a.j0, a.j0 + a.height))
    rows_columns = a.slices_of(part)
    assert i[rows_columns].shape == part.shape
    assert set(zip(i[rows_columns].flat, j[rows_columns].flat, strict=True)) == cells(part)


@given(small_windows, small_windows)
def test_union_and_overlap_of_bounds_agree_with_their_cells(a: Window, b: Window) -> None:
    lattice = Lattice(0.25)
    bounds_a, bounds_b = lattice.bounds(a), lattice.bounds(b)
    assert bounds_a.overlaps(bounds_b) == bool(cells(a) & cells(b))
    union = cells(lattice.window(bounds_a.union(bounds_b)))
    i, j = zip(*(cells(a) | cells(b)), strict=True)
    assert union == cells(Window(min(i), min(j), max(i) - min(i) + 1, max(j) - min(j) + 1))


def test_bounds_that_touch_do_not_overlap() -> None:
    middle = Bounds(0.0, 0.0, 2.0, 2.0)
    for i, j in [(-2.0, 0.0), (2.0, 0.0), (0.0, -2.0), (0.0, 2.0)]:
        neighbour = Bounds(i, j, i + 2.0, j + 2.0)
        assert not middle.overlaps(neighbour)
        assert middle.overlaps(Bounds(0.9 * i, 0.9 * j, 0.9 * i + 2.0, 0.9 * j + 2.0))
