"""The terrain of a real lidar drive against the ground raster of its own survey.

python -m benchmarks.lidar_ground LOG

LOG is a drive of Argoverse 2 (sweeps, poses, `map/*ground_height_surface*`). Its sweeps and poses
become a map; the layer `ground` is compared with the raster, which is interpolated, at the middle
of cells of 0.25 m. Then the points of the sweeps themselves are, without a map: what they and the
raster differ by is no error of the map.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from fieldgrid.core import Bool, Float64, Int64, resolve
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import DriveOptions, PoseSource
from tests.perception.test_lidar_drive import EAST_M, NORTH_M, UTM, Drive, read_drive, recorded

CELL_M, EVERY = 0.25, 4
NEAR_M, SIDE_M, EVEN_M = 0.35, 10.0, 0.1
"""Points so near to the raster are on the ground; those of the map's width are compared. The
slope of the errors is that of cells less apart."""
BANDS_M = ((0.0, 15.0), (15.0, 30.0), (0.0, 30.0))
SETTINGS = {
    "grid": {"width_m": 20.0, "length_m": 30.0, "cell_m": 0.1},
    "density": {"max_range_m": 30.0},
    "pose": {"cell_budget_m": 0.6},
}


class Ground(NamedTuple):
    """Cells with a height: map minus raster, its stated sigma, the distance ahead of the nearest
    sweep, all in metres."""

    error_m: Float64
    sigma_m: Float64
    ahead_m: Float64

    def within(self, nearest_m: float, farthest_m: float) -> Bool:
        return (self.ahead_m >= nearest_m) & (self.ahead_m < farthest_m)


def map_of(drive: Drive, folder: Path) -> Path:
    """A map of the sweeps, placed by the drive's own poses."""
    recording, poses, out = (
        recorded(drive, folder / "drive"),
        folder / "city.tum",
        folder / "m.gpkg",
    )
    quaternions = Rotation.from_matrix(drive.R_city_ego).as_quat()
    with poses.open("w") as file:
        for time_ns, place, turn in zip(
            drive.time_ns[::EVERY], drive.city_m[::EVERY], quaternions[::EVERY], strict=True
        ):
            seconds = f"{time_ns // 10**9}.{time_ns % 10**9:09d}"
            print(seconds, *(f"{value:.9f}" for value in (*place, *turn)), file=file)
    source = PoseSource(poses, axes="flu", point_flu_m=(0.0, 0.0, 0.0))
    build_map([recording], out, resolve(None, SETTINGS), DriveOptions(poses=source))
    return out


def ground_of(drive: Drive, path: Path) -> Ground:
    """The ground of a map against the raster."""
    with open_map(path) as universal:
        view = universal.read(cell_m=CELL_M, layers=("ground", "ground_sigma"))
        poses = [frame.pose for frame in universal.frames()]
        up_m, sigma_m = (view.layer(name).astype(float) for name in ("ground", "ground_sigma"))
        row, column = np.nonzero(np.isfinite(up_m))
        east, north = view.lattice.centres(view.window)
        east, north = east[column], north[row]
        lat, lon, height_m = universal.datum.to_geodetic(east, north, up_m[row, column])
    x, y = UTM.transform(lon, lat, direction="INVERSE")
    R = np.array(drive.to_raster["R"]).reshape(2, 2)
    cells = np.stack([x - EAST_M, y - NORTH_M], axis=1) @ R.T + drive.to_raster["t"]
    at = cells.T[::-1] * drive.to_raster["s"] - 0.5
    error_m = height_m - map_coordinates(drive.raster_m, at, order=1, cval=np.nan)
    ahead_m = [
        (east - pose.east_m) * np.sin(np.radians(pose.heading_deg))
        + (north - pose.north_m) * np.cos(np.radians(pose.heading_deg))
        for pose in poses
    ]
    known = np.isfinite(error_m)
    return Ground(
        error_m[known], sigma_m[row, column][known], np.min(np.maximum(ahead_m, 0.0), axis=0)[known]
    )


