"""Slow errors that are larger, or last shorter, than a receiver states."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Carrier, FixColumns, Motion, wrap_deg
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM, SLALOM, START, fixes_of, gyro_of, simulate, steps_of


def weaving(fixes: FixColumns, size_m: float) -> FixColumns:
    """Fixes of a receiver that goes to and fro by so much within some seconds."""
    at_s = (fixes.time_ns - START) / 1e9
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    east = east + size_m * np.sin(2.0 * np.pi * at_s / 11.0)
    north = north + size_m * np.sin(2.0 * np.pi * at_s / 17.0 + 1.0)
    lat, lon, _ = DATUM.to_geodetic(east, north, up)
    return fixes.replace(lat_deg=lat, lon_deg=lon)


@pytest.mark.parametrize("size_m", [0.0, 0.5])
def test_headings_know_of_fixes_that_drift_beside_the_turns_of_a_gyro(size_m: float) -> None:
    drive = simulate(SLALOM, 40.0)
    fixes = weaving(fixes_of(drive, 0.2, 0.005, seed=2), size_m)
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05))
    settings = PoseSettings(quality=2, accuracy_m=0.5)
    found = estimate_poses(fixes, Carrier(0.0), DATUM, settings, motion).trajectory
    truth_deg = np.degrees(drive.at((found.time_ns - START) / 1e9).heading_rad)
    off_deg = np.abs(wrap_deg(found.heading_deg - truth_deg))[found.accepted]
    sigma_deg = found.heading_sigma_deg[found.accepted]
    assert found.accepted.mean() > 0.5
    assert np.mean(off_deg < 3.0 * sigma_deg) > 0.98
    if size_m == 0.0:
        assert np.median(sigma_deg) < 1.0


@pytest.mark.parametrize("drives", [6, pytest.param(40, marks=pytest.mark.long)])
@pytest.mark.parametrize("by", ["gyro", "camera"])
def test_bursts_of_bias_of_a_fixed_solution_are_covered(by: str, drives: int) -> None:
    """Of 0.4 m for 5 to 20 s, while the receiver states a centimetre."""
    within = []
    for seed in range(drives):
        random = np.random.default_rng(seed)
        drive = simulate(SLALOM * 3, 40.0)
        fixes = fixes_of(drive, 0.2, 0.008, seed=seed)
        at_s = (fixes.time_ns - START) / 1e9
        begins_s = random.uniform(10.0, at_s[-1] - 30.0)
        off_m = 0.4 * ((at_s > begins_s) & (at_s < begins_s + random.uniform(5.0, 20.0)))
        way = random.uniform(0.0, 2.0 * np.pi)
        east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
        lat, lon, _ = DATUM.to_geodetic(east + off_m * np.sin(way), north + off_m * np.cos(way), up)
        gyro = gyro_of(drive, noise_dps=0.05) if by == "gyro" else None
        steps = steps_of(drive, noise=1.0, seed=3) if by == "camera" else None
        motion = Motion(gyro=gyro, steps=steps)
        moved = fixes.replace(lat_deg=lat, lon_deg=lon)
        found = estimate_poses(moved, Carrier(0.0), DATUM, motion=motion).trajectory
        truth = drive.at((found.time_ns - START) / 1e9)
        apart_m = np.hypot(found.east_m - truth.east_m, found.north_m - truth.north_m)
        inside = apart_m < 3.44 * found.position_sigma_m
        within.append(float(inside[found.accepted].mean()) if found.accepted.any() else 1.0)
    assert np.median(within) > 0.99
    # Along the path a vehicle may have gone faster, as far as a gyro tells: of 40 one is 0.89.
    assert np.mean(np.array(within) > 0.9) >= 0.95
    assert min(within) > 0.85
