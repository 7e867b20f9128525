"""Routes as missions of QGroundControl, whose lines between waypoints are straight: the route is
nowhere farther from them than `TOLERANCE_M`."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import shapely

from fieldgrid.core import Float64
from fieldgrid.field.route.plan import Route

TOLERANCE_M = 0.02
_WAYPOINT, _SET_REVERSE = 16, 194
_RELATIVE_ALTITUDE, _MISSION = 3, 2
_ARDUPILOT, _ROVER = 3, 10


def stretches(route: Route) -> list[tuple[slice, int, str]]:
    """The stretches of a route in one gear and one lane: their poses by number, to the first one of
    the next where the gear stays, the gear and the lane."""
    turns = np.diff(route.gear) != 0
    ends = [0, *(np.flatnonzero(turns | (route.lane[:-1] != route.lane[1:])) + 1).tolist()]
    slices = [slice(a, b + int(not turns[b - 1])) for a, b in itertools.pairwise(ends)]
    slices.append(slice(ends[-1], len(route.gear)))
    return [(s, int(route.gear[s.start]), str(route.lane[s.start])) for s in slices]


def _vertices(route: Route, poses: slice) -> Float64:
    """Points [n, 2] between which straight lines are near enough to some poses of a route."""
    line = shapely.LineString(np.column_stack([route.east_m[poses], route.north_m[poses]]))
    return np.asarray(shapely.get_coordinates(line.simplify(TOLERANCE_M)))


def mission(route: Route) -> dict[str, Any]:
    """A plan of QGroundControl (version 1) for a rover of ArduPilot: waypoints in longitude and
    latitude, and MAV_CMD_DO_SET_REVERSE before each stretch in another gear."""
    items: list[dict[str, Any]] = []

    def add(command: int, frame: int, params: list[float | None], **more: Any) -> None:
        items.append(
            {
                "type": "SimpleItem", "command": command, "frame": frame, "params": params,
                "doJumpId": len(items) + 1, "autoContinue": True, **more,
            }
        )  # fmt: skip

    gear, last = 1, (math.nan, math.nan)
    for poses, of_stretch, _ in stretches(route):
        if of_stretch != gear:
            gear = of_stretch
            add(_SET_REVERSE, _MISSION, [float(gear < 0), 0, 0, 0, 0, 0, 0])
        points = _vertices(route, poses)
        lat, lon, _ = route.datum.to_geodetic(points[:, 0], points[:, 1], np.zeros(len(points)))
        for place in zip(lat.round(9).tolist(), lon.round(9).tolist(), strict=True):
            if place != last:
                add(
                    _WAYPOINT, _RELATIVE_ALTITUDE, [0, 0, 0, None, *place, 0],
                    AltitudeMode=1, Altitude=0, AMSLAltAboveTerrain=None,
                )  # fmt: skip
            last = place
    first = next(item["params"][4:6] for item in items if item["command"] == _WAYPOINT)
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "fieldgrid",
        "mission": {
            "version": 2, "firmwareType": _ARDUPILOT, "vehicleType": _ROVER,
            "globalPlanAltitudeMode": 1, "cruiseSpeed": 1, "hoverSpeed": 1,
            "plannedHomePosition": [*first, 0], "items": items,
        },
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }  # fmt: skip
