"""Sight lines of a frame: its local cells by bearing and range, and what stands or is clear there.

A local cell is *clear* where the line of sight goes on beyond it to ground, low enough to pass
nothing that stands on the cell, and neither in that direction nor beside it does anything stand as
near, within a margin. The cell itself need not have been seen: a frame leaves pinholes, and ground
without texture is seen here and there only.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, Bool, Float32, Float64, Index, kernel
from fieldgrid.geometry import (
    FREE_UP_TO,
    HIDDEN_FROM,
    OBSTACLE_ABOVE,
    GridSpec,
    LocalGrid,
)

MARGIN_M, MARGIN_SHARE = 0.3, 0.05
"""How far what stands must be from what is clear, and the share of its distance by which that
grows: what was seen from afar may stand nearer or farther."""

LEAST_HITS = 3
"""Local cells above 100, around one, that are an obstacle: a lone one is noise."""

NOTHING, UNSURE, STANDS, CLEAR = range(4)
"""What a frame says of a place: `UNSURE` where something is that is no obstacle."""


class SightLines(NamedTuple):
    """The cells of a local grid as seen from its origin, arrays [n_y, n_x]: their range, the number
    of their bearing, and of their range in cells, that of what would hide them, and the step of
    bearings in radians."""

    range_m: Float32
    bearing: Index
    ring: Index
    hidden_from: Index
    step: float


@lru_cache(maxsize=8)
def sight_lines(spec: GridSpec) -> SightLines:
    """Bearings in steps of one cell at half the grid's reach, ranges in steps of a cell."""
    x, y = np.meshgrid(*spec.centres_m())
    range_m: Float64 = np.hypot(x, y)
    step = 2.0 * spec.cell_m / spec.reach_m
    bearing = np.floor((np.arctan2(x, y) + math.pi / 2.0) / step).astype(np.intp)
    ring = np.floor(range_m / spec.cell_m).astype(np.intp)
    first = np.floor(range_m * HIDDEN_FROM / spec.cell_m).astype(np.intp)
    return SightLines(range_m.astype(np.float32), bearing, ring, first, step)


def hidden(grid: LocalGrid) -> Bool:
    """The cells [n_y, n_x] with an obstacle shortly before them in the line of sight."""
    lines = sight_lines(grid.spec)
    stands = grid.observed & (grid.density > OBSTACLE_ABOVE)
    rays = np.zeros((int(lines.bearing.max()) + 1, int(lines.ring.max()) + 2), dtype=np.int16)
    rays[lines.bearing[stands], lines.ring[stands] + 1] = 1
    before: AnyArray = np.cumsum(rays, axis=1, dtype=np.int16)
    # `before[b, k]` counts the rings of a bearing that are nearer than ring k.
    return np.asarray(before[lines.bearing, lines.ring] > before[lines.bearing, lines.hidden_from])


@kernel
def fill_look(  # type: ignore[no-untyped-def]
    density, observed, bearing, ring, step, cell_m, around, rays, nearest, hits, said
):
    """Fill `said` with what a frame says of the places of its local cells [n_y, n_x]; what stands
    is said of those within `around` cells of it, too.

    `said`, `rays` [bearings, rings] and `hits` are 0 before, `nearest` [2, bearings] the number of
    rings: the nearest that stands in a bearing, and in it or beside it.
    """
    n_y, n_x = density.shape
    bearings, rings = rays.shape
    for r in range(n_y):
        for c in range(n_x):
            if not observed[r, c]:
                continue
            b, k, value = bearing[r, c], ring[r, c], density[r, c]
            if value <= FREE_UP_TO:
                rays[b, k] = 1
                continue
            nearest[0, b] = min(nearest[0, b], k)
            for j in range(max(r - around, 0), min(r + around + 1, n_y)):
                for i in range(max(c - around, 0), min(c + around + 1, n_x)):
                    said[j, i] = UNSURE
                    hits[j, i] += value > OBSTACLE_ABOVE
    for b in range(bearings):
        range_m = nearest[0, b] * cell_m
        if nearest[0, b] < rings:
            beside = (MARGIN_M + MARGIN_SHARE * range_m) / max(range_m, MARGIN_M)
            wide = int(beside / step) + 1
            for other in range(max(b - wide, 0), min(b + wide + 1, bearings)):
                nearest[1, other] = min(nearest[1, other], nearest[0, b])
    for b in range(bearings):
        range_m = nearest[1, b] * cell_m
        margin = int((MARGIN_M + MARGIN_SHARE * range_m) / cell_m) + 1
        end = nearest[1, b] if nearest[1, b] < rings else rings + margin
        ground = -1  # the nearest that is seen beyond
        for k in range(rings - 1, -1, -1):
            if rays[b, k] > 0 and k < end:
                ground = k
            rays[b, k] = ground >= 0 and HIDDEN_FROM * ground <= k + 1 and k + margin < end
    for r in range(n_y):
        for c in range(n_x):
            if said[r, c] == UNSURE:
                said[r, c] = STANDS if hits[r, c] >= LEAST_HITS else UNSURE
            elif rays[bearing[r, c], ring[r, c]] > 0:
                said[r, c] = CLEAR
