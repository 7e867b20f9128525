"""What cells count as, for whoever decides: free, obstacle or unseen, and where nobody may go.

This is the one reading of a map that routes, rows, costmaps, squares and exports for robots and
terminals share. It is made of the map's own cells: what the drives saw; what moved within a drive
(`views.moved`) and the ground that was driven over (`views.driven`), which are free; drops, which
are obstacles, and what was seen only beyond one, which is unseen. Marks say more than all that: a
cell that an obstacle mark touches is an obstacle, one that lies in a free mark with all of itself
is free, unless an obstacle mark touches it, too; one that a keep-out touches is kept out of,
whatever it is. A point marks the cell in which it lies. A larger cell is the worst of these in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, Bool, Float32, Float64, UInt8
from fieldgrid.geometry import Lattice, Window, squares
from fieldgrid.maps.vector.marks import Mark, MarkKind

KEEPOUT, OBSTACLE, FREE, DRIVEN, MOVED = 1, 2, 4, 8, 16
"""Flags of cells, the reasons why they count as other than what the drives saw: three kinds of
marks, ground that was driven over, and what moved within a drive."""

REASONS = {
    KEEPOUT: "kept out of by a mark",
    OBSTACLE: "marked as an obstacle",
    FREE: "marked as free",
    DRIVEN: "driven over",
    MOVED: "moved within a drive",
}
"""The flags in words."""

_FLAGS = {MarkKind.KEEPOUT: KEEPOUT, MarkKind.OBSTACLE: OBSTACLE, MarkKind.FREE: FREE}

_ROUNDING = 1e-6
"""An outline that enters a cell by less than this share of its side does not touch it."""

_BAND = 2048
"""Side of the squares of cells that an outline is laid over at a time."""


_Edge = Sequence[Float64]
"""Start and end of a side of an outline, each x, y in cells."""


class Decision(NamedTuple):
    """What a cost or an occupancy is made of, arrays of the view's shape: the highest density of
    the map's own cells in each cell, the share of them that was seen or is marked (0..1), and where
    no vehicle may go (None for nowhere)."""

    worst: UInt8
    seen: Float32
    keepout: Bool | None = None


class Decided(NamedTuple):
    """What the cells of a view count as, but for how much of a drop is an obstacle: see `Decision`;
    how far the ground falls away in each, and the flags of any of the map's own cells in it."""

    worst: UInt8
    seen: Float32
    drop_m: Float32
    flags: UInt8

    @classmethod
    def of_cells(cls, worst: UInt8, seen: Float32, drop_m: Float32, flags: UInt8) -> Decided:
        """The map's own cells: what the drives saw, with what is said by flags in its place."""
        worst, seen, drop_m = worst.copy(), seen.copy(), drop_m.copy()
        worst[(flags & MOVED) > 0] = 0
        for which, density in ((FREE | DRIVEN, 0), (OBSTACLE, 255)):
            said = (flags & which) > 0
            worst[said], seen[said], drop_m[said] = density, 1.0, 0.0
        return cls(worst, seen, drop_m, flags)

    @classmethod
    def nothing(cls, shape: tuple[int, int]) -> Decided:
        """Cells of which nothing is known."""
        return cls(
            np.zeros(shape, np.uint8),
            np.zeros(shape, np.float32),
            np.zeros(shape, np.float32),
            np.zeros(shape, np.uint8),
        )

    def put(self, place: Any, of: Decided, part: Any = ...) -> None:
        """Write a part of others into a place of these."""
        arrays: Iterable[tuple[AnyArray, AnyArray]] = zip(self, of, strict=True)
        for mine, theirs in arrays:
            mine[place] = theirs[part]

    def decision(self, least_drop_m: float) -> Decision:
        """It with an obstacle wherever the ground falls by `least_drop_m` or more."""
        edge = self.drop_m >= least_drop_m
        return Decision(
            np.where(edge, np.uint8(255), self.worst),
            np.where(edge, np.float32(1.0), self.seen),
            (self.flags & KEEPOUT) > 0,
        )


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
