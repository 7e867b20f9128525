"""Leaps that no gate sees and the estimate of the drive denies, without a camera."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import Quality
from fieldgrid.geometry import Carrier, FixColumns, Motion
from fieldgrid.poses import Estimate, estimate_poses
from tests.simulated import (
    DATUM,
    K_TURN,
    SLALOM,
    START,
    STOP,
    Command,
    Drive,
    fixes_of,
    gyro_of,
    simulate,
)

ROWS = [Command(25.0, 1.2), *K_TURN[1:-1], Command(25.0, 1.2)]
SAYS = "solution leaps"


def estimated(drive: Drive, fixes: FixColumns, *, gyro: bool = True) -> Estimate:
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05) if gyro else None)
    return estimate_poses(fixes, Carrier(0.0), DATUM, motion=motion)


def aside(drive: Drive, off_m: float, lasts_s: float, period_s: float) -> FixColumns:
    """Fixes that lie east for so long in the middle of the drive."""
    fixes = fixes_of(drive, period_s, 0.008, seed=4)
    time_s = (fixes.time_ns - START) / 1e9
    away = np.abs(time_s - float(time_s[-1]) * 0.75) < lasts_s / 2.0
    metre_deg = 1.0 / (111_320.0 * np.cos(np.radians(DATUM.lat_deg)))
    return fixes.replace(lon_deg=fixes.lon_deg + away * off_m * metre_deg)


def beyond(found: Estimate, drive: Drive) -> float:
    """The share of accepted positions that are beyond three sigma."""
    one = found.trajectory
    truth = drive.at((one.time_ns - START) / 1e9)
    off_m = np.hypot(one.east_m - truth.east_m, one.north_m - truth.north_m)
    return float((off_m > 3.44 * one.position_sigma_m)[one.accepted].mean())


def says_leaps(found: Estimate) -> bool:
    return any(SAYS in note for note in found.report.notes)


@pytest.mark.parametrize(
    ("off_m", "period_s", "gyro"),
    [(0.8, 0.2, True), (0.8, 0.2, False), (0.4, 0.2, False), (-0.8, 1.0, True)],
)
def test_positions_know_of_a_leap_across_the_path(
    off_m: float, period_s: float, gyro: bool
) -> None:
    drive = simulate(ROWS)
    found = estimated(drive, aside(drive, off_m, 8.0, period_s), gyro=gyro)
    assert says_leaps(found)
    assert beyond(found, drive) < 0.05
    assert found.trajectory.accepted.mean() > 0.8


@pytest.mark.parametrize("gyro", [True, False])
@pytest.mark.parametrize("commands", [ROWS, SLALOM, STOP, K_TURN], ids=len)
@pytest.mark.parametrize("period_s", [0.2, 1.0])
def test_drives_that_do_not_leap_are_as_sure_as_ever(
    commands: list[Command], period_s: float, gyro: bool
) -> None:
    drive = simulate(commands, 20.0)
    found = estimated(drive, fixes_of(drive, period_s, 0.02, seed=3), gyro=gyro)
    assert not says_leaps(found)
    assert np.median(found.trajectory.position_sigma_m[found.fix_row]) < 0.04


def test_a_step_of_no_more_than_is_stated_is_no_leap() -> None:
    drive = simulate(ROWS)
    fixes = aside(drive, 0.8, 8.0, 0.2)
    unsure = fixes.replace(
        sigma_m=np.full(len(fixes), 0.4),
        quality=np.full(len(fixes), int(Quality.DIFFERENTIAL)),
    )
    assert not says_leaps(estimated(drive, unsure))


def test_a_vehicle_that_swerves_does_not_leap() -> None:
    """As fast as it can from one lane to the next, seen by ten fixes a second."""
    drive = simulate([Command(20.0, 3.0), Command(1.0, 3.0, 0.4), Command(1.0, 3.0, -0.4)] * 3)
    assert not says_leaps(estimated(drive, fixes_of(drive, 0.1, 0.008, seed=5), gyro=False))
