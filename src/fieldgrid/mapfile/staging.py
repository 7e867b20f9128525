"""What a session has so far: frames on disk, tile sums in memory and on disk.

It is kept apart from the map until the session ends. So the map is locked for the moment of
the commit only, readers and other drives meanwhile see it as it was, and giving up costs
nothing. The disk part is an unnamed temporary database that SQLite deletes by itself, also
when the process is killed; it lies where SQLITE_TMPDIR says, or in the system's place for
temporary files. The memory taken does not depend on the length of the drive.
"""

from __future__ import annotations

import sqlite3
from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import ConfigError
from fieldgrid.grids import LocalGrid
from fieldgrid.lattice import TILE_CELLS, Lattice, TileIndex, Window, tile_window
from fieldgrid.mapfile.codec import decode_sums, encode_sums
from fieldgrid.mapfile.schema import FRAME_COLUMNS
from fieldgrid.trajectory import Pose
from fieldgrid.transfer import Transfer, add_to_sums, footprint

POOL_TILES = 64
"""Tiles whose sums are in memory, 1 MB each."""

SLAB_TILES = 16
"""Tiles that are asked of the system at a time."""

PART_CELLS = 2048
"""Side of the largest window that a frame is folded over in one go."""


class Staging:
    """The temporary database of one session."""

    def __init__(self) -> None:
        self._database = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        # Nothing here outlives an error, so nothing needs to be undone or synced.
        self._database.execute("PRAGMA journal_mode = OFF")
        self._database.execute("PRAGMA synchronous = OFF")
        self._database.execute(f"CREATE TABLE frame (id INTEGER PRIMARY KEY, {FRAME_COLUMNS})")
        self._database.execute(
            "CREATE TABLE tile (ty INTEGER, tx INTEGER, sums BLOB, PRIMARY KEY (ty, tx))"
        )

    def add_frame(self, row: tuple[Any, ...]) -> None:
        """Keep a frame's row, in the order of `FRAME_COLUMNS`."""
        places = ", ".join("?" * len(row))
        try:
            self._database.execute(f"INSERT INTO frame VALUES (NULL, {places})", row)
        except sqlite3.IntegrityError as error:
            raise ConfigError(
                f"Frame {row[0]!r} is in this session already; give each frame its own frame_id."
            ) from error

    def frames(self) -> Iterator[tuple[Any, ...]]:
        """The frames' rows in the order in which they were added."""
        return (row[1:] for row in self._database.execute("SELECT * FROM frame ORDER BY id"))

    def tiles(self) -> set[TileIndex]:
        """The tiles whose sums are here."""
        return {TileIndex(*row) for row in self._database.execute("SELECT ty, tx FROM tile")}

    def sums(self, tile: TileIndex) -> npt.NDArray[np.uint64] | None:
        """A tile's sums, or None."""
        row = self._database.execute(
            "SELECT sums FROM tile WHERE ty = ? AND tx = ?", tile
        ).fetchone()
        return None if row is None else decode_sums(row[0], f"tile {tuple(tile)}")

    def put_sums(self, tile: TileIndex, sums: npt.NDArray[np.uint64]) -> None:
        """Keep a tile's sums in place of those that were there."""
        self._database.execute(
            "INSERT OR REPLACE INTO tile VALUES (?, ?, ?)", (*tile, encode_sums(sums))
        )

    def close(self) -> None:
        """Throw everything away."""
        self._database.close()


class SessionFold:
    """The fold over a session's frames, tile by tile.

    The tiles last used are in memory, the others are compressed into the staging. Where the
    drive comes back to such a tile it starts afresh, and the two parts are added later.
    """

    def __init__(self, lattice: Lattice, transfer: Transfer, staging: Staging) -> None:
        self._lattice = lattice
        self._transfer = transfer
        self._staging = staging
        self._pool: OrderedDict[TileIndex, npt.NDArray[np.uint64]] = OrderedDict()
        self._free: list[npt.NDArray[np.uint64]] = []
        self._scratch = np.zeros(0, dtype=np.uint64)

    def add(self, grid: LocalGrid, pose: Pose) -> None:
        """Carry one local grid into the tiles under it."""
        for window in _parts(footprint(grid.spec, pose, self._lattice)):
            sums = self._fold(grid, pose, window)
            for tile in window.tiles():
                cells = tile_window(tile)
                shared = cells.intersect(window)
                if shared is not None:
                    pooled = self._pooled(tile)[cells.slices_of(shared)]
                    pooled += sums[window.slices_of(shared)]

    def tiles(self) -> set[TileIndex]:
        """Every tile that any local grid may have touched."""
        return self._staging.tiles() | self._pool.keys()

    def sums(self, tile: TileIndex) -> npt.NDArray[np.uint64]:
        """What this session adds to a tile: (weight, weighted sum), uint64 [256, 256, 2]."""
        pooled, staged = self._pool.get(tile), self._staging.sums(tile)
        if pooled is None:
            assert staged is not None
            return staged
        return pooled if staged is None else pooled + staged

    def _fold(self, grid: LocalGrid, pose: Pose, window: Window) -> npt.NDArray[np.uint64]:
        """One frame's sums over a window, in memory that the next frame takes over.

        The same as `MeanFold`, which would ask the system for new memory at each frame: that
        takes longer than the fold.
        """
        size = window.height * window.width * 2
        if size > self._scratch.size:
            self._scratch = np.zeros(size, dtype=np.uint64)
        sums = self._scratch[:size].reshape(*window.shape, 2)
        sums.fill(0)
        add_to_sums(sums, window, grid, pose, self._lattice, self._transfer)
        return sums

    def _pooled(self, tile: TileIndex) -> npt.NDArray[np.uint64]:
        sums = self._pool.get(tile)
        if sums is None:
            if len(self._pool) == POOL_TILES:
                self._stage(*self._pool.popitem(last=False))
            if not self._free:
                # Several tiles at once get large pages of memory, and are touched faster.
                slab = np.zeros((SLAB_TILES, TILE_CELLS, TILE_CELLS, 2), dtype=np.uint64)
                self._free.extend(slab)
            sums = self._pool[tile] = self._free.pop()
        self._pool.move_to_end(tile)
        return sums

    def _stage(self, tile: TileIndex, sums: npt.NDArray[np.uint64]) -> None:
        if sums[..., 0].any():  # or it is a corner of a footprint, which no cell reached
            staged = self._staging.sums(tile)
            self._staging.put_sums(tile, sums if staged is None else sums + staged)
        sums.fill(0)
        self._free.append(sums)


def _parts(window: Window) -> Iterator[Window]:
    """The window, cut up where its sums would take more than 64 MB."""
    for j0 in range(window.j0, window.j0 + window.height, PART_CELLS):
        for i0 in range(window.i0, window.i0 + window.width, PART_CELLS):
            part = window.intersect(Window(i0, j0, PART_CELLS, PART_CELLS))
            if part is not None:
                yield part
