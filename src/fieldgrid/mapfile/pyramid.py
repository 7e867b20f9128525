"""The tiles of a map: their sums at every zoom level, and the pictures that a GIS sees.

Each level holds sums, not means, so each is exact: a cell of an overview is the mean over
everything that fell into it. What a session adds, or what its leaving takes away, is added to
what is there; since sums add up, a tile above needs to know nothing of its other children. The
tiles that result are those of a map that was made of the present sessions at once.
"""

from __future__ import annotations

import json
import sqlite3
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.array_types import Bool, UInt64
from fieldgrid.kernel import kernel
from fieldgrid.lattice import TILE_CELLS, TileIndex, Window, tile_window
from fieldgrid.mapfile.codec import decode_sums, encode_sums
from fieldgrid.mapfile.png import encode_mean
from fieldgrid.mapfile.tiling import TileMatrixSet, children, parent

Sums = UInt64

_HALF = TILE_CELLS // 2

ENCODERS = 2
"""Threads that compress tiles: most of what a commit does, outside the interpreter's lock."""


class Backlog:
    """Work for threads, whose results are taken up in order, a few behind."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(ENCODERS, thread_name_prefix="fieldgrid-tiles")
        self._waiting: deque[tuple[Future[Any], Callable[[Any], None]]] = deque()

    def put(self, work: Callable[..., Any], argument: Any, then: Callable[[Any], None]) -> None:
        """Have `work(argument)` done, and its result taken by `then` before long."""
        self._waiting.append((self._pool.submit(work, argument), then))
        self._take_all_but(2 * ENCODERS)

    def finish(self) -> None:
        """Wait for all of it."""
        self._take_all_but(0)

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)

    def _take_all_but(self, count: int) -> None:
        while len(self._waiting) > count:
            future, then = self._waiting.popleft()
            then(future.result())


class _Encoded(NamedTuple):
    """A tile as it is stored; `seen` is the part of it that was observed, in its own cells."""

    sums: bytes
    png: bytes
    seen: Window


class Pyramid:
    """Changes the sums of a map's tiles, within the caller's transaction."""

    def __init__(
        self, connection: sqlite3.Connection, matrices: TileMatrixSet, backlog: Backlog
    ) -> None:
        self._connection = connection
        self._matrices = matrices
        self._backlog = backlog
        self._base = matrices.base_zoom
        self._seen: Window | None = None

    def change(
        self, tiles: set[TileIndex], delta: Callable[[TileIndex], Sums], *, shrinks: bool
    ) -> None:
        """Add to each base tile its delta, uint64 modulo 2^64, and to all levels above.

        With `shrinks` some cells may have less afterwards. Works down to the tiles and up again
        branch by branch, so that a few tiles a level are in memory, however large the session.
        """
        top = self._top_zoom()
        if tiles:
            self._update(self._matrices.top_zoom(tiles) if top is None else top, tiles, delta)
        self._settle()
        self._announce(shrinks)

    def _update(
        self, first: int, tiles: set[TileIndex], delta: Callable[[TileIndex], Sums]
    ) -> None:
        """Bring the levels from the base up to `first` up to date."""
        touched = {self._base: tiles}
        for zoom in range(self._base - 1, first - 1, -1):
            touched[zoom] = {parent(tile) for tile in touched[zoom + 1]}
        for tile in sorted(touched[first]):
            self._climb(first, tile, touched, delta)
        self._backlog.finish()

    def _climb(
        self,
        zoom: int,
        tile: TileIndex,
        touched: dict[int, set[TileIndex]],
        delta: Callable[[TileIndex], Sums],
    ) -> Sums:
        """Update a tile and all touched ones below it; returns what was added to it."""
        if zoom == self._base:
            added = delta(tile)
        else:
            added = np.zeros((TILE_CELLS, TILE_CELLS, 2), dtype=np.uint64)
            for child in children(tile):
                if child in touched[zoom + 1]:
                    part = self._climb(zoom + 1, child, touched, delta)
                    added[_quadrant(child)] = halve(part)
        if added.any():
            before = self._sums(zoom, tile)
            self._write(zoom, tile, added if before is None else before + added)
        return added

    def _settle(self) -> None:
        """Have just the levels that the present tiles need."""
        top, corners = self._top_zoom(), self._corners()
        needed = self._matrices.top_zoom(corners) if corners else self._base + 1
        if top is not None:
            for zoom in range(top - 1, needed - 1, -1):
                self._add_level(zoom)
        for table, column in (
            ("fieldgrid_tile", "zoom"),
            ("density", "zoom_level"),
            ("gpkg_tile_matrix", "table_name = 'density' AND zoom_level"),
        ):
            self._connection.execute(f"DELETE FROM {table} WHERE {column} < ?", (needed,))
        # To be listed for a GIS.
        self._connection.executemany(
            "INSERT OR IGNORE INTO gpkg_tile_matrix VALUES ('density', ?, ?, ?, ?, ?, ?, ?)",
            [
                (zoom, 1 << zoom, 1 << zoom, TILE_CELLS, TILE_CELLS, pixel_m, pixel_m)
                for zoom in range(needed, self._base + 1)
                for pixel_m in (self._matrices.pixel_m(zoom),)
            ],
        )

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
        self._backlog.finish()

    def _announce(self, shrinks: bool) -> None:
        """Record which base cells have data, and the raster's extent for a GIS."""
        meta = "fieldgrid_meta WHERE key = 'data_window'"
        before = self._connection.execute(f"SELECT value FROM {meta}").fetchone()
        if before is None or shrinks:
            window = self._window_at_the_edges()
        else:
            window = union(self._seen, Window(*json.loads(before[0])))
        self._connection.execute(f"DELETE FROM {meta}")
        bounds: tuple[float | None, ...] = (None,) * 4
        if window is not None:
            self._connection.execute(
                "INSERT INTO fieldgrid_meta VALUES ('data_window', ?)", (json.dumps(list(window)),)
            )
            top = self._top_zoom()
            assert top is not None
            bounds = self._matrices.lattice.bounds(self._matrices.whole_cells(window, top))
        self._connection.execute(
            "UPDATE gpkg_contents SET (min_x, min_y, max_x, max_y) = (?, ?, ?, ?) "
            "WHERE table_name = 'density'",
            bounds,
        )

    def _window_at_the_edges(self) -> Window | None:
        """The observed cells' extent: only the outermost tiles are looked into."""
        corners = self._corners()
        if not corners:
            return None
        (south, west), (north, east) = corners
        rows = self._connection.execute(
            "SELECT ty, tx, sums FROM fieldgrid_tile WHERE zoom = ?1 AND (ty IN (?2, ?3) OR rowid "
            "IN (SELECT rowid FROM fieldgrid_tile WHERE zoom = ?1 AND tx IN (?4, ?5)))",
            (self._base, south, north, west, east),
        )
        window: Window | None = None
        for ty, tx, blob in rows:
            tile = TileIndex(ty, tx)
            observed = decode_sums(blob, _named(self._base, tile))[..., 0] > 0
            window = union(window, _placed(tile, _seen_in(observed)))
        return window

    def _write(self, zoom: int, tile: TileIndex, sums: Sums) -> None:
        """Hand a tile over to be compressed; it is in the map a few tiles later."""
        if sums[..., 0].any():
            self._backlog.put(_encode, sums, lambda encoded: self._insert(zoom, tile, encoded))
            return
        self._connection.execute(
            "DELETE FROM fieldgrid_tile WHERE zoom = ? AND ty = ? AND tx = ?", (zoom, *tile)
        )
        self._connection.execute(
            "DELETE FROM density WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
            (zoom, *self._matrices.column_row(zoom, tile)),
        )

    def _insert(self, zoom: int, tile: TileIndex, encoded: _Encoded) -> None:
        if zoom == self._base:
            self._seen = union(self._seen, _placed(tile, encoded.seen))
        self._connection.execute(
            "INSERT INTO fieldgrid_tile (zoom, ty, tx, sums) VALUES (?, ?, ?, ?) "
            "ON CONFLICT (zoom, ty, tx) DO UPDATE SET sums = excluded.sums",
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
        return None if row is None else decode_sums(row[0], _named(zoom, tile))

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


def _encode(sums: Sums) -> _Encoded:
    png, seen = encode_mean(sums)
    return _Encoded(encode_sums(sums), png, seen)


def _seen_in(observed: Bool) -> Window:
    """The extent of a mask that is not empty, in its own cells."""
    j, i = np.flatnonzero(observed.any(axis=1)), np.flatnonzero(observed.any(axis=0))
    return Window(int(i[0]), int(j[0]), int(i[-1] - i[0]) + 1, int(j[-1] - j[0]) + 1)


def _placed(tile: TileIndex, part: Window) -> Window:
    """A part of a tile, in cells of the lattice."""
    cells = tile_window(tile)
    return Window(cells.i0 + part.i0, cells.j0 + part.j0, part.width, part.height)


def _named(zoom: int, tile: TileIndex) -> str:
    return f"tile {tuple(tile)} of level {zoom}"


def halve(sums: Sums) -> Sums:
    """Sums over 2 x 2 cells, from [2h, 2w, 2] to [h, w, 2]."""
    halved = np.empty((sums.shape[0] // 2, sums.shape[1] // 2, 2), dtype=np.uint64)
    add_four(sums, halved)
    return halved


@kernel
def add_four(sums, halved):  # type: ignore[no-untyped-def]
    """Fill halved [h, w, 2] with the sums over 2 x 2 cells of [2h, 2w, 2]."""
    for j in range(halved.shape[0]):
        for i in range(halved.shape[1]):
            for k in range(2):
                halved[j, i, k] = (
                    sums[2 * j, 2 * i, k]
                    + sums[2 * j, 2 * i + 1, k]
                    + sums[2 * j + 1, 2 * i, k]
                    + sums[2 * j + 1, 2 * i + 1, k]
                )


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
