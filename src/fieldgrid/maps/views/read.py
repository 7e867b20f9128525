"""Reading the cells of what a map holds, or of what several maps hold together."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from fieldgrid.core import Threads
from fieldgrid.geometry import MAX_CELL_M, TILE_CELLS, Lattice, Window, aligned_parts
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.layers.blocks import blocks_under
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup
from fieldgrid.maps.layers.registry import GROUPS, LAYERS, groups_of
from fieldgrid.maps.layers.window import coarser
from fieldgrid.maps.transfer import Averaging, Transfer, mean_density
from fieldgrid.maps.vector.marks import Mark
from fieldgrid.maps.views.sources import CellSource
from fieldgrid.maps.views.view import MapView, empty_view

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
    decide: str = ""
    """The layer of densities by which cells are to count as free or obstacles; '' where nobody
    decides."""
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

    def tells_of_drops(self) -> bool:
        """Whether any drive does."""

    def ways(self, request: Request) -> dict[str, list[FrameRecord]]:
        """The accepted frames near a window of the own cells, by drive, in their order."""

    def by_session(self, request: Request) -> Iterator[tuple[str, Cells]]:
        """What each drive alone saw of a window of the own cells."""

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


def read_cells(content: Content, request: Request) -> list[MapView]:
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
