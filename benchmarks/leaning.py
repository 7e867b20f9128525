"""`python -m benchmarks.leaning`: simulated vehicles that lean, and whether their sigmas hold.

IMUs that are mounted sideways, late or noisy; fixes alone on slopes; a turn in a hole of the fixes;
good IMUs on steep hills. A drive is honest if what is used of it is within three sigmas in 95 % of
its instants.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Quality
from fieldgrid.geometry import FixColumns, Inertial, LeverArm, Motion, Rig, roll_pitch_deg
from fieldgrid.poses import Estimate, estimate_poses
from tests.hilly import (
    Hike,
    camera_steps,
    fixes_over,
    gyro_and,
    hike,
    hills,
    inertial,
    mounted,
    rows,
    slope,
)
from tests.poses.test_levelled import ANTENNA_M, RIG, SENSOR_M
from tests.simulated import DATUM, START, time_ns

GROUNDS = {"hills": hills(9.0, 45.0), "rough": hills(6.0, 12.0), "level": slope(0.0)}

RECEIVERS = ((0.2, 0.012, 0.01), (1.0, 0.02, 0.02), (0.2, 0.05, 0.3), (1.0, 0.2, 1.0))
"""Seconds from fix to fix, their white and their slow error, metres."""

IMUS = (
    (100.0, 0.1, 0.05, 0.0),
    (100.0, 1.0, 1.0, 0.0),
    (25.0, 0.3, 0.3, 0.0),
    (100.0, 0.1, 0.05, 30.0),
)
"""Hertz, noise of gyro (°/s) and accelerometer (m/s²), and of one in 200 samples (m/s²)."""

LEFT_DEG = {"90° left": 90.0, "45° right": -45.0, "backward": 180.0}
LATE_S = {"0.1 s late": 0.1, "0.3 s late": 0.3}
FAULTS = ("none", *LEFT_DEG, *LATE_S)
SWAYS_DEG = (0.35, 2.0)
ENOUGH = 0.95


class Outcome(NamedTuple):
    """The share of a drive that was used, the 95th percentile of what it was off there, and the
    share of that within three sigmas."""

    used: float
    off: float = 0.0
    within: float = 1.0


def main() -> None:
    """Print a line for each kind of drive."""
    heading = f"{'':30}{'drives':>8}{'honest':>8}{'used':>8}  off (95 %): median, most  within 3 s"
    print(f"Roll and pitch by IMUs, degrees\n{heading}")
    for fault, sway_deg in product(FAULTS, SWAYS_DEG):
        _print(f"{fault}, sway {sway_deg}°", list(imu_drives(fault, sway_deg)))
    print(f"\nPositions by fixes alone, metres\n{heading}")
    for degrees, lanes in product((0.0, 8.0, 12.0, 20.0), (1, 2, 4)):
        _print(f"slope of {degrees:.0f}°, rows: {lanes}", list(slope_drives(degrees, lanes)))
    print(f"\nPositions with a turn in a hole of the fixes, metres\n{heading}")
    for sensors in ("camera", "IMU", "IMU, camera"):
        _print(sensors, list(hole_drives(sensors)))
    print(f"\nPositions by good IMUs on hills, metres\n{heading}")
    for degrees, length_m in ((6.0, 30.0), (9.0, 45.0), (12.0, 60.0), (15.0, 40.0), (12.0, 25.0)):
        _print(f"{degrees:.0f}°, waves of {length_m:.0f} m", list(hill_drives(degrees, length_m)))


def _print(name: str, found: Sequence[Outcome]) -> None:
    used = [one for one in found if one.used]
    off = [one.off for one in used] or [0.0]
    print(
        f"{name:30}{len(found):8}{sum(one.within >= ENOUGH for one in found):8}"
        f"{100.0 * np.mean([one.used for one in found]):6.0f} %"
        f"{np.median(off):17.2f}, {max(off):5.2f}"
        f"{100.0 * min(one.within for one in found):11.0f} %",
        flush=True,
    )


def imu_drives(fault: str, sway_deg: float) -> Iterator[Outcome]:
    """Roll and pitch, over each ground, by each IMU, with each of the better receivers."""
    for ground, (hertz, gyro_dps, force_mps2, shock_mps2), receiver in product(
        GROUNDS.values(), IMUS, RECEIVERS[:3]
    ):
        way = hike(ground, rows(3, 40.0), sway_deg=sway_deg)
        sensed = inertial(way, hertz, gyro_noise_dps=gyro_dps, force_noise_mps2=force_mps2)
        sensed = _jolted(sensed, shock_mps2)
        sensed = mounted(sensed, LEFT_DEG.get(fault, 0.0))
        late_ns = round(LATE_S.get(fault, 0.0) * 1e9)
        motion = gyro_and(sensed._replace(time_ns=sensed.time_ns + late_ns))
        yield _lean(way, _estimate(way, _fixes(way, receiver), motion))


def slope_drives(degrees: float, lanes: int) -> Iterator[Outcome]:
    """Rows across, along and askew, each receiver, the antenna 1.5 to 4 m high."""
    for toward_deg, receiver, up_m in product((120.0, 30.0, 75.0), RECEIVERS, (-1.0, 0.35, 1.5)):
        way = hike(slope(degrees, toward_deg), rows(lanes, 40.0))
        right_m, forward_m, _ = ANTENNA_M
        rig = replace(RIG, antenna=LeverArm(right_m, forward_m, SENSOR_M[2] + up_m))
        fixes = _fixes(way, receiver, (right_m, forward_m, up_m))
        yield _place(way, _estimate(way, fixes, Motion(), rig))


def hole_drives(sensors: str) -> Iterator[Outcome]:
    """Two rows, and no fix for 9 to 18 s around the turn between them."""
    for ground, (before_s, after_s), period_s in product(
        (slope(0.0), slope(12.0, 120.0), hills(9.0, 45.0)),
        ((1.0, 1.0), (5.0, 5.0), (1.0, 10.0)),
        (0.25, 0.5),
    ):
        way = hike(ground, rows(2, 28.0))
        turning_s = way.drive.time_s[np.abs(way.drive.curvature_per_m) > 0.1]
        fixes = _fixes(way, RECEIVERS[0])
        late_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
        hole = (late_s > turning_s[0] - before_s) & (late_s < turning_s[-1] + after_s)
        motion = gyro_and(inertial(way)) if "IMU" in sensors else Motion()
        if "camera" in sensors:
            motion = motion._replace(steps=camera_steps(way, period_s))
        yield _place(way, _estimate(way, fixes[~hole], motion))


def hill_drives(degrees: float, length_m: float) -> Iterator[Outcome]:
    """One to three rows in two directions, with and without a camera."""
    for (lanes, row_m), heading_deg, seed, camera in product(
        ((1, 40.0), (1, 80.0), (2, 28.0), (3, 40.0)), (30.0, 100.0), (0, 1), (False, True)
    ):
        way = hike(hills(degrees, length_m), rows(lanes, row_m), heading_deg, seed=seed)
        motion = gyro_and(inertial(way, seed=seed))
        if camera:
            motion = motion._replace(steps=camera_steps(way, 0.5, seed=seed))
        yield _place(way, _estimate(way, _fixes(way, RECEIVERS[0]), motion))


def _estimate(way: Hike, fixes: FixColumns, motion: Motion, rig: Rig = RIG) -> Estimate:
    frames_ns = time_ns(_frames_s(way))
    return estimate_poses(
        *(fixes, rig, DATUM), motion=motion, frame_ns=frames_ns, level_grids=False
    )


def _frames_s(way: Hike) -> Float64:
    return np.arange(1.03, way.drive.time_s[-1] - 2.0, 0.5)


def _fixes(
    way: Hike,
    receiver: tuple[float, float, float],
    antenna_m: tuple[float, float, float] = ANTENNA_M,
) -> FixColumns:
    _, noise_m, wander_m = receiver
    quality = Quality.RTK_FIXED if wander_m < 0.1 else Quality.DIFFERENTIAL
    sigma_m = np.hypot(noise_m, wander_m)
    return fixes_over(way, antenna_m, *receiver, quality=quality, sigma_m=sigma_m)


def _lean(way: Hike, found: Estimate) -> Outcome:
    if found.report.attitude is None:
        return Outcome(0.0)
    frames_s = _frames_s(way)
    at = found.report.attitude.at(time_ns(frames_s))
    roll_deg, pitch_deg = roll_pitch_deg(way.at(frames_s).R)
    off = np.abs(np.concatenate([at.roll_deg - roll_deg, at.pitch_deg - pitch_deg]))
    sigma = np.concatenate([at.roll_sigma_deg, at.pitch_sigma_deg])
    return Outcome(1.0, float(np.percentile(off, 95)), float(np.mean(off < 3.0 * sigma)))


def _place(way: Hike, found: Estimate) -> Outcome:
    """The ground below the sensor along the vehicle's axis, at the poses that were accepted."""
    poses = found.trajectory
    if not poses.accepted.any():
        return Outcome(0.0)
    seen = way.at((poses.time_ns[poses.accepted] - START) / 1e9)
    true = seen.sensor_m - seen.R @ np.array([0.0, 0.0, SENSOR_M[2]])
    place = np.stack([poses.east_m, poses.north_m], axis=1)[poses.accepted]
    off = np.hypot(*(place - true[:, :2]).T)
    within = off < 3.0 * poses.position_sigma_m[poses.accepted]
    used = float(poses.accepted.mean())
    return Outcome(used, float(np.percentile(off, 95)), float(np.mean(within)))


def _jolted(sensed: Inertial, shock_mps2: float) -> Inertial:
    random = np.random.default_rng(1)
    force = sensed.force_mps2.copy()
    hit = random.integers(0, len(force), len(force) // 200)
    force[hit] += random.normal(0.0, 1.0, (len(hit), 3)) * shock_mps2
    return sensed._replace(force_mps2=force)


if __name__ == "__main__":
    main()
