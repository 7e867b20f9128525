"""A view at half its resolution, at a quarter, and so on, as rasters want it: pixels are counted
from the north-west corner of the view, wherever that lies on the lattice.

They follow from the channels by the rule of all larger cells, not from the values of finer ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, Bool, Runner, UInt8, UInt64
from fieldgrid.geometry import Window
from fieldgrid.maps.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Combine,
    OverviewChannel,
    is_nothing,
    nothing,
)
from fieldgrid.maps.layers.registry import GROUPS, LAYERS, groups_of
from fieldgrid.maps.layers.window import coarser
from fieldgrid.maps.transfer import mean_density
from fieldgrid.maps.views.read import Content, Request, chunks, layer_values, reach_cells
from fieldgrid.maps.views.sources import FOR_KERNELS, assembled
from fieldgrid.maps.writing.sharing import check_known
from fieldgrid.maps.writing.subject import PickledByArguments

SQUARE_LEVELS = 10
"""Levels that are made of a square of the view, by whoever works on it: 1024 cells a side become
one. Those above follow from one cell a square."""


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
    whole, own = request.window, min(levels, SQUARE_LEVELS)
    side, tops = 1 << SQUARE_LEVELS, list[tuple[Window, Cells]]()
    places = [
        (row, column)
        for row in range(0, whole.height, side)
        for column in range(0, whole.width, side)
    ]
    for (row, column), halved in zip(
        places, run.in_order(_Halving(content, request, own), places), strict=True
    ):
        if halved is not None:
            blocks, top = halved
            yield from blocks
            if levels > own:
                tops.append((Window(column >> own, row >> own, 1, 1), top))
    if tops:
        yield from _above(tops, request, levels - own, own)


def _above(
    tops: list[tuple[Window, Cells]], request: Request, levels: int, below: int
) -> Iterator[OverviewBlock]:
    """The `levels` above those of the squares, from their single cells; rows go southward."""
    whole, multiple = request.window, 1 << levels
    height, width = (-(-size >> below) + multiple - 1 for size in whole.shape)
    filled = Window(0, 0, width // multiple * multiple, height // multiple * multiple)
    cells = assembled(filled, tops)
    assert cells is not None
    for level in range(below + 1, below + levels + 1):
        cells = coarser(_groups(request), cells, 2)
        inside = slice(0, -(-whole.height >> level)), slice(0, -(-whole.width >> level))
        cell_m = request.lattice.cell_m * (1 << level)
        yield _block(level, 0, 0, cells, request.layers, inside, cell_m)


def _groups(request: Request) -> tuple[ChannelGroup, ...]:
    return tuple(GROUPS[name] for name in groups_of(request.layers))


class _Halving(PickledByArguments):
    """Makes the overviews of squares of a view. Pickled it is where the map lies."""

    def __init__(self, content: Content, request: Request, levels: int) -> None:
        check_known((), request.layers)
        self._of = content, request, levels
        self._groups = _groups(request)
        self._source, self._factor = content.cell_source(request)
        # Cells beyond a square that its layers look at: a power of 2, so that they can be halved.
        reach = reach_cells(request)
        self._margin = max(2, 1 << math.ceil(math.log2(reach))) if reach >= 1.0 else 0

    def __call__(self, place: tuple[int, int]) -> tuple[list[OverviewBlock], Cells] | None:
        """The overviews of the square at a row and a column, and its one cell of the uppermost
        level; None where nothing was observed."""
        (row, column), (_, request, levels) = place, self._of
        whole, side = request.window, 1 << SQUARE_LEVELS
        square = Window(whole.i0 + column, whole.j0 + whole.height - row - side, side, side)
        cells = self._half_of(square.grown(self._margin), 1 << levels)
        if cells is None:
            return None
        edge, blocks = self._margin // 2, []
        own_height, own_width = min(side, whole.height - row), min(side, whole.width - column)
        for level in range(1, levels + 1):
            if level > 1:
                if edge % 2:  # larger cells than the reach need no neighbours
                    kept = {
                        name: np.pad(values[edge:, edge:], (0, edge))
                        for name, values in cells.items()
                    }
                    cells, edge = Cells(kept, cells.base_cells), 0
                cells, edge = coarser(self._groups, cells, 2), edge // 2
            inside = (
                slice(edge, edge - (-own_height >> level)),
                slice(edge, edge - (-own_width >> level)),
            )
            cell_m = request.lattice.cell_m * (1 << level)
            blocks.append(_block(level, row, column, cells, request.layers, inside, cell_m))
        one = (slice(edge, edge + 1),) * 2
        return blocks, Cells({k: v[one] for k, v in cells.items()}, cells.base_cells)

    def _half_of(self, square: Window, multiple: int) -> Cells | None:
        """Cells of twice the side of the part of a square that lies in the view, with row 0 in the
        north, where the square begins, filled up to half a multiple of rows and columns; None
        where nothing was observed.

        Made chunk by chunk: all channels of a square would be hundreds of megabytes.
        """
        part = self._of[1].window.intersect(square)
        assert part is not None
        shape = tuple(-(-size // multiple) * multiple // 2 for size in square.shape)
        arrays, base_cells = dict[str, UInt64](), 0
        for chunk in chunks(part, self._factor):
            cells = self._source.merged(chunk)
            if cells is None:
                continue
            row = square.j0 + square.height - chunk.j0 - chunk.height
            column = chunk.i0 - square.i0
            half = coarser(self._groups, _northward(cells, row % 2, column % 2), 2)
            base_cells = half.base_cells
            _gather(self._groups, half, arrays, row // 2, column // 2, shape)
        if not arrays:
            return None
        names = (name for name, _ in _rules(self._groups))
        return Cells({name: arrays.get(name, nothing(shape)) for name in names}, base_cells)


def _rules(groups: tuple[ChannelGroup, ...]) -> Iterator[tuple[str, Combine]]:
    """The channels of larger cells, and how they follow from smaller ones."""
    for group in groups:
        channels: tuple[Channel | OverviewChannel, ...] = (*group.channels, *group.overview)
        for channel in channels:
            if channel.coarser is not Combine.ABSENT:
                yield channel.name, channel.coarser


def _gather(
    groups: tuple[ChannelGroup, ...],
    cells: Cells,
    arrays: dict[str, UInt64],
    row: int,
    column: int,
    shape: tuple[int, ...],
) -> None:
    """Add cells to arrays of a shape, from a row and a column on. At their edges lie those of which
    other chunks have a part."""
    for name, rule in _rules(groups):
        values = cells[name]
        if is_nothing(values) and name not in FOR_KERNELS:
            continue
        if name not in arrays:
            arrays[name] = np.zeros(shape, np.uint64)
        place = arrays[name][row : row + values.shape[0], column : column + values.shape[1]]
        (np.maximum if rule is Combine.MAX else np.add)(place, values, out=place)


def _northward(cells: Cells, rows: int, columns: int) -> Cells:
    """The cells with row 0 in the north, behind `rows` and `columns` that hold nothing, filled up
    to an even number of rows and of columns."""

    def turned(values: UInt64) -> UInt64:
        beyond = [
            (n, (n + size) % 2) for n, size in zip((rows, columns), values.shape, strict=True)
        ]
        if not is_nothing(values):
            return np.pad(values[::-1], beyond)
        return nothing(tuple(sum(one) + n for one, n in zip(beyond, values.shape, strict=True)))

    return Cells({name: turned(values) for name, values in cells.items()}, cells.base_cells)


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
