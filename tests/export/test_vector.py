"""Features for a GIS: read back without GDAL, each obstacle and pose lies where it is."""

from __future__ import annotations

import dataclasses
import json
import sqlite3
import subprocess
import zipfile
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import pyogrio
import pyproj
import pytest
import shapefile
import shapely
import shapely.geometry
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as st_numpy
from scipy import ndimage

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.export import Selection, export_map
from fieldgrid.export.options import ShapeOptions
from fieldgrid.export.shapes.obstacles import trace_obstacles
from fieldgrid.geometry import Bounds, Lattice, Window
from fieldgrid.maps import MapFile, MapView, create_map, open_map
from tests.export.asymmetric import (
    DATUM,
    F_BOXES,
    SPRING,
    SUMMER,
    cells,
    enu,
    frame_poses,
    geodetic,
    probes,
    track,
    truth,
    write_asymmetric_map,
)
from tests.maps.file.maps import drive, write_session


class Feature(NamedTuple):
    shape: Any
    properties: dict[str, Any]


Features = dict[str, list[Feature]]


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def to_plane(shape: Any) -> Any:
    """Longitude and latitude to metres east and north, by PROJ."""

    def turned(places: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        east, north, _ = enu(places[:, 1], places[:, 0])
        return np.c_[east, north]

    return shapely.transform(shape, turned)


def read_geojson(path: Path) -> Features:
    document = json.loads(path.read_text())
    assert document["type"] == "FeatureCollection"
    assert "crs" not in document  # RFC 7946 knows WGS84 only
    found: Features = {}
    for feature in document["features"]:
        shape = to_plane(shapely.geometry.shape(feature["geometry"]))
        properties = {k: v for k, v in feature["properties"].items() if v is not None}
        found.setdefault(properties.pop("layer"), []).append(Feature(shape, properties))
    return found


def read_gpkg(path: Path) -> Features:
    connection = sqlite3.connect(path)
    connection.row_factory = sqlite3.Row
    found: Features = {}
    geometries = connection.execute("SELECT * FROM gpkg_geometry_columns").fetchall()
    for entry in geometries:
        table, column = entry["table_name"], entry["column_name"]
        (wkt,) = connection.execute(
            "SELECT definition FROM gpkg_spatial_ref_sys WHERE srs_id = ?", (entry["srs_id"],)
        ).fetchone()
        assert f'"latitude_of_origin",{DATUM.lat_deg}' in wkt
        features = []
        for row in connection.execute(f"SELECT * FROM {table}"):
            blob = row[column]
            envelope = {0: 0, 1: 32}[blob[3] >> 1 & 7]
            values = {k: row[k] for k in row.keys() if k not in ("fid", column)}  # noqa: SIM118
            features.append(Feature(shapely.from_wkb(blob[8 + envelope :]), values))
        found[table] = features
    connection.close()
    return found


def read_shapefiles(path: Path) -> Features:
    found: Features = {}
    zipped = path.suffix == ".zip"
    parts = zipfile.ZipFile(path).namelist() if zipped else [one.name for one in path.iterdir()]
    for name in sorted(part[:-4] for part in parts if part.endswith(".shp")):
        with shapefile.Reader(f"{path}/{name}.shp") as reader:
            found[name] = [
                Feature(
                    shapely.geometry.shape(entry.shape.__geo_interface__), entry.record.as_dict()
                )
                for entry in reader.iterShapeRecords()
            ]
    return found


def read_flatgeobuf(path: Path) -> Features:
    # As Arrow: pandas makes floats of whole numbers that are missing in some layers.
    about, table = pyogrio.read_arrow(path)
    operation = pyproj.CRS.from_wkt(about["crs"]).coordinate_operation
    assert operation is not None
    assert DATUM.lat_deg in [pytest.approx(one.value, abs=1e-9) for one in operation.params]
    found: Features = {}
    # The index of a FlatGeobuf orders features by their places.
    rows = table.to_pylist()
    rows.sort(key=lambda row: row["time_ns"] or row["first_ns"] or 0)
    for row in rows:
        shape = shapely.from_wkb(row.pop(about["geometry_name"] or "wkb_geometry"))
        found.setdefault(row.pop("layer"), []).append(Feature(shape, row))
    return found


READERS: dict[str, tuple[str, Callable[[Path], Features]]] = {
    "geojson": ("map.geojson", read_geojson),
    "gpkg": ("features.gpkg", read_gpkg),
    "shapefile": ("shapes.shp.zip", read_shapefiles),
    "flatgeobuf": ("features.fgb", read_flatgeobuf),
}


def exported(universal: MapFile, folder: Path, kind: str, **options: Any) -> Features:
    name, read = READERS[kind]
    export_map(universal, folder / name, options=options)
    return read(folder / name)


def check_obstacles(features: Sequence[Feature]) -> None:
    """A point is in an obstacle exactly where the density is above 100, to 5 mm of each edge."""
    whole = shapely.union_all([feature.shape for feature in features])
    east, north = probes()
    np.testing.assert_array_equal(
        shapely.contains_xy(whole, east, north), truth(east, north).density > 100
    )
    (letter,) = [f for f in features if f.shape.intersects(shapely.Point(-2.5, 0.0))]
    assert letter.shape.equals_exact(
        shapely.union_all([shapely.box(*box) for box in F_BOXES]).normalize(), 0.002
    ) or letter.shape.symmetric_difference(
        shapely.union_all([shapely.box(*box) for box in F_BOXES])
    ).area == pytest.approx(0.0, abs=0.02)
    named = {key[:8]: value for key, value in letter.properties.items()}
    assert named["area_m2"] == pytest.approx(18.0)
    # 10 m² of the stem at 220, 5 of the top arm at 255, 3 of the middle arm at 160.
    assert named["mean_den"] == pytest.approx((10 * 220 + 5 * 255 + 3 * 160) / 18, rel=1e-6)


@pytest.mark.parametrize("kind", READERS)
def test_obstacles_come_back(universal: MapFile, tmp_path: Path, kind: str) -> None:
    check_obstacles(exported(universal, tmp_path, kind)["obstacle"])


def turned_over(places: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return places[:, ::-1]


@pytest.mark.parametrize(
    "wrong",
    [
        turned_over,
        lambda places: places * (-1, 1),
        lambda places: places * (1, -1),
        lambda places: places + np.array([0.025, 0.0]),
        lambda places: places + np.array([0.0, -0.025]),
        lambda places: np.c_[
            DATUM.lon_deg + places[:, 0] / 111e3, DATUM.lat_deg + places[:, 1] / 111e3
        ],
    ],
)
@pytest.mark.parametrize("kind", READERS)
def test_wrong_obstacles_are_found(
    universal: MapFile, tmp_path: Path, kind: str, wrong: Callable[[Any], Any]
) -> None:
    features = exported(universal, tmp_path, kind, features="obstacle,pose,trajectory,footprint")
    moved = [Feature(shapely.transform(f.shape, wrong), f.properties) for f in features["obstacle"]]
    with pytest.raises((AssertionError, ValueError)):
        check_obstacles(moved)


@pytest.mark.parametrize("kind", READERS)
def test_poses_come_back(universal: MapFile, tmp_path: Path, kind: str) -> None:
    features = exported(universal, tmp_path, kind)["pose"]
    for session in (SPRING, SUMMER):
        drive = track(session)
        found = [f for f in features if f.properties["session"] == session]
        places = np.array([f.shape.coords[0] for f in found])
        np.testing.assert_allclose(places[:, 0], drive.east_m, atol=0.001)
        np.testing.assert_allclose(places[:, 1], drive.north_m, atol=0.001)
        assert [int(f.properties["time_ns"]) for f in found] == drive.time_ns.tolist()
        assert [f.properties["status"] for f in found] == [s.value for s in drive.status]
        first = datetime.fromisoformat(found[0].properties["time"])
        assert first.utcoffset() == timedelta(0)
        assert int(first.timestamp()) == int(drive.time_ns[0]) // 10**9
        key = "head_deg" if kind == "shapefile" else "heading_deg"
        assert [f.properties[key] for f in found] == pytest.approx(drive.heading_deg.tolist())


@pytest.mark.parametrize("kind", READERS)
def test_lines_follow_the_gear_and_leave_out_rejected_fixes(
    universal: MapFile, tmp_path: Path, kind: str
) -> None:
    lines = exported(universal, tmp_path, kind)["trajectory"]
    spring = [f for f in lines if f.properties["session"] == SPRING]
    assert [f.properties["gear"] for f in spring] == [1, -1]
    assert spring[0].shape.coords[-1] == pytest.approx(spring[1].shape.coords[0])
    summer = [f for f in lines if f.properties["session"] == SUMMER]
    assert all(f.shape.bounds[2] < 13.0 for f in summer)  # nothing goes to the fix 40 m off
    assert sum(f.shape.length for f in summer) == pytest.approx(0.25 * 37, abs=0.01)


@pytest.mark.parametrize("kind", READERS)
def test_footprints_come_back(universal: MapFile, tmp_path: Path, kind: str) -> None:
    footprints = exported(universal, tmp_path, kind)["footprint"]
    assert len(footprints) == sum(len(frame_poses(name)) for name in (SPRING, SUMMER))
    used = [f.shape for f in footprints if f.properties["status"] == "ok"]
    assert shapely.union_all(used).symmetric_difference(
        shapely.box(-10.0, -7.0, 14.0, 9.0)
    ).area == pytest.approx(0.0, abs=0.05)


def test_options_choose_what_is_written(universal: MapFile, tmp_path: Path) -> None:
    only = exported(universal, tmp_path, "geojson", features="obstacle", obstacle_above=210)
    assert list(only) == ["obstacle"]
    assert sum(f.properties["area_m2"] for f in only["obstacle"]) == pytest.approx(15.0)
    everything = ShapeOptions(min_area_m2=17.0)
    with_map = list(trace_obstacles([universal.read()], everything))
    assert [round(one.area_m2) for one in with_map] == [18]


def test_bounds_keep_what_touches_them(universal: MapFile, tmp_path: Path) -> None:
    out = tmp_path / "part.geojson"
    export_map(universal, out, Selection(Bounds(9.0, -6.5, 13.0, -4.5)))
    features = read_geojson(out)
    drawn = list(features)  # in the order of the file
    assert drawn.index("footprint") < drawn.index("obstacle")
    assert [round(f.properties["mean_density"]) for f in features["obstacle"]] == [120]
    assert {f.properties["session"] for f in features["pose"]} == {SUMMER}


def test_spring_alone(universal: MapFile, tmp_path: Path) -> None:
    out = tmp_path / "spring.geojson"
    export_map(universal, out, Selection(at=SPRING))
    features = read_geojson(out)
    assert {f.properties["session"] for f in features["pose"]} == {SPRING}
    point = shapely.Point(9.5, -5.5)  # 40 in spring
    assert not any(f.shape.contains(point) for f in features["obstacle"])


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"features": "trees"}, "'trees' is no layer of features; known are footprint, obstacle"),
        (
            {"obstacle_above": 255},
            "obstacle_above = 255 of the format .* equal to 254",
        ),
        ({"min_area_m2": -1.0}, "min_area_m2 = -1.0 of the format .* is not possible"),
        ({"simplify_m": 11.0}, "simplify_m = 11.0 of the format .* equal to 10"),
        ({"epsg": 4326}, "has no option 'epsg'"),
    ],
)
def test_what_cannot_be(
    universal: MapFile, tmp_path: Path, kind: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        exported(universal, tmp_path, kind, **options)
    with pytest.raises(ConfigError, match="cannot hold the layer 'count', only what is traced"):
        export_map(universal, tmp_path / READERS[kind][0], Selection(layer="count"))
    assert list(tmp_path.iterdir()) == []


def test_a_map_is_not_overwritten_by_its_own_features(tmp_path: Path) -> None:
    path = write_asymmetric_map(tmp_path / "f.gpkg")
    before = path.read_bytes()
    with open_map(path) as universal:
        for target in (path, write_asymmetric_map(tmp_path / "other.gpkg")):
            with pytest.raises(MapExistsError, match="is a map with its evidence"):
                export_map(universal, target, overwrite=True)
    assert path.read_bytes() == before


def test_a_folder_of_shapefiles(universal: MapFile, tmp_path: Path) -> None:
    out = tmp_path / "shapes"
    export_map(universal, out, format="shapefile")
    assert {path.suffix for path in out.iterdir()} == {".shp", ".shx", ".dbf", ".prj", ".cpg"}
    check_obstacles(read_shapefiles(out)["obstacle"])
    export_map(universal, out, format="shapefile", overwrite=True)
    for name in ("notes.docx", "roads.shp"):
        (out / name).write_text("mine")
        with pytest.raises(MapExistsError, match="holds other things than exported shapefiles"):
            export_map(universal, out, format="shapefile", overwrite=True)
        assert (out / name).read_text() == "mine"
        (out / name).unlink()


def test_an_older_gdal_reads_it_without_a_warning(universal: MapFile, tmp_path: Path) -> None:
    try:
        version = subprocess.run(["ogrinfo", "--version"], capture_output=True, check=True)
    except FileNotFoundError:
        pytest.skip("GDAL's programs are not installed")
    assert version.stdout.startswith(b"GDAL")
    for kind, (name, _) in READERS.items():
        exported(universal, tmp_path, kind)
        told = subprocess.run(
            ["ogrinfo", "-so", "-al", str(tmp_path / name)],
            capture_output=True,
            text=True,
            check=True,
        )
        assert told.stderr == ""
        assert "Feature Count: 0" not in told.stdout


@given(
    st_numpy.arrays(np.uint8, (9, 12), elements=st.sampled_from([0, 60, 101, 255])),
    st.integers(1, 9),
    st.integers(1, 12),
)
@settings(max_examples=60, deadline=None)
def test_obstacles_are_the_cells_that_touch_however_views_are_cut(
    density: npt.NDArray[np.uint8], row: int, column: int
) -> None:
    lattice, window = Lattice(0.5), Window(-5, -3, 12, 9)
    views = [
        MapView(lattice, part, cut, np.ones_like(cut, dtype=np.bool_), DATUM, is_base=True)
        for part in (
            Window(-5 + i, -3 + j, width, height)
            for j, height in ((row, 9 - row), (0, row))  # from the north, as blocks are
            for i, width in ((0, column), (column, 12 - column))
            if width and height
        )
        for cut in (density[window.slices_of(part)],)
    ]
    labels, count = ndimage.label(density > 100, structure=np.ones((3, 3)))
    expected = sorted(
        (
            int((labels == k).sum()),
            float(density[labels == k].mean()),
            int(density[labels == k].max()),
        )
        for k in range(1, count + 1)
    )
    found = list(trace_obstacles(views, ShapeOptions(simplify_m=0.0)))
    said = sorted((round(one.area_m2 / 0.25), one.mean_density, one.max_density) for one in found)
    assert said == expected
    starts = [tuple(np.argwhere(labels == k)[0]) for k in range(1, count + 1)]
    corners = [
        min((y, x) for x, y in shapely.get_coordinates(one.outline).tolist()) for one in found
    ]
    assert [y for y, _ in corners] == [(j - 3) * 0.5 for j, _ in sorted(starts)]


@given(
    st_numpy.arrays(np.uint8, (9, 12), elements=st.sampled_from([0, 60, 101, 255])),
    st.integers(1, 9),
)
@settings(max_examples=60, deadline=None)
def test_outlines_hold_exactly_their_cells(density: npt.NDArray[np.uint8], cut: int) -> None:
    """Whatever the cells, and wherever the view is cut: no cell is lost, gained, or in two."""
    lattice, seen = Lattice(0.5), np.ones((9, 12), dtype=np.bool_)
    views = [
        MapView(
            lattice,
            Window(-5, -3 + first, 12, part.shape[0]),
            part,
            seen[: part.shape[0]],
            DATUM,
            is_base=True,
        )
        for first, part in ((0, density[:cut]), (cut, density[cut:]))
        if part.shape[0]
    ]
    found = list(trace_obstacles(views, ShapeOptions(simplify_m=0.0)))
    whole = list(
        trace_obstacles(
            [MapView(lattice, Window(-5, -3, 12, 9), density, seen, DATUM, is_base=True)],
            ShapeOptions(simplify_m=0.0),
        )
    )
    assert [one[1:] for one in found] == [one[1:] for one in whole]
    assert sum(one.area_m2 for one in found) == 0.25 * np.count_nonzero(density > 100)
    for one in found:
        assert one.outline.is_valid
        assert one.outline.area == pytest.approx(one.area_m2)
    east, north = np.meshgrid(*lattice.centres(Window(-5, -3, 12, 9)))
    inside = sum(
        shapely.contains_xy(one.outline, east, north).astype(int) for one in found
    ) + np.zeros((9, 12), dtype=int)
    np.testing.assert_array_equal(inside, density > 100)


def test_simplified_outlines_stay_valid_when_they_are_rounded() -> None:
    """Where a corner touched an edge by a hair, degrees of nine decimals would make them cross."""
    random, lattice = np.random.default_rng(3), Lattice(0.05)
    blurred = cv2.GaussianBlur(random.random((160, 160)), (0, 0), 0.6)
    density = np.where(blurred > 0.5, np.uint8(255), np.uint8(0))
    seen = np.ones_like(density, dtype=np.bool_)
    view = MapView(lattice, Window(420, -377, 160, 160), density, seen, DATUM, is_base=True)
    found = np.array([one.outline for one in trace_obstacles([view])], dtype=np.object_)
    coarse = ShapeOptions(simplify_m=0.0)
    exact = np.array([one.outline for one in trace_obstacles([view], coarse)], dtype=np.object_)
    corners = shapely.get_num_coordinates(exact).sum()
    assert shapely.get_num_coordinates(found).sum() < 0.9 * corners
    assert shapely.covers(shapely.buffer(found, 1e-9), exact).all()

    def rounded(places: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        lat, lon, _ = geodetic(places[:, 0], places[:, 1])
        return np.round(np.c_[lon, lat], 9)

    assert shapely.is_valid(shapely.transform(found, rounded)).all()


def test_drives_are_in_their_order_whenever_they_were_added(tmp_path: Path) -> None:
    with create_map(tmp_path / "m.gpkg", DATUM, cell_m=0.1) as universal:
        for name, start in (("later", 50), ("earlier", 0)):
            when = dataclasses.replace(track(SPRING), time_ns=track(SPRING).time_ns + start)
            write_session(universal, name, drive(2, start=start), when)
    export_map(open_map(tmp_path / "m.gpkg"), tmp_path / "m.geojson")
    poses = read_geojson(tmp_path / "m.geojson")["pose"]
    assert list(dict.fromkeys(p.properties["session"] for p in poses)) == ["earlier", "later"]


def test_the_fixture_has_obstacles_that_touch_by_a_corner_only() -> None:
    """So that the above covers it: cells that touch by corners are one obstacle of two parts."""
    density = np.array([[255, 0], [0, 255]], dtype=np.uint8)
    seen = np.ones_like(density, dtype=np.bool_)
    view = MapView(Lattice(0.5), Window(0, 0, 2, 2), density, seen, DATUM, is_base=True)
    (one,) = trace_obstacles([view])
    assert len(one.outline.geoms) == 2
    assert cells()[2].observed.any()


def test_a_drawing_has_a_layer_for_each_kind(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "map.dxf")
    about, table = pyogrio.read_arrow(tmp_path / "map.dxf")
    assert about["fields"] is not None
    rows = table.to_pylist()
    by_layer = {row["Layer"] for row in rows}
    assert by_layer == {"obstacle", "trajectory", "pose", "footprint"}
    shapes = [
        shapely.from_wkb(row[about["geometry_name"] or "wkb_geometry"])
        for row in rows
        if row["Layer"] == "obstacle"
    ]
    outlines = shapely.polygonize(shapes)
    east, north = probes()
    np.testing.assert_array_equal(
        shapely.contains_xy(outlines, east, north), truth(east, north).density > 100
    )
