"""The map over all sessions: its base tiles, the levels above, and the pictures that a GIS sees.

What a session adds to a base tile is added to what is there, and what leaves is subtracted,
modulo 2^64; where that cannot be, the tile is folded again from the sessions that stay. A quadrant
of a tile above follows from the tile below it. So the tiles are those of a map that was made of the
present sessions at once, at a cost that goes with the change.

A commit takes out the tiles above those that it changes. `settle` makes them from the tiles below
when the map is closed; until then readers make larger cells from the map's own.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Generator, Mapping, Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np

from fieldgrid.core import MapError, Threads
from fieldgrid.geometry import TILE_CELLS, TileIndex, Window, tile_window
from fieldgrid.maps.file import schema
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup, Combine, is_nothing
from fieldgrid.maps.layers.window import empty_cells
from fieldgrid.maps.tiles.png import encode_png
from fieldgrid.maps.tiles.tile_codec import Box, box_of, stored_box
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.tiles.tiling import parent, window_of
from fieldgrid.maps.transfer import mean_density
from fieldgrid.maps.writing.placing import FoldedTiles, encode_groups

_NO_BLOBS: Mapping[str, bytes] = {}

_SETTLED_TILES = 2
"""Of each level what the level above it need not decode again: as many as a small session touches.
With all channels they take up to 20 MB each."""


class EncodedTile(NamedTuple):
    """A tile as it is to be stored: no blobs where nothing is observed. `seen` is the extent of
    the observed cells."""

    tile: TileIndex
    blobs: dict[str, bytes]
    picture: bytes
    seen: Box | None


def encoded_tile(
    tile: TileIndex,
    cells: Cells,
    groups: Sequence[ChannelGroup],
    known: Mapping[str, bytes] = _NO_BLOBS,
) -> EncodedTile:
    """A tile as it is to be stored; `known` has its blobs where they are there already."""
    if not cells["weight"].any():
        return EncodedTile(tile, {}, b"", None)
    box = box_of(cells["weight"])
    blobs = dict(known) or encode_groups(groups, cells, base=cells.base_cells == 1, box=box)
    return EncodedTile(tile, blobs, encode_png(*mean_density(cells["weight"], cells["sum"])), box)


class Pyramid:
    """Changes the tiles of a map, within the caller's transaction."""

    def __init__(self, tables: TileTables, jobs: int | None = None) -> None:
        self._connection = tables.connection
        self._tables = tables
        self._groups = tables.groups
        self._base = tables.matrices.base_zoom
        self._jobs = jobs

    def change(
        self,
        leaving: FoldedTiles | None,
        joining: FoldedTiles | None,
        cleared: Collection[TileIndex] = (),
    ) -> None:
        """Take from the base tiles what leaves, add to them what joins; of those that are `cleared`
        before nothing stays."""
        tiles = {*cleared, *(t for share in (leaving, joining) if share for t in share.tiles)}
        self._tables.remove(self._base, cleared)

        def work(tile: TileIndex) -> EncodedTile:
            gone = None if leaving is None else leaving.cells(tile)
            come = None if joining is None else joining.cells(tile)
            cells = self._changed(tile, gone, come)
            same = joining.blobs(tile) if joining is not None and cells is come else {}
            return encoded_tile(tile, cells, self._groups, same)

        self._put_base(
            Threads(self._jobs).in_order(work, sorted(tiles)),
            shrinks=leaving is not None or bool(cleared),
        )

    def fill(self, tiles: Generator[EncodedTile, None, None]) -> None:
        """Take all base tiles as they come, and make those above them; the tables of the map are
        empty before."""
        self._put_base(tiles, shrinks=False)
        self.settle()

    def settle(self) -> None:
        """Make the tiles above the base that commits have left for later."""
        top, below = self._tables.top_zoom() or self._base, dict[TileIndex, Cells]()
        for zoom in range(self._base - 1, top - 1, -1):
            lacking = {parent(tile) for tile in self._tables.tiles(zoom + 1)}
            lacking.difference_update(self._tables.tiles(zoom))
            kept = self._tables.kept(self._base - zoom)

            def made(
                tile: TileIndex,
                zoom: int = zoom,
                kept: Sequence[ChannelGroup] = kept,
                below: Mapping[TileIndex, Cells] = below,
            ) -> tuple[EncodedTile, Cells]:
                cells = self._tables.above(zoom, tile, self._groups, below)
                return encoded_tile(tile, cells, kept), cells

            below = {}
            for encoded, cells in Threads(self._jobs).in_order(made, sorted(lacking)):
                self._tables.put(zoom, encoded.tile, encoded.blobs, encoded.picture)
                if len(below) < _SETTLED_TILES:
                    below[encoded.tile] = cells
        self._connection.execute("DELETE FROM fieldgrid_meta WHERE key = ?", (schema.UNSETTLED,))

    def _put_base(self, changed: Generator[EncodedTile, None, None], *, shrinks: bool) -> None:
        """Store base tiles, and take out those above them."""
        tiles, seen = set[TileIndex](), None
        with closing(changed):  # a full disk: its threads must not read a map that is closed
            for encoded in changed:
                self._tables.put(self._base, encoded.tile, encoded.blobs, encoded.picture)
                tiles.add(encoded.tile)
                if encoded.seen is not None:
                    seen = union(seen, _placed(encoded.tile, encoded.seen))
        top = self._tables.top_zoom() or self._base + 1
        for zoom in range(self._base - 1, top - 1, -1):
            tiles = {parent(tile) for tile in tiles}
            self._tables.remove(zoom, tiles)
        for table, column in (
            ("fieldgrid_tile", "zoom"),
            ("density", "zoom_level"),
            ("gpkg_tile_matrix", "table_name = 'density' AND zoom_level"),
        ):
            self._connection.execute(f"DELETE FROM {table} WHERE {column} < ?", (top,))
        self._connection.execute(
            "INSERT OR REPLACE INTO fieldgrid_meta VALUES (?, 'later')", (schema.UNSETTLED,)
        )
        self.announce(None if shrinks else seen)

    def _changed(self, tile: TileIndex, leaving: Cells | None, joining: Cells | None) -> Cells:
        """A base tile over all sessions, after a session's share has changed."""
        total = self._tables.cells(self._base, tile)
        if total is None:
            shape = (TILE_CELLS, TILE_CELLS)
            return joining or empty_cells(self._groups, shape, self._tables.block(0))
        arrays = dict(total)
        for name, gone in () if leaving is None else leaving.items():
            if not is_nothing(gone):
                arrays[name] = arrays[name] - gone
        if joining is None:
            return Cells(arrays, block=total.block)
        box = box_of(joining["weight"])
        for group in self._groups:
            part = (box.blocks(joining.block) if group.blocks else box).slices
            for channel in group.channels:
                name, value = channel.name, arrays[channel.name]
                if is_nothing(joining[name]):
                    continue
                if is_nothing(value):
                    arrays[name] = joining[name]
                else:  # in place: nobody else has these arrays
                    combine = np.add if channel.sessions is Combine.SUM else np.maximum
                    combine(value[part], joining[name][part], out=value[part])
        return Cells(arrays, block=total.block)

    def announce(self, grown: Window | None = None) -> None:
        """Record which base cells have data, and tell a GIS of the raster's extent and levels. The
        cells are those from before and those that it has `grown` by; without these, the outermost
        tiles are looked at."""
        meta = "fieldgrid_meta WHERE key = 'data_window'"
        before = self._connection.execute(f"SELECT value FROM {meta}").fetchone()
        window = grown
        if grown is None:
            for _, ty, tx, name, blob in self._tables.edges():
                box = stored_box(self._groups[0], blob, f"{name} of tile {(ty, tx)} of level 0")
                window = union(window, _placed(TileIndex(ty, tx), box))
        elif before is not None:
            try:
                window = grown.union(window_of(before[0]))
            except ValueError as error:
                raise MapError(
                    f"The extent of the map's cells is damaged ({error}); repair the map."
                ) from error
        self._connection.execute(f"DELETE FROM {meta}")
        matrices = self._tables.matrices
        bounds: tuple[float | None, ...] = (None,) * 4
        top = self._tables.top_zoom() or self._base + 1
        if window is not None:
            self._connection.execute(
                "INSERT INTO fieldgrid_meta VALUES ('data_window', ?)", (json.dumps(list(window)),)
            )
            bounds = matrices.lattice.bounds(matrices.whole_cells(window, top))
        self._connection.execute(
            "UPDATE gpkg_contents SET (min_x, min_y, max_x, max_y) = (?, ?, ?, ?) "
            "WHERE table_name = 'density'",
            bounds,
        )
        self._connection.executemany(
            "INSERT OR IGNORE INTO gpkg_tile_matrix VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (
                ("density", zoom, 1 << zoom, 1 << zoom, TILE_CELLS, TILE_CELLS, pixel_m, pixel_m)
                for zoom in range(top, matrices.base_zoom + 1)
                for pixel_m in (matrices.pixel_m(zoom),)
            ),
        )


def _placed(tile: TileIndex, part: Box) -> Window:
    """A part of a tile, in cells of the lattice."""
    cells, (height, width) = tile_window(tile), part.shape
    return Window(cells.i0 + part.first_column, cells.j0 + part.first_row, width, height)


def union(a: Window | None, b: Window | None) -> Window | None:
    """The smallest window that holds both, as far as there are such."""
    return a.union(b) if a and b else a or b
