from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from fieldgrid.geometry import MAX_CELL_M, MAX_DISTANCE_M, Lattice, TileIndex, tile_window
from fieldgrid.geometry.lattice import MIN_CELL_M
from fieldgrid.maps.tiles.tiling import TileMatrixSet, children, parent

tiles = st.builds(TileIndex, st.integers(-4000, 3999), st.integers(-4000, 3999))


@given(st.floats(MIN_CELL_M, MAX_CELL_M))
def test_the_square_covers_every_accepted_position_and_no_more_than_it_must(cell_m: float) -> None:
    matrices = TileMatrixSet(Lattice(cell_m))
    assert matrices.base_zoom >= 1
    assert matrices.half_m >= MAX_DISTANCE_M + 500.0
    assert matrices.base_zoom == 1 or matrices.half_m / 2 < MAX_DISTANCE_M + 500.0
    assert matrices.pixel_m(matrices.base_zoom) == pytest.approx(cell_m, rel=1e-12)


@given(tiles)
def test_columns_count_from_the_west_and_rows_from_the_north(tile: TileIndex) -> None:
    matrices = TileMatrixSet(Lattice(0.05))
    zoom = matrices.base_zoom
    column, row = matrices.column_row(zoom, tile)
    bounds = matrices.lattice.bounds(tile_window(tile))
    span_m = 256 * matrices.pixel_m(zoom)
    # As GeoPackage has it: tile (0, 0) is in the upper left corner of the tile matrix set.
    assert -matrices.half_m + column * span_m == pytest.approx(bounds.west_m, abs=1e-6)
    assert matrices.half_m - row * span_m == pytest.approx(bounds.north_m, abs=1e-6)


@given(tiles)
def test_a_parent_covers_its_children(tile: TileIndex) -> None:
    assert {parent(child) for child in children(tile)} == {tile}
    assert len(set(children(tile))) == 4
    assert tile in children(parent(tile))


@given(st.sets(tiles, min_size=1, max_size=20))
def test_the_top_level_is_the_first_of_two_by_two_tiles(some: set[TileIndex]) -> None:
    matrices = TileMatrixSet(Lattice(0.05))
    top = matrices.top_zoom(some)
    level = some
    for zoom in range(matrices.base_zoom, top - 1, -1):
        spans = [max(axis) - min(axis) + 1 for axis in zip(*level, strict=True)]
        assert (max(spans) <= 2) == (zoom == top)
        level = {parent(tile) for tile in level}
