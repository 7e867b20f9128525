"""Leaps that no fix shows and the camera sees: small ones, and those over holes."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Carrier, FixColumns, Motion
from fieldgrid.poses import Estimate, estimate_poses
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
)

ROWS = [Command(25.0, 1.2), *K_TURN[1:-1], Command(25.0, 1.2)]


def estimated(
    drive: Drive, fixes: FixColumns, *, seen: bool = True, noise: float = 1.0
) -> Estimate:
    steps = camera(drive, noise=noise) if seen else None
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05), steps=steps)
    return estimate_poses(fixes, Carrier(0.0), DATUM, motion=motion)


def leapt(
    drive: Drive, leap_m: float, at_share: float, hole_s: float, noise_m: float = 0.008
) -> FixColumns:
    """Fixes that lie north from a moment on, around which there are none for so long."""
    fixes = fixes_of(drive, noise_m=noise_m, seed=4)
    time_s = (fixes.time_ns - START) / 1e9
    at_s = at_share * float(time_s[-1])
    lat_deg = fixes.lat_deg + np.where(time_s > at_s, leap_m, 0.0) / 111_000.0
    return fixes.replace(lat_deg=lat_deg)[np.abs(time_s - at_s) >= hole_s / 2.0]


def off_and_sigma(found: Estimate, drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    one = found.trajectory
    truth = drive.at((one.time_ns - START) / 1e9)
    off_m = np.hypot(one.east_m - truth.east_m, one.north_m - truth.north_m)
    return off_m[one.accepted], one.position_sigma_m[one.accepted]


@pytest.mark.parametrize(
    ("leap_m", "hole_s", "at_share"),
    [
        (0.25, 0.0, 0.25),
        (-0.6, 5.0, 0.7),
        *(
            pytest.param(*one, marks=pytest.mark.long)
            for one in ((0.25, 0.0, 0.7), (0.6, 5.0, 0.25), (0.6, 5.0, 0.7), (-0.6, 5.0, 0.25))
        ),
    ],
)
def test_positions_know_of_a_leap_that_the_camera_sees(
    leap_m: float, hole_s: float, at_share: float
) -> None:
    drive = simulate(ROWS)
    fixes = leapt(drive, leap_m, at_share, hole_s)
    off_m, sigma_m = off_and_sigma(found := estimated(drive, fixes), drive)
    assert (off_m <= 3.44 * sigma_m).mean() > 0.98
    assert any("solution leaps once" in note for note in found.report.notes)
    # Over a hole it is the camera that tells.
    blind = estimated(drive, fixes, seen=False)
    assert not hole_s or not any("leaps" in note for note in blind.report.notes)


def test_a_long_drive_is_looked_at_as_closely() -> None:
    drive = simulate(ROWS * 8)
    for leap_m in (0.25, 0.0):
        found = estimated(drive, leapt(drive, leap_m, 0.6, 0.0, 0.015))
        off_m, sigma_m = off_and_sigma(found, drive)
        assert (off_m <= 3.44 * sigma_m).mean() > 0.98
        assert any("solution leaps once" in note for note in found.report.notes) == (leap_m > 0.0)


@pytest.mark.parametrize("hole_s", [0.0, 5.0])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_drives_that_do_not_leap_are_as_sure_as_ever(hole_s: float, noise: float) -> None:
    drive = simulate(ROWS)
    found = estimated(drive, leapt(drive, 0.0, 0.5, hole_s), noise=noise)
    assert not any("leaps" in note for note in found.report.notes)
    assert np.median(found.trajectory.position_sigma_m) < 0.03
