"""Ground under the vehicle's own way: the surest sight of free ground.

It is free to half a width on either side of the way of the accepted frames, until a later drive
sees an obstacle there. Where a map has several drives the width is less by what their positions may
be off (1 sigma); what one drive saw and where it went share that error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fieldgrid.core import Bool
from fieldgrid.geometry import OBSTACLE_ABOVE, Window
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.transfer import mean_density
from fieldgrid.maps.views.read import Content, Request

WIDTH_M = 1.2
"""Width of the ground that a vehicle of which nothing is known drove over."""

_FARTHEST_M, _BULGE_M = 5.0, 0.3
"""Frames farther apart, or with an arc between them that leaves the straight line by more, leave
open where the vehicle went."""


def driven_cells(content: Content, own: Request, obstacle: Bool) -> Bool:
    """Which of the map's own cells lie with all of them under a way; `obstacle` is where the drives
    together saw one."""
    ways = content.ways(own)
    several = len(ways) > 1
    under = {name: _under(frames, own, by_sigma=several) for name, frames in ways.items()}
    driven = np.zeros(own.window.shape, dtype=np.bool_)
    is_doubtful = several and any((one & obstacle).any() for one in under.values())
    cells = dict(content.by_session(own)) if is_doubtful else {}
    for name, one in under.items():
        if name in cells:
            density, seen = mean_density(cells[name]["weight"], cells[name]["sum"])
            driven &= ~(seen & (density > OBSTACLE_ABOVE))
        driven |= one
    return driven


def _under(frames: Sequence[FrameRecord], own: Request, *, by_sigma: bool) -> Bool:
    """The cells under the way of a drive."""
    covered = np.zeros(own.window.shape, dtype=np.bool_)
    for before, after in pairwise([*frames[:1], *frames]):
        a, b = before.pose, after.pose
        sigma_m = max(a.position_sigma_m, b.position_sigma_m) if by_sigma else 0.0
        _cover(covered, before, after, 0.5 * WIDTH_M - sigma_m, own)
    return covered


def _cover(
    covered: Bool, before: FrameRecord, after: FrameRecord, half_m: float, own: Request
) -> None:
    """Mark the cells under the way from one frame to the next."""
    a, b = before.pose, after.pose
    way = np.array([b.east_m - a.east_m, b.north_m - a.north_m])
    length_m = math.hypot(*way)
    turn = math.radians(abs(math.remainder(b.heading_deg - a.heading_deg, 360.0)))
    if not half_m > 0.0 or length_m > _FARTHEST_M or length_m * turn / 8.0 > _BULGE_M:
        return
    per_m, window = own.lattice.cells_per_m, own.window
    half = half_m * per_m
    start = np.array([a.east_m, a.north_m]) * per_m
    ends = np.stack([start, start + way * per_m])
    (i0, j0), (i1, j1) = np.floor(ends.min(axis=0) - half), np.ceil(ends.max(axis=0) + half)
    part = Window(int(i0), int(j0), int(i1 - i0), int(j1 - j0)).intersect(window)
    if part is None:
        return
    x = part.i0 + 0.5 + np.arange(part.width) - start[0]
    y = (part.j0 + 0.5 + np.arange(part.height) - start[1])[:, None]
    along, across = way * per_m
    share = np.clip((x * along + y * across) / max(along**2 + across**2, 1e-9), 0.0, 1.0)
    near = np.hypot(x - share * along, y - share * across) <= half - math.sqrt(0.5)
    covered[window.slices_of(part)] |= near
