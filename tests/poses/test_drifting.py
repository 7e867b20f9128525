"""Fixes that drift bit by bit beside the way of the camera."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Carrier, FixColumns, LeverArm, Motion, WheelSpeed
from fieldgrid.poses import Estimate, estimate_poses
from fieldgrid.poses.faults.unseen import UnseenFault
from tests.simulated import (
    DATUM,
    K_TURN,
    START,
    Command,
    Drive,
    fixes_of,
    gyro_of,
    simulate,
    steps_of as camera,
    time_ns,
)
from tests.told import codes

ROWS = [Command(30.0, 1.2), *K_TURN[1:-1], Command(30.0, 1.2)]


def drifting(drive: Drive, drift_m: float) -> FixColumns:
    """RTK fixes that go north-east bit by bit."""
    fixes = fixes_of(drive, noise_m=0.008, seed=4)
    share = (fixes.time_ns - START) / 1e9 / float(drive.time_s[-1])
    away_m = drift_m * share
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    lat, lon, _ = DATUM.to_geodetic(east + 0.6 * away_m, north + 0.8 * away_m, up)
    return fixes.replace(lat_deg=lat, lon_deg=lon)


def estimated(
    drive: Drive, fixes: FixColumns, *, seen: bool = True, noise: float = 1.0, late_s: float = 0.0
) -> Estimate:
    steps = camera(drive, noise=noise, late_s=late_s, seed=3) if seen else None
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05), steps=steps)
    return estimate_poses(fixes, Carrier(0.0), DATUM, motion=motion)


def tells(found: Estimate) -> bool:
    return any("the fixes drift by about" in note for note in found.report.notes)


@pytest.mark.parametrize("drift_m", [2.0, -2.0, 3.0])
def test_positions_know_of_a_drift_that_the_camera_sees(drift_m: float) -> None:
    drive = simulate(ROWS, 50.0, speed_mps=1.2)
    fixes = drifting(drive, drift_m)
    found = estimated(drive, fixes)
    one, truth = found.trajectory, drive.at((found.trajectory.time_ns - START) / 1e9)
    off_m = np.hypot(one.east_m - truth.east_m, one.north_m - truth.north_m)
    assert tells(found)
    assert codes(found.report) == ["drift"]
    assert (off_m <= 3.44 * one.position_sigma_m).mean() > 0.98
    assert one.position_sigma_m.max() < 1.2 * abs(drift_m)
    turned_deg = np.abs((one.heading_deg - np.degrees(truth.heading_rad) + 180.0) % 360.0 - 180.0)
    assert (turned_deg <= 3.0 * one.heading_sigma_deg).mean() > 0.98
    # It is the camera that tells.
    assert not tells(estimated(drive, fixes, seen=False))


@pytest.mark.parametrize("ahead_m", [0.2, -0.2])
def test_an_antenna_elsewhere_than_declared_is_no_drift(ahead_m: float) -> None:
    """As it looks where an IMU is tilted by 5°: the antenna leans by as much at each heading."""
    drive = simulate(ROWS, 50.0, speed_mps=1.2)
    fixes = fixes_of(drive, noise_m=0.008, seed=4, antenna=LeverArm(0.0, ahead_m, 2.0))
    found = estimated(drive, fixes)
    one, truth = found.trajectory, drive.at((found.trajectory.time_ns - START) / 1e9)
    antenna_m = truth.point(0.0, ahead_m)
    assert not tells(found)
    assert np.median(one.position_sigma_m) < 0.05
    off_m = np.hypot(one.east_m - antenna_m[:, 0], one.north_m - antenna_m[:, 1])
    assert (off_m <= 3.44 * one.position_sigma_m).mean() > 0.98


@pytest.mark.parametrize("noise", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("heading_deg", [0.0, 130.0])
def test_fixes_that_do_not_drift_are_as_sure_as_ever(noise: float, heading_deg: float) -> None:
    drive = simulate(ROWS, heading_deg, speed_mps=1.2)
    found = estimated(drive, drifting(drive, 0.0), noise=noise)
    assert not tells(found)
    assert np.median(found.trajectory.position_sigma_m) < 0.03


def test_a_clock_that_is_off_is_no_drift() -> None:
    drive = simulate(ROWS, speed_mps=1.2)
    found = estimated(drive, drifting(drive, 0.0), late_s=0.4)
    assert found.report.clock is not None
    assert not tells(found)


# --- smooth ones of minutes

LONG = simulate(ROWS * 2, 50.0, speed_mps=1.2)


def slowly(drive: Drive, drift_m: float) -> FixColumns:
    """RTK fixes that go north-east and come back over the whole drive."""
    fixes = fixes_of(drive, 0.5, noise_m=0.008, seed=4)
    share = (fixes.time_ns - START) / 1e9 / float(drive.time_s[-1])
    away_m = drift_m * np.sin(np.pi * share) ** 2
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    lat, lon, _ = DATUM.to_geodetic(east + 0.6 * away_m, north + 0.8 * away_m, up)
    return fixes.replace(lat_deg=lat, lon_deg=lon)


def seen(drive: Drive, by: str) -> Motion:
    """The motion by a camera, by a gyro, or also by wheels, which slip by more where the vehicle
    goes north, say uphill."""
    gyro = gyro_of(drive, noise_dps=0.05) if "gyro" in by else None
    steps = camera(drive, noise=1.0, seed=3) if "camera" in by else None
    at = drive.every(0.1)
    slip = 1.0 + np.random.default_rng(5).normal(0.1 * np.cos(at.heading_rad), 0.02)
    wheels = WheelSpeed(time_ns(at.time_s), at.speed_mps * slip)
    return Motion(gyro=gyro, wheels=wheels if "wheels" in by else None, steps=steps)


@pytest.mark.parametrize("by", ["camera", "camera, gyro", "camera, gyro, wheels"])
def test_a_drift_there_and_back_is_seen_over_the_whole_drive(by: str) -> None:
    motion = seen(LONG, by)
    found = estimate_poses(slowly(LONG, 1.5), Carrier(0.0), DATUM, motion=motion)
    one, truth = found.trajectory, LONG.at((found.trajectory.time_ns - START) / 1e9)
    off_m = np.hypot(one.east_m - truth.east_m, one.north_m - truth.north_m)
    assert tells(found)
    assert (off_m <= 3.44 * one.position_sigma_m).mean() > 0.98
    assert one.position_sigma_m.max() < 1.5


@pytest.mark.parametrize("by", ["camera", "camera, gyro", "camera, gyro, wheels", "gyro, wheels"])
def test_long_drives_that_do_not_drift_are_as_sure_as_ever(by: str) -> None:
    """However wheels slip: by 10 % of rows of 250 m that is 25 m."""
    rows = [Command(250.0, 1.2), *K_TURN[1:-1], Command(250.0, 1.2)]
    drive = simulate(rows, 50.0, speed_mps=1.2)
    motion = seen(drive, by)
    found = estimate_poses(slowly(drive, 0.0), Carrier(0.0), DATUM, motion=motion)
    assert not tells(found)
    assert np.median(found.trajectory.position_sigma_m) < 0.1


def test_an_antenna_as_far_ahead_as_is_usual_is_no_slow_drift() -> None:
    fixes = fixes_of(LONG, 0.5, noise_m=0.008, seed=4, antenna=LeverArm(0.0, 0.25, 2.0))
    motion = seen(LONG, "camera, gyro")
    assert not tells(estimate_poses(fixes, Carrier(0.0), DATUM, motion=motion))


def test_a_drift_that_leaves_a_contradiction_is_not_known() -> None:
    """Of a gyro whose bias walks away and back nothing is told of the receiver."""
    motion = seen(LONG, "camera, gyro")
    assert motion.gyro is not None
    share = (motion.gyro.time_ns - START) / 1e9 / float(LONG.time_s[-1])
    rate = motion.gyro.rate_rad_s + np.radians(0.42) * np.sin(2.0 * np.pi * share)
    motion = motion._replace(gyro=motion.gyro._replace(rate_rad_s=rate))
    assert not tells(estimate_poses(slowly(LONG, 0.0), Carrier(0.0), DATUM, motion=motion))


def test_a_drift_of_a_decimetre_is_not_worth_a_word() -> None:
    """However well the camera knows its way."""
    motion = Motion(steps=camera(LONG, sigma_m=0.001, sigma_deg=0.005))
    assert not tells(estimate_poses(slowly(LONG, 0.14), Carrier(0.0), DATUM, motion=motion))


def test_a_drift_no_larger_than_stated_is_none() -> None:
    unsure = slowly(LONG, 0.8)
    unsure = unsure.replace(sigma_m=np.full(len(unsure), 0.4), quality=np.full(len(unsure), 2))
    found = estimate_poses(unsure, Carrier(0.0), DATUM, motion=seen(LONG, "camera"))
    assert not tells(found)


@pytest.mark.parametrize("by", ["gyro", "gyro, wheels", "coarse camera"])
def test_a_drift_that_would_not_be_seen_is_named(by: str) -> None:
    """Without a camera, or with turns that are known too badly for it."""
    motion = seen(LONG, by)
    if by == "coarse camera":
        steps = camera(LONG, noise=1.0, sigma_m=0.05, sigma_deg=0.5, seed=3)
        motion = Motion(steps=steps)
    found = estimate_poses(slowly(LONG, 1.0), Carrier(0.0), DATUM, motion=motion)
    assert not tells(found)
    assert UnseenFault.SLOW_DRIFT in found.report.unseen


@pytest.mark.parametrize(("repeats", "is_shown"), [(1, True), (2, False)])
def test_only_short_drives_show_a_drift_of_a_metre(repeats: int, is_shown: bool) -> None:
    """The longer a drive, the more the camera's own steps drift."""
    drive = simulate(ROWS * repeats, 50.0, speed_mps=1.2)
    found = estimate_poses(slowly(drive, 0.0), Carrier(0.0), DATUM, motion=seen(drive, "camera"))
    assert (UnseenFault.SLOW_DRIFT not in found.report.unseen) is is_shown
