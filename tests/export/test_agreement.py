"""A real map through the readers of four worlds: all say the same of the same place.

They are asked at the same points on Earth, 4 mm to either side of edges between cells that differ,
so that a reader which is a centimetre off gives other answers. Where the points are on Earth is
said by PROJ's topocentric plane.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyproj
import pytest
import shapely

from fieldgrid import Costmap
from fieldgrid.export import export_map
from fieldgrid.geometry import Datum, Status, Trajectory
from fieldgrid.maps import MapView, open_map
from tests.conftest import TWO_LANES
from tests.export.nav2_loader import load
from tests.export.test_rosbag import (
    Messages,
    layer_at,
    messages_of_bag,
    messages_of_mcap,
    occupancy_at,
)

CENTIMETRE = 0.01
OFF_EDGE_M = 0.004
EDGES, ANYWHERE = 400, 200

PYTHON = Path("/usr/bin/python3")
READERS = Path(__file__).with_name("system_readers.py")

PICTURES = ("v.tif", "v.png", "world.png")
SHAPES = ("v.geojson", "features.gpkg", "v.shp.zip")
BY_GDAL = (*PICTURES, "v.kmz", *SHAPES)
BY_QGIS = ("v.tif", "v.png", *SHAPES)

_Float64 = npt.NDArray[np.float64]


class Control(NamedTuple):
    """Points in the map's plane and on Earth, and what the map has there.

    The density is what the drives saw, `counts_as` what the map's own cells count as for whoever
    decides; both are -1 where nothing is known, and outside.
    """

    east_m: _Float64
    north_m: _Float64
    lat_deg: _Float64
    lon_deg: _Float64
    height_m: _Float64
    density: npt.NDArray[np.int64]
    counts_as: npt.NDArray[np.int64]

    @property
    def occupancy(self) -> npt.NDArray[np.int64]:
        worst = self.counts_as
        doubt = np.clip(np.rint(100.0 * (worst - 50.0) / 51.0), 1, 99)
        known = np.where(worst <= 50, 0, np.where(worst > 100, 100, doubt))
        return np.where(worst < 0, -1, known).astype(np.int64)


class Exports(NamedTuple):
    folder: Path
    datum: Datum
    view: MapView
    track: Trajectory
    control: Control


def topocentric(datum: Datum) -> pyproj.Transformer:
    """Longitude, latitude, height to east, north, up, by PROJ."""
    return pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart "
        f"+ellps=WGS84 +step +proj=topocentric +ellps=WGS84 +lat_0={datum.lat_deg!r} "
        f"+lon_0={datum.lon_deg!r} +h_0={datum.height_m!r}"
    )


def plane_of(exports: Exports, places: Any, height_m: float | None = None) -> _Float64:
    """East and north [n, 2] of latitudes and longitudes [n, 2], on the ground unless told."""
    lat, lon = np.asarray(places, dtype=np.float64).T
    height = np.full(len(lat), exports.datum.height_m if height_m is None else height_m)
    east, north, _ = topocentric(exports.datum).transform(lon, lat, height)
    return np.column_stack([east, north])


def seen_in(view: MapView) -> npt.NDArray[np.int64]:
    """The densities of cells, -1 where there is none."""
    return np.where(view.observed, view.density.astype(np.int64), -1)


def said_by(
    view: MapView, cells: npt.NDArray[np.int64], east_m: _Float64, north_m: _Float64
) -> npt.NDArray[np.int64]:
    """What cells of the view have at points, -1 outside."""
    column = np.floor(east_m / view.lattice.cell_m).astype(int) - view.window.i0
    row = np.floor(north_m / view.lattice.cell_m).astype(int) - view.window.j0
    inside = (column >= 0) & (row >= 0) & (column < view.window.width) & (row < view.window.height)
    found = np.full(len(column), -1, dtype=np.int64)
    here = row[inside], column[inside]
    found[inside] = cells[here]
    return found


def control_points(view: MapView) -> tuple[_Float64, _Float64]:
    """East and north of points on both sides of edges, and of some anywhere, 2 m outside too."""
    random, cell_m = np.random.default_rng(11), view.lattice.cell_m
    seen = seen_in(view)
    east, north = [], []
    for axis in (0, 1):
        rows, columns = np.nonzero(np.diff(seen, axis=axis))
        some = random.choice(len(rows), EDGES, replace=False)
        along = random.uniform(0.2, 0.8, EDGES)
        # The edge is the far one of the cell: to the north for axis 0, to the east for axis 1.
        x = view.window.i0 + columns[some] + (1.0 if axis else along)
        y = view.window.j0 + rows[some] + (along if axis else 1.0)
        for side in (-OFF_EDGE_M, OFF_EDGE_M):
            east.append(x * cell_m + (side if axis else 0.0))
            north.append(y * cell_m + (0.0 if axis else side))
    low, (width, height) = np.array(view.window[:2]) - 40, (view.window.width, view.window.height)
    cells = random.integers(low, low + np.array([width, height]) + 80, (ANYWHERE, 2))
    places = (cells + random.uniform(0.2, 0.8, cells.shape)) * cell_m
    east.append(places[:, 0])
    north.append(places[:, 1])
    return np.concatenate(east), np.concatenate(north)


@pytest.fixture(scope="module")
def exports(two_lanes_map: Path, tmp_path_factory: pytest.TempPathFactory) -> Exports:
    folder = tmp_path_factory.mktemp("exports")
    with open_map(two_lanes_map) as universal:
        for name in ("v.tif", "v.png", "v.kmz", "v.rosbag2"):
            export_map(universal, folder / name)
        export_map(universal, folder / "v.mcap", options={"messages": "foxglove"})
        for name in SHAPES:
            export_map(universal, folder / name, options={"simplify_m": 0.0})
        export_map(universal, folder / "v.yaml", options={"mode": "raw"})
        view = universal.read(decide="density")
        track, datum = universal.trajectory("two_lanes"), universal.datum
    for ending in ("png", "pgw", "prj"):  # without what GDAL alone finds beside it
        shutil.copy(folder / f"v.{ending}", folder / f"world.{ending}")
    east, north = control_points(view)
    lon, lat, height = topocentric(datum).transform(
        east, north, np.zeros(len(east)), direction="INVERSE"
    )
    decision = view.decision()
    counts = np.where(decision.seen > 0.0, decision.worst.astype(np.int64), -1)
    said = (said_by(view, cells, east, north) for cells in (seen_in(view), counts))
    return Exports(folder, datum, view, track, Control(east, north, lat, lon, height, *said))


def test_the_points_tell_a_centimetre(exports: Exports) -> None:
    control, view = exports.control, exports.view
    for axis, name in enumerate(("north", "east")):
        across = slice(2 * EDGES * axis, 2 * EDGES * (axis + 1))
        for off_m in (-CENTIMETRE, CENTIMETRE):
            moved = said_by(
                view,
                seen_in(view),
                control.east_m + (off_m if axis else 0.0),
                control.north_m + (0.0 if axis else off_m),
            )
            differ = np.mean((moved != control.density)[across])
            assert differ > 0.45, f"{off_m} m {name}: {differ}"
    assert 0.2 < np.mean(control.density < 0) < 0.8
    assert np.mean(control.density > 100) > 0.1


def test_the_map_counts_as_what_drives_saw_but_where_one_drove(
    exports: Exports, two_lanes_map: Path
) -> None:
    """Nothing moved at these points, so that the way from frame to frame alone makes a
    difference."""
    control = exports.control
    with open_map(two_lanes_map) as universal:
        poses = [frame.pose for frame in universal.frames()]
    places = [(pose.east_m, pose.north_m) for pose in poses if pose.status is Status.OK]
    points = shapely.points(control.east_m, control.north_m)
    differ = control.counts_as != control.density
    assert differ.any()
    assert (control.counts_as[differ] == 0).all()
    assert (shapely.distance(points, shapely.LineString(places))[differ] < 0.75).all()


# --- Nav2's rules, MCAP and ROS, the planner ------------------------------------------------------


def test_nav2s_rules(exports: Exports) -> None:
    control = exports.control
    about = json.loads((exports.folder / "v.georef.json").read_text(encoding="utf-8"))
    datum = Datum(*(about["datum"][key] for key in ("lat_deg", "lon_deg", "height_m")))
    x, y, _ = topocentric(datum).transform(control.lon_deg, control.lat_deg, control.height_m)
    found = load(exports.folder / "v.yaml").at(x, y)
    np.testing.assert_array_equal(found, control.occupancy)
    corners, bounds = about["corners_deg"], about["bounds_m"]
    for name, place in corners.items():
        row, column = name.split("_")
        assert plane_of(exports, [place])[0] == pytest.approx(
            (bounds[column], bounds[row]), abs=CENTIMETRE
        )


BAGS: dict[str, Callable[[Path], Messages]] = {
    "v.mcap": messages_of_mcap,
    "v.rosbag2": messages_of_bag,
}


@pytest.mark.parametrize("name", BAGS)
def test_mcap_and_ros(exports: Exports, name: str) -> None:
    control, messages = exports.control, BAGS[name](exports.folder / name)
    x, y = in_the_frame(messages["/tf_static"][0], control)
    (grid,), (layers,) = messages["/map"], messages["/grid_map"]
    np.testing.assert_array_equal(occupancy_at(grid, x, y), control.occupancy)
    density = layer_at(layers, "density", x, y)
    np.testing.assert_array_equal(np.where(np.isnan(density), -1, density), control.density)
    accepted = exports.track.accepted
    driven = np.column_stack([exports.track.east_m, exports.track.north_m])[accepted]
    (path,) = messages["/two_lanes/path"]
    poses = [(one.pose.position.x, one.pose.position.y) for one in path.poses]
    np.testing.assert_allclose(poses, driven, atol=CENTIMETRE)
    fixes = messages["/two_lanes/fix"]
    measured = accepted & (exports.track.quality != 6)  # 6 is an estimate between fixes
    lon, lat, height = np.array([(f.longitude, f.latitude, f.altitude) for f in fixes]).T
    east, north, up = topocentric(exports.datum).transform(lon, lat, height)
    forward_m, left_m, up_m = antenna_flu_m()
    heading = np.radians(exports.track.heading_deg[measured])
    sin, cos = np.sin(heading), np.cos(heading)
    track_e, track_n = exports.track.east_m[measured], exports.track.north_m[measured]
    np.testing.assert_allclose(east, track_e + forward_m * sin - left_m * cos, atol=CENTIMETRE)
    np.testing.assert_allclose(north, track_n + forward_m * cos + left_m * sin, atol=CENTIMETRE)
    np.testing.assert_allclose(up, exports.track.up_m[measured] + up_m, atol=CENTIMETRE)


def antenna_flu_m() -> tuple[float, float, float]:
    """The antenna as seen from the ground below the camera, as the example states it."""
    stated = json.loads((TWO_LANES / "calibration" / "mounting.json").read_text())
    forward_m, left_m, up_m = stated["gnss_antenna_from_camera_mid_flu_m"]
    return forward_m, left_m, up_m + stated["camera_height_above_ground_m"]


def in_the_frame(message: Any, control: Control) -> tuple[_Float64, _Float64]:
    """The points in the frame `map`, by the transform from `earth` that a bag has."""
    (stamped,) = [one for one in message.transforms if one.child_frame_id == "map"]
    turn, move = stamped.transform.rotation, stamped.transform.translation
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    earth = np.column_stack(
        to_ecef.transform(control.lon_deg, control.lat_deg, control.height_m)
    ) - np.array([move.x, move.y, move.z])
    axis = -np.array([turn.x, turn.y, turn.z])  # the other way round
    places = earth + 2.0 * np.cross(axis, np.cross(axis, earth) + turn.w * earth)
    np.testing.assert_allclose(places[:, 2], 0.0, atol=1e-6)
    return places[:, 0], places[:, 1]


def test_foxglove(exports: Exports) -> None:
    control, messages = exports.control, messages_of_mcap(exports.folder / "v.mcap")
    (grid,), (shapes,) = messages["/foxglove/grid"], messages["/foxglove/geojson"]
    column = np.floor((control.east_m - grid.pose.position.x) / grid.cell_size.x).astype(int)
    row = np.floor((control.north_m - grid.pose.position.y) / grid.cell_size.y).astype(int)
    data = np.frombuffer(grid.data, dtype=np.uint8).reshape(-1, grid.column_count, 5)
    inside = (column >= 0) & (row >= 0) & (column < data.shape[1]) & (row < len(data))
    cells = data[row[inside], column[inside]].astype(np.int64)
    found = np.full(len(column), -1, dtype=np.int64)
    found[inside] = np.where(cells[:, 3] == 255, cells[:, 4], -1)
    np.testing.assert_array_equal(found, control.density)
    track = exports.track
    for feature in json.loads(shapes.geojson)["features"]:
        about = feature["properties"]
        if about["layer"] == "obstacle":
            assert shapely.from_geojson(json.dumps(feature["geometry"])).is_valid
            continue
        first, last = np.searchsorted(track.time_ns, [about["first_ns"], about["last_ns"]])
        driven = np.column_stack([track.east_m, track.north_m])[first : last + 1]
        places = np.array(feature["geometry"]["coordinates"])[:, ::-1]
        np.testing.assert_allclose(plane_of(exports, places), driven, atol=CENTIMETRE)


def test_the_planner(exports: Exports, two_lanes_map: Path) -> None:
    control = exports.control
    with open_map(two_lanes_map) as universal:
        costmap = Costmap.from_map(universal)
    said = costmap.at_latlon(control.lat_deg, control.lon_deg)
    np.testing.assert_array_equal(said.known, control.counts_as >= 0)
    np.testing.assert_array_equal(said.cost == 254, control.counts_as > 100)
    np.testing.assert_array_equal(said.cost == 0, control.occupancy == 0)


# --- GDAL and QGIS of the system ------------------------------------------------------------------


@lru_cache
def installed(module: str) -> bool:
    """Whether the system's Python has it."""
    if not PYTHON.exists():
        return False
    return subprocess.run([PYTHON, "-c", f"import {module}"], capture_output=True).returncode == 0


