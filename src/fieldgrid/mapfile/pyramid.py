"""The tiles of a map: their sums at every zoom level, and the pictures that a GIS sees.

Each level holds sums, not means, so each is exact: a cell of an overview is the mean over
everything that fell into it. A session's contribution is added to what is there; since sums
add up, a tile above needs to know nothing of its other children.
"""

from __future__ import annotations

import sqlite3
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.lattice import TILE_CELLS, TileIndex, Window, tile_window
from fieldgrid.mapfile.codec import decode_sums, encode_sums
from fieldgrid.mapfile.png import encode_png
from fieldgrid.mapfile.tiling import TileMatrixSet, children, parent
from fieldgrid.transfer import mean_density

Sums = npt.NDArray[np.uint64]

_HALF = TILE_CELLS // 2


ENCODERS = 2
"""Threads that compress tiles: most of what a commit does, outside the interpreter's lock."""


class _Encoded(NamedTuple):
    """A tile as it is stored; `seen` is the part of it that was observed, in its own cells."""

    sums: bytes
    png: bytes
    seen: Window


class Pyramid:
    """Adds the sums of a session to the tiles of a map, within the caller's transaction.

    `extent` is the window of base cells that have been observed in the tiles written.
    """

    def __init__(self, connection: sqlite3.Connection, matrices: TileMatrixSet) -> None:
        self.extent: Window | None = None
        self._pool = ThreadPoolExecutor(ENCODERS, thread_name_prefix="fieldgrid-tiles")
        self._encoding: deque[tuple[int, TileIndex, Future[_Encoded]]] = deque()
        self._connection = connection
        self._matrices = matrices
        self._base = matrices.base_zoom

    def add(self, tiles: set[TileIndex], contribution: Callable[[TileIndex], Sums]) -> None:
        """Add each base tile's contribution, and bring all levels above up to date.

        Works down to the tiles and up again branch by branch, so that a few tiles a level are
        in memory, however large the session.
        """
        if not tiles:
            return
        old_top = self._top_zoom()
        top = self._matrices.top_zoom([*tiles, *self._corners()])
        first = top if old_top is None else old_top
        try:
            self._update(first, tiles, contribution)
            for zoom in range(first - 1, top - 1, -1):
                self._add_level(zoom)
        finally:
            self._pool.shutdown(cancel_futures=True)
        self._announce(top)

    def _update(
        self, first: int, tiles: set[TileIndex], contribution: Callable[[TileIndex], Sums]
    ) -> None:
        """Bring the levels from the base up to `first` up to date."""
        touched = {self._base: tiles}
        for zoom in range(self._base - 1, first - 1, -1):
            touched[zoom] = {parent(tile) for tile in touched[zoom + 1]}
        for tile in sorted(touched[first]):
            self._climb(first, tile, touched, contribution)
        self._write_all_but(0)

    def _climb(
        self,
        zoom: int,
        tile: TileIndex,
        touched: dict[int, set[TileIndex]],
        contribution: Callable[[TileIndex], Sums],
    ) -> Sums:
        """Update a tile and all touched ones below it; returns what was added to it."""
        if zoom == self._base:
            added = contribution(tile)
        else:
            added = np.zeros((TILE_CELLS, TILE_CELLS, 2), dtype=np.uint64)
            for child in children(tile):
                if child in touched[zoom + 1]:
                    part = self._climb(zoom + 1, child, touched, contribution)
                    added[_quadrant(child)] = halve(part)
        if added[..., 0].any():
            before = self._sums(zoom, tile)
            self._write(zoom, tile, added if before is None else before + added)
        return added

    def _add_level(self, zoom: int) -> None:
        """Make a level that the map did not need before, from all of the one below it."""
        below = self._tiles(zoom + 1)
        for tile in sorted({parent(child) for child in below}):
            total = np.zeros((TILE_CELLS, TILE_CELLS, 2), dtype=np.uint64)
            for child in children(tile):
                sums = self._sums(zoom + 1, child)
                if sums is not None:
                    total[_quadrant(child)] = halve(sums)
            self._write(zoom, tile, total)
        self._write_all_but(0)

    def _write(self, zoom: int, tile: TileIndex, sums: Sums) -> None:
        """Hand a tile over to be compressed; it is in the map a few tiles later."""
        self._encoding.append((zoom, tile, self._pool.submit(_encode, sums)))
        self._write_all_but(2 * ENCODERS)

    def _write_all_but(self, count: int) -> None:
        while len(self._encoding) > count:
            zoom, tile, future = self._encoding.popleft()
            self._insert(zoom, tile, future.result())

    def _insert(self, zoom: int, tile: TileIndex, encoded: _Encoded) -> None:
        if zoom == self._base:
            cells = tile_window(tile)
            seen = encoded.seen
            self.extent = union(
                self.extent,
                Window(cells.i0 + seen.i0, cells.j0 + seen.j0, seen.width, seen.height),
            )
        self._connection.execute(
            "INSERT OR REPLACE INTO fieldgrid_tile (zoom, ty, tx, sums) VALUES (?, ?, ?, ?)",
            (zoom, *tile, encoded.sums),
        )
        self._connection.execute(
            "INSERT INTO density (zoom_level, tile_column, tile_row, tile_data) "
            "VALUES (?, ?, ?, ?) ON CONFLICT (zoom_level, tile_column, tile_row) "
            "DO UPDATE SET tile_data = excluded.tile_data",
            (zoom, *self._matrices.column_row(zoom, tile), encoded.png),
        )

    def _sums(self, zoom: int, tile: TileIndex) -> Sums | None:
        row = self._connection.execute(
            "SELECT sums FROM fieldgrid_tile WHERE zoom = ? AND ty = ? AND tx = ?", (zoom, *tile)
        ).fetchone()
        return None if row is None else decode_sums(row[0], f"tile {tuple(tile)} of level {zoom}")

    def _tiles(self, zoom: int) -> list[TileIndex]:
        rows = self._connection.execute("SELECT ty, tx FROM fieldgrid_tile WHERE zoom = ?", (zoom,))
        return [TileIndex(*row) for row in rows]

    def _top_zoom(self) -> int | None:
        (zoom,) = self._connection.execute("SELECT min(zoom) FROM fieldgrid_tile").fetchone()
        return None if zoom is None else int(zoom)

    def _corners(self) -> list[TileIndex]:
        """The south-west and north-east tile of the base level's extent, if it has tiles."""
        south, west, north, east = self._connection.execute(
            "SELECT min(ty), min(tx), max(ty), max(tx) FROM fieldgrid_tile WHERE zoom = ?",
            (self._base,),
        ).fetchone()
        return [] if south is None else [TileIndex(south, west), TileIndex(north, east)]

    def _announce(self, top: int) -> None:
        """List the zoom levels in use for a GIS."""
        self._connection.executemany(
            "INSERT OR IGNORE INTO gpkg_tile_matrix VALUES ('density', ?, ?, ?, ?, ?, ?, ?)",
            [
                (zoom, 1 << zoom, 1 << zoom, TILE_CELLS, TILE_CELLS, pixel_m, pixel_m)
                for zoom in range(top, self._base + 1)
                for pixel_m in (self._matrices.pixel_m(zoom),)
            ],
        )


