"""A real lidar drive through a town: clouds to local grids and to a map, against its own raster."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pyproj
import pytest
from scipy.ndimage import maximum_filter

from fieldgrid.core import DensitySettings, resolve
from fieldgrid.geometry import (
    OBSTACLE_ABOVE,
    Datum,
    GridSpec,
    LeverArm,
    Lidar,
    LocalGrid,
    Mount,
    Rig,
)
from fieldgrid.maps import open_map
from fieldgrid.perception import FrameGround, LocalGridder, points_per_sr
from fieldgrid.pipeline import build_map, local_grid
from fieldgrid.recordings import CloudFrame, open_recording
from fieldgrid.recordings.frames.cloud_files import to_optical

pyarrow_feather = pytest.importorskip("pyarrow.feather")

_Float64 = npt.NDArray[np.float64]
_Float32 = npt.NDArray[np.float32]

LOG = "av2_lidar_pose_groundheight/7fab2350-7eaf-3b7e-a39d-6937a4c1bede"
UTM = pyproj.Transformer.from_crs("EPSG:32617", "EPSG:4326", always_xy=True)
EAST_M, NORTH_M = UTM.transform(-80.01294377242584, 40.44177902989321, direction="INVERSE")
"""The origin of the city frame in UTM 17N."""
HEIGHT_M = 0.32
"""Of the middle of the rear axle, the origin of the clouds, above the road."""
AHEAD = GridSpec(10.0, 15.0, 0.05)
STREET = GridSpec(20.0, 30.0, 0.1)
FAR = DensitySettings(max_range_m=30.0)

SharedData = Callable[[str], Path]


class Drive(NamedTuple):
    """Times, rotations and positions of the ego frame (x forward, y left, z up) in the city, the
    sweeps in the ego frame by time, and the height of the ground."""

    time_ns: npt.NDArray[np.int64]
    R_city_ego: _Float64
    city_m: _Float64
    sweeps: dict[int, _Float32]
    raster_m: _Float64
    to_raster: dict[str, list[float]]

    def ground_m(self, xy: _Float64) -> _Float64:
        """Height of the ground at points [n, 2] of the city."""
        R = np.array(self.to_raster["R"]).reshape(2, 2)
        cells = (xy @ R.T + self.to_raster["t"]) * self.to_raster["s"]
        return self.raster_m[np.floor(cells[:, 1]).astype(int), np.floor(cells[:, 0]).astype(int)]

    def heights(self, time_ns: int, x: _Float64, y: _Float64) -> _Float64:
        """z of the ground in the ego frame at points right and ahead, by the raster."""
        k = int(np.flatnonzero(self.time_ns == time_ns)[0])
        z = np.zeros(x.size)
        for _ in range(5):
            city = np.stack([y.ravel(), -x.ravel(), z], axis=1) @ self.R_city_ego[k].T
            city = city + self.city_m[k]
            z = z + self.ground_m(city[:, :2]) - city[:, 2]
        return z.reshape(x.shape)


@pytest.fixture
def drive(shared_data: SharedData) -> Drive:
    return read_drive(shared_data(LOG))


def read_drive(folder: Path) -> Drive:
    """A log of Argoverse 2 with its raster."""

    def columns(path: Path, names: str) -> _Float64:
        table = pyarrow_feather.read_table(path)
        return np.stack([table[name].to_numpy() for name in names.split()], axis=1)

    (raster,) = (folder / "map").glob("*.npy")
    (similarity,) = (folder / "map").glob("*.json")
    poses = folder / "city_SE3_egovehicle.feather"
    w, x, y, z = columns(poses, "qw qx qy qz").T
    rotations = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    sweeps = sorted((folder / "sensors" / "lidar").glob("*.feather"))
    return Drive(
        columns(poses, "timestamp_ns")[:, 0].astype(np.int64),
        np.moveaxis(rotations, 2, 0),
        columns(poses, "tx_m ty_m tz_m"),
        {int(p.stem): columns(p, "x y z").astype(np.float32) for p in sweeps},
        np.load(raster).astype(np.float64),
        json.loads(similarity.read_text()),
    )


def rig_of(points: _Float32) -> Rig:
    return Rig(Lidar(points_per_sr(points)), Mount(HEIGHT_M, 0.0), LeverArm(0.0, 0.0, HEIGHT_M))


def grids_of(
    drive: Drive, spec: GridSpec, density: DensitySettings | None = None
) -> list[tuple[int, _Float32, LocalGrid, FrameGround]]:
    found = []
    for time_ns, flu in drive.sweeps.items():
        points = to_optical(flu, "flu")
        gridder = LocalGridder(rig_of(points), spec, density=density)
        found.append((time_ns, points, *gridder.from_cloud(points)))
    return found


def test_the_ground_is_that_of_the_raster(drive: Drive) -> None:
    x, y = np.meshgrid(np.arange(-4.75, 5.0, 0.5), np.arange(2.0, 14.0, 0.5))
    for time_ns, _, _, ground in grids_of(drive, AHEAD):
        z = drive.heights(time_ns, x, y)
        plane = np.stack([np.ones(x.size), x.ravel(), y.ravel()], axis=1)
        level, right, ahead = np.linalg.lstsq(plane, z.ravel())[0]
        assert ground.refined
        assert ground.camera_height_m == pytest.approx(-level, abs=0.04)
        assert ground.pitch_deg == pytest.approx(math.degrees(math.atan(ahead)), abs=0.3)
        assert ground.roll_deg == pytest.approx(math.degrees(math.atan(right)), abs=0.3)


def test_cars_and_walls_are_obstacles_and_the_road_is_free(drive: Drive) -> None:
    """Against the raster: what stands at least half a metre above it, and what lies on it."""
    for time_ns, points, grid, _ in grids_of(drive, STREET, FAR):
        x, y, z = points[:, 0].astype(float), points[:, 2].astype(float), -points[:, 1]
        near = (np.abs(x) < 9.9) & (y > 1.5) & (np.hypot(x, y) < 29.5)
        x, y, z = x[near], y[near], z[near]
        above = z - drive.heights(time_ns, x, y)
        column, row = ((x + 10.0) / 0.1).astype(int), (y / 0.1).astype(int)
        value, seen = grid.density[row, column], grid.observed[row, column]
        obstacle = grid.density > OBSTACLE_ABOVE
        standing = np.zeros(STREET.shape, dtype=np.bool_)
        standing[row[above > 0.15], column[above > 0.15]] = True

        tall, road = (above > 0.5) & (above < 1.8), (np.abs(above) < 0.08) & (np.abs(x) < 6.0)
        assert tall.sum() > 1000
        assert (value[tall] > OBSTACLE_ABOVE).mean() > 0.8
        assert maximum_filter(obstacle, 3)[row, column][tall].mean() > 0.9
        assert road.sum() > 1500
        assert (value[road] == 0).mean() > 0.99
        assert seen[road].mean() > 0.9
        obstacle[:16], obstacle[290:] = False, False  # of which no points were looked at
        assert obstacle.sum() > 200
        assert maximum_filter(standing, 3)[obstacle].mean() > 0.98


def test_the_order_of_points_does_not_matter(drive: Drive) -> None:
    _, points, grid, ground = grids_of(drive, AHEAD)[0]
    turned = points[np.random.default_rng(0).permutation(len(points))]
    again, ground_again = LocalGridder(rig_of(turned), AHEAD).from_cloud(turned)
    assert ground_again[:4] == ground[:4]
    for one, other_one in zip(ground_again[4:], ground[4:], strict=True):
        np.testing.assert_array_equal(one, other_one)
    assert np.array_equal(again.density, grid.density)
    assert np.array_equal(again.observed, grid.observed)


# --- as a recording


def recorded(drive: Drive, folder: Path) -> Path:
    """The drive as a plain folder: clouds in two formats, fixes of the antenna on the axle."""
    for name in ("clouds", "gnss", "calibration"):
        (folder / name).mkdir(parents=True)
    for (time_ns, flu), suffix in zip(drive.sweeps.items(), ("npy", "bin"), strict=True):
        path = folder / "clouds" / f"{time_ns}.{suffix}"
        if suffix == "npy":
            np.save(path, flu)
        else:
            np.column_stack([flu, np.zeros(len(flu))]).astype("<f4").tofile(path)
    mounting = {
        "camera_height_above_ground_m": HEIGHT_M,
        "camera_tilt_down_deg": 0.0,
        "gnss_antenna_from_camera_mid_flu_m": [0.0, 0.0, 0.0],
        "camera_mid_from_rear_axle_ground_flu_m": [0.0, 0.0, HEIGHT_M],
    }
    (folder / "calibration" / "mounting.json").write_text(json.dumps(mounting))
    with (folder / "gnss" / "poses.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_ns", "lat_deg", "lon_deg", "height_m", "quality"])
        for time_ns, (x, y, z) in zip(drive.time_ns[::17], drive.city_m[::17], strict=True):
            lon, lat = UTM.transform(EAST_M + x, NORTH_M + y)
            table.writerow([time_ns, f"{lat:.9f}", f"{lon:.9f}", f"{z:.4f}", 4])
    return folder


def test_a_map_is_built_from_clouds(drive: Drive, tmp_path: Path) -> None:
    folder, out = recorded(drive, tmp_path / "drive"), tmp_path / "map.gpkg"
    tables = {
        "grid": {"width_m": 20.0, "length_m": 30.0, "cell_m": 0.1},
        "density": {"max_range_m": 30.0},
        "pose": {"cell_budget_m": 0.6},
    }
    settings = resolve(None, tables)
    (report,) = build_map([folder], out, settings)
    assert (report.used, report.ground_refined, report.max_range_m) == (2, 2, 30.0)
    assert any("no stereo pairs" in note for note in report.notes)
    assert any("points in a steradian" in note for note in report.notes)

    with open_recording(folder) as recording, open_map(out) as universal:
        frames = list(recording.frames())
        assert all(isinstance(frame, CloudFrame) for frame in frames)
        assert {stream.role for stream in recording.streams()} == {"cloud", "fix"}
        assert isinstance(recording.rig.sensor, Lidar)
        for frame in frames:
            direct, _ = LocalGridder(recording.rig, STREET, density=FAR).from_cloud(
                to_optical(drive.sweeps[frame.time_ns], "flu")
            )
            assert np.array_equal(
                local_grid(frame, recording.rig, settings).density, direct.density
            )
        (session,) = universal.sessions()
        assert "search" not in session.config
        assert session.config["rig"]["lidar"]["points_per_sr"] > 10_000
        view = universal.read()
        obstacle = maximum_filter(view.density > OBSTACLE_ABOVE, 7)  # 0.3 m around
        for time_ns, flu in drive.sweeps.items():
            i, j = view.lattice.index(*tall_points(drive, time_ns, flu, universal.datum).T)
            hit = obstacle[j - view.window.j0, i - view.window.i0]
            assert len(hit) > 1000
            assert hit.mean() > 0.9


def tall_points(drive: Drive, time_ns: int, flu: _Float32, datum: Datum) -> _Float64:
    """East and north of what stands before the vehicle by the drive's own poses, [n, 2]."""
    k = int(np.flatnonzero(drive.time_ns == time_ns)[0])
    x, y = -flu[:, 1].astype(float), flu[:, 0].astype(float)
    near = (np.abs(x) < 9.0) & (y > 2.0) & (np.hypot(x, y) < 28.0)
    above = flu[near, 2] - drive.heights(time_ns, x[near], y[near])
    tall = flu[near][(above > 0.5) & (above < 1.8)].astype(float)
    city = tall @ drive.R_city_ego[k].T + drive.city_m[k]
    lon, lat = UTM.transform(EAST_M + city[:, 0], NORTH_M + city[:, 1])
    return np.stack(datum.to_enu(lat, lon, city[:, 2])[:2], axis=-1)


def test_the_terrain_of_a_map_is_that_of_the_raster(drive: Drive, tmp_path: Path) -> None:
    """The raster lies 7 to 8 cm (RMS) from the points on the road themselves."""
    from benchmarks.lidar_ground import ground_of, map_of

    ground = ground_of(drive, map_of(drive, tmp_path))
    near = ground.within(0.0, 15.0)
    assert near.sum() > 800
    assert np.sqrt(np.mean(ground.error_m[near] ** 2)) < 0.04
    assert np.sqrt(np.mean(ground.error_m**2)) < 0.065
    assert (np.abs(ground.error_m) <= 3.0 * ground.sigma_m).mean() > 0.99
