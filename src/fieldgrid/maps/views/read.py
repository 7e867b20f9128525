"""Reading a view of what a map holds, or of what several maps hold together."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from fieldgrid.core import Bool, Threads, UInt8
from fieldgrid.geometry import MAX_CELL_M, TILE_CELLS, Lattice, Window, aligned_parts
from fieldgrid.maps.cost import DENSITIES
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.layers.blocks import blocks_under
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup
from fieldgrid.maps.layers.registry import GROUPS, LAYERS, groups_of
from fieldgrid.maps.layers.window import coarser
from fieldgrid.maps.transfer import Averaging, Transfer, mean_density
from fieldgrid.maps.vector.marks import Mark
from fieldgrid.maps.views.base_cells import enlarged
from fieldgrid.maps.views.decision import (
    FREE,
    KEEPOUT,
    OBSTACLE,
    MarkedCells,
    PartlyFree,
    deciding,
    marked_cells,
)
from fieldgrid.maps.views.driven import DrivenWay, driven_cells
from fieldgrid.maps.views.sources import CellSource
from fieldgrid.maps.views.view import DROP_LAYERS, MapView, empty_view

_CHUNK_CELLS = 512
"""Stored cells along the side of a square that is worked on at a time: what its channels take fits
into the caches of a processor, and some of them at once into little memory."""


class Request(NamedTuple):
    """What is asked of a map; `sessions` in the order of their drives, None for all active."""

    lattice: Lattice
    window: Window
    transfer: Transfer
    averaging: Averaging = Averaging.MEAN
    sessions: tuple[str, ...] | None = None
    frame_filter: Callable[[FrameRecord], bool] | None = None
    layers: tuple[str, ...] = ()
    """Those beside the density."""
    jobs: int | None = None
    """Threads that read it, one a core when not given."""
    ways: Callable[[Request], list[DrivenWay]] | None = None
    """Where the drives went near a window of the own cells, in their order; None where the ground
    under them is as the frames saw it."""
    levels: int = 0
    """Overviews beside it, of cells of 2, 4, ... times the side; the window is of whole ones."""

    def at_level(self, level: int) -> Request:
        """The same of an overview."""
        if level == 0:
            return self
        lattice = Lattice(self.lattice.cell_m * (1 << level))
        window = Window(*(value >> level for value in self.window))
        return self._replace(lattice=lattice, window=window, levels=self.levels - level)


class Content(Protocol):
    """What views are made of: the cells of a map, or of several as one. Within one state of it."""

    @property
    def header(self) -> MapHeader:
        """The plane, the own cells and the rule by which frames were carried into them."""

    def marks(self) -> tuple[Mark, ...]:
        """The marks that are in force."""

    def fill(self, view: MapView, request: Request) -> bool:
        """Fill an empty view by a shorter way than its channels; False where there is none."""

    def own_cells(
        self, request: Request, groups: tuple[ChannelGroup, ...]
    ) -> tuple[CellSource, int]:
        """Where the own cells come from, and 1."""

    def folded(self, request: Request, groups: tuple[ChannelGroup, ...]) -> CellSource:
        """All that is asked for from frames folded anew."""

    def cell_source(self, request: Request) -> tuple[CellSource, float]:
        """Where the cells that are asked for come from, and how many of those that are looked into
        lie along the side of one."""


def read_views(content: Content, request: Request) -> list[MapView]:
    """The view, with the marks that are in force, and what they and the ways of drives decide; and
    its overviews, of cells alone."""
    marks = content.marks()
    view, *overviews = _read(content, request)
    view = replace(view, marks=marks)
    # Without ways, base cells are decided by their marks when that is asked for.
    if request.ways is None and (
        view.is_base or "seen_share" not in request.layers or not deciding(marks)
    ):
        return [view, *overviews]
    lattice = content.header.lattice
    by = enlarged((), lattice, request.lattice)
    flags, partly = np.zeros(request.window.shape, np.uint8), []
    for chunk in chunks(request.window, by.factor):
        base = _decided(content, request._replace(lattice=lattice, window=by.under(chunk)))
        found = flags[request.window.slices_of(chunk)]
        for flag in (KEEPOUT, OBSTACLE):
            found |= by.highest(base & np.uint8(flag), chunk)
        free = (base & FREE) > 0
        some, rest = (by.highest(one.view(np.uint8), chunk) > 0 for one in (free, ~free))
        found[some & ~rest] |= np.uint8(FREE)
        if (some & rest).any():
            partly.append(_partly_free(content, request, chunk, some & rest))
    if flags.any() or partly:
        view = replace(view, marked=MarkedCells(flags, tuple(partly)))
    return [view, *overviews]


def _decided(content: Content, own: Request) -> UInt8:
    """Flags of the map's own cells of a window: those of marks, and `FREE` where drives went."""
    flags = marked_cells(content.marks(), own.lattice, own.window)
    if own.ways is not None:
        flags[driven_cells(own.ways(own), own.lattice, own.window)] |= np.uint8(FREE)
    return flags


