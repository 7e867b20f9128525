"""Lanes as a map of Lanelet2: XML of OpenStreetMap, a lanelet a lane.

Nodes have degrees and the height above the ellipsoid, and `local_x`, `local_y` in metres of the
datum's plane. That plane is the one of Lanelet2's LocalCartesianProjector at the datum.
"""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ElementTree
from functools import partial
from pathlib import Path

import numpy as np
import shapely

from fieldgrid.core import ConfigError, mentions, replacing
from fieldgrid.field.rows.result import Planting

_GENERATOR = "fieldgrid"
_TOLERANCE_M = 0.005
_LEAST_HALF_M = 0.05


def write_lanelet2(
    planting: Planting, path: Path, *, speed_limit_kmh: float | None = None, overwrite: bool = False
) -> None:
    """Write a lanelet for each lane, whose bounds are the faces of the rows beside it, or the sides
    of the swath of a track; both ways may be driven.

    Raises ConfigError without lanes, MapExistsError for a file that may not be overwritten,
    MapWriteError where it cannot be written.
    """
    if not planting.lanes:
        raise ConfigError("A map of Lanelet2 needs lanes, and none was found; see --crop.")
    root = ElementTree.Element("osm", version="0.6", generator=_GENERATOR)
    ways: list[ElementTree.Element] = []
    relations: list[ElementTree.Element] = []
    ids = itertools.count(1)
    kind = {"type": "road_border"} if planting.rows else {"type": "virtual"}
    faces = {row.id: row.half_width_m for row in planting.rows}
    for lane in planting.lanes:
        bounds = {}
        half_m = 0.5 * lane.area.area / lane.length_m
        found = []
        for side, row in zip((1.0, -1.0), lane.rows, strict=True):
            away = max(half_m - faces.get(row, 0.0), _LEAST_HALF_M)
            beside = shapely.offset_curve(lane.line, side * away, join_style="mitre")
            longest = max(shapely.get_parts(beside), key=lambda part: part.length)
            found.append(longest.simplify(_TOLERANCE_M))
        for role, line in zip(("left", "right"), found, strict=True):
            nodes = _add_nodes(root, planting, line, ids)
            way = _element("way", next(ids), kind)
            for place, node in enumerate(nodes):
                way.insert(place, ElementTree.Element("nd", ref=node))
            ways.append(way)
            bounds[role] = way.attrib["id"]
        tags = {
            "type": "lanelet", "subtype": "road", "location": "nonurban", "one_way": "no",
            "name": lane.id,
        }  # fmt: skip
        if speed_limit_kmh is not None:
            tags["speed_limit"] = f"{speed_limit_kmh:g} km/h"
        relation = _element("relation", next(ids), tags)
        for place, (role, way_id) in enumerate(bounds.items()):
            relation.insert(place, ElementTree.Element("member", type="way", ref=way_id, role=role))
        relations.append(relation)
    root.extend([*ways, *relations])
    ElementTree.indent(root)
    ours = partial(mentions, mark=b'generator="fieldgrid"')
    with replacing(path, overwrite=overwrite, ours=ours, what="a map of Lanelet2") as draft:
        ElementTree.ElementTree(root).write(draft, encoding="utf-8", xml_declaration=True)


def _add_nodes(
    root: ElementTree.Element,
    planting: Planting,
    line: shapely.LineString,
    ids: itertools.count[int],
) -> list[str]:
    """Add the points of a line as nodes; their ids."""
    places = shapely.get_coordinates(line)
    degrees = planting.datum.to_geodetic(places[:, 0], places[:, 1], np.zeros(len(places)))
    found = []
    for (east, north), lat, lon, height in zip(
        places.tolist(), *(v.tolist() for v in degrees), strict=True
    ):
        tags = {"ele": f"{height:.4f}", "local_x": f"{east:.4f}", "local_y": f"{north:.4f}"}
        node = _element("node", next(ids), tags)
        node.set("lat", f"{lat:.11f}")
        node.set("lon", f"{lon:.11f}")
        root.append(node)
        found.append(node.attrib["id"])
    return found


def _element(kind: str, number: int, tags: dict[str, str]) -> ElementTree.Element:
    element = ElementTree.Element(kind, id=str(number), version="1", visible="true")
    for key, value in tags.items():
        ElementTree.SubElement(element, "tag", k=key, v=value)
    return element
