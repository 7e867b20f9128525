"""Zoom levels: the lattice's tiles as a GeoPackage numbers them.

The tile matrix set is one fixed square about the datum, wide enough for every position that a
datum accepts, so a map that grows never renumbers a tile. Its zoom level z has 2^z x 2^z tiles;
the base level has the map's own cells, and each level above has cells of twice the side.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from fieldgrid.core import parse_json, quoted
from fieldgrid.geometry import MAX_DISTANCE_M, TILE_CELLS, Lattice, TileIndex, Window

_FARTHEST = 1 << 40
"""More cells than any map has, and few enough for whole numbers of all kinds."""

_MARGIN_M = 500.0
"""More than the reach of any local grid, which may look out over `MAX_DISTANCE_M`."""


@dataclass(frozen=True, slots=True)
class TileMatrixSet:
    """The pyramid of tiles over a lattice, whose cells are those of the base level."""

    lattice: Lattice

    @property
    def base_zoom(self) -> int:
        """The zoom level of the lattice's own tiles, at least 1."""
        half_tiles = (MAX_DISTANCE_M + _MARGIN_M) * self.lattice.cells_per_m / TILE_CELLS
        return 1 + max(0, math.ceil(math.log2(half_tiles)))

    @property
    def half_m(self) -> float:
        """From the datum to each edge of the square; always a whole number of base tiles."""
        return TILE_CELLS * (1 << (self.base_zoom - 1)) / self.lattice.cells_per_m

    def pixel_m(self, zoom: int) -> float:
        """Side of a cell at a zoom level."""
        return (1 << (self.base_zoom - zoom)) / self.lattice.cells_per_m

    def column_row(self, zoom: int, tile: TileIndex) -> tuple[int, int]:
        """A tile's column and row in the GeoPackage: from the west, and from the north."""
        half = 1 << (zoom - 1)
        return tile.tx + half, half - 1 - tile.ty

    def tile(self, zoom: int, column: int, row: int) -> TileIndex:
        """The tile at a column and row of the GeoPackage."""
        half = 1 << (zoom - 1)
        return TileIndex(half - 1 - row, column - half)

    def whole_cells(self, window: Window, zoom: int) -> Window:
        """A window of base cells, widened to whole cells of a zoom level.

        GDAL takes the raster's extent for that of its overviews too, and shifts those or loses
        their last pixels where it is not a multiple of their cells.
        """
        side = 1 << (self.base_zoom - zoom)
        i0, j0 = window.i0 // side * side, window.j0 // side * side
        i1, j1 = window.i0 + window.width, window.j0 + window.height
        return Window(i0, j0, -(-i1 // side) * side - i0, -(-j1 // side) * side - j0)

    def top_zoom(self, tiles: Iterable[TileIndex]) -> int:
        """The first level, from the base up, at which these base tiles become 2 x 2 or fewer.

        Not one: a field around its datum lies in four tiles at any level.
        """
        rows, columns = {tile.ty for tile in tiles}, {tile.tx for tile in tiles}
        zoom = self.base_zoom
        while zoom > 1 and any(max(span) - min(span) > 1 for span in (rows, columns) if span):
            rows, columns = {ty >> 1 for ty in rows}, {tx >> 1 for tx in columns}
            zoom -= 1
        return zoom


def parent(tile: TileIndex) -> TileIndex:
    """The tile one zoom level up that covers this one."""
    return TileIndex(tile.ty >> 1, tile.tx >> 1)


def children(tile: TileIndex) -> Iterator[TileIndex]:
    """The four tiles one zoom level down that this one covers."""
    for ty in (2 * tile.ty, 2 * tile.ty + 1):
        for tx in (2 * tile.tx, 2 * tile.tx + 1):
            yield TileIndex(ty, tx)


def window_of(text: str) -> Window:
    """The extent of a map's cells as it is stored; ValueError says why it is none."""
    try:
        i0, j0, width, height = map(int, parse_json(text))
    except (TypeError, OverflowError) as error:
        raise ValueError(f"{quoted(text)} are no four whole numbers") from error
    if min(width, height) < 1 or max(map(abs, (i0, j0, width, height))) > _FARTHEST:
        raise ValueError(f"it has {width} x {height} cells from {i0}, {j0}")
    return Window(i0, j0, width, height)
