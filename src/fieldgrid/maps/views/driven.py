"""Ground under the vehicle's own way: the surest sight of free ground.

It is free to half a width on either side of the way of the accepted frames, less what their
positions may be off (1 sigma), until a later drive sees an obstacle there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool
from fieldgrid.geometry import OBSTACLE_ABOVE, Lattice, Window
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.layers.declaration import Cells
from fieldgrid.maps.transfer import mean_density

DRIVEN_WIDTH_M = 1.2
"""Width of the ground that a vehicle of which nothing is known drove over."""

_FARTHEST_M, _BULGE_M = 5.0, 0.3
"""Frames farther apart, or with an arc between them that leaves the straight line by more, leave
open where the vehicle went."""


class DrivenWay(NamedTuple):
    """The accepted frames of a session near a window, in time order, its own cells in it, and the
    width of the ground that is free along them."""

    frames: Sequence[FrameRecord]
    cells: Cells | None
    width_m: float


def driven_cells(ways: Sequence[DrivenWay], lattice: Lattice, window: Window) -> Bool:
    """Which cells of a window lie with all of them under a way; `ways` in the order of drives."""
    driven = np.zeros(window.shape, dtype=np.bool_)
    for frames, cells, width_m in ways:
        if cells is not None and driven.any():
            density, seen = mean_density(cells["weight"], cells["sum"])
            driven &= ~(seen & (density > OBSTACLE_ABOVE))
        for before, after in pairwise([*frames[:1], *frames]):
            _cover(driven, before, after, width_m, lattice, window)
    return driven


def _cover(
    driven: Bool,
    before: FrameRecord,
    after: FrameRecord,
    width_m: float,
    lattice: Lattice,
    window: Window,
) -> None:
    """Mark the cells under the way from one frame to the next."""
    a, b = before.pose, after.pose
    way = np.array([b.east_m - a.east_m, b.north_m - a.north_m])
    length_m = math.hypot(*way)
    turn = math.radians(abs(math.remainder(b.heading_deg - a.heading_deg, 360.0)))
    if length_m > _FARTHEST_M or length_m * turn / 8.0 > _BULGE_M:
        return
    half_m = 0.5 * width_m - max(a.position_sigma_m, b.position_sigma_m)
    if not half_m > 0.0:
        return
    half = half_m * lattice.cells_per_m
    start = np.array([a.east_m, a.north_m]) * lattice.cells_per_m
    ends = np.stack([start, start + way * lattice.cells_per_m])
    (i0, j0), (i1, j1) = np.floor(ends.min(axis=0) - half), np.ceil(ends.max(axis=0) + half)
    part = Window(int(i0), int(j0), int(i1 - i0), int(j1 - j0)).intersect(window)
    if part is None:
        return
    x = part.i0 + 0.5 + np.arange(part.width) - start[0]
    y = (part.j0 + 0.5 + np.arange(part.height) - start[1])[:, None]
    along, across = way * lattice.cells_per_m
    share = np.clip((x * along + y * across) / max(along**2 + across**2, 1e-9), 0.0, 1.0)
    near = np.hypot(x - share * along, y - share * across) <= half - math.sqrt(0.5)
    driven[window.slices_of(part)] |= near