class Points(NamedTuple):
    """Cells of the city with points of a sweep near the raster's ground: their numbers, median
    height above the raster and distance ahead, metres, and the slope of all these errors, degrees
    ahead and to the left."""

    cell: Int64
    error_m: Float64
    ahead_m: Float64
    slope_deg: Float64


def points_of(drive: Drive, time_ns: int) -> Points:
    """The points of a sweep against the raster."""
    k = int(np.flatnonzero(drive.time_ns == time_ns)[0])
    ego = drive.sweeps[time_ns].astype(np.float64)
    x, y = ego[:, 0], ego[:, 1]
    city = ego @ drive.R_city_ego[k].T + drive.city_m[k]
    R = np.array(drive.to_raster["R"]).reshape(2, 2)
    at = (city[:, :2] @ R.T + drive.to_raster["t"]).T[::-1] * drive.to_raster["s"] - 0.5
    error_m = city[:, 2] - map_coordinates(drive.raster_m, at, order=1, cval=np.nan)
    near = (np.abs(error_m) < NEAR_M) & (x > 0.0) & (x < BANDS_M[-1][1]) & (np.abs(y) < SIDE_M)
    number = np.floor(city[near, :2] / CELL_M).astype(np.int64) @ [1 << 32, 1]
    order = np.argsort(number, kind="stable")
    cell, first = np.unique(number[order], return_index=True)
    rows = np.split(np.flatnonzero(near)[order], first[1:])
    median_m, ahead_m, left_m = (
        np.array([np.median(values[own]) for own in rows]) for values in (error_m, x, y)
    )
    plane = np.stack([np.ones(len(rows)), ahead_m, left_m], axis=1)
    even = np.abs(median_m - np.median(median_m)) < EVEN_M  # kerbs are not
    slope = np.linalg.lstsq(plane[even], median_m[even], rcond=None)[0]
    return Points(cell, median_m, ahead_m, np.degrees(np.arctan(slope[1:])))


def about_points(drive: Drive) -> Iterator[str]:
    """What the points of both sweeps say of the raster, a line each."""
    one, two = (points_of(drive, time_ns) for time_ns in drive.sweeps)
    for nearest_m, farthest_m in BANDS_M:
        for sweep in (one, two):
            error_m = sweep.error_m[(sweep.ahead_m >= nearest_m) & (sweep.ahead_m < farthest_m)]
            yield (
                f"points of a sweep, {nearest_m:2.0f} - {farthest_m:2.0f} m ahead: RMS "
                f"{100 * np.sqrt(np.mean(error_m**2)):.1f} cm off the raster, mean "
                f"{100 * error_m.mean():+.1f} cm, {error_m.size} cells"
            )
    for sweep in (one, two):
        yield "slope of these errors: {:+.3f}° ahead, {:+.3f}° to the left".format(*sweep.slope_deg)
    _, a, b = np.intersect1d(one.cell, two.cell, return_indices=True)
    apart_m = one.error_m[a] - two.error_m[b]
    yield (
        f"the same {a.size} cells in both sweeps: {100 * np.median(np.abs(apart_m)):.1f} cm apart "
        f"(median), errors correlated by {np.corrcoef(one.error_m[a], two.error_m[b])[0, 1]:.2f}"
    )


def main() -> None:
    """Print the errors by the distance ahead."""
    drive = read_drive(Path(sys.argv[1]))
    with tempfile.TemporaryDirectory() as folder:
        ground = ground_of(drive, map_of(drive, Path(folder)))
    for band in BANDS_M:
        there = ground.within(*band)
        error_m, sigma_m = ground.error_m[there], ground.sigma_m[there]
        rmse_cm = 100 * np.sqrt(np.mean(error_m**2))
        print(
            f"{band[0]:2.0f} - {band[1]:2.0f} m ahead: RMSE {rmse_cm:.1f} cm, "
            f"bias {100 * error_m.mean():+.1f} cm, {there.sum()} cells, "
            f"{100 * np.mean(np.abs(error_m) <= 3 * sigma_m):.1f} % within 3 sigma"
        )
    print("\n".join(about_points(drive)))


if __name__ == "__main__":
    main()
