"""The variance of the density over all that frames said of a cell."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import AnyArray, UInt64, palette
from fieldgrid.geometry import Lattice
from fieldgrid.maps.layers.declaration import Cells, Channel, ChannelGroup, Colours, Layer
from fieldgrid.maps.layers.frame import FrameInPlace
from fieldgrid.maps.transfer import CELL_WEIGHT, add_values

_SQUARES = np.arange(256, dtype=np.uint64) ** 2
_WHOLE = ~np.uint64(CELL_WEIGHT - 1)


class _Squares:
    """The weighted sum of the squares of the density, in sixteenths of a local cell."""

    def __init__(self, cells: int, _: Lattice) -> None:
        self._squares = np.zeros(cells, dtype=np.uint64)

    def add(self, frame: FrameInPlace) -> None:
        landing = frame.landing
        table = _SQUARES * np.uint64(landing.unit)
        add_values(frame.cells.grid.density, *landing, table, self._squares)

    def channels(self) -> UInt64:
        return self._squares[None]


def _expected(weight: UInt64, total: UInt64) -> UInt64:
    """The squares of values that are all alike, cut to whole local cells."""
    return (total * total // np.maximum(weight, np.uint64(1)) & _WHOLE)[None]


def _variance(cells: Cells) -> AnyArray:
    weight, total, squares = (
        cells[name].astype(np.float64) for name in ("weight", "sum", "squares")
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        # Of whole numbers, so that a constant has a variance of exactly 0.
        return np.asarray((weight * squares - total * total) / (weight * weight))


GROUP = ChannelGroup(
    "variance", (Channel("squares"),), fold=_Squares, expected=_expected, of_frames=True
)

VARIANCE = Layer(
    "variance",
    "float32",
    "",
    "variance of the density over all that frames said of the cell",
    ("density", "variance"),
    _variance,
    float("nan"),
    Colours.of(palette.VALUES, 0.0),
)
