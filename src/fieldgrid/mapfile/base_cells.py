"""What the map's own cells say of cells that are no whole multiple of them.

The density of such cells is folded anew from the frames, and that mean may hide an obstacle: here
each takes the highest of the map's own cells that it touches, and counts how much of it was seen.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float32, Int64, UInt8
from fieldgrid.lattice import Lattice, Window
from fieldgrid.mapfile.view import MapView

_ROUNDING = 1e-9
"""Cells that overlap by less than this share of a cell only touch by an edge."""


def peak_and_seen(base: MapView, lattice: Lattice, window: Window) -> tuple[UInt8, Float32]:
    """The highest density of the base cells that a cell touches, uint8, and the share of its area
    that they have seen, float32, both [rows, columns] of `window` on `lattice`.

    `base` covers the window.
    """
    ratio = base.lattice.cell_m / lattice.cell_m
    rows = _touched(base.window.j0, base.window.height, ratio, window.j0, window.height)
    columns = _touched(base.window.i0, base.window.width, ratio, window.i0, window.width)
    peak = _highest(_highest(base.density, rows).T, columns).T
    seen = _sum(_sum(base.observed.astype(np.float32), rows).T, columns).T
    return peak, np.minimum(seen, 1.0)


class _Touched(NamedTuple):
    """Of each cell along an axis [n]: a base cell that it touches, and the share of it that lies
    there, 0 where there is none."""

    cell: Int64
    share: Float32


def _touched(first: int, count: int, ratio: float, start: int, size: int) -> list[_Touched]:
    """All that cells [size] from `start` touch of base cells [count] from `first`, which are
    `ratio` times as long."""
    low = start + np.arange(size, dtype=np.float64)
    begin = np.floor(low / ratio + _ROUNDING).astype(np.int64)
    found = []
    for k in range(math.ceil(1.0 / ratio) + 1):
        cell = begin + k
        share = np.minimum(low + 1.0, (cell + 1) * ratio) - np.maximum(low, cell * ratio)
        inside = (share > _ROUNDING) & (cell >= first) & (cell < first + count)
        share = np.where(inside, share, 0.0).astype(np.float32)
        found.append(_Touched(np.clip(cell - first, 0, count - 1), share))
    return found


def _highest(values: UInt8, touched: list[_Touched]) -> UInt8:
    """The highest of the rows that each new row touches."""
    parts = (values[cell] * (share > 0.0)[:, None] for cell, share in touched)
    return reduce(np.maximum, parts)


def _sum(values: Float32, touched: list[_Touched]) -> Float32:
    """The rows that each new row touches, by their shares."""
    parts = (values[cell] * share[:, None] for cell, share in touched)
    return reduce(np.add, parts)
