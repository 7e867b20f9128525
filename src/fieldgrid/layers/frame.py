"""A frame where it lands in a window of cells: what a channel group is given of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from fieldgrid.array_types import AnyArray, Int32
from fieldgrid.grids import LocalGrid
from fieldgrid.lattice import Lattice
from fieldgrid.trajectory import Pose
from fieldgrid.transfer import Landing


class FrameCells(NamedTuple):
    """What a frame saw: its local grid, and further channels [n_y, n_x] by name."""

    grid: LocalGrid
    channels: Mapping[str, AnyArray]


@dataclass(frozen=True, slots=True)
class FrameInPlace:
    """One frame at its pose in the map.

    `landing` says where each local cell lands, `touched` (int32, flat indices) has each cell of the
    window that any landed in once.
    """

    cells: FrameCells
    pose: Pose
    lattice: Lattice
    landing: Landing
    touched: Int32
