"""What moved while a drive went on: it stood there, and was seen through afterwards.

A person who walks away leaves a trail of obstacles in the mean of a drive, a car a lane of them. A
frame looks at a cell along its sight lines (`layers.sight`): something stands there, or all is
clear. Clear looks from farther than the obstacle was seen from do not count, nor do those from so
near that what hangs there is out of the picture. A cell has *moved* in a drive where at least two
looks, and as many as those in which it stood, were clear since: a post that one look of two misses
stays, and so does what came and is there in the end.

It is evidence of its own: density and all other layers are as ever. `views.moved` makes things of
the cells, for whoever decides.
"""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import Bool, Float32, Int32, Int64, UInt8, UInt64, kernel, palette
from fieldgrid.geometry import FREE_UP_TO, Lattice
from fieldgrid.maps.layers.declaration import (
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    Layer,
    nothing,
)
from fieldgrid.maps.layers.frame import FrameInPlace
from fieldgrid.maps.layers.sight import CLEAR, NOTHING, STANDS, fill_look, sight_lines

LEAST_CLEAR = 2
"""Clear looks since the latest obstacle that tell of a thing that moved."""

AS_NEAR = 1.1
"""A clear look counts up to this many times the least distance from which the obstacle was seen."""

NEAREST_M = 2.0
"""Clear looks from nearer do not count: a branch that hangs there may be above the picture."""


class _Looks:
    """Of each cell how many looks saw an obstacle, from how near, and how many since were clear.

    Frames come in the order of their time; those of one time in any. Only cells in which anything
    ever stood are looked at again; they are listed.
    """

    def __init__(self, cells: int, lattice: Lattice) -> None:
        self._per_m = lattice.cells_per_m
        self._looks: UInt8 = np.zeros((cells, 2), dtype=np.uint8)
        self._near_m: Float32 = np.zeros(cells, dtype=np.float32)
        self._stood_ns: Int64 = np.zeros(cells, dtype=np.int64)
        self._listed: Bool = np.zeros(cells, dtype=np.bool_)
        self._list: Int32 = np.zeros(cells, dtype=np.int32)
        self._count = 0

    def add(self, frame: FrameInPlace) -> None:
        grid, pose, landing = frame.cells.grid, frame.pose, frame.landing
        local_m, phi = grid.spec.cell_m, math.radians(pose.heading_deg)
        self._count = list_standing(
            grid.density, landing.cell, landing.shift, self._list, self._count, self._listed
        )
        lines = sight_lines(grid.spec)
        rays = np.zeros((int(lines.bearing.max()) + 1, int(lines.ring.max()) + 1), np.uint8)
        nearest = np.full((2, len(rays)), rays.shape[1], np.int32)
        said, around = (
            np.zeros(grid.spec.shape, np.uint8),
            int(0.71 / (self._per_m * local_m) + 0.5),
        )
        fill_look(
            *(grid.density, grid.observed, lines.bearing, lines.ring, lines.step, local_m),
            *(around, rays, nearest, np.zeros(said.shape, np.int32), said),
        )
        add_looks(
            *(said, local_m, self._per_m, pose.east_m, pose.north_m, math.cos(phi), math.sin(phi)),
            *(*frame.window, self._list, self._count, pose.time_ns),
            *(self._looks, self._near_m, self._stood_ns),
        )

    def channels(self) -> UInt64:
        stood, clear = self._looks[:, 0], self._looks[:, 1]
        moved = (stood > 0) & (clear >= np.maximum(stood, LEAST_CLEAR))
        return moved.astype(np.uint64)[None] if moved.any() else nothing((1, moved.size))


@kernel
def list_standing(density, cell, shift, cells, count, listed):  # type: ignore[no-untyped-def]
    """Add to `cells` those of the window in which a local cell lands where anything stands; returns
    how many there are then."""
    inner = (1 << shift) >> 1
    for r in range(density.shape[0]):
        for c in range(density.shape[1]):
            if density[r, c] <= FREE_UP_TO:
                continue
            k = cell[(r << shift) + inner, (c << shift) + inner]
            if k >= 0 and not listed[k]:
                listed[k], cells[count] = True, k
                count += 1
    return count


@kernel
def add_looks(  # type: ignore[no-untyped-def]
    said, local_m, per_m, east_m, north_m, cos, sin, i0, j0, width, height, cells, count,
    time_ns, looks, near_m, stood_ns,
):  # fmt: skip
    """Add what a frame has `said` [n_y, n_x] of the middles of the listed cells.

    `looks` [cells, 2] counts obstacles, and clear looks since the latest; `near_m` is the least
    distance of the obstacles, `stood_ns` when anything was last seen standing.
    """
    n_y, n_x = said.shape
    for n in range(count):
        k = cells[n]
        away_n = (k // width + j0 + 0.5) / per_m - north_m
        away_e = (k % width + i0 + 0.5) / per_m - east_m
        x = (away_e * cos - away_n * sin) / local_m
        y = (away_e * sin + away_n * cos) / local_m
        r, c = int(np.floor(y)), int(np.floor(x + 0.5 * n_x))
        if r < 0 or c < 0 or r >= n_y or c >= n_x or said[r, c] == NOTHING:
            continue
        away_m = np.float32(local_m * np.sqrt(x * x + y * y))
        if said[r, c] != CLEAR:
            looks[k, 1], stood_ns[k] = 0, time_ns
            if said[r, c] == STANDS:
                if looks[k, 0] == 0 or away_m < near_m[k]:
                    near_m[k] = away_m
                looks[k, 0] = min(looks[k, 0] + 1, 255)
        elif (
            looks[k, 0] > 0
            and stood_ns[k] != time_ns
            and NEAREST_M <= away_m <= AS_NEAR * near_m[k]
        ):
            looks[k, 1] = min(looks[k, 1] + 1, 255)


GROUP = ChannelGroup(
    "moved",
    (Channel("moved_drives", coarser=Combine.MAX),),
    fold=_Looks,
)

MOVED = Layer(
    "moved",
    "uint8",
    "",
    "1: something stood there, and was seen through later in the same drive; of a larger cell, in "
    "any of its base cells",
    ("density", GROUP.name),
    lambda cells: cells["moved_drives"] > 0,
    None,
    Colours((palette.DENSITY[0].colour, palette.DENSITY[-1].colour), 0.0, 1.0),
)