@pytest.fixture(scope="module")
def found(exports: Exports, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What GDAL, and QGIS where it is, find in the files."""
    if not installed("osgeo.gdal_array"):
        pytest.skip("GDAL for the system's Python (Debian's python3-gdal) is not installed")
    control, home = exports.control, tmp_path_factory.mktemp("home")
    asked = {
        "points": np.column_stack([control.lat_deg, control.lon_deg]).tolist(),
        "gdal": [str(exports.folder / name) for name in BY_GDAL],
        "qgis": [str(exports.folder / name) for name in BY_QGIS if installed("qgis.core")],
    }
    done = subprocess.run(
        [PYTHON, READERS],
        input=json.dumps(asked),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={
            "PATH": os.environ["PATH"],
            "HOME": str(home),
            "QT_QPA_PLATFORM": "offscreen",
            "XDG_RUNTIME_DIR": str(home),
        },
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def of_reader(found: dict[str, Any], reader: str, path: Path) -> dict[str, Any]:
    if reader not in found:
        pytest.skip("QGIS's library (Debian's python3-qgis) is not installed")
    said: dict[str, Any] = found[reader][str(path)]
    return said


def check_cells(said: dict[str, Any], control: Control) -> None:
    density = [-1 if cell is None or cell[1] == 0 else cell[0] for cell in said["cells"]]
    assert {cell[1] for cell in said["cells"] if cell is not None} == {0, 255}
    np.testing.assert_array_equal(density, control.density)


@pytest.mark.parametrize("name", PICTURES)
def test_gdal_reads_pictures(exports: Exports, found: dict[str, Any], name: str) -> None:
    check_cells(of_reader(found, "gdal", exports.folder / name), exports.control)


def test_gdal_reads_the_kmz(exports: Exports, found: dict[str, Any]) -> None:
    said = of_reader(found, "gdal", exports.folder / "v.kmz")
    check_cells(said, exports.control)
    track = exports.track
    driven = np.column_stack([track.east_m, track.north_m])[track.accepted]
    np.testing.assert_allclose(plane_of(exports, said["poses"]), driven, atol=CENTIMETRE)


@pytest.mark.parametrize("name", ["v.tif", "v.png"])
def test_qgis_reads_pictures(exports: Exports, found: dict[str, Any], name: str) -> None:
    check_cells(of_reader(found, "qgis", exports.folder / name), exports.control)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("reader", ["gdal", "qgis"])
def test_gdal_and_qgis_read_shapes(
    exports: Exports, found: dict[str, Any], reader: str, name: str
) -> None:
    said = of_reader(found, reader, exports.folder / name)
    np.testing.assert_array_equal(said["obstacle"], exports.control.density > 100)
    track = exports.track
    known = np.isfinite(track.east_m)
    driven = np.column_stack([track.east_m, track.north_m])[known]
    np.testing.assert_allclose(plane_of(exports, said["poses"]), driven, atol=CENTIMETRE)
