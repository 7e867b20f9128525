"""The map as other programs see it: GDAL of the wheels, and that of the system if installed."""

from __future__ import annotations

import io
import re
import shutil
import sqlite3
import subprocess
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
from PIL import Image
from pyogrio.raw import read as read_layer
from rasterio.enums import MaskFlags
from rasterio.warp import transform
from rasterio.windows import Window as RasterWindow

from fieldgrid.geometry import Status
from fieldgrid.maps import open_map
from tests.maps.file.maps import CELL_M, DATUM, drive, one_cell, pose_at, track, write_map

# East, north, up: asymmetric, so that no swap or sign goes unnoticed.
POINTS = ((12.3, -45.6, 0.0), (-830.2, 410.7, -3.4), (1500.0, 2200.0, 5.1))
CENTIMETRE = 0.01

# Cell centres, and the density that is put there.
CELLS = ((12.35, -45.65, 173), (-830.25, 410.75, 9), (1500.05, 2200.05, 0))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of three single cells, far apart."""
    folder = tmp_path_factory.mktemp("map")
    return write_map(
        folder / "map.gpkg", [[one_cell(*cell) for cell in CELLS]], trajectory=track(7)
    )


def tool(name: str, *arguments: str, stdin: str | None = None) -> str:
    """What a program of the system's GDAL prints, without a word on stderr."""
    if shutil.which(name) is None:
        pytest.skip(f"{name} (Debian's gdal-bin) is not on the PATH")
    done = subprocess.run([name, *arguments], input=stdin, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def geodetic(east_m: float, north_m: float, up_m: float = 0.0) -> tuple[float, float]:
    lat, lon, _ = DATUM.to_geodetic(east_m, north_m, up_m)
    return float(lat), float(lon)


# --- the raster


@pytest.mark.parametrize("point", POINTS)
def test_the_plane_of_the_file_is_the_tangent_plane(
    path: Path, point: tuple[float, float, float]
) -> None:
    lat, lon = geodetic(*point)
    with rasterio.open(path) as dataset:
        (east,), (north,) = transform("EPSG:4326", dataset.crs, [lon], [lat])
    assert (east, north) == pytest.approx(point[:2], abs=CENTIMETRE)


@pytest.mark.parametrize("point", POINTS)
def test_the_plane_is_the_same_for_the_gdal_of_the_system(
    path: Path, point: tuple[float, float, float]
) -> None:
    lat, lon = geodetic(*point)
    wkt = tool("gdalsrsinfo", "-o", "wkt1", "--single-line", str(path)).strip()
    out = tool("gdaltransform", "-s_srs", "EPSG:4326", "-t_srs", wkt, stdin=f"{lon!r} {lat!r}\n")
    assert [float(v) for v in out.split()[:2]] == pytest.approx(point[:2], abs=CENTIMETRE)


def test_the_raster_is_as_large_as_the_data(path: Path) -> None:
    assert open_map(path).bounds == pytest.approx((-830.3, -45.7, 1500.1, 2200.1))
    with rasterio.open(path) as dataset:
        assert dataset.res == pytest.approx((CELL_M, CELL_M))
        assert dataset.count == 4
        assert set(dataset.dtypes) == {"uint8"}
        assert MaskFlags.alpha in dataset.mask_flag_enums[0]
        overviews = dataset.overviews(1)
        assert overviews == [2, 4, 8, 16, 32, 64, 128]
        # Widened to whole pixels of the uppermost overview, 12.8 m here.
        assert tuple(dataset.bounds) == pytest.approx((-832.0, -51.2, 1510.4, 2201.6))
        assert (dataset.width, dataset.height) == (183 * 128, 176 * 128)


@pytest.mark.parametrize("cell", CELLS)
def test_a_cell_is_where_it_belongs_and_nothing_else_is(
    path: Path, cell: tuple[float, float, int]
) -> None:
    east, north, density = cell
    with rasterio.open(path) as dataset:
        row, column = dataset.index(east, north)
        pixels = dataset.read(window=RasterWindow(column - 3, row - 3, 7, 7))
    expected = np.zeros((4, 7, 7), dtype=np.uint8)
    expected[:, 3, 3] = (density, density, density, 255)
    np.testing.assert_array_equal(pixels, expected)


@pytest.mark.parametrize("cell", CELLS)
def test_the_gdal_of_the_system_finds_the_cell_by_its_latitude_and_longitude(
    path: Path, cell: tuple[float, float, int]
) -> None:
    east, north, density = cell
    lat, lon = geodetic(east, north)
    out = tool("gdallocationinfo", "-valonly", "-wgs84", str(path), repr(lon), repr(lat))
    assert [int(value) for value in out.split()] == [density, density, density, 255]
    lat, lon = geodetic(east + CELL_M, north)
    out = tool("gdallocationinfo", "-valonly", "-wgs84", str(path), repr(lon), repr(lat))
    assert [int(value) for value in out.split()] == [0, 0, 0, 0]


def test_the_gdal_of_the_system_opens_it_without_complaint(path: Path) -> None:
    out = tool("gdalinfo", str(path))
    assert "Size is 23424, 22528" in out
    corner = re.search(r"Upper Left +\( *(\S+), +(\S+)\)", out)
    assert corner is not None
    assert [float(v) for v in corner.groups()] == pytest.approx((-832.0, 2201.6), abs=1e-6)
    assert "Band 4 Block=256x256 Type=Byte, ColorInterp=Alpha" in out
    assert "Overviews: 11712x11264" in out


def test_an_asymmetric_picture_comes_out_upright(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(9)])
    view = open_map(path).read()
    with rasterio.open(path) as dataset:
        south, west = dataset.index(view.bounds.west_m + 0.01, view.bounds.south_m + 0.01)
        height, width = view.window.shape
        window = RasterWindow(west, south - height + 1, width, height)
        grey, alpha = dataset.read([1, 4], window=window)
        assert np.count_nonzero(dataset.read(4)) == np.count_nonzero(alpha)
    np.testing.assert_array_equal(grey[::-1], view.density)
    np.testing.assert_array_equal(alpha[::-1], view.observed * 255)


