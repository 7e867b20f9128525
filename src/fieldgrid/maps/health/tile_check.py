"""The tiles of a map against what its frames say: made again, level by level, and compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain

import numpy as np

from fieldgrid.core import MapError
from fieldgrid.geometry import TileIndex
from fieldgrid.maps.file import schema
from fieldgrid.maps.layers.declaration import Cells
from fieldgrid.maps.layers.registry import GROUPS
from fieldgrid.maps.tiles.png import decode_png
from fieldgrid.maps.tiles.pyramid import Pyramid
from fieldgrid.maps.tiles.tile_codec import stored_channels
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.tiles.tiling import parent
from fieldgrid.maps.transfer import mean_density
from fieldgrid.maps.writing.derived import active, squares_of
from fieldgrid.maps.writing.placing import stored_of_session
from fieldgrid.maps.writing.subject import PickledByArguments, Subject

_TILES_TOGETHER = 8


def check_tiles(subject: Subject, *, folded: bool = False) -> Iterator[str]:
    """The tiles of sessions against a new fold, unless they were `folded` just now, and those above
    against those below them."""
    tables = subject.tables
    for session_id, name in () if folded else active(subject.connection):
        yield from _session_tiles(subject, session_id, name)
    removed = subject.connection.execute(
        "SELECT DISTINCT s.name FROM fieldgrid_session_tile AS t LEFT JOIN fieldgrid_session AS s "
        "ON s.id = t.session_id WHERE s.removed IS NOT NULL OR s.id IS NULL"
    ).fetchall()
    for (name,) in removed:
        yield f"The map has tiles of session {name!r}, which is not in it."
    base = tables.matrices.base_zoom
    top = _top_zoom(tables)
    tiles = {TileIndex(*row) for row in tables.rows("SELECT ty, tx FROM fieldgrid_session_tile")}
    for zoom in range(base, top - 1, -1):
        if zoom < base:
            tiles = {parent(tile) for tile in tiles}
        yield from _level(subject, zoom, tiles)
    strays = tables.rows(
        "SELECT DISTINCT zoom FROM fieldgrid_tile WHERE zoom < ? OR zoom > ?", (top, base)
    )
    strays += tables.rows(
        "SELECT DISTINCT zoom_level FROM density WHERE zoom_level < ? OR zoom_level > ?",
        (top, base),
    )
    for (zoom,) in strays:
        yield f"The map has tiles of a level {zoom} that it does not need."
    yield from check_extent(subject)


def _top_zoom(tables: TileTables) -> int:
    """The uppermost level that the map needs; one below the base where it has no tiles."""
    corners, matrices = tables.corners(), tables.matrices
    return matrices.top_zoom(corners) if corners else matrices.base_zoom + 1


def _session_tiles(subject: Subject, session_id: int, name: str) -> Iterator[str]:
    header, tables, runner = subject.header, subject.tables, subject.runner
    check = _SquareCheck(subject, session_id, name)
    left = tables.session_tiles(session_id)
    for tile, problem in chain.from_iterable(runner.in_order(check, check.squares.places())):
        if tile not in left:
            yield f"The map lacks {check.what(tile)}."
            continue
        left.discard(tile)
        if problem:
            yield problem
    for tile in sorted(left):
        yield f"The map has {check.what(tile)}, which does not follow from its frames."
    expected = {g.name for g in stored_of_session(tables.groups)}
    known = {*expected, *(name for name in header.groups if name not in GROUPS)}
    groups = tables.rows(
        "SELECT DISTINCT channels FROM fieldgrid_session_tile WHERE session_id = ?", (session_id,)
    )
    for (group,) in groups:
        if group not in known:
            yield f"The map has channels {group!r} of session {name!r} that it should not have."


class _SquareCheck(PickledByArguments):
    """Folds squares of a session anew, and compares its tiles."""

    def __init__(self, subject: Subject, session_id: int, name: str) -> None:
        self._of = subject, session_id, name
        self._tables = subject.tables
        groups = self._tables.groups
        self._names = [c.name for g in stored_of_session(groups) for c in g.channels]
        self.squares = squares_of(subject, session_id, groups)

    def __call__(self, place: tuple[int, int]) -> list[tuple[TileIndex, str]]:
        return self.squares.fold(place, self._compare)

    def what(self, tile: TileIndex) -> str:
        """What a tile is called."""
        return f"tile {tuple(tile)} of session {self._of[2]!r}"

    def _compare(self, tile: TileIndex, cells: Cells) -> tuple[TileIndex, str]:
        return tile, _difference(
            lambda: self._tables.session_cells(self._of[1], tile),
            cells,
            self._names,
            self.what(tile),
        )


def _level(subject: Subject, zoom: int, tiles: set[TileIndex]) -> Iterator[str]:
    """The tiles and pictures of a zoom level against what is below them."""
    tables, runner = subject.tables, subject.runner
    pictures = {
        tables.matrices.tile(zoom, column, row)
        for column, row in tables.rows(
            "SELECT tile_column, tile_row FROM density WHERE zoom_level = ?", (zoom,)
        )
    }
    stored = set(tables.tiles(zoom))
    for kind, there in (("tile", stored), ("picture of tile", pictures)):
        for tile in sorted(tiles - there):
            yield f"The map lacks {kind} {tuple(tile)} of level {zoom}."
        for tile in sorted(there - tiles):
            yield f"The map has {kind} {tuple(tile)} of level {zoom}, where nothing was observed."
    both = sorted(tiles & stored & pictures)
    for problem in runner.in_order(_LevelCheck(subject, zoom), both, _TILES_TOGETHER):
        if problem:
            yield problem


class _LevelCheck(PickledByArguments):
    """Makes tiles of a level anew of what is below them, and compares them and their pictures."""

    def __init__(self, subject: Subject, zoom: int) -> None:
        self._of = subject, zoom
        self._tables = subject.tables
        self._is_base = zoom == self._tables.matrices.base_zoom
        self._pyramid = Pyramid(subject.connection, self._tables)
        groups = self._tables.groups
        self._names = [n for g in groups for n, _ in stored_channels(g, base=self._is_base)]

    def __call__(self, tile: TileIndex) -> str:
        _, zoom = self._of
        tables = self._tables
        try:
            if self._is_base:
                expected = self._pyramid.merged(tile)
            else:
                expected = tables.above(zoom, tile, tables.groups)
        except MapError:
            return ""  # what it is made of was told of already
        if expected is None:
            return ""
        what = f"tile {tuple(tile)} of level {zoom}"
        found = _difference(lambda: tables.cells(zoom, tile), expected, self._names, what)
        return found or _picture_problem(tables, zoom, tile, expected)


def _picture_problem(tables: TileTables, zoom: int, tile: TileIndex, cells: Cells) -> str:
    ((blob,),) = tables.rows(
        "SELECT tile_data FROM density WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
        (zoom, *tables.matrices.column_row(zoom, tile)),
    )
    density, observed = mean_density(cells["weight"], cells["sum"])
    try:
        grey_alpha = decode_png(blob, "picture")[::-1]
        if np.array_equal(grey_alpha, np.stack([density, observed * np.uint8(255)], axis=-1)):
            return ""
    except MapError:
        pass
    return f"The picture of tile {tuple(tile)} of level {zoom} is not that of its density."


def _difference(
    stored: Callable[[], Cells | None], expected: Cells, names: list[str], what: str
) -> str:
    """Whether stored channels are what they should be; empty when they are."""
    try:
        found = stored()
    except MapError as error:
        return str(error)
    if found is None or any(not np.array_equal(found[name], expected[name]) for name in names):
        return f"The {what} is not what follows from the frames."
    return ""


def check_extent(subject: Subject) -> Iterator[str]:
    """The extents and levels that are announced of the tiles."""
    connection, tables = subject.connection, subject.tables
    matrices, top = tables.matrices, _top_zoom(tables)
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
