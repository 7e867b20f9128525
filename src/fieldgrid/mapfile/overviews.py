"""A view at half its resolution, at a quarter, and so on, as rasters want it: pixels are counted
from the north-west corner of the view, wherever that lies on the lattice.

They follow from the channels by the rule of all larger cells, not from the values of finer ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.array_types import AnyArray, Bool, UInt8
from fieldgrid.lattice import Window
from fieldgrid.layers import GROUPS, LAYERS, Cells, groups_of
from fieldgrid.layers.window import coarser
from fieldgrid.mapfile.reading import (
    Content,
    Request,
    chunks,
    layer_values,
    reach_cells,
)
from fieldgrid.mapfile.sharing import check_known
from fieldgrid.mapfile.sources import assembled
from fieldgrid.transfer import mean_density
from fieldgrid.workers.order import Runner

MAX_LEVELS = 10
"""Levels that are made: 1024 cells a side become one pixel."""

_SIDE = 1 << MAX_LEVELS


class OverviewBlock(NamedTuple):
    """A part of an overview; its arrays have row 0 in the north.

    `level` 1 has cells of twice the side, `row` and `column` are those of its first pixel.
    """

    level: int
    row: int
    column: int
    density: UInt8
    observed: Bool
    layers: Mapping[str, AnyArray]

    def layer(self, name: str) -> AnyArray:
        """A layer by its name."""
        return self.density if name == "density" else self.layers[name]


def read_overviews(
    content: Content, request: Request, levels: int, run: Runner
) -> Iterator[OverviewBlock]:
    """The blocks of all levels in which anything was observed."""
    whole = request.window
    places = [
        (row, column)
        for row in range(0, whole.height, _SIDE)
        for column in range(0, whole.width, _SIDE)
    ]
    for blocks in run.in_order(_Halving(content, request, min(levels, MAX_LEVELS)), places):
        yield from blocks


class _Halving:
    """Makes the overviews of squares of a view. Pickled it is where the map lies."""

    def __init__(self, content: Content, request: Request, levels: int) -> None:
        self._of = content, request, levels
        self._groups = tuple(GROUPS[name] for name in groups_of(request.layers))
        self._source, self._factor = content.cell_source(request)
        # Cells beyond a block that its layers look at: a power of 2, so that they can be halved.
        reach = reach_cells(request)
        self._margin = 1 << math.ceil(math.log2(reach)) if reach >= 1.0 else 0

    def __reduce__(self) -> tuple[Any, ...]:
        return _arrived, self._of

    def __call__(self, place: tuple[int, int]) -> list[OverviewBlock]:
        """The blocks of all levels of the square at a row and a column; none where nothing was
        observed."""
        (row, column), (_, request, levels) = place, self._of
        whole, margin, groups = request.window, self._margin, self._groups
        south = whole.j0 + whole.height - row - _SIDE
        square = Window(whole.i0 + column, south, _SIDE, _SIDE).grown(margin)
        part = whole.intersect(square)
        assert part is not None
        parts = ((chunk, self._source.merged(chunk)) for chunk in chunks(part, self._factor))
        found = assembled(part, ((chunk, cells) for chunk, cells in parts if cells is not None))
        if found is None:
            return []
        cells, edge, blocks = _northward(found, square, part, 1 << levels), margin, []
        own_height, own_width = min(_SIDE, whole.height - row), min(_SIDE, whole.width - column)
        for level in range(1, levels + 1):
            if edge % 2:  # larger cells than the reach need no neighbours
                cells, edge = _without_edge(cells, edge), 0
            cells, edge = coarser(groups, cells, 2), edge // 2
            inside = (
                slice(edge, edge - (-own_height >> level)),
                slice(edge, edge - (-own_width >> level)),
            )
            cell_m = request.lattice.cell_m * (1 << level)
            blocks.append(_block(level, row, column, cells, request.layers, inside, cell_m))
        return blocks


def _arrived(content: Content, request: Request, levels: int) -> _Halving:
    check_known((), request.layers)
    return _Halving(content, request, levels)


def _northward(cells: Cells, square: Window, part: Window, multiple: int) -> Cells:
    """The cells of a part of a square with row 0 in the north, where the square begins, filled up
    to a multiple of rows and columns."""
    before = square.j0 + square.height - part.j0 - part.height, part.i0 - square.i0
    beyond = tuple(
        (first, -(first + size) % multiple) for first, size in zip(before, part.shape, strict=True)
    )
    turned = {name: np.pad(values[::-1], beyond) for name, values in cells.items()}
    return Cells(turned, cells.base_cells)


def _without_edge(cells: Cells, edge: int) -> Cells:
    """The cells without their first rows and columns, filled up again at the other end."""
    kept = {name: np.pad(values[edge:, edge:], (0, edge)) for name, values in cells.items()}
    return Cells(kept, cells.base_cells)


def _block(
    level: int,
    row: int,
    column: int,
    cells: Cells,
    layers: tuple[str, ...],
    inside: tuple[slice, slice],
    cell_m: float,
) -> OverviewBlock:
    density, observed = mean_density(cells["weight"][inside], cells["sum"][inside])
    values = {
        name: layer_values(LAYERS[name], cells, cell_m)[inside].astype(LAYERS[name].dtype)
        for name in layers
        if name != "density"
    }
    return OverviewBlock(level, row >> level, column >> level, density, observed, values)
