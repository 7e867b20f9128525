"""The tiles of a map against what its frames say: all are folded again beside it, and compared."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from functools import partial

import numpy as np

from fieldgrid.core import MapError, Threads
from fieldgrid.geometry import TileIndex
from fieldgrid.maps.health.feature_check import differences, empty_map
from fieldgrid.maps.tiles.png import decode_png
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.transfer import mean_density
from fieldgrid.maps.writing.derived import fold_tiles
from fieldgrid.maps.writing.subject import Subject


def check_tiles(subject: Subject) -> Iterator[str]:
    """The tiles and pictures of all levels against a new fold of all frames; of a map whose last
    commit left some for later, those of its own cells."""
    tables, groups = subject.tables, subject.header.groups
    base, known = tables.matrices.base_zoom, [group.name for group in tables.groups]
    with closing(empty_map(subject)) as scratch:
        anew = TileTables(scratch, tables.matrices, tables.groups)
        fold_tiles(subject, anew)
        top = anew.top_zoom() or base
        zooms = "TRUE" if tables.is_settled else f"zoom NOT BETWEEN {top} AND {base - 1}"
        # Groups that no imported module knows are not looked at.
        others = ", ".join(f"'{name}'" for name in groups if name not in known) or "''"
        tiles = "SELECT zoom, ty, tx, channels FROM fieldgrid_tile WHERE"
        query = f"{tiles} {zooms} AND channels NOT IN ({others}) ORDER BY 1, 2, 3, 4"
        yield from differences(subject.connection, scratch, {"tile": query})
        yield from check_pictures(subject.connection, anew, zooms)
        places = anew.rows(f"SELECT DISTINCT zoom, ty, tx FROM fieldgrid_tile WHERE {zooms}")
        yield from filter(None, Threads().in_order(partial(_difference, tables, anew), places))


def _difference(tables: TileTables, anew: TileTables, place: tuple[int, int, int]) -> str:
    """How a stored tile differs from the same made anew; empty where it does not, or is missing."""
    zoom, tile = place[0], TileIndex(*place[1:])
    expected = anew.cells(zoom, tile)
    try:
        found = tables.cells(zoom, tile)
    except MapError as error:
        return str(error)
    if found is None or expected is None:
        return ""
    if all(np.array_equal(found[name], values) for name, values in expected.items()):
        return ""
    return f"The tile {tuple(tile)} of level {zoom} is not what follows from the frames."


def check_pictures(
    connection: sqlite3.Connection, anew: TileTables, zooms: str = "TRUE"
) -> Iterator[str]:
    """The pictures of a map against tiles that were made anew."""
    rows = "SELECT zoom_level AS zoom, tile_column, tile_row, tile_data FROM density"
    places = f"SELECT zoom, tile_column, tile_row FROM ({rows}) WHERE {zooms} ORDER BY 1, 2, 3"
    yield from differences(connection, anew.connection, {"picture of tile": places})
    for zoom, column, row, blob in connection.execute(f"SELECT * FROM ({rows}) WHERE {zooms}"):
        tile = anew.matrices.tile(zoom, column, row)
        cells = anew.cells(zoom, tile, anew.groups[:1])
        if cells is None:
            continue  # which is told of by its place
        density, observed = mean_density(cells["weight"], cells["sum"])
        shown = np.stack([density, observed * np.uint8(255)], axis=-1)
        try:
            is_shown = np.array_equal(decode_png(blob, "picture")[::-1], shown)
        except MapError:
            is_shown = False
        if not is_shown:
            yield f"The picture of tile {tuple(tile)} of level {zoom} is not that of its density."
