"""Jumps that looked drivable are told from the drive by the estimate of the whole."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import Bool
from fieldgrid.geometry import Carrier, FixColumns, Motion, wrap_deg
from fieldgrid.poses import Estimate, estimate_poses
from tests.simulated import DATUM, K_TURN, SLALOM, STOP, Command, Drive, fixes_of, gyro_of, simulate

ROWS = [Command(25.0, 1.2), *K_TURN[1:-1], Command(25.0, 1.2)]
DENIED = ("lies ", "lies between jumps")


def jumping(
    drive: Drive, start_s: float, long_s: float, jump_m: float, period_s: float = 0.2
) -> tuple[FixColumns, Bool]:
    """Decimetre fixes that lie elsewhere for a while, east and south; and which of them do."""
    fixes = fixes_of(drive, period_s, 0.03, quality=2, speed=True)
    at_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    off = (at_s >= start_s - 1e-6) & (at_s < start_s + long_s - 1e-6)
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    noise = np.random.default_rng(3).normal(0.0, 0.15, (2, len(off)))
    lat, lon, _ = DATUM.to_geodetic(
        east + off * (0.74 * jump_m + noise[0]), north - off * (0.67 * jump_m + noise[1]), up
    )
    return fixes.replace(lat_deg=lat, lon_deg=lon), off


def estimate(drive: Drive, fixes: FixColumns) -> Estimate:
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05))
    return estimate_poses(fixes, Carrier(0.0), DATUM, motion=motion)


def wrong_headings(found: Estimate, drive: Drive) -> float:
    """The share of accepted poses whose heading is off by more than three sigma."""
    one = found.trajectory
    truth = drive.at((one.time_ns - one.time_ns[found.fix_row[0]]) / 1e9)
    off = np.abs(wrap_deg(one.heading_deg - np.degrees(truth.heading_rad)))
    return float(np.mean(off[one.accepted] > 3.0 * one.heading_sigma_deg[one.accepted]))


def denied(found: Estimate) -> Bool:
    """Which fixes the estimate denied."""
    return np.array([found.trajectory.reason[k].startswith(DENIED) for k in found.fix_row])


@pytest.mark.parametrize("start_s", [26.0, 29.5, 33.0])
@pytest.mark.parametrize("jump_m", [1.2, 3.3])
def test_a_jump_while_the_vehicle_turns_takes_nothing_else_away(
    start_s: float, jump_m: float
) -> None:
    drive = simulate(ROWS, 37.0)
    fixes, off = jumping(drive, start_s, 2.0, jump_m)
    found = estimate(drive, fixes)
    used = found.trajectory.accepted[found.fix_row]
    assert not used[off].any()
    assert used[~off].mean() > 0.98
    assert wrong_headings(found, drive) == 0.0


@pytest.mark.parametrize("commands", [ROWS, SLALOM, STOP])
@pytest.mark.parametrize(("period_s", "noise_m", "quality"), [(0.1, 0.01, 4), (1.0, 0.05, 2)])
def test_a_drive_without_jumps_denies_nothing(
    commands: list[Command], period_s: float, noise_m: float, quality: int
) -> None:
    drive = simulate(commands, 120.0)
    fixes = fixes_of(drive, period_s, noise_m, quality=quality)
    assert not denied(estimate_poses(fixes, Carrier(0.0), DATUM)).any()
    assert not denied(estimate(drive, fixes)).any()


def test_a_solution_that_has_moved_is_no_stray() -> None:
    drive = simulate([Command(60.0, 1.5)], 20.0)
    fixes = fixes_of(drive, 0.2, 0.01, speed=True)
    later = np.arange(len(fixes)) >= len(fixes) // 2
    found = estimate(drive, fixes.replace(lat_deg=fixes.lat_deg + later * 5e-5))
    assert not denied(found).any()
    assert sum("the solution has moved" in reason for reason in found.trajectory.reason) == 1


def test_what_lies_between_a_jump_and_a_hole_is_denied_however_the_estimate_is_drawn() -> None:
    drive = simulate(ROWS, 37.0)
    fixes, off = jumping(drive, 29.0, 2.0, 3.3)
    at_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    seen = (at_s < 31.0) | (at_s > 36.0)
    found = estimate_poses(fixes[seen], Carrier(0.0), DATUM)
    assert not found.trajectory.accepted[found.fix_row][off[seen]].any()
