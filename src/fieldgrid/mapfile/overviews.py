"""A view at half its resolution, at a quarter, and so on, as rasters want it: pixels are counted
from the north-west corner of the view, wherever that lies on the lattice.

They follow from the channels by the rule of all larger cells, not from the values of finer ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import AnyArray, Bool, UInt8
from fieldgrid.lattice import Window
from fieldgrid.layers import GROUPS, LAYERS, Cells, groups_of
from fieldgrid.layers.window import coarser
from fieldgrid.mapfile.evidence import Evidence
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.reading import Request, cell_source, chunks, layer_values
from fieldgrid.mapfile.sources import assembled
from fieldgrid.mapfile.workers import in_order
from fieldgrid.transfer import mean_density

MAX_LEVELS = 10
"""Levels that are made: 1024 cells a side become one pixel."""


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
    evidence: Evidence, header: Header, request: Request, levels: int
) -> Iterator[OverviewBlock]:
    """The blocks of all levels in which anything was observed."""
    levels = min(levels, MAX_LEVELS)
    groups = tuple(GROUPS[name] for name in groups_of(request.layers))
    source, factor = cell_source(evidence, header, request)
    whole, side = request.window, 1 << MAX_LEVELS
    top = whole.j0 + whole.height

    def halved(place: tuple[int, int]) -> list[OverviewBlock]:
        row, column = place
        square = Window(whole.i0 + column, top - row - side, side, side)
        part = whole.intersect(square)
        assert part is not None
        parts = ((chunk, source.merged(chunk)) for chunk in chunks(part, factor))
        found = assembled(part, ((chunk, cells) for chunk, cells in parts if cells is not None))
        if found is None:
            return []
        cells = _northward(found, 1 << levels)
        blocks = []
        for level in range(1, levels + 1):
            cells = coarser(groups, cells, 2)
            height, width = -(-part.height >> level), -(-part.width >> level)
            blocks.append(_block(level, row, column, cells, request.layers, (height, width)))
        return blocks

    places = [
        (row, column)
        for row in range(0, whole.height, side)
        for column in range(0, whole.width, side)
    ]
    for blocks in in_order(halved, places):
        yield from blocks


def _northward(cells: Cells, multiple: int) -> Cells:
    """Cells with row 0 in the north, filled up to a multiple of rows and columns."""
    beyond = tuple((0, -side % multiple) for side in cells["weight"].shape)
    turned = {name: np.pad(values[::-1], beyond) for name, values in cells.items()}
    return Cells(turned, cells.base_cells)


def _block(
    level: int,
    row: int,
    column: int,
    cells: Cells,
    layers: tuple[str, ...],
    shape: tuple[int, int],
) -> OverviewBlock:
    density, observed = mean_density(cells["weight"], cells["sum"])
    inside = slice(shape[0]), slice(shape[1])
    values = {
        name: layer_values(LAYERS[name], cells)[inside].astype(LAYERS[name].dtype)
        for name in layers
        if name != "density"
    }
    place = row >> level, column >> level
    return OverviewBlock(level, *place, density[inside], observed[inside], values)
