"""What a session has so far: frames on disk, the moments of its tiles in memory and on disk.

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

from fieldgrid.errors import ConfigError
from fieldgrid.grids import LocalGrid
from fieldgrid.lattice import TILE_CELLS, Lattice, TileIndex, Window
from fieldgrid.mapfile.codec import decode_moments, encode_moments
from fieldgrid.mapfile.schema import FRAME_COLUMNS
from fieldgrid.moments import PLANES, Moments, add_to_tiles, finished, merge_moments
from fieldgrid.trajectory import Pose
from fieldgrid.transfer import Transfer, footprint

POOL_TILES = 32
"""Tiles whose moments are in memory, 2.6 MB each."""

PART_TILES = 4
"""Side of the largest square of tiles that a frame is folded into in one go."""


class Staging:
    """The temporary database of one session."""

    def __init__(self) -> None:
        self._database = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        # Nothing here outlives an error, so nothing needs to be undone or synced.
        self._database.execute("PRAGMA journal_mode = OFF")
        self._database.execute("PRAGMA synchronous = OFF")
        self._database.execute(f"CREATE TABLE frame (id INTEGER PRIMARY KEY, {FRAME_COLUMNS})")
        self._database.execute(
            "CREATE TABLE tile (ty INTEGER, tx INTEGER, moments BLOB, PRIMARY KEY (ty, tx))"
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
        """The tiles whose moments are here."""
        return {TileIndex(*row) for row in self._database.execute("SELECT ty, tx FROM tile")}

    def moments(self, tile: TileIndex) -> Moments | None:
        """A tile's moments, or None."""
        row = self._database.execute(
            "SELECT moments FROM tile WHERE ty = ? AND tx = ?", tile
        ).fetchone()
        return None if row is None else decode_moments(row[0], f"tile {tuple(tile)}")

    def put_moments(self, tile: TileIndex, moments: Moments) -> None:
        """Keep a tile's moments in place of those that were there."""
        self._database.execute(
            "INSERT OR REPLACE INTO tile VALUES (?, ?, ?)", (*tile, encode_moments(moments))
        )

    def close(self) -> None:
        """Throw everything away."""
        self._database.close()


class SessionFold:
    """The fold over a session's frames, tile by tile.

    The tiles last used are in memory, the others are compressed into the staging. Where the
    drive comes back to such a tile it starts afresh, and the two parts are merged later.
    """

    def __init__(self, lattice: Lattice, transfer: Transfer, staging: Staging) -> None:
        self._lattice = lattice
        self._transfer = transfer
        self._staging = staging
        # Memory that is not touched is not taken.
        self._pool = np.zeros((POOL_TILES, TILE_CELLS, TILE_CELLS, PLANES), dtype=np.uint64)
        self._slots: OrderedDict[TileIndex, int] = OrderedDict()
        self._free = list(range(POOL_TILES))
        self._number = 0

    def add(self, grid: LocalGrid, pose: Pose) -> None:
        """Carry one local grid into the tiles under it."""
        self._number += 1
        for tiles in _parts(footprint(grid.spec, pose, self._lattice)):
            rows, columns = (
                range(tiles.j0, tiles.j0 + tiles.height),
                range(tiles.i0, tiles.i0 + tiles.width),
            )
            slots = np.array(
                [[self._slot(TileIndex(ty, tx)) for tx in columns] for ty in rows], dtype=np.int32
            )
            window = Window(*(TILE_CELLS * value for value in tiles))
            add_to_tiles(
                self._pool, slots, window, grid, pose, self._lattice, self._transfer, self._number
            )

    def tiles(self) -> set[TileIndex]:
        """Every tile that any local grid may have touched."""
        return self._staging.tiles() | self._slots.keys()

    def moments(self, tile: TileIndex) -> Moments:
        """What this session has in a tile, uint64 [256, 256, 5]."""
        slot, staged = self._slots.get(tile), self._staging.moments(tile)
        if slot is None:
            return np.zeros(self._pool.shape[1:], dtype=np.uint64) if staged is None else staged
        pooled = finished(self._pool[slot])
        return pooled if staged is None else merge_moments(pooled, staged)

    def close(self) -> None:
        """Throw everything away."""
        self._staging.close()

    def _slot(self, tile: TileIndex) -> int:
        slot = self._slots.get(tile)
        if slot is None:
            if not self._free:
                self._stage(*self._slots.popitem(last=False))
            slot = self._slots[tile] = self._free.pop()
        self._slots.move_to_end(tile)
        return slot

    def _stage(self, tile: TileIndex, slot: int) -> None:
        moments = finished(self._pool[slot])
        if moments[..., 0].any():  # or it is a corner of a footprint, which no cell reached
            staged = self._staging.moments(tile)
            merged = moments if staged is None else merge_moments(moments, staged)
            self._staging.put_moments(tile, merged)
            self._pool[slot] = 0
        self._free.append(slot)


def _parts(window: Window) -> Iterator[Window]:
    """The tiles under a window, cut up where they are more than the pool should hold at once."""
    ty0, ty1 = window.j0 // TILE_CELLS, (window.j0 + window.height - 1) // TILE_CELLS
    tx0, tx1 = window.i0 // TILE_CELLS, (window.i0 + window.width - 1) // TILE_CELLS
    whole = Window(tx0, ty0, tx1 - tx0 + 1, ty1 - ty0 + 1)
    for ty in range(ty0, ty1 + 1, PART_TILES):
        for tx in range(tx0, tx1 + 1, PART_TILES):
            part = whole.intersect(Window(tx, ty, PART_TILES, PART_TILES))
            if part is not None:
                yield part
