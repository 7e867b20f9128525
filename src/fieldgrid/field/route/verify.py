"""The check that every route passes before it is given out; it shares nothing with the planner.

The planner looks steps up in a distance field and holds hulls that were made once against cells.
Here what the footprint sweeps is built as polygons from each pose to the next, and measured against
the squares of the blocked cells; curvature and gear are read back from positions and headings, and
slopes along and across the way are looked up by SciPy.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import shapely
from scipy import ndimage

from fieldgrid.core import Bool
from fieldgrid.field.route.ground import Ground
from fieldgrid.field.route.path import Path
from fieldgrid.field.route.vehicle import Vehicle
from fieldgrid.geometry import yaw_from_heading_rad

MAX_STEP_M = 0.2
"""Poses that are farther apart leave open how the vehicle gets from one to the next."""

_CHUNK = 40
"""Poses that are held against cells at a time."""

_RELATIVE = 1e-3
_ABSOLUTE = 1e-7
_ROUNDING_M = 1e-6
_ROUNDING_DEG = 1e-3


class Fault(NamedTuple):
    """What is wrong with a way, in words, and where (metres east and north)."""

    reason: str
    east_m: float
    north_m: float


def find_fault(path: Path, ground: Ground, vehicle: Vehicle) -> Fault | None:
    """The first fault of a way, None when the vehicle can drive it and keeps its clearance."""
    return (
        _kinematic_fault(path, vehicle)
        or _swept_fault(path, ground, vehicle)
        or slope_fault(path, ground, vehicle)
    )


def _kinematic_fault(path: Path, vehicle: Vehicle) -> Fault | None:
    """Steps, gears and curvature, from positions and headings alone."""
    yaw = yaw_from_heading_rad(path.heading_deg)
    east, north = np.diff(path.east_m), np.diff(path.north_m)
    chord = np.hypot(east, north)
    turn = np.angle(np.exp(1j * np.diff(yaw)))
    middle = yaw[:-1] + 0.5 * turn
    along = east * np.cos(middle) + north * np.sin(middle)
    aside = np.abs(north * np.cos(middle) - east * np.sin(middle))
    gear, curvature = path.gear, path.curvature_1pm
    rests = chord < _ABSOLUTE
    # Of an arc that turns by t, whose chord is c: 2 sin(t / 2) / c, with the sign of the motion.
    driven = 2.0 * np.sin(0.5 * turn)
    slack = _RELATIVE * vehicle.curvature_1pm * chord + _ABSOLUTE
    signed = np.where(gear[:-1] < 0, -chord, chord)
    checks: tuple[tuple[str, Bool], ...] = (
        ("the way has a hole", chord > MAX_STEP_M),
        ("a pose has no gear", ~np.isin(gear, (-1, 1))),
        ("the way reverses", (gear < 0) & (not vehicle.reverse)),
        ("the way moves against its gear", ~rests & (along * gear[:-1] <= 0.0)),
        ("the gear changes while moving", (np.diff(gear) != 0) & ~rests),
        ("the way moves sideways", aside > _RELATIVE * chord + _ABSOLUTE),
        ("the way turns on the spot", rests & (np.abs(turn) > _RELATIVE)),
        (
            "the way turns sharper than the vehicle can",
            np.abs(driven) > vehicle.curvature_1pm * chord + slack,
        ),
        ("the curvature is another", ~rests & (np.abs(driven - curvature[:-1] * signed) > slack)),
    )
    for reason, wrong in checks:
        if wrong.any():
            k = int(np.argmax(wrong))
            return Fault(reason, float(path.east_m[k]), float(path.north_m[k]))
    return None


def _swept_fault(path: Path, ground: Ground, vehicle: Vehicle) -> Fault | None:
    """A blocked cell within the clearance of what the footprint sweeps, or ground beyond the
    window."""
    hulls, bulge_m = swept_hulls(path, vehicle)
    west, south, east, north = ground.bounds_m
    box = shapely.bounds(hulls)
    beyond = (box[:, :2] < (west, south)).any(axis=1) | (box[:, 2:] > (east, north)).any(axis=1)
    if beyond.any():
        k = int(np.argmax(beyond))
        return Fault("the way leaves the map", float(path.east_m[k]), float(path.north_m[k]))
    for k in range(0, len(hulls), _CHUNK):
        near, distance_m = hulls[k : k + _CHUNK], vehicle.clearance_m + bulge_m
        low, high = box[k : k + _CHUNK, :2].min(axis=0), box[k : k + _CHUNK, 2:].max(axis=0)
        boxes = ground.blocked_boxes(*(low - distance_m), *(high + distance_m))
        # A hair smaller, since a vehicle may stand beside a cell.
        squares = shapely.box(*(boxes + np.array([1.0, 1.0, -1.0, -1.0]) * _ROUNDING_M).T)
        _, hit = shapely.STRtree(squares).query(near, "dwithin", distance_m)
        if len(hit):
            place = boxes[hit[0]].reshape(2, 2).mean(axis=0).tolist()
            return Fault(f"the vehicle comes too near to {ground.what_is_at(*place)}", *place)
    return None


def slope_fault(path: Path, ground: Ground, vehicle: Vehicle) -> Fault | None:
    """The steepest place along the way, or across it, that is beyond the vehicle's limit."""
    if not ground.rises.size:
        return None
    sin, cos = np.sin(np.radians(path.heading_deg)), np.cos(np.radians(path.heading_deg))
    middle_e, middle_n = path.east_m + vehicle.middle_m * sin, path.north_m + vehicle.middle_m * cos
    cells = np.stack([middle_n - ground.south_m, middle_e - ground.west_m]) / ground.cell_m - 0.5
    to_east, to_north = (
        ndimage.map_coordinates(ground.rises[..., k], cells, order=1, output=np.float64)
        for k in (0, 1)
    )
    for which, rise, most_deg in (
        ("along", to_east * sin + to_north * cos, vehicle.slope_along_deg),
        ("across", to_east * cos - to_north * sin, vehicle.slope_across_deg),
    ):
        slope_deg = np.degrees(np.arctan(np.abs(rise)))
        k = int(np.argmax(slope_deg))
        if slope_deg[k] > most_deg + _ROUNDING_DEG:
            return Fault(
                f"a slope of {slope_deg[k]:.1f}° {which} the way is over the vehicle's "
                f"{most_deg:g}°",
                float(path.east_m[k]), float(path.north_m[k]),
            )  # fmt: skip
    return None


def swept_hulls(path: Path, vehicle: Vehicle) -> tuple[npt.NDArray[Any], float]:
    """What the footprint covers from each pose to the next, polygons [n - 1] or that of the only
    pose, and how far a corner on its arc may be beyond them, metres."""
    corners = vehicle.footprint()
    yaw = yaw_from_heading_rad(path.heading_deg)
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x = path.east_m[:, None] + corners[:, 0] * cos - corners[:, 1] * sin
    y = path.north_m[:, None] + corners[:, 0] * sin + corners[:, 1] * cos
    if len(x) == 1:
        return shapely.polygons(np.stack([x, y], axis=2)), 0.0
    both = np.stack([np.hstack([x[:-1], x[1:]]), np.hstack([y[:-1], y[1:]])], axis=2)
    # The height of an arc above its chord is an eighth of the chord times the turn.
    chord = np.hypot(np.diff(x, axis=0), np.diff(y, axis=0)).max(axis=1)
    bulge = 0.125 * chord * np.abs(np.angle(np.exp(1j * np.diff(yaw))))
    return shapely.convex_hull(shapely.multipoints(both)), float(bulge.max())
