"""The height of the ground under the vehicle, as the frames that observed a cell have it.

A local grid says what stands on the ground, not how high the ground is. What is known is where
the vehicle stood when it saw the cell, or the block of cells that it belongs to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fieldgrid.core import AnyArray, UInt64, palette
from fieldgrid.geometry import Lattice
from fieldgrid.maps.layers.blocks import blocks_of, session_means
from fieldgrid.maps.layers.declaration import Cells, Channel, ChannelGroup, Colours, Layer
from fieldgrid.maps.layers.frame import FrameInPlace

_PER_M = 100
"""Heights are summed in whole centimetres, so that a sum does not depend on the frames' order."""


class _VehicleHeights:
    """The sum of heights in whole centimetres, and of how many frames: one whose pose has no height
    does not count."""

    def __init__(self, blocks: int, _: Lattice) -> None:
        self._sums = np.zeros((blocks, 2), dtype=np.int64)

    def add(self, frame: FrameInPlace) -> None:
        if math.isfinite(frame.pose.up_m):
            seen = blocks_of(frame.touched, frame.lattice, frame.window)
            self._sums[seen] += round(frame.pose.up_m * _PER_M), 1

    def channels(self) -> Sequence[UInt64]:
        total, frames = self._sums.T
        said = session_means(total, frames), (frames > 0).astype(np.int64)
        return [one.view(np.uint64) for one in said]


def _height(cells: Cells) -> AnyArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(cells["height_cm"].view(np.int64) / cells["height_sessions"] / _PER_M)


GROUP = ChannelGroup(
    "vehicle_height",
    (Channel("height_cm", signed=True), Channel("height_sessions")),
    fold=_VehicleHeights,
    blocks=True,
)

HEIGHT = Layer(
    "height",
    "float32",
    "m",
    "ground height of the vehicle when it saw the cell, metres above the datum's plane: the mean "
    "over the sessions, of their frames that observed it",
    ("density", "vehicle_height"),
    _height,
    float("nan"),
    Colours.of(palette.VALUES),
    above_datum=True,
)
