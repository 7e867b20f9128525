"""Leaps at a fix a second, which an estimate follows and recorded headings deny."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import PoseSettings, Quality
from fieldgrid.geometry import Carrier, FixColumns, LeverArm, VehicleGeometry
from fieldgrid.poses import Estimate, estimate_poses
from fieldgrid.poses.faults.leaps.recorded import recorded_leaps
from fieldgrid.poses.faults.leaps.seams import SeenLeap
from fieldgrid.poses.fused import conditioned
from tests.scenes import paper_rig
from tests.simulated import DATUM, K_TURN, SLALOM, START, Command, Drive, fixes_of, simulate

ROWS = [Command(25.0, 1.2), *K_TURN[1:-1], Command(25.0, 1.2), *K_TURN[1:-1], Command(25.0, 1.2)]
SWERVES = [Command(20.0, 3.0), Command(1.0, 3.0, 0.4), Command(1.0, 3.0, -0.4)] * 3
SAYS = "solution leaps"


def recorded(drive: Drive, period_s: float, off_m: float, *, headings: bool = True) -> FixColumns:
    """Fixes with headings, that lie east for some seconds on the last row."""
    sigma_deg = 0.5 if headings else None
    fixes = fixes_of(drive, period_s, 0.008, seed=4, heading_sigma_deg=sigma_deg)
    time_s = (fixes.time_ns - START) / 1e9
    away = np.abs(time_s - float(time_s[-1]) * 0.9) < 4.5
    metre_deg = 1.0 / (111_320.0 * np.cos(np.radians(DATUM.lat_deg)))
    return fixes.replace(lon_deg=fixes.lon_deg + away * off_m * metre_deg)


def estimated(fixes: FixColumns, vehicle: VehicleGeometry | None = None) -> Estimate:
    return estimate_poses(fixes, vehicle or Carrier(0.0), DATUM)


def beyond(found: Estimate, drive: Drive) -> float:
    """The share of accepted positions that are beyond three sigma."""
    one = found.trajectory
    truth = drive.at((one.time_ns - START) / 1e9)
    off_m = np.hypot(one.east_m - truth.east_m, one.north_m - truth.north_m)
    return float((off_m > 3.44 * one.position_sigma_m)[one.accepted].mean())


def says_leaps(found: Estimate) -> bool:
    return any(SAYS in note for note in found.report.notes)


@pytest.mark.parametrize("off_m", [0.5, 1.0])
def test_positions_know_of_a_leap_aside_of_the_headings(off_m: float) -> None:
    drive = simulate(ROWS)
    found = estimated(recorded(drive, 1.0, off_m))
    assert says_leaps(found)
    assert beyond(found, drive) < 0.05
    assert found.trajectory.accepted.mean() > 0.8
    # It is the headings that tell.
    blind = estimated(recorded(drive, 1.0, off_m, headings=False))
    assert not says_leaps(blind)
    assert beyond(blind, drive) > 0.05


@pytest.mark.parametrize("commands", [ROWS, SLALOM, SWERVES, K_TURN], ids=len)
@pytest.mark.parametrize("period_s", [0.2, 1.0])
@pytest.mark.parametrize("antenna_m", [0.0, 2.0])
def test_drives_that_do_not_leap_are_as_sure_as_ever(
    commands: list[Command], period_s: float, antenna_m: float
) -> None:
    """Also those whose antenna swings out in turns."""
    drive = simulate(commands, 20.0)
    antenna = LeverArm(0.0, antenna_m, 2.0)
    fixes = fixes_of(drive, period_s, 0.02, seed=3, antenna=antenna, heading_sigma_deg=0.5)
    rig = paper_rig(antenna=antenna, rear_axle_forward_m=0.0)
    assert not says_leaps(estimated(fixes, rig))


def leaps(
    fixes: FixColumns, heading_deg: np.ndarray, antenna_ahead_m: float = 0.0
) -> tuple[SeenLeap, ...]:
    accepted = conditioned(fixes, PoseSettings(), DATUM).accepted
    return recorded_leaps(accepted, heading_deg, antenna_ahead_m)


def test_a_leap_has_its_place_and_size() -> None:
    drive = simulate(ROWS)
    fixes = recorded(drive, 1.0, 0.5)
    out, back = leaps(fixes, fixes.heading_deg)
    assert (back.time_ns - out.time_ns) / 1e9 == pytest.approx(8.0, abs=1.1)
    # How far it leapt along the row, where a vehicle may speed up, is not told.
    phi = np.radians(fixes.heading_deg[-1])
    aside = 0.5 * np.cos(phi) * np.array([np.cos(phi), -np.sin(phi)])
    assert [out.east_m, out.north_m] == pytest.approx(aside, abs=0.05)
    assert [back.east_m, back.north_m] == pytest.approx(-aside, abs=0.05)


def test_headings_that_are_wrong_for_a_while_are_no_leap() -> None:
    drive = simulate(ROWS)
    fixes = recorded(drive, 1.0, 0.0)
    for count in (1, 2, 5):
        heading_deg = fixes.heading_deg.copy()
        heading_deg[8 : 8 + count] += 20.0
        assert not leaps(fixes, heading_deg)


def test_a_sharp_turn_of_an_antenna_elsewhere_is_no_leap() -> None:
    """Within one step, of an antenna that sits 0.8 m ahead: as declared, or not."""
    drive = simulate([Command(24.0, 1.0), Command(1.0, 1.0, 0.7), Command(25.0, 1.0)], 20.0)
    fixes = fixes_of(
        drive, 2.0, 0.008, seed=4, antenna=LeverArm(0.0, 0.8, 0.0), heading_sigma_deg=0.5
    )
    assert not leaps(fixes, fixes.heading_deg, 0.8)
    assert not leaps(fixes, fixes.heading_deg, 0.0)


def test_an_antenna_far_ahead_swings_as_declared() -> None:
    """By 4° within one step, 5 m ahead of the axle."""
    drive = simulate([Command(12.0, 1.0), Command(0.4, 1.0, 0.5), Command(12.6, 1.0)], 20.0)
    fixes = fixes_of(
        drive, 1.0, 0.008, seed=4, antenna=LeverArm(0.0, 5.0, 0.0), heading_sigma_deg=0.2
    )
    assert not leaps(fixes, fixes.heading_deg, 5.0)
    assert leaps(fixes, fixes.heading_deg, 0.0)


def test_what_headings_leave_open_over_a_long_step_is_no_leap() -> None:
    """8 m a step, and headings that are ten times as unsure at last as at first."""
    drive = simulate([Command(60.0, 8.0)], 20.0)
    fixes = fixes_of(drive, 1.0, 0.008, seed=4, heading_sigma_deg=0.2)
    heading_deg, sigma_deg = fixes.heading_deg.copy(), fixes.heading_sigma_deg.copy()
    heading_deg[48:52] += (-3.0, 4.0, 4.0, -3.0)
    sigma_deg[45:] = 2.0
    assert not leaps(fixes.replace(heading_sigma_deg=sigma_deg), heading_deg)
    assert leaps(fixes, heading_deg)


def test_a_step_of_no_more_than_is_stated_is_no_leap() -> None:
    drive = simulate(ROWS)
    fixes = recorded(drive, 1.0, 1.0)
    unsure = fixes.replace(
        sigma_m=np.full(len(fixes), 0.4),
        quality=np.full(len(fixes), int(Quality.DIFFERENTIAL)),
    )
    assert not says_leaps(estimated(unsure))
