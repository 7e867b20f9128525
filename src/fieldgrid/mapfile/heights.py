"""The height of the ground under the vehicle, as the frames that observed a cell have it.

A map keeps no heights of cells: a local grid says what stands on the ground, not how high the
ground is. What is known is where the vehicle stood when it saw the cell.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fieldgrid.lattice import Lattice, Window
from fieldgrid.mapfile.records import FrameRecord
from fieldgrid.mapfile.view import BLOCK_CELLS, MapView, blocks
from fieldgrid.transfer import MeanFold, Transfer, footprint

HEIGHT = "height"
"""The layer's name."""

_PER_M = 1000
"""Heights are summed in whole millimetres, so that a sum does not depend on the frames' order."""


def with_heights(view: MapView, frames: Sequence[FrameRecord], transfer: Transfer) -> MapView:
    """The view with the layer `height`, float32 metres above the datum's plane.

    Each frame that observed a cell counts once, and one whose pose has no height does not.
    """
    known = [frame for frame in frames if math.isfinite(frame.pose.up_m)]
    height = np.full(view.window.shape, np.nan, dtype=np.float32)
    for block in blocks(view.window, BLOCK_CELLS):
        total, count = _totals(block, view.lattice, known, transfer)
        with np.errstate(invalid="ignore"):  # 0 / 0 where nobody looked
            height[view.window.slices_of(block)] = total / count / _PER_M
    return replace(view, layers={**view.layers, HEIGHT: height})


def _totals(
    block: Window, lattice: Lattice, frames: Sequence[FrameRecord], transfer: Transfer
) -> tuple[np.ndarray, np.ndarray]:
    """The sum of heights in millimetres, int64, and the number of frames, of each cell."""
    total = np.zeros(block.shape, dtype=np.int64)
    count = np.zeros(block.shape, dtype=np.int64)
    for frame in frames:
        part = footprint(frame.spec, frame.pose, lattice).intersect(block)
        if part is None:
            continue
        fold = MeanFold(lattice, part, transfer)
        fold.add(frame.grid(), frame.pose)
        seen, place = fold.sums[..., 0] > 0, block.slices_of(part)
        total[place] += seen * round(frame.pose.up_m * _PER_M)
        count[place] += seen
    return total, count
