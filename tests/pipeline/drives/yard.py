"""A lidar that turns while it drives in a circle between the walls of a yard."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fieldgrid.geometry import OBSTACLE_ABOVE, Datum
from fieldgrid.maps import open_map

_Floats = npt.NDArray[np.float64]

DATUM = Datum(41.65, -4.72, 700.0)
START_NS = 1_780_000_000_000_000_000
SPEED_MPS, RATE_RAD_S = 2.5, 0.6
"""In a circle to the right, of 4.2 m."""
LASTS_S, SWEEPS, BEGINS_S = 0.1, 10, 2.0
HALF_M, HEIGHT_M, WALL_M = 9.0, 1.8, 1.6
"""The yard is a square of 18 m with walls 1.6 m high, the lidar 1.8 m above the ground."""
SETTINGS = {
    "grid": {"width_m": 20.0, "length_m": 15.0, "cell_m": 0.1},
    "map": {"cell_m": 0.1},
}


def place(after_s: npt.ArrayLike) -> tuple[_Floats, _Floats, _Floats]:
    """East, north and heading (radians) of the lidar, which is the antenna, too."""
    heading = RATE_RAD_S * np.asarray(after_s, dtype=np.float64)
    radius_m = SPEED_MPS / RATE_RAD_S
    return -radius_m * np.cos(heading), radius_m * np.sin(heading), heading


def swept(begin_s: float) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """One turn: points forward, left, up of where the lidar was at each of them, and when, ns."""
    turn, elevation = np.meshgrid(
        np.linspace(0.0, 2.0 * math.pi, 900, endpoint=False), np.radians(np.linspace(-30, 3, 48))
    )
    turn, elevation = turn.ravel(), elevation.ravel()
    after_s = turn / (2.0 * math.pi) * LASTS_S
    east, north, heading = place(begin_s + after_s)
    way = heading + turn  # clockwise, as such lidars turn
    d_east, d_north = np.sin(way), np.cos(way)
    with np.errstate(divide="ignore"):
        to_east_m = (np.sign(d_east) * HALF_M - east) / d_east
        to_north_m = (np.sign(d_north) * HALF_M - north) / d_north
        level_m = np.where(elevation < 0.0, HEIGHT_M / -np.tan(elevation), np.inf)
    range_m = np.minimum(np.minimum(to_east_m, to_north_m), level_m)
    up = range_m * np.tan(elevation)
    hit = up < WALL_M - HEIGHT_M
    points = np.stack([range_m * np.cos(turn), -range_m * np.sin(turn), up], axis=1)[hit]
    return points.astype(np.float32), np.rint(after_s[hit] * 1e9).astype(np.uint32)


def recorded(folder: Path, *, timed: bool = True, settings: str = "") -> Path:
    """The drive as a plain folder: clouds as PLY, fixes of RTK at 10 Hz, a gyro."""
    for name in ("clouds", "gnss", "calibration", "imu"):
        (folder / name).mkdir(parents=True)
    for k in range(SWEEPS):
        begin_s = BEGINS_S + 0.5 * k
        points, after_ns = swept(begin_s)
        names = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")]
        vertices = np.zeros(len(points), dtype=names if timed else names[:3])
        for axis, column in zip("xyz", points.T, strict=True):
            vertices[axis] = column
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        header += "property float x\nproperty float y\nproperty float z\n"
        if timed:
            vertices["t"] = after_ns
            header += "property uint t\n"
        stamp_ns = START_NS + round(begin_s * 1e9)
        data = header.encode() + b"end_header\n" + vertices.tobytes()
        (folder / "clouds" / f"{stamp_ns}.ply").write_bytes(data)
    mounting = {
        "camera_height_above_ground_m": HEIGHT_M,
        "camera_tilt_down_deg": 0.0,
        "gnss_antenna_from_camera_mid_flu_m": [0.0, 0.0, 0.0],
        "camera_mid_from_rear_axle_ground_flu_m": [0.0, 0.0, HEIGHT_M],
        "imu_axes": "flu",
    }
    (folder / "calibration" / "mounting.json").write_text(json.dumps(mounting))
    times_s = np.arange(0.0, 12.0, 0.1)
    with (folder / "gnss" / "fixes.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_ns", "lat_deg", "lon_deg", "height_m", "quality"])
        east, north, _ = place(times_s)
        lat, lon, height = DATUM.to_geodetic(east, north, np.full(len(east), HEIGHT_M))
        for row in zip(
            START_NS + np.rint(times_s * 1e9).astype(int), lat, lon, height, strict=True
        ):
            table.writerow([row[0], f"{row[1]:.10f}", f"{row[2]:.10f}", f"{row[3]:.4f}", 4])
    with (folder / "imu" / "gyro.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time_ns", "gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s"])
        for at_s in np.arange(0.0, 12.0, 0.02):
            table.writerow([START_NS + round(at_s * 1e9), 0, 0, -RATE_RAD_S])
    (folder / "recording.toml").write_text(
        "[datum]\nlat_deg = 41.65\nlon_deg = -4.72\nheight_m = 700.0\n" + settings
    )
    return folder


def off_m(out: Path) -> _Floats:
    """How far the obstacles of a map are off the walls, metres."""
    with open_map(out) as universal:
        view = universal.read()
    j, i = np.nonzero(view.density > OBSTACLE_ABOVE)
    east = (view.window.i0 + i + 0.5) * view.lattice.cell_m
    north = (view.window.j0 + j + 0.5) * view.lattice.cell_m
    return np.asarray(np.abs(np.maximum(np.abs(east), np.abs(north)) - HALF_M))
