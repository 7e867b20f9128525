"""Routes as programs that drive take them: a mission of QGroundControl, a route graph of Nav2.

Both have straight lines between points: the vertices of each stretch, of which the route is nowhere
farther than `TOLERANCE_M`.
"""

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


def route_graph(route: Route) -> dict[str, Any]:
    """A graph for the route server of Nav2, in metres of the frame `map`: a node a vertex, and an
    edge in the direction of driving from each to the next, which costs its length."""
    points = [_vertices(route, poses) for poses, _, _ in stretches(route)]
    nodes: list[dict[str, Any]] = []
    edges: list[dict[str, Any]] = []
    # Ids of nodes and of edges are told apart by no reader.
    first_edge = sum(len(one) for one in points)
    for (poses, gear, lane), places in zip(stretches(route), points, strict=True):
        clearance = round(float(route.clearance_m[poses].min()), 3)
        about: dict[str, Any] = {"gear": gear, "clearance_m": clearance}
        about |= {"lane": lane} if lane else {}
        for place in places.round(4).tolist():
            if nodes and nodes[-1]["geometry"]["coordinates"] == place:
                continue
            nodes.append(_feature("Point", place, {"id": len(nodes), "frame": "map"}))
            if len(nodes) == 1:
                continue
            ends = [node["geometry"]["coordinates"] for node in nodes[-2:]]
            ids = {
                "id": first_edge + len(edges),
                "startid": len(nodes) - 2,
                "endid": len(nodes) - 1,
            }
            costs = {"cost": round(math.dist(*ends), 4), "overridable": True, "metadata": about}
            edges.append(_feature("LineString", ends, ids | costs))
    datum = route.datum
    return {
        "type": "FeatureCollection",
        "name": "fieldgrid route graph",
        "datum": {
            "lat_deg": datum.lat_deg, "lon_deg": datum.lon_deg, "height_m": datum.height_m,
        },
        "features": [*nodes, *edges],
    }  # fmt: skip


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": kind, "coordinates": coordinates},
    }
