"""`python -m benchmarks.live_long [--hours 8] [--rate 30] [--imu]`: a live session of many
simulated hours.

A depth camera of 160 x 120 pixels looks twice a second at level ground with a post now and then,
from a vehicle that drives lane after lane at 1.5 m/s, with a receiver of 5 Hz and a gyro of 20 Hz;
time runs `rate` times as fast. With `--imu` all axes of an IMU are pushed, too, so that grids are
level and the points of frames are kept to the end. Each line is a part of the drive: what the
process holds in memory, what the session has on the disk, how long grids took, and what processor
time a frame with all that is between two took, which other work on the machine hardly changes. At
the end the map is made.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from fieldgrid.core import BuildSettings, Quality
from fieldgrid.geometry import Datum, DepthCamera, Fix, LeverArm, Mount, Rig
from fieldgrid.live import Live, LiveGrid, LiveResult

DATUM = Datum(41.65, -4.72, 787.4)
RIG = Rig(
    DepthCamera(160, 120, 125.0, 125.0, 79.5, 59.5),
    Mount(1.5, 20.0),
    LeverArm(0.0, 0.0, 1.5),
    rear_axle_forward_m=0.0,
)
SETTINGS = BuildSettings(
    grid={"width_m": 4.0, "length_m": 6.0, "cell_m": 0.1}, map={"cell_m": 0.25}
)
SPEED_MPS, LANE_M, TURN_M = 1.5, 200.0, 3.0
START_NS = 1_790_000_000_000_000_000
FIX_HZ, GYRO_HZ, FRAME_HZ, PARTS = 5, 20, 2, 16


def main() -> None:
    """Drive, and print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--hours", type=float, default=8.0)
    options.add_argument("--rate", type=float, default=30.0)
    options.add_argument("--imu", action="store_true", help="push all axes of an IMU, too")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        drive(Path(folder) / "map.gpkg", chosen.hours, chosen.rate, has_imu=chosen.imu)


