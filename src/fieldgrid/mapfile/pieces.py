"""A view of a map piece by piece, for what never needs all of it at once.

The pieces have the bits of `MapFile.read`, and are of one state of the map. The density of all
sessions on stored cells comes from the pictures of the map's tiles: they hold just the mean and the
mask, and are read several times as fast as the sums that they were drawn from.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from fieldgrid.errors import ConfigError
from fieldgrid.lattice import TILE_CELLS, Lattice, TileIndex, Window, tile_window
from fieldgrid.mapfile.evidence import Evidence
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.png import decode_png
from fieldgrid.mapfile.reading import Request, read_view, stored_level
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.mapfile.view import MapView, empty_view

MAX_CELLS = 10_000_000_000
"""Cells that may be read in pieces: 25 square kilometres at 5 cm."""

_ROWS, _COLUMNS = 4 * TILE_CELLS, 32 * TILE_CELLS
_READERS = 2
"""Threads that decompress pictures."""


class Pieces(NamedTuple):
    """The cells that were asked for, and the views that cover those that were observed.

    The views come from the north to the south, and from the west to the east; each begins and
    ends where tiles do, or at the window's edge. There is none where nothing was observed.
    """

    lattice: Lattice
    window: Window
    views: Iterator[MapView]


def read_pieces(evidence: Evidence, header: Header, request: Request) -> Pieces:
    """The view that is asked for in pieces; ConfigError when it has too many cells."""
    window = request.window
    if window.width * window.height > MAX_CELLS:
        raise ConfigError(
            f"{window.width:.6g} x {window.height:.6g} cells of {request.lattice.cell_m} m are "
            f"over {MAX_CELLS / 1e9:.0f} thousand million; give smaller bounds or a larger cell."
        )
    level = stored_level(evidence, header, request)
    if level is not None:
        return Pieces(request.lattice, window, _drawn(evidence, header, request, level))
    views = (read_view(evidence, header, request._replace(window=w)) for w in windows(window))
    return Pieces(request.lattice, window, (view for view in views if view.observed.any()))


def windows(whole: Window) -> Iterator[Window]:
    """A window cut where tiles begin, the northern rows first."""
    for j0 in reversed(range(whole.j0 // _ROWS * _ROWS, whole.j0 + whole.height, _ROWS)):
        for i0 in range(whole.i0 // _COLUMNS * _COLUMNS, whole.i0 + whole.width, _COLUMNS):
            part = whole.intersect(Window(i0, j0, _COLUMNS, _ROWS))
            assert part is not None
            yield part


def _drawn(evidence: Evidence, header: Header, request: Request, level: int) -> Iterator[MapView]:
    """The pieces from stored pictures, the next one decompressed while one is looked at."""
    matrices = TileMatrixSet(header.lattice)
    pool = ThreadPoolExecutor(_READERS, thread_name_prefix="fieldgrid-pieces")
    waiting: deque[tuple[MapView, list[Future[None]]]] = deque()
    try:
        for window in windows(request.window):
            pictures = evidence.pictures(window, matrices, level)
            if not pictures:
                continue
            view = empty_view(request.lattice, window, header.datum)
            waiting.append((view, [pool.submit(_draw, view, *picture) for picture in pictures]))
            if len(waiting) > 1:
                yield _done(*waiting.popleft())
        while waiting:
            yield _done(*waiting.popleft())
    finally:
        pool.shutdown(cancel_futures=True)


def _done(view: MapView, parts: list[Future[None]]) -> MapView:
    for part in parts:
        part.result()
    return view


def _draw(view: MapView, tile: TileIndex, blob: object) -> None:
    """Fill a tile's part of a view from its picture, whose first row is the northernmost."""
    cells = tile_window(tile)
    part = cells.intersect(view.window)
    if part is None:
        return
    grey_alpha = decode_png(blob, f"picture of tile {tuple(tile)}")[::-1][cells.slices_of(part)]
    place = view.window.slices_of(part)
    view.density[place] = grey_alpha[..., 0]
    np.not_equal(grey_alpha[..., 1], 0, out=view.observed[place])
