"""Maps of Lanelet2, read by the library itself and by the letters of its XML."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import shapely
from lxml import etree

from benchmarks.planting import DATUM
from fieldgrid.core import ConfigError, Float64, MapExistsError
from fieldgrid.field import Planting, network_of, write_planting
from fieldgrid.field.rows.result import Row
from tests.field.coverage.test_plan import straight_lane
from tests.field.rows.test_network import two_blocks

LEFT_HALF, RIGHT_HALF = 0.2, 0.5


def row(name: str, line: shapely.LineString, half_m: float) -> Row:
    return Row(name, "B1", line, line.length, 0.02, 2.0, half_m, 2.0, 1.0, 9, (), 0.0)


@pytest.fixture(scope="module")
def planting() -> Planting:
    """A lane to the north-east and one that bends to its right; the rows are not equally wide."""
    bent = shapely.LineString([(40.0, 0.0), (40.0, 10.0), (42.0, 20.0)])
    lanes = (
        straight_lane("B1-L1", (3.0, -20.0), (15.0, -4.0)),
        straight_lane("B1-L2", (40.0, 0.0), (42.0, 20.0))._replace(
            line=bent, length_m=bent.length, area=bent.buffer(1.0, cap_style="flat")
        ),
    )
    rows = tuple(
        row(lane.rows[side], shapely.offset_curve(lane.line, away), half)
        for lane in lanes
        for side, (away, half) in enumerate(((1.0, LEFT_HALF), (-1.0, RIGHT_HALF)))
    )
    view = shapely.box(0.0, 0.0, 1.0, 1.0).bounds
    return Planting(DATUM, view, 0.2, rows, lanes, (), (), (), ())  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def osm(planting: Planting, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("lanelet2") / "lanes.osm"
    write_planting(planting, out, speed_limit_kmh=5.0)
    return out


def by_the_letters(path: Path) -> dict[str, dict[str, Float64]]:
    """Bounds by the name of the lane and their role, metres by PROJ; the local tags must agree."""
    root = etree.parse(path).getroot()
    places = {}
    for node in root.findall("node"):
        tags = {tag.get("k"): float(tag.get("v")) for tag in node.findall("tag")}
        place = DATUM.to_enu(float(node.get("lat")), float(node.get("lon")), tags["ele"])
        assert np.abs(np.array(place) - (tags["local_x"], tags["local_y"], 0.0)).max() < 0.001
        places[node.get("id")] = [float(v) for v in place[:2]]
    ways = {
        way.get("id"): np.array([places[nd.get("ref")] for nd in way.findall("nd")])
        for way in root.findall("way")
    }
    found = {}
    for relation in root.findall("relation"):
        tags = {tag.get("k"): tag.get("v") for tag in relation.findall("tag")}
        assert (tags["type"], tags["subtype"], tags["one_way"]) == ("lanelet", "road", "no")
        assert tags["speed_limit"] == "5 km/h"
        found[tags["name"]] = {
            member.get("role"): ways[member.get("ref")] for member in relation.findall("member")
        }
    assert len({e.get("id") for e in root}) == len(root)
    return found


def check(planting: Planting, found: dict[str, dict[str, Float64]]) -> None:
    """Each bound at the face of its own row, to 1 cm, on its own side and the right way round."""
    assert set(found) == {strip.id for strip in network_of(planting).strips}
    for lane in planting.lanes:
        start, ahead = np.array(lane.line.coords[0]), np.array(lane.line.coords[1])
        unit = (ahead - start) / np.hypot(*(ahead - start))
        left = np.array([-unit[1], unit[0]])
        for role, side, face in (("left", 1.0, LEFT_HALF), ("right", -1.0, RIGHT_HALF)):
            bound = found[lane.id][role]
            assert np.allclose(bound[0], start + side * (1.0 - face) * left, atol=0.01)
            assert (bound[-1] - bound[0]) @ unit > 0.0
            away = shapely.distance(lane.line, shapely.points(bound))
            assert (away >= 1.0 - face - 0.01).all()


def test_the_letters_of_the_file(planting: Planting, osm: Path) -> None:
    check(planting, by_the_letters(osm))


@pytest.fixture(scope="module")
def lanelet2() -> ModuleType:
    return pytest.importorskip("lanelet2", reason="its wheels are for Linux and Python <= 3.12")


def test_lanelet2_reads_the_same(planting: Planting, osm: Path, lanelet2: Any) -> None:
    from lanelet2.core import GPSPoint
    from lanelet2.io import Origin, loadRobust
    from lanelet2.projection import LocalCartesianProjector

    origin = Origin(GPSPoint(DATUM.lat_deg, DATUM.lon_deg, DATUM.height_m))
    found, problems = loadRobust(str(osm), LocalCartesianProjector(origin))
    assert list(problems) == []
    bounds = {}
    for lanelet in found.laneletLayer:
        assert lanelet.attributes["subtype"] == "road"
        sides = {"left": lanelet.leftBound, "right": lanelet.rightBound}
        bounds[lanelet.attributes["name"]] = {
            role: np.array([(point.x, point.y) for point in line]) for role, line in sides.items()
        }
        assert max(abs(point.z) for line in sides.values() for point in line) < 0.01
        # Both ways.
        rules = lanelet2.traffic_rules.create(
            lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
        )
        assert not rules.isOneWay(lanelet)
        assert rules.speedLimit(lanelet).speedLimit == pytest.approx(5.0)
    check(planting, bounds)


def test_lanelet2_routes_from_any_lane_to_any_other(tmp_path: Path, lanelet2: Any) -> None:
    """By its own routing graph, and out of both ends of each."""
    from lanelet2.core import GPSPoint
    from lanelet2.io import Origin, loadRobust
    from lanelet2.projection import LocalCartesianProjector

    planting = two_blocks()
    write_planting(planting, tmp_path / "lanes.osm")
    origin = Origin(GPSPoint(DATUM.lat_deg, DATUM.lon_deg, DATUM.height_m))
    found, problems = loadRobust(str(tmp_path / "lanes.osm"), LocalCartesianProjector(origin))
    assert list(problems) == []
    rules = lanelet2.traffic_rules.create(
        lanelet2.traffic_rules.Locations.Germany, lanelet2.traffic_rules.Participants.Vehicle
    )
    graph = lanelet2.routing.RoutingGraph(found, rules)
    assert list(graph.checkValidity()) == []
    names = {lane.id for lane in planting.lanes}
    lanes = [one for one in found.laneletLayer if one.attributes["name"] in names]
    both = [[one, one.invert()] for one in lanes]
    assert len(lanes) == len(planting.lanes)
    for one, back in both:
        assert graph.following(one)
        assert graph.previous(one)
        assert graph.following(back)
        assert graph.previous(back)
    for a, b in itertools.permutations(both, 2):
        ways = [graph.getRoute(start, stop) for start in a for stop in b]
        assert any(way is not None for way in ways)


def test_what_cannot_be_written(planting: Planting, osm: Path, tmp_path: Path) -> None:
    bare = Planting(DATUM, planting.bounds, 0.2, (), (), (), (), (), ())
    with pytest.raises(ConfigError, match="needs lanes"):
        write_planting(bare, tmp_path / "none.osm")
    with pytest.raises(ConfigError, match="speed limit is for networks"):
        write_planting(planting, tmp_path / "lanes.kml", speed_limit_kmh=5.0)
    with pytest.raises(MapExistsError):
        write_planting(planting, osm)
    write_planting(planting, osm, speed_limit_kmh=5.0, overwrite=True)
