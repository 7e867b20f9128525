"""Files of routes, read back by what did not write them."""

from __future__ import annotations

import csv
import json
import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from benchmarks.planting import DATUM
from fieldgrid.core import ConfigError, Float64, MapExistsError
from fieldgrid.export.figures import read_route
from fieldgrid.field import Route, Vehicle, write_route
from fieldgrid.field.route.output import COLUMNS
from fieldgrid.field.route.plan import route_in_view
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import MapView


@pytest.fixture(scope="module")
def route() -> Route:
    """With a change of gear, and longer to the east than to the north."""
    density = np.zeros((30, 60), dtype=np.uint8)
    view = MapView(Lattice(0.2), Window(0, 0, 60, 30), density, density == 0, DATUM, is_base=True)
    vehicle = Vehicle(0.8, 0.4, 0.6, turning_radius_m=1.5, clearance_m=0.1)
    found = route_in_view(view, (2.0, 2.0, 90.0), (9.0, 3.0, -80.0), vehicle)
    assert found.cusps > 0
    return found


def test_the_table_has_every_pose(route: Route, tmp_path: Path) -> None:
    write_route(route, tmp_path / "route.csv")
    with (tmp_path / "route.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert ",".join(COLUMNS) == ("east_m,north_m,heading_deg,gear,curvature_1pm,clearance_m,lane")
    for name in COLUMNS[:-1]:
        values = np.array([float(row[name]) for row in rows])
        assert np.allclose(values, getattr(route, name), atol=6e-4), name
    assert (rows[0]["east_m"], rows[0]["heading_deg"]) == ("2.000000", "90.000000")
    assert {row["lane"] for row in rows} == {""}


def test_lanes_are_columns_and_lines(route: Route, tmp_path: Path) -> None:
    """A lane ends where the next stretch begins."""
    names = np.full(len(route.lane), "", dtype="U5")
    names[10:30] = "B1-L2"
    assert set(np.diff(route.gear[:31]).tolist()) == {0}
    worked = replace(route, lane=names)
    write_route(worked, tmp_path / "route.csv")
    with (tmp_path / "route.csv").open(newline="") as file:
        assert [row["lane"] for row in csv.DictReader(file)] == names.tolist()
    write_route(worked, tmp_path / "route.geojson")
    features = json.loads((tmp_path / "route.geojson").read_text())["features"]
    assert [f["properties"]["lane"] for f in features[:3]] == [None, "B1-L2", None]
    ends = [f["geometry"]["coordinates"] for f in features]
    assert ends[0][-1] == ends[1][0]
    assert ends[1][-1] == ends[2][0]
    assert len(ends[1]) == 21
    length = sum(f["properties"]["length_m"] for f in features)
    assert length == pytest.approx(route.length_m, abs=1e-3)


def test_lines_are_in_degrees_and_by_gear(route: Route, tmp_path: Path) -> None:
    write_route(route, tmp_path / "route.geojson")
    features = json.loads((tmp_path / "route.geojson").read_text())["features"]
    assert len(features) == route.cusps + 1
    assert {f["properties"]["kind"] for f in features} == {"route"}
    assert [f["properties"]["gear"] for f in features[:2]] in ([1, -1], [-1, 1])
    places = np.array([point for f in features for point in f["geometry"]["coordinates"]])
    east, north, _ = DATUM.to_enu(places[:, 1], places[:, 0], DATUM.height_m)
    assert np.allclose(east, route.east_m, atol=1e-3)
    assert np.allclose(north, route.north_m, atol=1e-3)
    length = sum(f["properties"]["length_m"] for f in features)
    assert length == pytest.approx(route.length_m, abs=1e-3)


def test_tracks_are_in_degrees_and_by_gear(route: Route, tmp_path: Path) -> None:
    write_route(route, tmp_path / "route.gpx")
    root = ElementTree.parse(tmp_path / "route.gpx").getroot()
    space = {"g": "http://www.topografix.com/GPX/1/1"}
    assert len(root.findall(".//g:trkseg", space)) == route.cusps + 1
    points = root.findall(".//g:trkpt", space)
    lat = np.array([float(point.attrib["lat"]) for point in points])
    lon = np.array([float(point.attrib["lon"]) for point in points])
    east, north, _ = DATUM.to_enu(lat, lon, DATUM.height_m)
    assert np.allclose(
        np.column_stack([east, north]), np.column_stack([route.east_m, route.north_m]), atol=1e-3
    )


def test_the_path_has_the_nose_of_the_vehicle(route: Route, tmp_path: Path) -> None:
    write_route(route, tmp_path / "route.mcap")
    with AnyReader(
        [tmp_path / "route.mcap"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)
    ) as reader:
        found = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    path = found["/route"]
    assert path.header.frame_id == "map"
    east = [p.pose.position.x for p in path.poses]
    north = [p.pose.position.y for p in path.poses]
    assert np.allclose(east, route.east_m)
    assert np.allclose(north, route.north_m)
    yaw = [2.0 * math.atan2(p.pose.orientation.z, p.pose.orientation.w) for p in path.poses]
    assert np.allclose(np.cos(yaw), np.sin(np.radians(route.heading_deg)), atol=1e-9)
    assert np.allclose(np.sin(yaw), np.cos(np.radians(route.heading_deg)), atol=1e-9)
    assert found["/datum"].latitude == DATUM.lat_deg


def assert_along(places: Float64, route: Route) -> None:
    """Points of the route itself, in the order of driving, and straight lines between them."""
    line = np.column_stack([route.east_m, route.north_m])
    at = [int(np.hypot(*(line - place).T).argmin()) for place in places]
    apart = np.hypot(*(line[at] - places).T)
    assert apart.max() < 0.01
    assert at == sorted(at)
    drawn = shapely.LineString(places)
    assert shapely.distance(drawn, shapely.points(line)).max() < 0.025
    assert math.dist(places[0], line[0]) < 0.01
    assert math.dist(places[-1], line[-1]) < 0.01


def test_a_plan_of_waypoints_and_gears(route: Route, tmp_path: Path) -> None:
    """Read as the plan format of QGroundControl is documented: x and y are latitude and longitude,
    and command 194 says whether what follows is driven backwards."""
    write_route(route, tmp_path / "route.plan")
    plan = json.loads((tmp_path / "route.plan").read_text())
    assert (plan["fileType"], plan["version"]) == ("Plan", 1)
    assert isinstance(plan["groundStation"], str)
    mission = plan["mission"]
    assert (mission["version"], mission["firmwareType"], mission["vehicleType"]) == (2, 3, 10)
    items = mission["items"]
    assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
    assert {(item["command"], item["frame"]) for item in items} == {(16, 3), (194, 2)}
    assert all(len(item["params"]) == 7 and item["type"] == "SimpleItem" for item in items)
    assert items[0]["command"] == 16
    assert mission["plannedHomePosition"][:2] == items[0]["params"][4:6]
    gear, gears, degrees = 1, [], []
    for item in items:
        if item["command"] == 194:
            gear = -1 if item["params"][0] else 1
        else:
            gears.append(gear)
            degrees.append(item["params"][4:6])
    lat, lon = np.array(degrees).T
    east, north, _ = DATUM.to_enu(lat, lon, DATUM.height_m)
    places = np.column_stack([east, north])
    assert_along(places, route)
    # Every waypoint is driven to in the gear that leads there.
    line = np.column_stack([route.east_m, route.north_m])
    for place, driven in list(zip(places, gears, strict=True))[1:]:
        assert route.gear[int(np.hypot(*(line - place).T).argmin()) - 1] == driven
    assert np.count_nonzero(np.diff(gears)) == route.cusps


@pytest.mark.parametrize("suffix", [".csv", ".geojson", ".gpx", ".mcap", ".kml", ".plan"])
def test_only_routes_are_overwritten(route: Route, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"route{suffix}"
    write_route(route, path)
    with pytest.raises(MapExistsError, match="--overwrite"):
        write_route(route, path)
    write_route(route, path, overwrite=True)
    path.write_text("my own notes")
    with pytest.raises(MapExistsError, match="another name"):
        write_route(route, path, overwrite=True)
    assert path.read_text() == "my own notes"


def test_another_ending_is_refused(route: Route, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"route\.xyz ends in none of \.geojson"):
        write_route(route, tmp_path / "route.xyz")
    with pytest.raises(ConfigError, match=r"--swaths write it"):
        write_route(route, tmp_path / "route.graph.geojson")


def test_figures_read_both_forms(route: Route, tmp_path: Path) -> None:
    for name in ("route.csv", "route.geojson"):
        write_route(route, tmp_path / name)
        places = read_route(tmp_path / name, DATUM)
        places = places[np.isfinite(places[:, 0])]
        assert np.allclose(places, np.column_stack([route.east_m, route.north_m]), atol=1e-3)


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "east_m,north_m\n1,2\n", "east_m,north_m\n1,x\n2,3\n",
             "east_m,north_m\n1,nan\n2,3\n", "east_m,north_m\n1\n2,3\n"]
)  # fmt: skip
def test_a_table_that_is_no_route(tmp_path: Path, text: str) -> None:
    file = tmp_path / "route.csv"
    file.write_text(text)
    with pytest.raises(ConfigError, match="is no table of poses"):
        read_route(file, DATUM)
