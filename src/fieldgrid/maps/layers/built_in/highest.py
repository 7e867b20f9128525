"""The highest density that any frame gave a cell."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import UInt8, UInt64, kernel
from fieldgrid.geometry import Lattice
from fieldgrid.maps.layers.built_in.density import DENSITIES
from fieldgrid.maps.layers.declaration import Channel, ChannelGroup, Combine, Layer
from fieldgrid.maps.layers.frame import FrameInPlace


class _Highest:
    def __init__(self, cells: int, _: Lattice) -> None:
        self._highest: UInt8 = np.zeros(cells, dtype=np.uint8)

    def add(self, frame: FrameInPlace) -> None:
        raise_to(frame.cells.grid.density, *frame.landing, self._highest)

    def channels(self) -> UInt64:
        return self._highest.astype(np.uint64)[None]


@kernel
def raise_to(values, cell, shift, spans, highest):  # type: ignore[no-untyped-def]
    """Raise each cell of a landing to the value of the local cell, where that is higher."""
    for r in range(cell.shape[0]):
        for c in range(spans[r, 0], spans[r, 1]):
            k = cell[r, c]
            if k >= 0:
                value = values[r >> shift, c >> shift]
                if value > highest[np.uint32(k)]:
                    highest[np.uint32(k)] = value


def _expected(weight: UInt64, total: UInt64) -> UInt64:
    """The mean rounded up, which the highest value is not below."""
    divisor = np.maximum(weight, np.uint64(1))
    return ((total + divisor - np.uint64(1)) // divisor)[None]


GROUP = ChannelGroup(
    "max",
    (Channel("highest", Combine.MAX, Combine.MAX),),
    fold=_Highest,
    expected=_expected,
    of_frames=True,
)

MAX = Layer(
    "max",
    "uint8",
    "",
    "highest density that any frame gave the cell",
    ("density", "max"),
    lambda cells: cells["highest"],
    None,
    DENSITIES,
)
