"""A slope that nothing tells the lean of makes poses unsure, and level ground does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fieldgrid.geometry import Carrier, FixColumns, LeverArm, Motion
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.attitude.ground import ExpectedGround, expected_ground
from tests.scenes import paper_rig
from tests.simulated import DATUM, Command, Drive, fixes_of, gyro_of, simulate

ANTENNA = LeverArm(0.0, 0.0, 3.0)
LANES = [
    Command(40.0, 1.5),
    *[
        command
        for side in (1.0, -1.0, 1.0)
        for command in (Command(10.5, 1.2, 0.25 * side), Command(40.0, 1.5))
    ],
]


def on_ground(
    drive: Drive, climb_east: float, climb_north: float, bent_per_m: float = 0.0, noise_m: float = 0
) -> FixColumns:
    """Fixes of an antenna over ground with that slope, which changes along east."""
    fixes = fixes_of(drive, 0.2, 0.01)
    at = drive.every(0.2)
    ground_m = climb_east * at.east_m + climb_north * at.north_m + bent_per_m * at.east_m**2 / 2.0
    noise = np.random.default_rng(5).normal(0.0, 1.0, len(fixes)) * noise_m
    return fixes.replace(height_m=fixes.height_m + ground_m + noise)


def seen(fixes: FixColumns) -> ExpectedGround:
    place_m = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    return expected_ground(np.stack(place_m, axis=1), 0.0)


@pytest.mark.parametrize("noise_m", [0.0, 0.02, 0.06])
def test_level_ground_is_level(noise_m: float) -> None:
    found = seen(on_ground(simulate(LANES, 30.0), 0.0, 0.0, noise_m=noise_m))
    assert found.slope < np.radians(0.4)
    assert found.bent < np.radians(0.05)


@pytest.mark.parametrize("heading_deg", [0.0, 45.0, 90.0])
@pytest.mark.parametrize("noise_m", [pytest.param(0.0, marks=pytest.mark.long), 0.02, 0.06])
def test_a_slope_is_seen_whichever_way_the_lanes_lie(heading_deg: float, noise_m: float) -> None:
    """Along the fall line a vehicle climbs, across it only its lanes lie at other heights."""
    drive = simulate(LANES, heading_deg)
    found = seen(on_ground(drive, np.tan(np.radians(8.0)), 0.0, noise_m=noise_m))
    assert np.degrees(found.slope) == pytest.approx(8.0, abs=2.5)
    assert np.degrees(found.bent) < 0.15


def test_a_crest_bends_the_way() -> None:
    drive = simulate([Command(50.0, 1.5)], 90.0)
    flat, crest = (seen(on_ground(drive, 0.0, 0.0, bent, 0.01)) for bent in (0.0, -0.01))
    assert flat.bent < 0.001
    assert crest.bent == pytest.approx(0.006, rel=0.3)


@pytest.mark.parametrize("seconds", [0.5, 4.0])
@pytest.mark.parametrize("standing", [False, True])
def test_a_drive_too_short_to_tell_may_stand_on_any_usual_slope(
    seconds: float, standing: bool
) -> None:
    drive = simulate([Command(seconds, 0.0 if standing else 1.0)], 0.0)
    found = seen(on_ground(drive, 0.0, 0.0))
    assert 8.0 < np.degrees(found.slope) < 12.0
    assert found.unseen > 0.9 * found.slope
    assert found.bent == 0.0


@pytest.mark.parametrize("across_deg", [-12.0, 0.0, 12.0])
@pytest.mark.parametrize("bent_per_m", [0.0, 0.01])
def test_a_single_row_does_not_show_how_steep_it_is_across(
    across_deg: float, bent_per_m: float
) -> None:
    """Its fixes lie some centimetres beside each other, over which its own hills make no slope."""
    drive = simulate([Command(40.0, 1.5)], 90.0)
    fixes = on_ground(drive, 0.0, np.tan(np.radians(across_deg)), bent_per_m, 0.02)
    found = seen(fixes)
    assert 7.0 < np.degrees(found.unseen) < 9.0
    assert 7.0 < np.degrees(found.slope) < 22.0
    poses = estimate_poses(fixes, paper_rig(antenna=ANTENNA), DATUM)
    off_m = 3.0 * np.tan(np.radians(abs(across_deg)))
    assert np.median(poses.trajectory.position_sigma_m) * 3.0 > off_m
    (note,) = (note for note in poses.report.notes if "leans" in note)
    if not bent_per_m:
        assert "does not show how steep the ground is across" in note
        assert "another row" in note


def test_another_row_shows_it() -> None:
    both = seen(on_ground(simulate(LANES[:3], 30.0), 0.0, 0.0, noise_m=0.02))
    assert np.degrees(both.unseen) < 1.0
    assert np.degrees(both.slope) < 1.5


def test_positions_on_a_slope_are_as_unsure_as_the_antenna_leans() -> None:
    rig, drive = paper_rig(antenna=ANTENNA), simulate(LANES, 45.0)
    level, slope = (
        estimate_poses(on_ground(drive, climb, 0.0, noise_m=0.01), rig, DATUM)
        for climb in (0.0, np.tan(np.radians(8.0)))
    )
    assert np.median(level.trajectory.position_sigma_m) < 0.07
    off_m = 3.0 * np.tan(np.radians(8.0)) / np.sqrt(2.0)
    assert np.median(slope.trajectory.position_sigma_m) == pytest.approx(off_m, rel=0.35)
    assert any("nothing tells how the vehicle leans" in note for note in slope.report.notes)
    assert not any("leans" in note for note in level.report.notes)
    assert slope.trajectory.accepted.mean() > level.trajectory.accepted.mean() - 0.05


def test_an_antenna_at_no_known_height_leans_by_nothing_that_is_known() -> None:
    drive = simulate(LANES, 45.0)
    one, other = (
        estimate_poses(on_ground(drive, climb, 0.0, noise_m=0.01), Carrier(0.0), DATUM)
        for climb in (0.0, 0.14)
    )
    assert np.allclose(
        one.trajectory.position_sigma_m, other.trajectory.position_sigma_m, rtol=1e-6
    )
    assert other.report.notes == one.report.notes


def test_a_crest_makes_headings_unsure_unless_a_gyro_saw_them_turn() -> None:
    drive = simulate([Command(60.0, 1.5)], 90.0)
    rig = replace(paper_rig(), antenna=ANTENNA)
    fixes = on_ground(drive, 0.3, 0.0, -0.01, 0.005)
    alone = estimate_poses(fixes, rig, DATUM).trajectory
    turned = estimate_poses(fixes, rig, DATUM, motion=Motion(gyro=gyro_of(drive))).trajectory
    flat = estimate_poses(on_ground(drive, 0.0, 0.0), rig, DATUM).trajectory
    added = np.sqrt(
        np.median(alone.heading_sigma_deg) ** 2 - np.median(flat.heading_sigma_deg) ** 2
    )
    assert added == pytest.approx(np.degrees(3.0 * 0.006), rel=0.35)
    assert np.median(turned.heading_sigma_deg) < 0.6
