"""Reading a view of a map, with what its cells count as where that is asked for."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from fieldgrid.geometry import OBSTACLE_ABOVE, Window, aligned_parts
from fieldgrid.maps.views.base_cells import enlarged
from fieldgrid.maps.views.decision import (
    DRIVEN,
    FREE,
    KEEPOUT,
    MOVED,
    OBSTACLE,
    Decided,
    marked_cells,
)
from fieldgrid.maps.views.driven import driven_cells
from fieldgrid.maps.views.moved import LAYERS, MARGIN_M, moved_cells
from fieldgrid.maps.views.read import Content, Request, read_cells
from fieldgrid.maps.views.view import DROP_LAYERS, MapView


def read_views(content: Content, request: Request) -> list[MapView]:
    """The view, with the marks that are in force, and what its cells count as where that is asked
    for; and its overviews, of cells alone."""
    view, *overviews = read_cells(content, request)
    view = replace(view, marks=content.marks())
    if request.decide:
        view = replace(view, decided=_decided(content, request))
    return [view, *overviews]


_SQUARE_CELLS = 1024
"""Side of the squares of own cells that are decided at a time. They lie at multiples of it, so that
a cell counts as the same whatever is asked for."""


def _decided(content: Content, request: Request) -> Decided:
    """What the cells that are asked for count as, by the map's own in them."""
    own = content.header.lattice
    by = enlarged((), own, request.lattice)
    result = Decided.nothing(request.window.shape)
    square = lru_cache(maxsize=8)(partial(_square, content, request._replace(lattice=own)))
    side = max(1, round(_SQUARE_CELLS / by.factor))
    for part in aligned_parts(request.window, side, side):
        under = by.under(part)
        cells = Decided.nothing(under.shape)
        for piece in aligned_parts(under, _SQUARE_CELLS, _SQUARE_CELLS):
            whole, found = square(piece.i0 // _SQUARE_CELLS, piece.j0 // _SQUARE_CELLS)
            cells.put(under.slices_of(piece), found, whole.slices_of(piece))
        # In whole centimetres, as drops are stored.
        drop_cm = np.rint(100.0 * np.minimum(cells.drop_m, 2.55)).astype(np.uint8)
        each = (cells.flags & np.uint8(flag) for flag in (KEEPOUT, OBSTACLE, FREE, DRIVEN, MOVED))
        larger = Decided(
            by.highest(cells.worst, part),
            by.share(cells.seen > 0.0, part),
            by.highest(drop_cm, part).astype(np.float32) / np.float32(100.0),
            np.bitwise_or.reduce([by.highest(flags, part) for flags in each]),
        )
        result.put(request.window.slices_of(part), larger)
    result.seen[(result.flags & OBSTACLE) > 0] = 1.0
    return result


def _square(content: Content, asked: Request, column: int, row: int) -> tuple[Window, Decided]:
    """A square of the map's own cells, and what they count as."""
    side, lattice = _SQUARE_CELLS, asked.lattice
    window = Window(column * side, row * side, side, side)
    around = window.grown(math.ceil(MARGIN_M * lattice.cells_per_m))
    layers = (*LAYERS, *(DROP_LAYERS if content.tells_of_drops() else ()))
    wanted = tuple(dict.fromkeys((asked.decide, *layers)))
    (view,) = read_cells(
        content,
        asked._replace(
            window=around, levels=0, layers=tuple(name for name in wanted if name != "density")
        ),
    )
    inside = around.slices_of(window)
    worst = np.where(view.observed, view.layer(asked.decide), np.uint8(0))[inside]
    flags = marked_cells(content.marks(), lattice, window)
    flags[moved_cells(view, asked.decide)[inside]] |= np.uint8(MOVED)
    own, obstacle = asked._replace(window=window), worst > OBSTACLE_ABOVE
    flags[driven_cells(content, own, obstacle, view.observed[inside])] |= np.uint8(DRIVEN)
    return window, Decided.of_cells(worst, view.sure_share[inside], view.drop_m[inside], flags)
