"""From end to end of a lane: along its middle, or beside it where something stands there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import shapely

from fieldgrid.core import Float64, NoRouteError
from fieldgrid.field.route.footprint import BULGE_M
from fieldgrid.field.route.plan import find_way, remedy, standing_fault
from fieldgrid.field.route.search import Searcher, SearchPose
from fieldgrid.field.rows.result import Lane
from fieldgrid.geometry import (
    extended,
    lengths,
    normals,
    part,
    project,
    resampled,
)

_STRAIGHT_M = 0.15
"""A lane that bends less than this is driven straight."""

_STEP_M = 0.1
_BESIDE_M = 0.6
"""How far beside the middle of a lane a vehicle may drive along it."""

_LEFT_OUT = 0.15
"""The share of a lane that may be left out at either end, where that end has no room or was not
seen."""

_MAX_POSES = 100_000


class Pass(NamedTuple):
    """A way along a lane, as rows of x, y, yaw, gear, curvature (metres from the window's corner).

    It begins `from_m` and ends `to_m` along the lane's line, counted in the direction of driving.
    """

    samples: Float64
    from_m: float
    to_m: float

    @property
    def start(self) -> SearchPose:
        """Where it begins."""
        return SearchPose(*self.samples[0, :3].tolist())

    @property
    def stop(self) -> SearchPose:
        """Where it ends."""
        return SearchPose(*self.samples[-1, :3].tolist())


def drive_lane(searcher: Searcher, lane: Lane, *, backwards: bool) -> Pass:
    """The way along a lane, in the direction of its line or against it; the vehicle drives
    forward, but for where it has to manoeuvre.

    The reference point goes from the line's one end to the other; where the vehicle cannot stand
    there, from as near to it as it can, and no farther than its nose or tail reaches or a seventh
    of the lane. Raises NoRouteError where it cannot be driven.
    """
    ground, vehicle = searcher.ground, searcher.vehicle
    line = np.asarray(lane.line.coords, dtype=np.float64)[:, :2]
    line = line[::-1] if backwards else line
    inner = line - (ground.west_m, ground.south_m)
    chord = inner[[0, -1]]
    is_straight = float(np.abs(project(inner, chord)[1]).max()) <= _STRAIGHT_M
    inner = chord if is_straight else resampled(inner, 0.5)
    half_m = 0.5 * lane.area.area / lane.length_m
    count = int(min(_BESIDE_M, max(half_m - 0.5 * vehicle.width_m, 0.0)) / _STEP_M + 1e-9)
    beside = sorted(_STEP_M * np.arange(-count, count + 1), key=abs)
    starts, stops = (_free_ends(searcher, inner, beside, is_last=is_last) for is_last in (0, 1))
    for aside in (aside for aside in beside if aside in starts and aside in stops):
        at = starts[aside], stops[aside]
        along = part(inner, *at)
        samples = followed(searcher, along + aside * normals(along))
        if len(samples):
            return Pass(samples, *at)
    for name, at_m, found in (("near", 0.0, starts), ("far", lengths(inner)[-1], stops)):
        if not found:
            fault = standing_fault(searcher, _poses(inner, np.array([at_m]), 0.0)[0])
            raise NoRouteError(
                f"At the {name} end of the lane the vehicle has no room: {fault.reason}",
                fault.east_m,
                fault.north_m,
                remedy(searcher, [fault[1:]]),
            )
    return _around(searcher, lane, inner, next(iter(starts.items())), next(iter(stops.items())))


def _free_ends(
    searcher: Searcher, line: Float64, beside: list[float], *, is_last: int
) -> dict[float, float]:
    """For each distance to the left of a line, how far along it the vehicle can stand that is
    nearest to one end; none where it cannot."""
    vehicle, size = searcher.vehicle, float(lengths(line)[-1])
    corners = vehicle.footprint()[:, 0]
    reach = (corners.max() if is_last else -corners.min()) + vehicle.clearance_m
    shift = np.arange(0.0, min(max(reach + _STEP_M, _LEFT_OUT * size), 0.4 * size), _STEP_M)
    at = size - shift if is_last else shift
    found = {}
    for aside in beside:
        free = np.flatnonzero(searcher.is_free(_poses(line, at, aside)))
        if len(free):
            found[aside] = float(at[free[0]])
    return found


def _poses(line: Float64, at_m: Float64, aside_m: float) -> Float64:
    """Poses [n, 3] along a line, some way to its left."""
    s = lengths(line)
    unit = np.diff(line, axis=0)
    yaw = np.arctan2(unit[:, 1], unit[:, 0])[
        np.clip(np.searchsorted(s, at_m) - 1, 0, len(line) - 2)
    ]
    x, y = (np.interp(at_m, s, line[:, k]) for k in (0, 1))
    return np.column_stack([x - aside_m * np.sin(yaw), y + aside_m * np.cos(yaw), yaw])


def followed(searcher: Searcher, line: Float64) -> Float64:
    """A free way along a line, metres from the window's corner: straight where it has two points,
    else short arcs that aim at a point of the line ahead (pure pursuit); no rows when that does not
    lead to its end, or is not free."""
    samples = _pursued(searcher, line)
    if not len(samples):
        return samples
    # A corner moves aside by this between two poses.
    turn = float(np.abs(samples[:, 4]).max()) * searcher.shape.step_m
    enough = searcher.vehicle.clearance_m + BULGE_M + turn * searcher.vehicle.reach_m
    is_free = (searcher.gaps_m(samples[:, :3], enough) >= enough).all()
    return samples if is_free else samples[:0]


def _pursued(searcher: Searcher, line: Float64) -> Float64:
    size, step = float(lengths(line)[-1]), searcher.shape.step_m
    out = line[1] - line[0]
    x, y, yaw = float(line[0, 0]), float(line[0, 1]), math.atan2(out[1], out[0])
    if len(line) == 2:
        d = np.linspace(0.0, size, max(2, math.ceil(size / step) + 1))
        same = np.ones(len(d))
        rows = (x + d * math.cos(yaw), y + d * math.sin(yaw), yaw * same, same, 0.0 * same)
        return np.column_stack(rows)
    radius = searcher.vehicle.turning_radius_m
    ahead_m = max(1.5, radius)
    longer = extended(line, 0.0, 2.0 * ahead_m)
    s, poses = lengths(longer), []
    for _ in range(2 * math.ceil(size / step)):
        along = float(project(np.array([[x, y]]), longer)[0][0])
        aim_x, aim_y = (float(np.interp(along + ahead_m, s, longer[:, k])) for k in (0, 1))
        left = (aim_y - y) * math.cos(yaw) - (aim_x - x) * math.sin(yaw)
        apart = (aim_x - x) ** 2 + (aim_y - y) ** 2
        curvature = min(max(2.0 * left / apart, -1.0 / radius), 1.0 / radius)
        curvature = curvature if abs(curvature) > 1e-6 else 0.0
        poses.append((x, y, yaw, 1.0, curvature))
        if along >= size - 0.5 * step:
            return np.array(poses)
        turned = yaw + curvature * step
        if curvature:
            x += (math.sin(turned) - math.sin(yaw)) / curvature
            y += (math.cos(yaw) - math.cos(turned)) / curvature
        else:
            x, y = x + step * math.cos(yaw), y + step * math.sin(yaw)
        yaw = turned
    return np.zeros((0, 5))


def _around(
    searcher: Searcher,
    lane: Lane,
    line: Float64,
    first: tuple[float, float],
    last: tuple[float, float],
) -> Pass:
    """A way that the search finds between the sides of a lane; `first` and `last` are its ends: the
    distances to the left of the lane's line, and along it."""
    ground, vehicle = searcher.ground, searcher.vehicle
    corner = np.array([ground.west_m, ground.south_m])
    beyond_m = vehicle.reach_m + vehicle.clearance_m + 1.0
    strip = shapely.LineString(extended(line, beyond_m, beyond_m) + corner)
    half_m = 0.5 * lane.area.area / lane.length_m
    area = lane.area.union(strip.buffer(half_m, cap_style="flat", join_style="mitre"))
    inside = Searcher(ground.confined(area), vehicle)
    shift = np.array([inside.ground.west_m, inside.ground.south_m]) - corner
    start, stop = (
        SearchPose(*(_poses(line, np.array([at_m]), aside)[0] - (*shift, 0.0)).tolist())
        for aside, at_m in (first, last)
    )
    samples = find_way(inside, [start], [stop], "along the lane", _MAX_POSES)
    samples[:, :2] += shift
    return Pass(samples, first[1], last[1])
