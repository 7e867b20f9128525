"""Keep-outs, corrections and places in what is written for other programs, each read back."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapefile
import shapely
from rosbags.highlevel import AnyReader

from fieldgrid.export import export_map
from fieldgrid.geometry import LocalGrid
from fieldgrid.maps import MapFile, Mark, MarkKind, open_map
from tests.export.nav2_loader import Grid, load
from tests.maps.file.maps import SPEC, pose_at, write_map
from tests.maps.file.test_marks import square

# Seen is what lies 0..6 m east and -2..2 m north; in its eastern half everything is an obstacle.
FREE, UNSAID, OBSTACLE, KEEPOUT = (4.05, 0.55), (4.05, -1.05), (1.55, 1.05), (1.55, -0.95)


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    density = np.zeros(SPEC.shape, np.uint8)
    density[SPEC.shape[0] // 2 :] = 200
    grid = LocalGrid(SPEC, density, np.ones(SPEC.shape, np.bool_))
    frames = [(grid, pose_at(0.03, 0.03, 90.0, time_ns=10**18))]
    path = write_map(tmp_path_factory.mktemp("marked") / "field.gpkg", [frames])
    opened = open_map(path, writable=True)
    opened.add_marks(
        [
            Mark(MarkKind.FREE, square(3.5, 0.0)),
            Mark(MarkKind.OBSTACLE, square(1.0, 0.5), "shed"),
            Mark(MarkKind.KEEPOUT, square(1.0, -1.5), "pond", "deep", "Ana"),
            Mark(MarkKind.PLACE, ((5.0, -1.0),), "gate"),
            Mark(MarkKind.KEEPOUT, square(90.0, 90.0), "of another field"),
        ]
    )
    return opened


def values(grid: Grid) -> list[int]:
    east, north = np.array([FREE, UNSAID, OBSTACLE, KEEPOUT]).T
    return grid.at(east, north).tolist()


@pytest.mark.parametrize("cell_m", [None, 0.3])
def test_nav2_has_them_in_its_map_and_keep_outs_in_a_mask(
    universal: MapFile, tmp_path: Path, cell_m: float | None
) -> None:
    from fieldgrid.export import Selection

    done = export_map(universal, tmp_path / "field.yaml", Selection(cell_m=cell_m))
    assert values(load(tmp_path / "field.yaml")) == [0, 100, 100, 100]
    mask = load(tmp_path / "field.keepout.yaml")
    assert values(mask) == [0, 0, 0, 100]
    assert set(np.unique(mask.data)) == {0, 100}
    if cell_m is None:
        assert (mask.data == 100).sum() == 100
        assert dict(done.rows)["kept out of"] == "100"
    assert mask.origin == load(tmp_path / "field.yaml").origin


def test_a_map_without_keep_outs_has_an_empty_mask(universal: MapFile, tmp_path: Path) -> None:
    """So that what a launch file names is there, and an older mask does not stay."""
    shutil.copy(universal.path, tmp_path / "field.gpkg")
    with open_map(tmp_path / "field.gpkg", writable=True) as copy:
        export_map(copy, tmp_path / "field.yaml")
        copy.remove_marks([3, 5])
        export_map(copy, tmp_path / "field.yaml", overwrite=True)
    assert not load(tmp_path / "field.keepout.yaml").data.any()


def test_the_occupancy_grid_of_a_bag_has_them(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "bag", format="rosbag2")
    with AnyReader([tmp_path / "bag"]) as bag:
        (message,) = (
            bag.deserialize(raw, connection.msgtype)
            for connection, _, raw in bag.messages()
            if connection.topic == "/map"
        )
    info = message.info
    data = np.asarray(message.data).reshape(info.height, info.width)
    origin = (info.origin.position.x, info.origin.position.y, 0.0)
    assert values(Grid(data, info.resolution, origin)) == [0, 100, 100, 100]


def test_outlines_and_marks_are_features_of_their_own(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "field.geojson")
    features = json.loads((tmp_path / "field.geojson").read_text())["features"]
    marks = [f["properties"] for f in features if f["properties"]["layer"] == "mark"]
    assert [(m["kind"], m["name"]) for m in marks] == [
        ("free", ""), ("obstacle", "shed"), ("keepout", "pond"), ("place", "gate"),
        ("keepout", "of another field"),
    ]  # fmt: skip
    assert (marks[2]["note"], marks[2]["author"]) == ("deep", "Ana")
    outlines = shapely.union_all(
        [
            shapely.geometry.shape(f["geometry"])
            for f in features
            if f["properties"]["layer"] == "obstacle"
        ]
    )

    def inside(place: tuple[float, float]) -> bool:
        lat, lon, _ = universal.datum.to_geodetic(*place, 0.0)
        return bool(outlines.contains(shapely.Point(lon, lat)))

    assert [inside(p) for p in (FREE, UNSAID, OBSTACLE, KEEPOUT)] == [False, True, True, False]


def test_a_shapefile_has_polygons_and_points_apart(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "shapes", format="shapefile")
    with shapefile.Reader(f"{tmp_path}/shapes/mark.shp") as reader:
        assert [record["name"] for record in reader.records()][1:3] == ["shed", "pond"]
    with shapefile.Reader(f"{tmp_path}/shapes/mark_point.shp") as reader:
        assert [record["name"] for record in reader.records()] == ["gate"]
    export_map(universal, tmp_path / "shapes", format="shapefile", overwrite=True)


@pytest.mark.filterwarnings("error")
def test_a_shapefile_cuts_long_texts_between_letters(universal: MapFile, tmp_path: Path) -> None:
    copy = shutil.copy(universal.path, tmp_path / "copy.gpkg")
    with open_map(copy, writable=True) as own:
        own.add_marks([Mark(MarkKind.PLACE, ((1.0, 1.0),), "well", "x" + "ü" * 200)])
        export_map(own, tmp_path / "shapes", format="shapefile")
    with shapefile.Reader(f"{tmp_path}/shapes/mark_point.shp") as reader:
        notes = {record["name"]: record["note"] for record in reader.records()}
    assert notes["well"] == "x" + "ü" * 126


def test_a_kmz_has_a_placemark_of_each(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "field.kmz")
    with zipfile.ZipFile(tmp_path / "field.kmz") as archive:
        root = ElementTree.fromstring(archive.read("doc.kml"))
    kml = {"k": "http://www.opengis.net/kml/2.2"}
    names = [node.text for node in root.findall(".//k:Folder/k:Placemark/k:name", kml)]
    assert {"shed", "pond", "gate"} <= set(names)
    assert root.find(".//k:Placemark[k:name='pond']//k:coordinates", kml) is not None


def test_task_data_have_zones_obstacles_and_flags(universal: MapFile, tmp_path: Path) -> None:
    pytest.importorskip("isoxml")
    export_map(universal, tmp_path / "taskdata")
    root = ElementTree.parse(tmp_path / "taskdata" / "TASKDATA.XML").getroot()
    zones = np.fromfile(tmp_path / "taskdata" / "GRD00001.bin", np.uint8)
    grid = next(root.iter("GRD"))
    zones = zones.reshape(int(grid.get("F") or 0), int(grid.get("E") or 0))
    codes = {zone.get("B"): int(zone.get("A") or 0) for zone in root.iter("TZN")}

    def zone_at(east: float, north: float) -> int:
        lat, lon, _ = universal.datum.to_geodetic(east, north, 0.0)
        row = (float(lat) - float(grid.get("A") or 0)) / float(grid.get("C") or 1)
        column = (float(lon) - float(grid.get("B") or 0)) / float(grid.get("D") or 1)
        return int(zones[int(row), int(column)])

    assert [zone_at(*place) for place in (FREE, UNSAID, OBSTACLE, KEEPOUT)] == [
        codes[name] for name in ("free", "obstacle", "obstacle", "keep-out")
    ]
    polygons = {polygon.get("B"): polygon.get("A") for polygon in root.iter("PLN")}
    assert polygons["keep-out pond"] == "6"  # an obstacle
    flags = [point.get("B") for point in root.iter("PNT") if point.get("A") == "1"]
    assert flags == ["gate"]
