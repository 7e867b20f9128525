"""A network as a map of Lanelet2: XML of OpenStreetMap, a lanelet a strip.

Nodes have degrees and the height above the ellipsoid, and `local_x`, `local_y` in metres of the
datum's plane. That plane is the one of Lanelet2's LocalCartesianProjector at the datum. Strips that
meet share the nodes at which their bounds end, by which Lanelet2 knows what follows what.
"""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from fieldgrid.core import ConfigError, Float64, mentions, replacing
from fieldgrid.field.rows.network import LaneNetwork

_GENERATOR = "fieldgrid"


def write_lanelet2(
    network: LaneNetwork,
    path: Path,
    *,
    speed_limit_kmh: float | None = None,
    overwrite: bool = False,
) -> None:
    """Write a lanelet for each strip, that may be driven both ways. The bounds of a lane are the
    faces of the rows beside it, or the sides of the swath of a track.

    Raises ConfigError without lanes, MapExistsError for a file that may not be overwritten,
    MapWriteError where it cannot be written.
    """
    if not network.strips:
        raise ConfigError("A map of Lanelet2 needs lanes, and none was found; see --crop.")
    root = ElementTree.Element("osm", version="0.6", generator=_GENERATOR)
    ways: list[ElementTree.Element] = []
    relations: list[ElementTree.Element] = []
    ids = itertools.count(1)
    datum = network.planting.datum

    def nodes(places: Float64) -> Iterator[str]:
        """Add points as nodes; their ids."""
        lat, lon, ele = datum.to_geodetic(places[:, 0], places[:, 1], np.zeros(len(places)))
        for place, *degrees, height in zip(
            places.tolist(), lat.tolist(), lon.tolist(), ele.tolist(), strict=True
        ):
            tags = {"ele": f"{height:.4f}"}
            tags |= {f"local_{axis}": f"{v:.4f}" for axis, v in zip("xy", place, strict=True)}
            node = _element("node", next(ids), tags)
            for name, value in zip(("lat", "lon"), degrees, strict=True):
                node.set(name, f"{value:.11f}")
            root.append(node)
            yield node.attrib["id"]

    shared = np.array(list(nodes(network.sides_m.reshape(-1, 2)))).reshape(-1, 2)
    for strip in network.strips:
        borders = strip.lane and network.planting.rows
        tags = {
            "type": "lanelet", "subtype": "road", "location": "nonurban", "one_way": "no",
            "name": strip.id,
        }  # fmt: skip
        if speed_limit_kmh is not None:
            tags["speed_limit"] = f"{speed_limit_kmh:g} km/h"
        relation = _element("relation", next(ids), tags)
        for place, (role, line) in enumerate((("left", strip.left), ("right", strip.right))):
            first, last = (
                shared[node, place ^ turned]
                for node, turned in zip(strip.ends, strip.turned, strict=True)
            )
            way = _element("way", next(ids), {"type": "road_border" if borders else "virtual"})
            inner = nodes(np.asarray(line.coords)[1:-1, :2])
            for k, ref in enumerate([first, *inner, last]):
                way.insert(k, ElementTree.Element("nd", ref=ref))
            ways.append(way)
            member = ElementTree.Element("member", type="way", ref=way.attrib["id"], role=role)
            relation.insert(place, member)
        relations.append(relation)
    root.extend([*ways, *relations])
    ElementTree.indent(root)
    ours = partial(mentions, mark=b'generator="fieldgrid"')
    with replacing(path, overwrite=overwrite, ours=ours, what="a map of Lanelet2") as draft:
        ElementTree.ElementTree(root).write(draft, encoding="utf-8", xml_declaration=True)


def _element(kind: str, number: int, tags: dict[str, str]) -> ElementTree.Element:
    element = ElementTree.Element(kind, id=str(number), version="1", visible="true")
    for key, value in tags.items():
        ElementTree.SubElement(element, "tag", k=key, v=value)
    return element
