"""Ground under the vehicle's own way: the surest sight of free ground.

It is free to half a width on either side of the way of the accepted frames, until a later drive
sees an obstacle there; what no drive saw is free a little farther. Where a map has several drives
both are less by what their positions may be off (1 sigma); what one drive saw and where it went
share that error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fieldgrid.core import Bool, Float32
from fieldgrid.geometry import OBSTACLE_ABOVE, Window
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.transfer import mean_density
from fieldgrid.maps.views.read import Content, Request

WIDTH_M, UNSEEN_WIDTH_M = 1.2, 1.5
"""Width of the ground that a vehicle of which nothing is known drove over, whatever was seen there;
and of what counts as such where nothing was seen."""

_FARTHEST_M, _BULGE_M = 5.0, 0.3
"""Frames farther apart, or with an arc between them that leaves the straight line by more, leave
open where the vehicle went."""


def driven_cells(content: Content, own: Request, obstacle: Bool, seen: Bool) -> Bool:
    """Which of the map's own cells lie with all of them under a way; `obstacle` is where the drives
    together saw one, `seen` where they saw anything."""
    ways = content.ways(own)
    several = len(ways) > 1
    limits = np.where(seen, np.float32(0.5 * WIDTH_M), np.float32(0.5 * UNSEEN_WIDTH_M))
    under = {name: _away_m(frames, own, by_sigma=several) < limits for name, frames in ways.items()}
    driven = np.zeros(own.window.shape, dtype=np.bool_)
    is_doubtful = several and any((one & obstacle).any() for one in under.values())
    cells = dict(content.by_session(own)) if is_doubtful else {}
    for name, one in under.items():
        if name in cells:
            density, observed = mean_density(cells[name]["weight"], cells[name]["sum"])
            driven &= ~(observed & (density > OBSTACLE_ABOVE))
        driven |= one
    return driven


def _away_m(frames: Sequence[FrameRecord], own: Request, *, by_sigma: bool) -> Float32:
    """How far the cells lie from the way of a drive with all of them, and with the error of its
    positions; inf where that is more than a width."""
    away_m = np.full(own.window.shape, np.inf, dtype=np.float32)
    per_m = own.lattice.cells_per_m
    for before, after in pairwise([*frames[:1], *frames]):
        a, b = before.pose, after.pose
        sigma_m = max(a.position_sigma_m, b.position_sigma_m) if by_sigma else 0.0
        way = np.array([b.east_m - a.east_m, b.north_m - a.north_m])
        length_m = math.hypot(*way)
        turn = math.radians(abs(math.remainder(b.heading_deg - a.heading_deg, 360.0)))
        if length_m > _FARTHEST_M or length_m * turn / 8.0 > _BULGE_M:
            continue
        start = np.array([a.east_m, a.north_m]) * per_m
        ends, reach = np.stack([start, start + way * per_m]), UNSEEN_WIDTH_M * per_m
        (i0, j0), (i1, j1) = np.floor(ends.min(axis=0) - reach), np.ceil(ends.max(axis=0) + reach)
        part = Window(int(i0), int(j0), int(i1 - i0), int(j1 - j0)).intersect(own.window)
        if part is None:
            continue
        x = part.i0 + 0.5 + np.arange(part.width) - start[0]
        y = (part.j0 + 0.5 + np.arange(part.height) - start[1])[:, None]
        along, across = way * per_m
        share = np.clip((x * along + y * across) / max(along**2 + across**2, 1e-9), 0.0, 1.0)
        away = np.hypot(x - share * along, y - share * across) + math.sqrt(0.5)
        place = own.window.slices_of(part)
        away_m[place] = np.fmin(away_m[place], away / per_m + sigma_m)
    return away_m
