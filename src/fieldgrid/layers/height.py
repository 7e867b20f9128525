"""The height of the ground under the vehicle, as the frames that observed a cell have it.

A local grid says what stands on the ground, not how high the ground is. What is known is where
the vehicle stood when it saw the cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fieldgrid import palette
from fieldgrid.array_types import AnyArray, UInt64
from fieldgrid.lattice import Lattice
from fieldgrid.layers.count import frames_of_weight
from fieldgrid.layers.declaration import Cells, Channel, ChannelGroup, Colours, Layer, nothing
from fieldgrid.layers.frame import FrameInPlace

_PER_M = 1000
"""Heights are summed in whole millimetres, so that a sum does not depend on the frames' order."""


class _Heights:
    """The sum of heights, and of how many frames: one whose pose has no height does not count."""

    def __init__(self, cells: int, _: Lattice) -> None:
        self._sums = np.zeros((2, cells), dtype=np.int64)

    def add(self, frame: FrameInPlace) -> None:
        if math.isfinite(frame.pose.up_m):
            self._sums[0, frame.touched] += round(frame.pose.up_m * _PER_M)
            self._sums[1, frame.touched] += 1

    def channels(self) -> UInt64:
        return self._sums.view(np.uint64)


def _expected(weight: UInt64, _: UInt64) -> Sequence[UInt64]:
    return nothing(weight.shape), frames_of_weight(weight)


def _height(cells: Cells) -> AnyArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        height: AnyArray = cells["height_mm"].view(np.int64) / cells["height_frames"] / _PER_M
    return height


GROUP = ChannelGroup(
    "height",
    (Channel("height_mm", signed=True), Channel("height_frames", signed=True)),
    fold=_Heights,
    expected=_expected,
)

HEIGHT = Layer(
    "height",
    "float32",
    "m",
    "ground height of the vehicle when it saw the cell, metres above the datum's plane: the mean "
    "over the frames that observed it",
    ("density", "height"),
    _height,
    float("nan"),
    Colours.of(palette.VALUES),
    above_datum=True,
)
