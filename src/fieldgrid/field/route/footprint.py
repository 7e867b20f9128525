"""Whether a vehicle fits: the ground that it sweeps in one step, against the blocked cells.

A step is a short arc. The hull of the footprint at both ends of it holds all that is swept between
them but for a bulge of `BULGE_M`, so a way whose steps are all free is free everywhere. Discs that
cover the hull are looked up in a distance field, which settles most steps at once and on the safe
side; where a disc is too near to something, the squares of the blocked cells are held against the
hull itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely

from fieldgrid.core import Float64, kernel
from fieldgrid.field.route.vehicle import Vehicle

BULGE_M = 0.002
"""How far a corner on an arc may be from the chord between the ends of a step."""

MAX_STEP_M = 0.1
CURVATURES = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Of the arcs that are driven, in units of the highest one, to the left."""

STANDING = len(CURVATURES)
"""The index of the footprint itself among the hulls."""

_DISCS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A vehicle as the kernels take it, (forward, left) metres of the pose behind a step.

    `hulls` [6, n, 2] are convex and counter-clockwise: what a step forward sweeps at each of
    `CURVATURES`, and the footprint; the last corner is repeated where one has fewer than n.
    `discs` [6, m, 3] (forward, left, radius) cover them. `clearance_m` is kept about them.
    """

    hulls: Float64
    discs: Float64
    clearance_m: float
    step_m: float

    @classmethod
    def of(cls, vehicle: Vehicle) -> Shape:
        """The steps of a vehicle, short enough for `BULGE_M`."""
        outer = math.hypot(vehicle.turning_radius_m + vehicle.reach_m, vehicle.reach_m)
        step = min(MAX_STEP_M, vehicle.turning_radius_m * math.sqrt(8.0 * BULGE_M / outer))
        corners = vehicle.footprint()
        shapes = [
            _hull(np.concatenate([corners, _moved(corners, c * vehicle.curvature_1pm, step)]))
            for c in CURVATURES
        ]
        shapes.append(_hull(corners))
        most = max(len(shape) for shape in shapes)
        hulls = np.stack([np.pad(s, ((0, most - len(s)), (0, 0)), mode="edge") for s in shapes])
        discs = np.stack([_covering(shape) for shape in shapes])
        return cls(hulls, discs, vehicle.clearance_m + BULGE_M, step)


def _moved(corners: Float64, curvature: float, step: float) -> Float64:
    """Corners after a step along an arc."""
    turn = curvature * step
    x, y = step, 0.0
    if curvature:
        x, y = math.sin(turn) / curvature, (1.0 - math.cos(turn)) / curvature
    cos, sin = math.cos(turn), math.sin(turn)
    return np.asarray(corners @ np.array([[cos, sin], [-sin, cos]]) + (x, y))


def _hull(points: Float64) -> Float64:
    """The corners of the convex hull, counter-clockwise."""
    hull = shapely.orient_polygons(shapely.MultiPoint(points).convex_hull)
    return np.asarray(shapely.get_coordinates(hull)[:-1])


def _covering(corners: Float64) -> Float64:
    """Discs along the middle of the box about some corners."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    step = (high[0] - low[0]) / _DISCS
    centres = low[0] + (np.arange(_DISCS) + 0.5) * step
    radius = math.hypot(0.5 * step, 0.5 * (high[1] - low[1]))
    middle = 0.5 * (low[1] + high[1])
    return np.column_stack([centres, np.full(_DISCS, middle), np.full(_DISCS, radius)])


@kernel
def square_gap(forward, left, along, aside, corners):  # type: ignore[no-untyped-def]
    """The squared distance from a convex polygon to a square, 0 where they meet.

    The square has its middle at (forward, left); (along, aside) goes from there to the middle of
    one side.
    """
    count = corners.shape[0]
    best = 1e18
    for k in range(4):
        # Its corners, against the polygon's edges.
        a, b = 1.0 if k < 2 else -1.0, 1.0 if k % 2 == 0 else -1.0
        x, y = forward + a * along - b * aside, left + a * aside + b * along
        inside = True
        for n in range(count):
            ax, ay = corners[n, 0], corners[n, 1]
            m = n + 1 if n + 1 < count else 0
            ex, ey = corners[m, 0] - ax, corners[m, 1] - ay
            dx, dy = x - ax, y - ay
            if ex * dy - ey * dx < 0.0:
                inside = False
                t = min(max((ex * dx + ey * dy) / (ex * ex + ey * ey), 0.0), 1.0)
                best = min(best, (dx - t * ex) ** 2 + (dy - t * ey) ** 2)
        if inside:
            return 0.0
    half = math.hypot(along, aside)
    for n in range(count):
        # The polygon's corners, against the square.
        dx, dy = corners[n, 0] - forward, corners[n, 1] - left
        u = max(abs(dx * along + dy * aside) / half - half, 0.0)
        v = max(abs(dy * along - dx * aside) / half - half, 0.0)
        best = min(best, u * u + v * v)
    return best