def _encode(sums: Sums) -> _Encoded:
    density, observed = mean_density(sums)
    j, i = np.flatnonzero(observed.any(axis=1)), np.flatnonzero(observed.any(axis=0))
    seen = Window(int(i[0]), int(j[0]), int(i[-1] - i[0]) + 1, int(j[-1] - j[0]) + 1)
    return _Encoded(encode_sums(sums), encode_png(density, observed), seen)


def halve(sums: Sums) -> Sums:
    """Sums over 2 x 2 cells, from [2h, 2w, 2] to [h, w, 2]."""
    rows = sums[0::2] + sums[1::2]
    halved: Sums = rows[:, 0::2] + rows[:, 1::2]
    return halved


def union(a: Window | None, b: Window) -> Window:
    """The smallest window that holds both."""
    if a is None:
        return b
    i0, j0 = min(a.i0, b.i0), min(a.j0, b.j0)
    i1, j1 = max(a.i0 + a.width, b.i0 + b.width), max(a.j0 + a.height, b.j0 + b.height)
    return Window(i0, j0, i1 - i0, j1 - j0)


def _quadrant(child: TileIndex) -> tuple[slice, slice]:
    """Where a tile lies in its parent's array."""
    j, i = _HALF * (child.ty & 1), _HALF * (child.tx & 1)
    return slice(j, j + _HALF), slice(i, i + _HALF)
