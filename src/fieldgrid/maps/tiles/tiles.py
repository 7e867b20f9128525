"""The tiles of a map over all sessions, at every zoom level."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from fieldgrid.core import MapError, UInt64, shortened
from fieldgrid.geometry import TILE_CELLS, TileIndex
from fieldgrid.maps.file import schema
from fieldgrid.maps.layers.blocks import block_side
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup, is_nothing, nothing
from fieldgrid.maps.layers.window import coarser, with_overviews
from fieldgrid.maps.tiles.tile_codec import stored_channels
from fieldgrid.maps.tiles.tiling import TileMatrixSet, children
from fieldgrid.maps.writing.placing import decode_groups

_FARTHEST = 1 << 31
"""Beyond the places of all tiles."""

_NONE_KNOWN: Mapping[TileIndex, Cells] = MappingProxyType({})


class TileTables:
    """Reads and writes tiles; reading is safe from any thread. Base tiles have `levels` 0."""

    def __init__(
        self,
        connection: sqlite3.Connection,
        matrices: TileMatrixSet,
        groups: Sequence[ChannelGroup],
    ) -> None:
        self.connection = connection
        self._lock = threading.Lock()
        self.matrices = matrices
        self.groups = groups

    def rows(self, query: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """The rows of a query, all at once."""
        with self._lock:
            return self.connection.execute(query, values).fetchall()

    def cells(
        self,
        zoom: int,
        tile: TileIndex,
        groups: Sequence[ChannelGroup] | None = None,
        known: Mapping[TileIndex, Cells] = _NONE_KNOWN,
    ) -> Cells | None:
        """The channels of a tile over all sessions; None when nothing was observed there. `known`
        has tiles of the level below, which are not read again."""
        rows = self.rows(
            "SELECT channels, data FROM fieldgrid_tile WHERE zoom = ? AND ty = ? AND tx = ?",
            (zoom, *tile),
        )
        if not rows:
            return None
        blobs, levels = dict(rows), self.matrices.base_zoom - zoom
        wanted = self.groups if groups is None else groups
        kept = self.kept(levels)
        stored = [group for group in wanted if group in kept]
        what = f"tile {tuple(tile)} of level {zoom}"
        block = self.block(levels)
        found = dict(decode_groups(stored, blobs, what, base=levels == 0, block=block))
        if len(stored) < len(wanted):
            others = [group for group in wanted if group not in kept]
            found.update(self.above(zoom, tile, others, known))
        return Cells(found, 1 << 2 * levels, block)

    def block(self, levels: int) -> int:
        """Cells along the side of a block in tiles that lie `levels` above the base."""
        return max(block_side(self.matrices.lattice) >> levels, 1)

    def kept(self, levels: int) -> Sequence[ChannelGroup]:
        """The groups that the tiles of a level hold: above the base none whose blocks are larger
        than its cells, which would be the same once more."""
        if levels == 0 or self.block(levels) == 1:
            return self.groups
        return [group for group in self.groups if not group.blocks]

    def above(
        self,
        zoom: int,
        tile: TileIndex,
        groups: Sequence[ChannelGroup],
        known: Mapping[TileIndex, Cells] = _NONE_KNOWN,
    ) -> Cells:
        """A tile of a level above the base from the four tiles below it, which are read but for
        those `known`."""
        wanted = tuple(dict.fromkeys((self.groups[0], *groups)))
        levels = self.matrices.base_zoom - zoom
        block = self.block(levels)
        arrays = dict[str, UInt64]()
        for group in groups:
            side = TILE_CELLS // block if group.blocks else TILE_CELLS
            for name, _ in stored_channels(group, base=False):
                arrays[name] = nothing((side, side))
        for child in children(tile):
            cells = known.get(child) or self.cells(zoom + 1, child, wanted)
            if cells is None:
                continue
            if zoom + 1 == self.matrices.base_zoom:
                cells = with_overviews(groups, cells)
            for name, part in coarser(groups, cells, 2).items():
                if name in arrays and not is_nothing(part):
                    if is_nothing(arrays[name]):
                        arrays[name] = np.zeros(arrays[name].shape, np.uint64)
                    half = len(arrays[name]) // 2
                    j, i = half * (child.ty & 1), half * (child.tx & 1)
                    arrays[name][j : j + half, i : i + half] = part
        return Cells(arrays, 1 << 2 * levels, block)

    @property
    def is_settled(self) -> bool:
        """Whether no commit has left tiles above the base for later."""
        return not self.rows("SELECT 1 FROM fieldgrid_meta WHERE key = ?", (schema.UNSETTLED,))

    def tiles(self, zoom: int) -> list[TileIndex]:
        """The observed tiles of a zoom level, in order."""
        return [
            _index(*row)
            for row in self.rows(
                "SELECT ty, tx FROM fieldgrid_tile WHERE zoom = ? AND channels = 'density' "
                "ORDER BY 1, 2",
                (zoom,),
            )
        ]

    def top_zoom(self) -> int | None:
        """The uppermost level that the map needs; None where it has no tiles."""
        corners = self.corners()
        return self.matrices.top_zoom(corners) if corners else None

    def corners(self) -> list[TileIndex]:
        """The south-west and north-east tile of the base level's extent, if it has tiles."""
        ((south, west, north, east),) = self.rows(
            "SELECT min(ty), min(tx), max(ty), max(tx) FROM fieldgrid_tile WHERE zoom = ?",
            (self.matrices.base_zoom,),
        )
        return [] if south is None else [_index(south, west), _index(north, east)]

    def edges(self) -> list[tuple[Any, ...]]:
        """The rows of the densities of the outermost base tiles."""
        corners = self.corners()
        if not corners:
            return []
        (south, west), (north, east) = corners
        return self.rows(
            "SELECT * FROM fieldgrid_tile WHERE zoom = ? AND channels = ? "
            "AND (ty IN (?, ?) OR tx IN (?, ?))",
            (self.matrices.base_zoom, self.groups[0].name, south, north, west, east),
        )

    def put(self, zoom: int, tile: TileIndex, blobs: Mapping[str, bytes], picture: bytes) -> None:
        """Replace a tile over all sessions and its picture; rows that stay as they are cost
        nothing. Without blobs it is removed."""
        if not blobs:
            self.remove(zoom, [tile])
            return
        with self._lock:
            self.connection.executemany(
                "INSERT INTO fieldgrid_tile VALUES (?, ?, ?, ?, ?) "
                "ON CONFLICT (zoom, ty, tx, channels) DO UPDATE SET data = excluded.data "
                "WHERE data IS NOT excluded.data",
                [(zoom, *tile, name, blob) for name, blob in blobs.items()],
            )
            self.connection.execute(
                "INSERT INTO density (zoom_level, tile_column, tile_row, tile_data) "
                "VALUES (?, ?, ?, ?) ON CONFLICT (zoom_level, tile_column, tile_row) "
                "DO UPDATE SET tile_data = excluded.tile_data",
                (zoom, *self.matrices.column_row(zoom, tile), picture),
            )

    def remove(self, zoom: int, tiles: Iterable[TileIndex]) -> None:
        """Take tiles and their pictures out."""
        places = [(zoom, *tile, zoom, *self.matrices.column_row(zoom, tile)) for tile in tiles]
        with self._lock:
            self.connection.executemany(
                "DELETE FROM fieldgrid_tile WHERE zoom = ? AND ty = ? AND tx = ?",
                [place[:3] for place in places],
            )
            self.connection.executemany(
                "DELETE FROM density WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
                [place[3:] for place in places],
            )


def _index(ty: object, tx: object) -> TileIndex:
    """Where a tile lies, as it was stored."""
    if not (isinstance(ty, int) and isinstance(tx, int) and max(abs(ty), abs(tx)) < _FARTHEST):
        raise MapError(
            f"A tile lies at {shortened(ty)}, {shortened(tx)}, which is no place; try "
            "`fieldgrid repair`."
        )
    return TileIndex(ty, tx)
