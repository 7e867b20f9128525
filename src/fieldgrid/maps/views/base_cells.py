"""Larger cells from the map's own: of a whole multiple of their side, or of any other.

A larger cell is what the map's own cells in it are. Where it is no whole multiple, only some
channels follow from them: the highest of all that it touches, and how much of it they have seen.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import NamedTuple, TypeVar

import numpy as np

from fieldgrid.core import Bool, Float32, Int64, UInt8, UInt64
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps.layers.declaration import Cells, ChannelGroup, Combine
from fieldgrid.maps.layers.window import coarser

_Values = TypeVar("_Values", UInt8, UInt64)

PARTS = 1 << 10
"""Parts along the side of a cell that is no whole multiple, in which its area is counted."""

_ROUNDING = 1e-9
"""Cells that overlap by less than this share of a cell only touch by an edge."""


class Multiple(NamedTuple):
    """Cells of which each is a square of `factor` x `factor` of the map's own; all channels."""

    groups: tuple[ChannelGroup, ...]
    factor: int

    def under(self, window: Window) -> Window:
        """The map's own cells that a window needs."""
        return Window(*(value * self.factor for value in window))

    def larger(self, cells: Cells, window: Window) -> Cells:
        """The cells of a window from the map's own under it, overviews included."""
        return coarser(self.groups, cells, self.factor)

    def highest(self, values: UInt8, window: Window) -> UInt8:
        """The highest value in each cell of a window, from those of the map's own under it."""
        blocks = (window.height, self.factor, window.width, self.factor)
        return np.asarray(values.reshape(blocks).max(axis=(1, 3)))

    def share(self, true: Bool, window: Window) -> Float32:
        """The share of each cell of a window, 0..1, in which the map's own under it are true."""
        blocks = (window.height, self.factor, window.width, self.factor)
        return np.asarray(true.reshape(blocks).mean(axis=(1, 3), dtype=np.float32))


class Resampling(NamedTuple):
    """Cells of any other lattice: what follows from the map's own that each touches.

    These are maxima, and channels of overviews: how much was seen is counted in `PARTS` squared.
    """

    groups: tuple[ChannelGroup, ...]
    own: Lattice
    lattice: Lattice

    @property
    def factor(self) -> float:
        """How many of the map's own cells lie along the side of one."""
        return max(1.0, self.lattice.cell_m / self.own.cell_m)

    def under(self, window: Window) -> Window:
        """See `Multiple`."""
        return self.own.window(self.lattice.bounds(window))

    def larger(self, cells: Cells, window: Window) -> Cells:
        """See `Multiple`."""
        rows, columns = self._touched(window)
        arrays: dict[str, UInt64] = {}
        for group in self.groups:
            for channel in group.channels:
                if channel.coarser is Combine.MAX:
                    arrays[channel.name] = _highest(cells[channel.name], rows, columns)
            for extra in group.overview:
                of = _highest if extra.coarser is Combine.MAX else _area
                arrays[extra.name] = of(cells[extra.name], rows, columns)
        return Cells(arrays, PARTS * PARTS)

    def highest(self, values: UInt8, window: Window) -> UInt8:
        """See `Multiple`."""
        return _highest(values, *self._touched(window))

    def share(self, true: Bool, window: Window) -> Float32:
        """See `Multiple`."""
        parts = _area(true.astype(np.uint64), *self._touched(window))
        return (parts / (PARTS * PARTS)).astype(np.float32)

    def _touched(self, window: Window) -> tuple[list[_Overlap], list[_Overlap]]:
        """What the rows and the columns of a window touch."""
        under, ratio = self.under(window), self.own.cell_m / self.lattice.cell_m
        return (
            _touched(under.j0, under.height, ratio, window.j0, window.height),
            _touched(under.i0, under.width, ratio, window.i0, window.width),
        )


def follows_from_touched(group: ChannelGroup) -> bool:
    """Whether any channel of a group comes from the cells that a larger one touches."""
    return bool(group.overview) or any(c.coarser is Combine.MAX for c in group.channels)


def enlarged(
    groups: tuple[ChannelGroup, ...], own: Lattice, lattice: Lattice
) -> Multiple | Resampling:
    """How the cells of a lattice follow from those of the map's own."""
    factor = round(lattice.cell_m / own.cell_m)
    if factor >= 1 and abs(factor * own.cell_m - lattice.cell_m) <= 1e-9 * lattice.cell_m:
        return Multiple(groups, factor)
    return Resampling(groups, own, lattice)


class _Overlap(NamedTuple):
    """Of each cell along an axis [n]: a base cell that it touches, and how many of its parts lie
    there, 0 where there is none."""

    cell: Int64
    parts: UInt64


def _touched(first: int, count: int, ratio: float, start: int, size: int) -> list[_Overlap]:
    """All that cells [size] from `start` touch of base cells [count] from `first`, which are
    `ratio` times as long."""
    low = start + np.arange(size, dtype=np.float64)
    begin = np.floor(low / ratio + _ROUNDING).astype(np.int64)
    found = []
    for k in range(math.ceil(1.0 / ratio) + 1):
        cell = begin + k
        left = np.maximum(low, cell * ratio) - low
        right = np.minimum(low + 1.0, (cell + 1) * ratio) - low
        # Neighbours share an edge, and so its rounding: the parts of a whole cell add up.
        parts = np.maximum(np.rint(right * PARTS) - np.rint(left * PARTS), 1.0)
        inside = (right - left > _ROUNDING) & (cell >= first) & (cell < first + count)
        parts = np.where(inside, parts, 0.0).astype(np.uint64)
        found.append(_Overlap(np.clip(cell - first, 0, count - 1), parts))
    return found


def _highest(values: _Values, rows: list[_Overlap], columns: list[_Overlap]) -> _Values:
    """The highest value that each cell touches."""
    for touched in (rows, columns):
        taken = (values[cell] * (parts > 0)[:, None] for cell, parts in touched)
        values = reduce(np.maximum, taken).T
    return values


def _area(values: UInt64, rows: list[_Overlap], columns: list[_Overlap]) -> UInt64:
    """The values that each cell touches by how many of its parts they have."""
    for touched in (rows, columns):
        values = reduce(np.add, (values[cell] * parts[:, None] for cell, parts in touched)).T
    return values