def _partly_free(content: Content, request: Request, chunk: Window, cells: Bool) -> PartlyFree:
    """What the map's own cells say of those larger ones of which a part is marked as free."""
    j, i = np.nonzero(cells)
    i0, j0 = int(i.min()), int(j.min())
    part = Window(chunk.i0 + i0, chunk.j0 + j0, int(i.max()) - i0 + 1, int(j.max()) - j0 + 1)
    header = content.header
    by = enlarged((), header.lattice, request.lattice)
    names = tuple(name for name in (*DENSITIES, *DROP_LAYERS) if name in request.layers)
    own = request._replace(lattice=header.lattice, window=by.under(part), layers=names, levels=0)
    (base,) = _read(content, own)
    free = (_decided(content, own) & FREE) > 0
    inside = j - j0, i - i0
    place = j + chunk.j0 - request.window.j0, i + chunk.i0 - request.window.i0
    worst = {}
    for name in ("density", *(name for name in names if name in DENSITIES)):
        values = np.where(base.observed & ~free, base.layer(name), np.uint8(0))
        worst[name] = by.highest(values, part)[inside]
    seen = by.share((base.sure_share > 0.0) | free, part)[inside]
    # In whole centimetres, as drops are stored.
    drop_cm = np.rint(100.0 * np.where(free, 0.0, np.minimum(base.drop_m, 2.55)))
    drop_m = by.highest(drop_cm.astype(np.uint8), part)[inside].astype(np.float32) / 100.0
    return PartlyFree(*place, worst, seen, drop_m)


def _read(content: Content, request: Request) -> list[MapView]:
    """What the drives saw, by the shortest way that gives the same bits, and its overviews."""
    requests = [request.at_level(level) for level in range(request.levels + 1)]
    of = content.header
    views = [
        empty_view(one.lattice, one.window, of.datum, one.layers, is_base=one.lattice == of.lattice)
        for one in requests
    ]
    for level, one in enumerate(requests):
        if not content.fill(views[level], one):
            _fold(content, one, views[level:])
            break
    return views


def _fold(content: Content, request: Request, views: Sequence[MapView]) -> None:
    """Fill empty views from channels: those of larger cells follow from those of smaller ones."""
    groups = tuple(GROUPS[name] for name in groups_of(request.layers))
    around = [LAYERS[name].around for name in request.layers]
    reach = max((one.reach_m for one in around if one is not None), default=0.0)
    reach_cells = reach / request.lattice.cell_m
    # Neighbours that layers look at: a power of 2 of cells, which become half as many.
    margin = 1 << math.ceil(math.log2(reach_cells)) if reach_cells >= 1.0 else 0
    source, factor = content.cell_source(request._replace(window=request.window.grown(margin)))

    def fill(chunk: Window) -> None:
        cells, edge = source.merged(chunk.grown(margin)), margin
        if cells is None:
            return
        for level, view in enumerate(views):
            if level > 0:
                if edge % 2:  # larger cells than the reach need no neighbours
                    inner = {
                        name: np.ascontiguousarray(values[1:-1, 1:-1])
                        for name, values in cells.items()
                    }
                    cells, edge = Cells(inner, cells.base_cells), 0
                cells, edge = coarser(groups, cells, 2), edge // 2
            part = Window(*(value >> level for value in chunk))
            place, inside = view.window.slices_of(part), part.grown(edge).slices_of(part)
            view.density[place], view.observed[place] = mean_density(
                cells["weight"][inside], cells["sum"][inside]
            )
            for name, array in view.layers.items():
                layer = LAYERS[name]
                values = np.where(cells["seen"] > 0, layer.values(cells), layer.nodata or 0)
                if layer.around is not None:
                    reach_cells = layer.around.reach_m / view.lattice.cell_m
                    values = layer.around.of(values, reach_cells)
                array[place] = values[inside]

    for _ in Threads(request.jobs).in_order(fill, chunks(request.window, factor)):
        pass


def chunks(window: Window, factor: float) -> Iterator[Window]:
    """A window cut into squares of about a quarter of a million stored cells, `factor` along the
    side of one of its own; where tiles begin, if that is a small whole number. A smaller window is
    one of them, so that no frame or tile is read twice."""
    side = TILE_CELLS if factor in (3, 5) else 1 << _most_levels(factor)
    if max(window.shape) <= side:
        return iter([window])
    return aligned_parts(window, side, side)


def _most_levels(factor: float) -> int:
    """How often a square that is worked on can be halved."""
    return max(0, math.floor(math.log2(_CHUNK_CELLS / factor)))


def with_levels(request: Request, own: Lattice, smallest_px: int) -> Request:
    """A request with as many overviews as its longer side can be halved until it has at most so
    many cells, and each square of cells that are worked on at a time; in whole cells of the last.
    """
    cell_m, levels, window = request.lattice.cell_m, 0, request.window
    most = _most_levels(max(1.0, cell_m / own.cell_m))
    while (
        max(window.shape) >> levels > smallest_px
        and levels < most
        and cell_m * (2 << levels) <= MAX_CELL_M
    ):
        levels += 1
        window = Window(*(v << levels for v in blocks_under(request.window, 1 << levels)))
    return request._replace(window=window, levels=levels)
