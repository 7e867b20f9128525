"""The tiles of a map against what its frames say: made again, level by level, and compared."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from itertools import chain

import numpy as np

from fieldgrid.core import MapError
from fieldgrid.geometry import TileIndex
from fieldgrid.maps.file import schema
from fieldgrid.maps.layers.declaration import Cells
from fieldgrid.maps.tiles.png import decode_png
from fieldgrid.maps.tiles.pyramid import Pyramid
from fieldgrid.maps.tiles.tile_codec import stored_channels
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.tiles.tiling import parent
from fieldgrid.maps.transfer import mean_density
from fieldgrid.maps.writing.derived import squares_of
from fieldgrid.maps.writing.subject import PickledByArguments, Subject

_TILES_TOGETHER = 8


def check_tiles(subject: Subject, *, folded: bool = False) -> Iterator[str]:
    """The tiles of the map's own cells against a new fold, unless they were `folded` just now, and
    those above against those below them."""
    tables = subject.tables
    base = tables.matrices.base_zoom
    top = tables.top_zoom() or base + 1
    first = base - 1 if tables.is_settled else top - 1
    tiles = set(tables.tiles(base))
    if not folded:
        tiles = yield from _base_tiles(subject)
    for zoom in range(first, top - 1, -1):
        tiles = {parent(tile) for tile in tiles}
        yield from _missing(subject, zoom, tiles)
        found = subject.runner.in_order(_LevelCheck(subject, zoom), sorted(tiles), _TILES_TOGETHER)
        yield from filter(None, found)
    strays = tables.rows(
        "SELECT DISTINCT zoom FROM fieldgrid_tile WHERE zoom < ? OR zoom > ?", (top, base)
    )
    strays += tables.rows(
        "SELECT DISTINCT zoom_level FROM density WHERE zoom_level < ? OR zoom_level > ?",
        (top, base),
    )
    for (zoom,) in strays:
        yield f"The map has tiles of a level {zoom} that it does not need."
    known = {*subject.header.groups, *(group.name for group in tables.groups)}
    for (name,) in tables.rows("SELECT DISTINCT channels FROM fieldgrid_tile"):
        if name not in known:
            yield f"The map has channels {name!r} that it should not have."
    yield from check_extent(subject)


def _base_tiles(subject: Subject) -> Generator[str, None, set[TileIndex]]:
    """The tiles and pictures of the map's own cells against a new fold of all frames; returns those
    that there should be."""
    check, tiles = _SquareCheck(subject), set[TileIndex]()
    places = check.squares.places()
    for tile, problem in chain.from_iterable(subject.runner.in_order(check, places)):
        tiles.add(tile)
        if problem:
            yield problem
    yield from _missing(subject, subject.tables.matrices.base_zoom, tiles)
    return tiles


class _SquareCheck(PickledByArguments):
    """Folds squares of the map anew, and compares their tiles and pictures."""

    def __init__(self, subject: Subject) -> None:
        self._of = (subject,)
        self._tables = subject.tables
        self._names = [c.name for group in self._tables.groups for c in group.channels]
        self.squares = squares_of(subject, self._tables.groups)

    def __call__(self, place: tuple[int, int]) -> list[tuple[TileIndex, str]]:
        return self.squares.fold(place, self._compare)

    def _compare(self, tile: TileIndex, cells: Cells) -> tuple[TileIndex, str]:
        zoom = self._tables.matrices.base_zoom
        return tile, _difference(self._tables, zoom, tile, cells, self._names)


def _missing(subject: Subject, zoom: int, tiles: set[TileIndex]) -> Iterator[str]:
    """The tiles and pictures that a zoom level lacks, or has beyond those that it should have."""
    tables = subject.tables
    pictures = {
        tables.matrices.tile(zoom, column, row)
        for column, row in tables.rows(
            "SELECT tile_column, tile_row FROM density WHERE zoom_level = ?", (zoom,)
        )
    }
    for kind, there in (("tile", set(tables.tiles(zoom))), ("picture of tile", pictures)):
        for tile in sorted(tiles - there):
            yield f"The map lacks {kind} {tuple(tile)} of level {zoom}."
        for tile in sorted(there - tiles):
            yield f"The map has {kind} {tuple(tile)} of level {zoom}, where nothing was observed."


class _LevelCheck(PickledByArguments):
    """Makes tiles of a level anew of what is below them, and compares them and their pictures."""

    def __init__(self, subject: Subject, zoom: int) -> None:
        self._of = subject, zoom
        self._tables = subject.tables
        self._names = [n for g in self._tables.groups for n, _ in stored_channels(g, base=False)]

    def __call__(self, tile: TileIndex) -> str:
        _, zoom = self._of
        try:
            expected = self._tables.above(zoom, tile, self._tables.groups)
        except MapError:
            return ""  # what it is made of was told of already
        return _difference(self._tables, zoom, tile, expected, self._names)


def _difference(
    tables: TileTables, zoom: int, tile: TileIndex, expected: Cells, names: list[str]
) -> str:
    """How a stored tile and its picture differ from what they should be; empty where neither does,
    or one of them is missing."""
    try:
        found = tables.cells(zoom, tile)
    except MapError as error:
        return str(error)
    if found is None:
        return ""
    if any(not np.array_equal(found[name], expected[name]) for name in names):
        return f"The tile {tuple(tile)} of level {zoom} is not what follows from the frames."
    return _picture_problem(tables, zoom, tile, expected)


def _picture_problem(tables: TileTables, zoom: int, tile: TileIndex, cells: Cells) -> str:
    rows = tables.rows(
        "SELECT tile_data FROM density WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
        (zoom, *tables.matrices.column_row(zoom, tile)),
    )
    density, observed = mean_density(cells["weight"], cells["sum"])
    try:
        pictures = [decode_png(blob, "picture")[::-1] for (blob,) in rows]
        shown = np.stack([density, observed * np.uint8(255)], axis=-1)
        if all(np.array_equal(picture, shown) for picture in pictures):
            return ""
    except MapError:
        pass
    return f"The picture of tile {tuple(tile)} of level {zoom} is not that of its density."


def check_extent(subject: Subject) -> Iterator[str]:
    """The extents and levels that are announced of the tiles."""
    connection, tables = subject.connection, subject.tables
    matrices = tables.matrices
    top = tables.top_zoom() or matrices.base_zoom + 1
    window = Pyramid(connection, tables).window_at_the_edges()
    meta = connection.execute("SELECT value FROM fieldgrid_meta WHERE key = 'data_window'")
    expected = None if window is None else (str(list(window)),)
    if meta.fetchone() != expected:
        yield "The extent of the map's cells is not what follows from its frames."
    bounds: tuple[float | None, ...] = (None,) * 4
    if window is not None:
        bounds = tuple(matrices.lattice.bounds(matrices.whole_cells(window, top)))
    announced = connection.execute(
        "SELECT min_x, min_y, max_x, max_y FROM gpkg_contents WHERE table_name = 'density'"
    ).fetchone()
    if announced != bounds:
        yield "The extent of the layer density is not what follows from the frames."
    levels = connection.execute(
        "SELECT zoom_level, matrix_width, matrix_height, tile_width, tile_height, pixel_x_size, "
        "pixel_y_size FROM gpkg_tile_matrix WHERE table_name = 'density' ORDER BY 1"
    ).fetchall()
    if levels != [row[1:] for row in schema.zoom_levels(matrices, top)]:
        yield "The zoom levels that are announced are not those of the map."
