"""The tile tables of a map: what sessions have in base tiles, and the map at every zoom level."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Sequence
from typing import Any

from fieldgrid.lattice import TileIndex, Window
from fieldgrid.layers import Cells, ChannelGroup
from fieldgrid.mapfile.placing import decode_groups, session_cells
from fieldgrid.mapfile.tiling import TileMatrixSet


class TileTables:
    """Reads and writes tiles; reading is safe from any thread. Base tiles have `levels` 0."""

    def __init__(
        self,
        connection: sqlite3.Connection,
        matrices: TileMatrixSet,
        groups: Sequence[ChannelGroup],
    ) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self.matrices = matrices
        self.groups = groups

    def rows(self, query: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """The rows of a query, all at once."""
        with self._lock:
            return self._connection.execute(query, values).fetchall()

    def session_tiles(self, session_id: int) -> set[TileIndex]:
        """The base tiles in which a session has something."""
        return {
            TileIndex(*row)
            for row in self.rows(
                "SELECT DISTINCT ty, tx FROM fieldgrid_session_tile WHERE session_id = ?",
                (session_id,),
            )
        }

    def session_cells(
        self, session_id: int, tile: TileIndex, groups: Sequence[ChannelGroup] | None = None
    ) -> Cells:
        """What a session has in a base tile."""
        rows = self.rows(
            "SELECT channels, data FROM fieldgrid_session_tile "
            "WHERE session_id = ? AND ty = ? AND tx = ?",
            (session_id, *tile),
        )
        what = f"tile {tuple(tile)} of session {session_id}"
        return session_cells(groups or self.groups, dict(rows), what)

    def sessions_in(self, tile: TileIndex) -> list[int]:
        """The sessions that have something in a base tile."""
        rows = self.rows(
            "SELECT DISTINCT session_id FROM fieldgrid_session_tile WHERE ty = ? AND tx = ? "
            "ORDER BY 1",
            tile,
        )
        return [row[0] for row in rows]

    def sessions_near(self, window: Window) -> list[tuple[TileIndex, int]]:
        """The base tiles that a window touches, with the sessions that have something there."""
        corners = list(window.tiles())
        (south, west), (north, east) = corners[0], corners[-1]
        rows = self.rows(
            "SELECT DISTINCT ty, tx, session_id FROM fieldgrid_session_tile "
            "WHERE ty BETWEEN ? AND ? AND tx BETWEEN ? AND ? ORDER BY 1, 2, 3",
            (south, north, west, east),
        )
        return [(TileIndex(ty, tx), session_id) for ty, tx, session_id in rows]

    def cells(
        self, zoom: int, tile: TileIndex, groups: Sequence[ChannelGroup] | None = None
    ) -> Cells | None:
        """The channels of a tile over all sessions; None when nothing was observed there."""
        rows = self.rows(
            "SELECT channels, data FROM fieldgrid_tile WHERE zoom = ? AND ty = ? AND tx = ?",
            (zoom, *tile),
        )
        if not rows:
            return None
        levels = self.matrices.base_zoom - zoom
        what = f"tile {tuple(tile)} of level {zoom}"
        found = decode_groups(groups or self.groups, dict(rows), what, base=levels == 0)
        return Cells(found, 1 << 2 * levels)

    def tiles(self, zoom: int) -> list[TileIndex]:
        """The observed tiles of a zoom level, in order."""
        return [
            TileIndex(*row)
            for row in self.rows(
                "SELECT ty, tx FROM fieldgrid_tile WHERE zoom = ? AND channels = 'density' "
                "ORDER BY 1, 2",
                (zoom,),
            )
        ]

    def top_zoom(self) -> int | None:
        """The uppermost level that there is."""
        ((zoom,),) = self.rows("SELECT min(zoom) FROM fieldgrid_tile")
        return None if zoom is None else int(zoom)

    def corners(self) -> list[TileIndex]:
        """The south-west and north-east tile of the base level's extent, if it has tiles."""
        ((south, west, north, east),) = self.rows(
            "SELECT min(ty), min(tx), max(ty), max(tx) FROM fieldgrid_tile WHERE zoom = ?",
            (self.matrices.base_zoom,),
        )
        return [] if south is None else [TileIndex(south, west), TileIndex(north, east)]

    def put_session(self, session_id: int, tile: TileIndex, blobs: dict[str, bytes]) -> None:
        """Replace what a session has in a base tile; nothing when there are no blobs."""
        with self._lock:
            self._connection.execute(
                "DELETE FROM fieldgrid_session_tile WHERE session_id = ? AND ty = ? AND tx = ?",
                (session_id, *tile),
            )
            self._connection.executemany(
                "INSERT INTO fieldgrid_session_tile VALUES (?, ?, ?, ?, ?)",
                [(session_id, *tile, name, blob) for name, blob in blobs.items()],
            )

    def put(self, zoom: int, tile: TileIndex, blobs: dict[str, bytes], picture: bytes) -> None:
        """Replace a tile over all sessions and its picture; nothing when there are no blobs."""
        with self._lock:
            self._connection.execute(
                "DELETE FROM fieldgrid_tile WHERE zoom = ? AND ty = ? AND tx = ?", (zoom, *tile)
            )
            self._connection.executemany(
                "INSERT INTO fieldgrid_tile VALUES (?, ?, ?, ?, ?)",
                [(zoom, *tile, name, blob) for name, blob in blobs.items()],
            )
            place = (zoom, *self.matrices.column_row(zoom, tile))
            if not blobs:
                self._connection.execute(
                    "DELETE FROM density WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
                    place,
                )
                return
            self._connection.execute(
                "INSERT INTO density (zoom_level, tile_column, tile_row, tile_data) "
                "VALUES (?, ?, ?, ?) ON CONFLICT (zoom_level, tile_column, tile_row) "
                "DO UPDATE SET tile_data = excluded.tile_data",
                (*place, picture),
            )
