"""The density as the GeoPackage stores it: tiles and zoom levels as any GIS reads them.

Only this module and `features` look into tables of the file; all else goes through `MapFile`.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from fieldgrid.geometry import TileIndex
from fieldgrid.maps import connect, reading

_NAME_BYTES = 32
"""At most, of the level and the place of a tile as text."""


class ZoomLevels(NamedTuple):
    """The zoom levels of the density: `base_zoom` has the map's own cells, `above` levels above it
    have cells of twice the side each."""

    base_zoom: int
    above: int


@contextmanager
def stored(path: Path) -> Iterator[sqlite3.Connection]:
    """One state of the file, for reading."""
    connection = connect(path, path, writable=False)
    try:
        with reading(connection, path):
            yield connection
    finally:
        connection.close()


def read_levels(connection: sqlite3.Connection) -> ZoomLevels:
    """The levels that have tiles; none above the base in an empty map."""
    top, base = connection.execute(
        "SELECT min(zoom_level), max(zoom_level) FROM density"
    ).fetchone()
    return ZoomLevels(base or 1, 0 if base is None else base - top)


def finest_within(connection: sqlite3.Connection, levels: ZoomLevels, room_bytes: int) -> int:
    """The lowest level from which all tiles up to the top, in base 64 and named, take no more
    than some bytes together; the top one where not even that does."""
    sizes = dict(
        connection.execute(
            "SELECT zoom_level, sum((length(tile_data) + 2) / 3 * 4 + ?) FROM density "
            "GROUP BY zoom_level",
            (_NAME_BYTES,),
        ).fetchall()
    )
    taken = 0
    for level in range(levels.above, -1, -1):
        taken += sizes.get(levels.base_zoom - level, 0)
        if taken > room_bytes:
            return min(level + 1, levels.above)
    return 0


def pictures(
    connection: sqlite3.Connection, levels: ZoomLevels, finest: int
) -> Iterator[tuple[int, int, int, bytes]]:
    """Every tile from a level up: level, ty, tx, PNG."""
    for zoom, column, row, picture in connection.execute(
        "SELECT zoom_level, tile_column, tile_row, tile_data FROM density WHERE zoom_level <= ?",
        (levels.base_zoom - finest,),
    ):
        half = 1 << (zoom - 1)
        yield levels.base_zoom - zoom, half - 1 - row, column - half, bytes(picture)


def read_picture(
    connection: sqlite3.Connection, levels: ZoomLevels, level: int, tile: TileIndex
) -> bytes | None:
    """The PNG of a tile, `level` 0 for the base; None where nothing was observed."""
    zoom = levels.base_zoom - level
    half = 1 << (zoom - 1)
    row = connection.execute(
        "SELECT tile_data FROM density WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
        (zoom, tile.tx + half, half - 1 - tile.ty),
    ).fetchone()
    return None if row is None else bytes(row[0])
