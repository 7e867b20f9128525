"""Lines cut at bounds, against shapely, and every export of a part against the part."""

from __future__ import annotations

import itertools
import json
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pyogrio
import pytest
import shapely
from hypothesis import example, given, strategies as st
from rosbags.highlevel import AnyReader

from fieldgrid.export import Selection, export_map, formats
from fieldgrid.export.shapes.clipping import at, stretches_inside
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, open_map
from tests.export.asymmetric import enu, write_asymmetric_map

BOX = Bounds(-2.0, -1.0, 3.0, 2.0)
coordinates = st.floats(-6.0, 6.0).map(lambda value: round(value, 1))
lines = st.lists(st.tuples(coordinates, coordinates), min_size=2, max_size=12)


@given(lines)
@example([(0.0, 0.0), (1.0, -2.0), (-2.9, -0.7)])
def test_a_line_is_cut_as_shapely_cuts_it(places: list[tuple[float, float]]) -> None:
    line = np.array(places)
    found = stretches_inside(line[:, 0], line[:, 1], BOX)
    box = shapely.box(*BOX)
    length_m = 0.0
    for positions in found:
        assert np.all(np.diff(positions) > 0.0)
        part = np.column_stack([at(column, positions) for column in line.T])
        assert shapely.covers(shapely.buffer(box, 1e-9), shapely.LineString(part))
        length_m += float(np.hypot(*np.diff(part, axis=0).T).sum())
    # Segment by segment: shapely merges what lies on itself.
    expected_m = sum(
        shapely.intersection(shapely.LineString(pair), box).length
        for pair in itertools.pairwise(line)
        if not np.array_equal(*pair)
    )
    assert length_m == pytest.approx(expected_m, abs=1e-6)


def test_leaving_and_coming_back_makes_two_stretches() -> None:
    east, north = np.array([0.0, 5.0, 5.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0])
    first, second = stretches_inside(east, north, BOX)
    np.testing.assert_allclose(first, [0.0, 0.6])
    np.testing.assert_allclose(second, [2.4, 3.0])
    (whole,) = stretches_inside(east, north, None)
    np.testing.assert_array_equal(whole, np.arange(4))
    assert stretches_inside(east[:1], north[:1], None) == []
    assert stretches_inside(east * np.nan, north, BOX) == []


# --- every export of a part

PART = Bounds(-3.0, -1.0, 4.0, 3.0)


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def within(places: np.ndarray) -> bool:
    """Whether places in metres lie in the part, but for the rounding of degrees."""
    west, south, east, north = PART
    inside = (places[:, 0] >= west - 1e-3) & (places[:, 0] <= east + 1e-3)
    return bool(np.all(inside & (places[:, 1] >= south - 1e-3) & (places[:, 1] <= north + 1e-3)))


def test_features_end_at_the_bounds(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "all.geojson")
    export_map(universal, tmp_path / "part.geojson", Selection(PART))
    counts = {}
    for name in ("all", "part"):
        features = json.loads((tmp_path / f"{name}.geojson").read_text())["features"]
        shapes = shapely.get_coordinates([shapely.from_geojson(json.dumps(f)) for f in features])
        kinds = [feature["properties"]["layer"] for feature in features]
        counts[name] = {kind: kinds.count(kind) for kind in kinds}
        assert within(np.column_stack(enu(shapes[:, 1], shapes[:, 0]))) == (name == "part")
    assert set(counts["part"]) >= {"trajectory", "pose", "footprint"}
    assert counts["part"]["pose"] < counts["all"]["pose"]


def test_lines_of_a_kmz_end_at_the_bounds(universal: MapFile, tmp_path: Path) -> None:
    lengths = {}
    for name, part in (("all", Selection()), ("part", Selection(PART))):
        export_map(universal, tmp_path / f"{name}.kmz", part)
        with zipfile.ZipFile(tmp_path / f"{name}.kmz") as archive:
            root = ElementTree.fromstring(archive.read("doc.kml"))
        spaces = {"kml": "http://www.opengis.net/kml/2.2"}
        texts = [
            one.text or "" for one in root.findall(".//kml:LineString/kml:coordinates", spaces)
        ]
        places = [np.array([p.split(",")[:2] for p in text.split()], dtype=float) for text in texts]
        metres = [np.column_stack(enu(p[:, 1], p[:, 0])) for p in places]
        assert within(np.concatenate(metres)) == (name == "part")
        lengths[name] = sum(float(np.hypot(*np.diff(m, axis=0).T).sum()) for m in metres)
    assert 0.0 < lengths["part"] < lengths["all"]


@pytest.mark.parametrize("name", ["part.rosbag2", "part.bag"])
def test_paths_and_fixes_of_a_bag_end_at_the_bounds(
    universal: MapFile, tmp_path: Path, name: str
) -> None:
    export_map(universal, tmp_path / name, Selection(PART))
    poses, fixes = [], []
    with AnyReader([tmp_path / name]) as reader:
        for connection, _, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            if "/path" in connection.topic:
                poses += [(p.pose.position.x, p.pose.position.y) for p in message.poses]
            elif connection.topic.endswith("/odometry"):
                place = message.pose.pose.position
                poses.append((place.x, place.y))
            elif connection.topic == "/tf":
                (placed,) = message.transforms
                poses.append((placed.transform.translation.x, placed.transform.translation.y))
            elif connection.topic.endswith("/fix"):
                fixes.append((message.latitude, message.longitude))
    assert len(poses) > 1
    assert within(np.array(poses))
    lat, lon = np.array(fixes).T
    assert within(np.column_stack(enu(lat, lon)))


def test_task_data_end_at_the_bounds(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "TASKDATA", Selection(PART))
    root = ElementTree.parse(tmp_path / "TASKDATA" / "TASKDATA.XML").getroot()
    points = np.array([(float(p.get("C", "")), float(p.get("D", ""))) for p in root.iter("PNT")])
    assert within(np.column_stack(enu(points[:, 0], points[:, 1])))
    assert {line.get("A") for line in root.iter("PLN")} >= {"1"}  # the boundary


@pytest.mark.parametrize("name", ["part.fgb", "part.dxf"])
def test_features_of_other_formats_end_at_the_bounds(
    universal: MapFile, tmp_path: Path, name: str
) -> None:
    export_map(universal, tmp_path / name, Selection(PART))
    west, south, east, north = pyogrio.read_info(tmp_path / name, force_total_bounds=True)[
        "total_bounds"
    ]
    assert within(np.array([(west, south), (east, north)]))


def test_no_format_is_forgotten() -> None:
    """The others are made of the cells of the part."""
    of_cells = {"geotiff", "png", "nav2", "csv", "parquet", "npz", "zarr", "netcdf"}
    of_cells |= {"mbtiles", "las", "ply"}
    tested = {"geojson", "gpkg", "shapefile", "flatgeobuf", "dxf"} | {
        "kmz",
        "mcap",
        "rosbag1",
        "rosbag2",
        "isoxml",
    }
    assert set(formats()) == of_cells | tested | {"qgz"}  # a project holds no ground
