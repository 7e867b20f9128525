"""`python -m benchmarks.live_end [--hours 2] [--imu]`: the memory that the end of a session takes.

The journal of a drive of ten pairs a second is written as a session does it, with a receiver of
5 Hz, a gyro of 20 Hz and the camera's steps, and small grids; then the map is made of it. Each
line is the most that the process held until a part of that was done.
"""

from __future__ import annotations

import argparse
import math
import resource
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live_long import DATUM, START_NS, imu, vehicle
from fieldgrid.core import BuildSettings, Quality
from fieldgrid.geometry import Fix, GridSpec, LeverArm, LocalGrid, Mount, Rig, StereoCamera
from fieldgrid.live import finish, finish_session
from fieldgrid.live.kept import session_folder
from fieldgrid.live.pose.sensor_rows import rows_of
from fieldgrid.maps import stage
from fieldgrid.perception import CameraStep
from fieldgrid.pipeline import DriveStart, StageTimes, session

CAMERA = StereoCamera(640, 480, 500.0, 319.5, 239.5, 0.2)
RIG = Rig(CAMERA, Mount(2.0, 15.0), LeverArm(0.0, 0.0, 2.0), rear_axle_forward_m=0.0)
SETTINGS = BuildSettings(
    grid={"width_m": 2.0, "length_m": 4.0, "cell_m": 0.25}, map={"cell_m": 0.25}
)
FRAME_HZ, FIX_HZ, GYRO_HZ = 10, 5, 20


def main() -> None:
    """Write a journal, make the map of it, and print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--hours", type=float, default=2.0)
    options.add_argument("--imu", action="store_true", help="all axes of an IMU, too")
    chosen = options.parse_args()
    for module, name, what in (
        (session_folder.SessionFolder, "read", "the journal read"),
        (finish, "NewSession", "the poses without the camera's steps"),
        (session, "estimate_drive", "the poses"),
        (session, "_place", "the frames placed"),
    ):
        setattr(module, name, told(getattr(module, name), what))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "map.gpkg"
        count = write_journal(out, round(3600.0 * chosen.hours), has_imu=chosen.imu)
        print(f"{count} frames")
        # Two hours of these steps are taken for a jump of a clock, which there is not.
        report = finish_session(out, {"checks": {"accept": ["clock-jump"]}})
        print(f"the map of {report.used} frames: {most_mb():.0f} MB")


def told(work: Callable[..., Any], what: str) -> Callable[..., Any]:
    """The same work, after which the most memory until then is printed."""

    def call(*given: Any, **named: Any) -> Any:
        done = work(*given, **named)
        print(f"{what}: {most_mb():.0f} MB", flush=True)
        return done

    return call


def most_mb() -> float:
    """The most that the process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def write_journal(out: Path, seconds: int, *, has_imu: bool) -> int:
    """The journal of a session for a map; its number of frames."""
    spec, random = GridSpec.of(SETTINGS.grid), np.random.default_rng(0)
    grid = LocalGrid(spec, np.zeros(spec.shape, np.uint8), np.ones(spec.shape, np.bool_))
    seen, count, before = stage(grid, "", 0), 0, (0.0, 0.0, 0.0)
    about = DriveStart("long", RIG, SETTINGS, DATUM)
    with session_folder.SessionFolder(out, about, points_gb=0.0) as kept:
        for at_s in np.arange(seconds * GYRO_HZ) / GYRO_HZ:
            time_ns, tick = START_NS + round(1e9 * at_s), round(at_s * GYRO_HZ)
            east_m, north_m, heading_rad, rate_rad_s = vehicle(float(at_s))
            noise = random.normal(0.0, 0.01, 3)
            kept.add_rows("gyro", rows_of("gyro", time_ns, rate_rad_s + 0.1 * noise[0]))
            if has_imu:
                kept.add_rows("inertial", rows_of("inertial", time_ns, *imu(rate_rad_s, noise)))
            if tick % (GYRO_HZ // FIX_HZ) == 0:
                place = DATUM.to_geodetic(east_m + noise[0], north_m + noise[1], 2.0 + noise[2])
                fix = Fix(time_ns, *map(float, place), Quality.RTK_FIXED, 14, sigma_m=0.02)
                kept.add_fix(fix)
            if tick % (GYRO_HZ // FRAME_HZ) == 0:
                found = step(before, (east_m, north_m, heading_rad), noise) if count else None
                before = east_m, north_m, heading_rad
                images = {"images": (f"{count}/left",), "images_sha256": (f"{count:064x}",)}
                frame = replace(seen, frame_id=f"{count:06d}", time_ns=time_ns, **images)
                kept.keep(count, frame, found, StageTimes(), (False, False))
                count += 1
    return count


def step(
    start: tuple[float, float, float], stop: tuple[float, float, float], noise: np.ndarray
) -> CameraStep:
    """The camera's step between two places, metres east and north, and heading in radians."""
    east_m, north_m, turn_rad = np.subtract(stop, start)
    sine, cosine = math.sin(start[2]), math.cos(start[2])
    forward_m = east_m * sine + north_m * cosine + 0.2 * noise[0]
    right_m = east_m * cosine - north_m * sine + 0.1 * noise[1]
    turn_deg = (math.degrees(turn_rad) + 180.0) % 360.0 - 180.0 + noise[2]
    return CameraStep(forward_m, right_m, turn_deg, 0.005, 0.05, 0.0, 0.0, 0.0, 0.1, 100)


if __name__ == "__main__":
    main()
