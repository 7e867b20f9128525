"""A frame where it lands in a window of cells: what a channel group is given of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from fieldgrid.core import AnyArray, Int32
from fieldgrid.geometry import Lattice, LocalGrid, Pose, Window
from fieldgrid.maps.layers.blocks import BlockPoints, block_points
from fieldgrid.maps.transfer import Landing


class FrameCells(NamedTuple):
    """What a frame saw: its local grid, and further channels [n_y, n_x] by name."""

    grid: LocalGrid
    channels: Mapping[str, AnyArray]


@dataclass(frozen=True)
class FrameInPlace:
    """One frame at its pose in the map; `landing` says where each local cell lands in `window`."""

    cells: FrameCells
    pose: Pose
    lattice: Lattice
    window: Window
    landing: Landing
    touch: Callable[[Landing], Int32] = field(repr=False)

    @cached_property
    def touched(self) -> Int32:
        """The cells of the window that any local cell landed in, each once, flat indices."""
        return self.touch(self.landing)

    @cached_property
    def in_blocks(self) -> BlockPoints:
        """Where the blocks under the window lie in the local grid."""
        return block_points(self.cells.grid.spec, self.pose, self.lattice, self.window)
