"""What cells count as, for whoever plans: free, obstacle or unseen, and where nobody may go.

This is the one place where drops and marks change that, on the map's own cells. Where the ground
falls away a cell is an obstacle, and what was seen only beyond such an edge is unseen. Marks say
more than that: a cell that an obstacle mark touches is an obstacle, one that lies in a free mark
with all of itself is free, unless an obstacle mark touches it, too; one that a keep-out touches is
kept out of, whatever it is. A point marks the cell in which it lies. Larger cells follow from these
by the rule of all larger cells.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float32, Float64, Int64, UInt8
from fieldgrid.geometry import Lattice, Window, squares
from fieldgrid.maps.vector.marks import Mark, MarkKind

KEEPOUT, OBSTACLE, FREE = 1, 2, 4
"""Flags of cells."""

_FLAGS = {MarkKind.KEEPOUT: KEEPOUT, MarkKind.OBSTACLE: OBSTACLE, MarkKind.FREE: FREE}

_ROUNDING = 1e-6
"""An outline that enters a cell by less than this share of its side does not touch it."""

_BAND = 2048
"""Side of the squares of cells that an outline is laid over at a time."""


_Edge = Sequence[Float64]
"""Start and end of a side of an outline, each x, y in cells."""


class Decision(NamedTuple):
    """What a cost or an occupancy is made of, arrays of the view's shape: the highest density of
    the map's own cells in each cell, the share of them that was seen or is marked (0..1, NaN for
    none; 1 where an obstacle mark is), and where no vehicle may go (None for nowhere)."""

    worst: UInt8
    seen: Float32
    keepout: Bool | None = None


class PartlyFree(NamedTuple):
    """Cells of a view of which only a part is marked as free [n]: their rows and columns, the worst
    that the rest of them holds by layer, the share that was seen, what is marked included, and how
    far the ground falls away in the rest."""

    rows: Int64
    columns: Int64
    worst: Mapping[str, UInt8]
    seen: Float32
    drop_m: Float32


class MarkedCells(NamedTuple):
    """The flags of a view's cells, `FREE` only where all of a cell is, and those partly free."""

    flags: UInt8
    partly: tuple[PartlyFree, ...] = ()

    def decide(
        self, layer: str, worst: UInt8, seen: Float32, drop_m: Float32, least_drop_m: float
    ) -> Decision:
        """What the drives saw, with what people said put in its place."""
        worst, seen, drop_m = worst.copy(), seen.copy(), drop_m.copy()
        for part in self.partly:
            worst[part.rows, part.columns] = part.worst[layer]
            seen[part.rows, part.columns] = part.seen
            drop_m[part.rows, part.columns] = part.drop_m
        for flag, density in ((FREE, 0), (OBSTACLE, 255)):
            said = (self.flags & flag) > 0
            worst[said], seen[said], drop_m[said] = density, 1.0, 0.0
        return with_drops(worst, seen, drop_m, least_drop_m)._replace(
            keepout=(self.flags & KEEPOUT) > 0
        )


def with_drops(worst: UInt8, seen: Float32, drop_m: Float32, least_drop_m: float) -> Decision:
    """What the drives saw, with an obstacle wherever the ground falls by `least_drop_m` or more."""
    edge = drop_m >= least_drop_m
    return Decision(np.where(edge, np.uint8(255), worst), np.where(edge, np.float32(1.0), seen))


def deciding(marks: Iterable[Mark]) -> list[Mark]:
    """The marks that change what cells count as."""
    return [mark for mark in marks if mark.kind in _FLAGS]


def cells_under(mark: Mark, lattice: Lattice) -> Window:
    """The cells that a mark may touch."""
    west, south, east, north = (value * lattice.cells_per_m for value in mark.bounds)
    i0, j0 = math.floor(west + _ROUNDING), math.floor(south + _ROUNDING)
    i1, j1 = math.ceil(east - _ROUNDING), math.ceil(north - _ROUNDING)
    return Window(i0, j0, max(i1 - i0, 1), max(j1 - j0, 1))


def marked_cells(marks: Iterable[Mark], lattice: Lattice, window: Window) -> UInt8:
    """The flags of the cells of a window, uint8 [rows north, columns east]."""
    flags = np.zeros(window.shape, dtype=np.uint8)
    for mark in deciding(marks):
        flag, part = np.uint8(_FLAGS[mark.kind]), cells_under(mark, lattice).intersect(window)
        if part is None:
            continue
        if mark.is_point:
            flags[window.slices_of(part)] |= flag
            continue
        for band in squares(part, _BAND):
            edges = [
                edge
                for ring in mark.rings
                for corners in (np.array(ring) * lattice.cells_per_m - (band.i0, band.j0),)
                for edge in zip(corners, np.roll(corners, -1, axis=0), strict=True)
            ]
            inside, edge = _inside(edges, band.shape), _crossed(edges, band.shape)
            covered = inside & ~edge if mark.kind is MarkKind.FREE else inside | edge
            flags[window.slices_of(band)][covered] |= flag
    return flags


def _inside(edges: Iterable[_Edge], shape: tuple[int, int]) -> Bool:
    """Whether the middles of cells lie inside: a line to the east crosses the outlines, in cells,
    an odd number of times."""
    height, width = shape
    y = np.arange(height) + 0.5
    crossings = np.zeros((height, width + 1), dtype=np.uint8)
    for (x0, y0), (x1, y1) in edges:
        row = np.flatnonzero((y0 <= y) != (y1 <= y))
        if row.size:
            x = x0 + (y[row] - y0) * ((x1 - x0) / (y1 - y0))
            crossings[row, np.clip(np.ceil(x - 0.5), 0, width).astype(np.intp)] ^= 1
    return np.asarray(np.bitwise_xor.accumulate(crossings, axis=1)[:, :-1], np.bool_)


def _crossed(edges: Iterable[_Edge], shape: tuple[int, int]) -> Bool:
    """Which cells the outlines enter."""
    height, width = shape
    steps = np.zeros((height, width + 1), dtype=np.int32)
    for start, end in edges:
        (x0, y0), (x1, y1) = (start, end) if start[1] <= end[1] else (end, start)
        first, last = math.floor(y0 + _ROUNDING), math.ceil(y1 - _ROUNDING)
        row = np.arange(max(first, 0), min(last, height))
        if y1 - y0 < _ROUNDING:
            low, high = np.full(row.size, min(x0, x1)), np.full(row.size, max(x0, x1))
        else:
            slope = (x1 - x0) / (y1 - y0)
            ends = x0 + slope * (np.clip([row, row + 1], y0, y1) - y0)
            low, high = ends.min(axis=0), ends.max(axis=0)
        column = np.clip(np.floor(low + _ROUNDING), 0, width).astype(np.intp)
        beyond = np.clip(np.ceil(high - _ROUNDING), 0, width).astype(np.intp)
        entered = column < beyond
        np.add.at(steps, (row[entered], column[entered]), 1)
        np.add.at(steps, (row[entered], beyond[entered]), -1)
    return np.asarray(steps.cumsum(axis=1)[:, :-1] > 0)