def test_a_map_that_grew_to_all_sides_is_read_whole(tmp_path: Path) -> None:
    corners = [(-310.25, -95.05, 3), (205.15, -400.35, 4), (-7.75, 512.25, 5)]
    path = write_map(tmp_path / "map.gpkg", [[one_cell(*cell)] for cell in corners])
    with rasterio.open(path) as dataset:
        assert tuple(dataset.bounds) == pytest.approx((-310.4, -400.0 - 3.2, 208.0, 512.0 + 3.2))
        for east, north, density in corners:
            ((value, alpha),) = dataset.sample([(east, north)], indexes=[1, 4])
            assert (value, alpha) == (density, 255)


def test_overviews_show_the_cells_at_their_place(path: Path) -> None:
    with rasterio.open(path) as dataset:
        levels = len(dataset.overviews(1))
    for level in range(levels):
        with rasterio.open(path, overview_level=level) as overview:
            for east, north, density in CELLS:
                row, column = overview.index(east, north)
                values, alphas = overview.read([1, 4], window=RasterWindow(column, row, 1, 1))
                assert (values.item(), alphas.item()) == (density, 255)


# --- the layers of points


def test_the_layers_are_these_and_the_binary_tables_are_none(path: Path) -> None:
    layers = dict(pyogrio.list_layers(path).tolist())
    assert layers == {
        "trajectory": "Point",
        "frame_position": "Point",
        "footprint": "Polygon",
        "fieldgrid_session": None,
        "layer_styles": None,  # QGIS lists it as none of its own
    }


def test_the_trajectory_is_a_layer_of_points_at_the_right_place(path: Path) -> None:
    expected = track(7)
    info = pyogrio.read_info(path, layer="trajectory")
    assert info["features"] == 7
    assert info["total_bounds"] == pytest.approx((-830.2, -45.6, 12.3, 410.7))
    meta, _, geometry, columns = read_layer(path, layer="trajectory")
    fields = dict(zip(meta["fields"].tolist(), columns, strict=True))
    assert sorted(fields) == sorted(
        ["session", "time_ns", "time", "up_m", "heading_deg", "heading_sigma_deg",
         "position_sigma_m", "speed_mps", "gear", "quality", "status", "reason"]
    )  # fmt: skip
    for name in ("time_ns", "up_m", "heading_deg", "position_sigma_m", "speed_mps", "quality"):
        np.testing.assert_array_equal(fields[name], getattr(expected, name))
    times = fields["time"].astype("datetime64[ns]").astype(np.int64)  # read as a moment
    assert np.abs(times - expected.time_ns).max() < 1_000_000
    assert fields["status"].tolist() == list(expected.status)
    assert fields["reason"].tolist() == list(expected.reason)
    points = np.array([np.frombuffer(wkb[5:], dtype="<f8") for wkb in geometry])
    np.testing.assert_array_equal(points[:, 0], expected.east_m)
    np.testing.assert_array_equal(points[:, 1], expected.north_m)
    lat, lon = geodetic(*points[2])
    (east,), (north,) = transform("EPSG:4326", meta["crs"], [lon], [lat])
    assert (east, north) == pytest.approx((-830.2, 410.7), abs=CENTIMETRE)