def drive(out: Path, hours: float, rate: float, *, has_imu: bool) -> None:
    """One session; `rate` times as fast as it would be."""
    to_grid: list[float] = []
    lock = threading.Lock()

    def take(result: LiveResult) -> None:
        if isinstance(result, LiveGrid):
            with lock:
                to_grid.append(1e3 * result.latency_s)

    print("hours   frames  memory, MB  disk, MB  bytes a frame  grid ms, 50 / 99 %  processor ms")
    seconds = round(3600.0 * hours)
    began_s = time.monotonic()
    spent_s = time.process_time()
    live = Live(out, RIG, SETTINGS, name="long", datum=DATUM, on_result=take)
    part_s, part_frames = time.process_time(), 0
    noise_m = np.random.default_rng(0).normal(0.0, 0.01, (FIX_HZ * 1000, 3))
    for second in range(seconds):
        push(live, float(second), noise_m, has_imu=has_imu)
        time.sleep(max(0.0, began_s + (second + 1) / rate - time.monotonic()))
        if (second + 1) % max(seconds // PARTS, 1) == 0:
            live.drain()
            held = sum(path.stat().st_size for path in live.folder.iterdir())
            frames = live.counts.frames
            frame_ms = 1e3 * (time.process_time() - part_s) / (frames - part_frames)
            part_s, part_frames = time.process_time(), frames
            with lock:
                grids = to_grid[:]
                to_grid.clear()
            print(
                f"{(second + 1) / 3600.0:>5.2f}{frames:>9}{memory_mb():>12.1f}{held / 1e6:>10.1f}"
                f"{held / frames:>15.0f}{shown(grids):>20}{frame_ms:>14.1f}",
                flush=True,
            )
    print(f"dropped {live.counts.dropped}, took {time.monotonic() - began_s:.0f} s, of it")
    print(f"{time.process_time() - spent_s:.0f} s of the processor")
    began_s = time.monotonic()
    report = live.finish()
    took_s = time.monotonic() - began_s
    print(f"the map of {report.used} of {report.frames} frames took {took_s:.0f} s and has")
    print(f"{out.stat().st_size / 1e6:.1f} MB; {memory_mb():.0f} MB in memory after it")


def push(live: Live, second: float, noise_m: np.ndarray, *, has_imu: bool) -> None:
    """What the sensors say in one second."""
    for k in range(GYRO_HZ):
        at_s = second + k / GYRO_HZ
        time_ns = START_NS + round(1e9 * at_s)
        east_m, north_m, _, rate_rad_s = vehicle(at_s)
        live.push_gyro(time_ns, rate_rad_s)
        if has_imu:
            live.push_imu(time_ns, *imu(rate_rad_s, noise_m[round(at_s * GYRO_HZ) % len(noise_m)]))
        if k % (GYRO_HZ // FIX_HZ) == 0:
            off_m = noise_m[round(at_s * FIX_HZ) % len(noise_m)]
            up_m = 1.5 + off_m[2]
            lat, lon, height = DATUM.to_geodetic(east_m + off_m[0], north_m + off_m[1], up_m)
            place = float(lat), float(lon), float(height)
            live.push_fix(Fix(time_ns, *place, Quality.RTK_FIXED, 14, sigma_m=0.02))
        if k % (GYRO_HZ // FRAME_HZ) == 0:
            live.push_depth(depths(round(at_s * FRAME_HZ)), time_ns, wait=True)


def vehicle(at_s: float) -> tuple[float, float, float, float]:
    """East, north, heading in radians and its rate, of lanes to the north and back."""
    arc_m = math.pi * TURN_M
    lane, along_m = divmod(at_s * SPEED_MPS, LANE_M + arc_m)
    side, east_m = (1.0 if lane % 2 == 0 else -1.0), 2.0 * TURN_M * lane
    if along_m <= LANE_M:
        north_m = along_m if side > 0.0 else LANE_M - along_m
        return east_m, north_m, 0.0 if side > 0.0 else math.pi, 0.0
    turned = (along_m - LANE_M) / TURN_M
    north_m = (LANE_M if side > 0.0 else 0.0) + side * TURN_M * math.sin(turned)
    heading = turned if side > 0.0 else math.pi - turned
    return east_m + TURN_M * (1.0 - math.cos(turned)), north_m, heading, side * SPEED_MPS / TURN_M


def imu(rate_rad_s: float, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rates and specific forces of a level vehicle that turns clockwise at a rate: right, forward,
    up, with noise [3]."""
    rates = np.array([0.0, 0.0, -rate_rad_s]) + 0.1 * noise
    forces = np.array([SPEED_MPS * rate_rad_s, 0.0, 9.81]) + noise
    return rates, forces


def depths(number: int) -> np.ndarray:
    """Level ground as the camera sees it, noisy, with a post in each eighth picture."""
    random = np.random.default_rng(number)
    camera, tilt = RIG.depth_camera, math.radians(RIG.mount.tilt_deg)
    down = (np.arange(camera.height_px) - camera.cy_px) / camera.fy_px
    falling = (down * math.cos(tilt) + math.sin(tilt)) / RIG.mount.height_m
    depth_m = np.full((camera.height_px, camera.width_px), np.nan)
    seen = falling > 1.0 / 12.0
    depth_m[seen] = 1.0 / falling[seen][:, None]
    depth_m *= random.normal(1.0, 0.003, depth_m.shape)
    if number % 8 == 0:
        depth_m[10:75, 50:60] = 4.0
    return depth_m.astype(np.float32)


def memory_mb() -> float:
    """What the process holds now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def shown(values: list[float]) -> str:
    """The median and 99 % of some milliseconds."""
    if not values:
        return "-"
    median, most = np.percentile(values, [50.0, 99.0])
    return f"{median:.0f} / {most:.0f}"


if __name__ == "__main__":
    main()
