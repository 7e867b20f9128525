"""Rows and routes anywhere on the Earth: where they lie, which way they lead, what is on the left.

Files are read by their letters, and places compared by PROJ's geodesics, which the writers do not
use.
"""

from __future__ import annotations

import dataclasses
import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import shapely
from pyproj import Geod
from shapely.geometry import LineString, Point, shape

from fieldgrid.field import Planting, Route, Vehicle, write_planting, write_route
from fieldgrid.field.route.plan import route_in_view
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import Datum
from tests.field.rows.fields import Array, straight, view_of

EARTH = Geod(ellps="WGS84")
HEADING_DEG = 37.0
PLACES = {
    "Melbourne": (-37.8, 145.0),
    "Santiago": (-33.4, -70.6),
    "Saskatoon": (52.1, -106.6),
    "equator and Greenwich": (0.00005, -0.00005),
    "Svalbard": (78.2, 15.6),
    "Taveuni, across the antimeridian": (-16.8, 179.99995),
}


class Worked(NamedTuple):
    """A field at a place: its rows and a route along its first lane."""

    datum: Datum
    planting: Planting
    route: Route


@pytest.fixture(scope="module", params=PLACES.values(), ids=PLACES)
def field(request: pytest.FixtureRequest) -> Worked:
    datum = Datum(*request.param, 0.0)
    rows = straight(3, 20.0, 3.0, HEADING_DEG, at=(2.0, -5.0))
    rows[2] = rows[2][:1] + 0.7 * (rows[2] - rows[2][:1])
    view = dataclasses.replace(view_of(rows, cell_m=0.1), datum=datum, is_base=True)
    planting = rows_of_view(view)
    assert len(planting.lanes) == 2
    start, stop = (planting.lanes[0].line.interpolate(at, normalized=True) for at in (0.2, 0.8))
    vehicle = Vehicle(0.8, 0.4, 0.6, turning_radius_m=1.5, clearance_m=0.1)
    goals = [(point.x, point.y, HEADING_DEG) for point in (start, stop)]
    return Worked(datum, planting, route_in_view(view, *goals, vehicle, allow_unknown=True))


def metres(datum: Datum, lon_deg: Array, lat_deg: Array) -> Array:
    """East and north of the datum [n, 2] by the geodesic to each place."""
    count = len(lon_deg)
    azimuth, _, distance = EARTH.inv(
        np.full(count, datum.lon_deg), np.full(count, datum.lat_deg), lon_deg, lat_deg
    )
    phi = np.radians(azimuth)
    return np.column_stack([distance * np.sin(phi), distance * np.cos(phi)])


def bearing_deg(degrees: Array) -> float:
    """From the first of some places (longitude, latitude) [n, 2] to the last."""
    return float(EARTH.inv(*degrees[0], *degrees[-1])[0])


def assert_leads_there(datum: Datum, degrees: Array, line: Array) -> None:
    """Through the points of the line, in their order; where it is cut there are more."""
    there = metres(datum, *degrees.T)
    way = LineString(there)
    assert max(way.distance(Point(*at)) for at in line) < 0.01
    assert np.abs(there[[0, -1]] - line[[0, -1]]).max() < 0.01
    assert way.length == pytest.approx(LineString(line).length, abs=0.02)
    assert bearing_deg(degrees) == pytest.approx(HEADING_DEG, abs=1.5)


def test_rows_and_lanes_of_geojson(field: Worked, tmp_path: Path) -> None:
    write_planting(field.planting, tmp_path / "rows.geojson")
    features = json.loads((tmp_path / "rows.geojson").read_text())["features"]
    lines = {
        f["properties"]["id"]: shapely.get_coordinates(shape(f["geometry"]))  # of all its parts
        for f in features
        if f["properties"]["kind"] in ("row", "lane")
    }
    for one in (*field.planting.rows, *field.planting.lanes):
        assert_leads_there(field.datum, lines[one.id], np.array(one.line.coords))
    for lane in field.planting.lanes:
        for name, side in zip(lane.rows, (-1.0, 1.0), strict=True):
            azimuth = bearing_deg(np.array([lines[lane.id][0], lines[name][len(lines[name]) // 2]]))
            turn = (azimuth - HEADING_DEG + 180.0) % 360.0 - 180.0
            assert side * turn > 0.0


def test_rows_of_kml(field: Worked, tmp_path: Path) -> None:
    write_planting(field.planting, tmp_path / "rows.kml")
    root = ElementTree.parse(tmp_path / "rows.kml").getroot()
    space = {"k": "http://www.opengis.net/kml/2.2"}
    folder = next(f for f in root.iterfind(".//k:Folder", space) if f[0].text == "row")
    places = folder.findall(".//k:Placemark", space)
    assert len(places) == len(field.planting.rows)
    for place, row in zip(places, field.planting.rows, strict=True):
        text = " ".join(node.text or "" for node in place.iterfind(".//k:coordinates", space))
        degrees = np.array([pair.split(",")[:2] for pair in text.split()], dtype=np.float64)
        assert_leads_there(field.datum, degrees, np.array(row.line.coords))


def test_lanelets(field: Worked, tmp_path: Path) -> None:
    write_planting(field.planting, tmp_path / "rows.osm")
    root = ElementTree.parse(tmp_path / "rows.osm").getroot()
    nodes = {
        node.attrib["id"]: np.array([float(node.attrib["lon"]), float(node.attrib["lat"])])
        for node in root.iter("node")
    }
    ways = {
        way.attrib["id"]: np.array([nodes[nd.attrib["ref"]] for nd in way.iter("nd")])
        for way in root.iter("way")
    }
    lanes = {lane.id for lane in field.planting.lanes}
    for relation in root.iter("relation"):
        if not lanes & {tag.attrib["v"] for tag in relation.iter("tag")}:
            continue
        lanes -= {tag.attrib["v"] for tag in relation.iter("tag")}
        sides = {m.attrib["role"]: ways[m.attrib["ref"]] for m in relation.iter("member")}
        assert bearing_deg(sides["left"]) == pytest.approx(HEADING_DEG, abs=1.5)
        across = bearing_deg(np.array([sides["left"][0], sides["right"][0]]))
        assert across == pytest.approx(HEADING_DEG + 90.0, abs=3.0)
    assert not lanes


def test_routes(field: Worked, tmp_path: Path) -> None:
    line = np.column_stack([field.route.east_m, field.route.north_m])
    write_route(field.route, tmp_path / "route.geojson")
    features = json.loads((tmp_path / "route.geojson").read_text())["features"]
    degrees = np.concatenate([np.array(f["geometry"]["coordinates"]) for f in features])
    assert_leads_there(field.datum, degrees, line)

    write_route(field.route, tmp_path / "route.gpx")
    root = ElementTree.parse(tmp_path / "route.gpx").getroot()
    points = [p for p in root.iter() if p.tag.endswith("trkpt")]
    degrees = np.array([[float(p.attrib["lon"]), float(p.attrib["lat"])] for p in points])
    assert_leads_there(field.datum, degrees, line)

    write_route(field.route, tmp_path / "route.plan")
    items = json.loads((tmp_path / "route.plan").read_text())["mission"]["items"]
    waypoints = np.array([one["params"][4:6] for one in items if one["command"] == 16])[:, ::-1]
    apart = np.abs(metres(field.datum, *waypoints[[0, -1]].T) - line[[0, -1]])
    assert apart.max() < 0.01
    assert bearing_deg(waypoints) == pytest.approx(HEADING_DEG, abs=1.5)