def test_the_frames_are_a_layer_of_points(path: Path) -> None:
    meta, _, geometry, columns = read_layer(path, layer="frame_position")
    fields = dict(zip(meta["fields"].tolist(), columns, strict=True))
    assert fields["frame_id"].tolist() == ["000000", "000001", "000002"]
    assert fields["heading_deg"].tolist() == [90.0] * 3
    assert set(fields["session"]) == {"0"}
    poses = [one_cell(*cell)[1] for cell in CELLS]
    points = np.array([np.frombuffer(wkb[5:], dtype="<f8") for wkb in geometry])
    np.testing.assert_array_equal(points, [(pose.east_m, pose.north_m) for pose in poses])


def test_the_system_lists_the_same_layers(path: Path) -> None:
    out = tool("ogrinfo", "-ro", "-so", "-al", str(path))
    assert re.findall(r"Layer name: (\w+)", out) == [
        "trajectory", "frame_position", "footprint", "fieldgrid_session", "layer_styles",
    ]  # fmt: skip


# --- the tables


def test_the_header_and_tables_are_those_of_geopackage_1_3(path: Path) -> None:
    data = path.read_bytes()
    assert data[:16] == b"SQLite format 3\0"
    assert data[68:72] == b"GPKG"
    assert int.from_bytes(data[60:64], "big") == 10300
    database = sqlite3.connect(path)
    database.row_factory = sqlite3.Row
    assert database.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
    assert database.execute("PRAGMA foreign_key_check").fetchall() == []
    ids = {row["srs_id"] for row in database.execute("SELECT * FROM gpkg_spatial_ref_sys")}
    assert ids >= {-1, 0, 4326}
    contents = {row["table_name"]: row for row in database.execute("SELECT * FROM gpkg_contents")}
    assert {name: row["data_type"] for name, row in contents.items()} == {
        "density": "tiles",
        "trajectory": "features",
        "frame_position": "features",
        "footprint": "features",
        "fieldgrid_session": "attributes",
        "layer_styles": "attributes",
    }
    for row in contents.values():
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", row["last_change"])
    (matrix_set,) = database.execute("SELECT * FROM gpkg_tile_matrix_set")
    for matrix in database.execute("SELECT * FROM gpkg_tile_matrix"):
        for axis, size in (("x", "width"), ("y", "height")):
            span = matrix_set[f"max_{axis}"] - matrix_set[f"min_{axis}"]
            pixels = matrix[f"matrix_{size}"] * matrix[f"tile_{size}"]
            assert pixels * matrix[f"pixel_{axis}_size"] == pytest.approx(span, rel=1e-14)
        inside = "tile_column NOT BETWEEN 0 AND ? - 1 OR tile_row NOT BETWEEN 0 AND ? - 1"
        assert not database.execute(
            f"SELECT * FROM density WHERE zoom_level = ? AND ({inside})",
            (matrix["zoom_level"], matrix["matrix_width"], matrix["matrix_height"]),
        ).fetchall()
    for row in database.execute("SELECT tile_data FROM density"):
        assert Image.open(io.BytesIO(row["tile_data"])).mode == "LA"
    database.close()


def test_gdals_validator_of_geopackages_finds_nothing(tmp_path: Path) -> None:
    """Its script is in Debian's python3-gdal, and checks one requirement after the other."""
    validator = ["/usr/bin/python3", "-m", "osgeo_utils.samples.validate_gpkg"]
    if (
        not Path(validator[0]).exists()
        or subprocess.run(
            [validator[0], "-c", "import osgeo_utils.samples.validate_gpkg"], capture_output=True
        ).returncode
    ):
        pytest.skip("GDAL's validator (Debian's python3-gdal) is not installed")
    unseen = (one_cell(*CELLS[0])[0], pose_at(float("nan"), 2.0, 3.0, status=Status.REJECTED))
    path = write_map(
        tmp_path / "map.gpkg", [drive(30), [unseen], drive(2, start=9)], trajectory=track(7)
    )
    with open_map(path, writable=True) as universal:
        universal.remove_session("2")
    done = subprocess.run(
        [*validator, "--extra", "--warning-as-error", "-k", str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
