"""How many frames observed a cell."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import UInt32, UInt64, kernel, palette
from fieldgrid.geometry import Lattice
from fieldgrid.maps.layers.declaration import Channel, ChannelGroup, Colours, Combine, Layer
from fieldgrid.maps.layers.frame import FrameInPlace
from fieldgrid.maps.transfer import AREA_SHIFT, CELL_WEIGHT


class _FrameCount:
    def __init__(self, cells: int, _: Lattice) -> None:
        self._frames: UInt32 = np.zeros(cells, dtype=np.uint32)

    def add(self, frame: FrameInPlace) -> None:
        add_one(frame.touched, self._frames)

    def channels(self) -> UInt64:
        return self._frames.astype(np.uint64)[None]


@kernel
def add_one(touched, frames):  # type: ignore[no-untyped-def]
    """Count one frame more in the cells that it touched, each of which is in there once."""
    for k in touched:
        frames[np.uint32(k)] += 1


def frames_of_weight(weight: UInt64) -> UInt64:
    """The frames of a cell to which each gave one whole local cell, rounded up."""
    frames = weight + np.uint64(CELL_WEIGHT - 1)
    frames >>= np.uint64(2 * AREA_SHIFT)
    return frames


GROUP = ChannelGroup(
    "count",
    (Channel("frames", coarser=Combine.MAX, signed=True),),
    fold=_FrameCount,
    expected=lambda weight, _: frames_of_weight(weight)[None],
    of_frames=True,
)

COUNT = Layer(
    "count",
    "uint32",
    "frames",
    "frames that observed the cell; of a larger cell, the most that observed one of its base cells",
    ("density", "count"),
    lambda cells: cells["frames"],
    0,
    Colours.of(palette.VALUES, 0.0),
)