@kernel
def gap_m(  # type: ignore[no-untyped-def]
    x, y, yaw, corners, discs, reach, enough, blocked, to_blocked, cell
):
    """Metres from a convex polygon at a pose to the nearest blocked cell; -1 when that leaves the
    window.

    The pose is in metres from the window's corner, `yaw` in radians counter-clockwise from east. A
    distance above `reach` is given as a lower bound, and the search ends below `enough`.
    """
    cos, sin = math.cos(yaw), math.sin(yaw)
    height, width = blocked.shape
    least = 1e18
    for k in range(discs.shape[0]):
        px = x + discs[k, 0] * cos - discs[k, 1] * sin
        py = y + discs[k, 0] * sin + discs[k, 1] * cos
        i, j = math.floor(px / cell), math.floor(py / cell)
        if i < 0 or j < 0 or i >= width or j >= height:
            return -1.0
        least = min(least, to_blocked[j, i] - discs[k, 2])
        if least < reach:
            break
    if least >= reach:
        return least
    low_x, low_y, high_x, high_y = 1e18, 1e18, -1e18, -1e18
    for k in range(corners.shape[0]):
        px = x + corners[k, 0] * cos - corners[k, 1] * sin
        py = y + corners[k, 0] * sin + corners[k, 1] * cos
        low_x, high_x = min(low_x, px), max(high_x, px)
        low_y, high_y = min(low_y, py), max(high_y, py)
    if low_x < 0.0 or low_y < 0.0 or high_x > width * cell or high_y > height * cell:
        return -1.0
    i0, i1 = math.floor((low_x - reach) / cell), math.floor((high_x + reach) / cell)
    j0, j1 = math.floor((low_y - reach) / cell), math.floor((high_y + reach) / cell)
    best = reach * reach
    stop = enough * enough
    for j in range(max(j0, 0), min(j1, height - 1) + 1):
        cy = (j + 0.5) * cell - y
        for i in range(max(i0, 0), min(i1, width - 1) + 1):
            if blocked[j, i] == 0:
                continue
            cx = (i + 0.5) * cell - x
            forward, left = cx * cos + cy * sin, cy * cos - cx * sin
            half = 0.5 * cell
            best = min(best, square_gap(forward, left, half * cos, -half * sin, corners))
            if best < stop:
                return math.sqrt(best)
    return math.sqrt(best)


@kernel
def may_lean(x, y, yaw, cell, rises, limits):  # type: ignore[no-untyped-def]
    """Whether the ground under a pose is no steeper along and across it than `limits` say: both in
    metres a metre, and how far ahead of the pose the ground is looked up.

    Between the middles of cells `rises` [rows, columns, 2], to east and north, change evenly; where
    there are none, and at the edge of the window, no ground is too steep.
    """
    cos, sin = math.cos(yaw), math.sin(yaw)
    px, py = (x + limits[2] * cos) / cell - 0.5, (y + limits[2] * sin) / cell - 0.5
    i, j = math.floor(px), math.floor(py)
    if i < 0 or j < 0 or i + 1 >= rises.shape[1] or j + 1 >= rises.shape[0]:
        return True
    east = north = 0.0
    for b in range(2):
        for a in range(2):
            share = abs(1.0 - a - px + i) * abs(1.0 - b - py + j)
            east += share * rises[j + b, i + a, 0]
            north += share * rises[j + b, i + a, 1]
    along, across = abs(east * cos + north * sin), abs(north * cos - east * sin)
    return along <= limits[0] and across <= limits[1]


@kernel
def gaps_m(  # type: ignore[no-untyped-def]
    poses, corners, discs, reach, blocked, to_blocked, cell, rises, limits, gaps
):
    """Fill `gaps` [n] with :func:`gap_m` of poses [n, 3]; -1 where the ground is too steep, too."""
    for k in range(len(poses)):
        x, y, yaw = poses[k, 0], poses[k, 1], poses[k, 2]
        gaps[k] = -1.0
        if may_lean(x, y, yaw, cell, rises, limits):
            gaps[k] = gap_m(x, y, yaw, corners, discs, reach, 0.0, blocked, to_blocked, cell)
