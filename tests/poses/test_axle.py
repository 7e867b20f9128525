"""An axle that nobody names: told by camera or gyro, or unsure, and said so."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Carrier, Datum, LeverArm, Motion, Rig, wrap_deg
from fieldgrid.poses import Estimate, estimate_poses
from fieldgrid.poses.axle import Axle, axle_of
from tests.scenes import paper_rig
from tests.simulated import K_TURN, SLALOM, Command, Drive, fixes_of, gyro_of, simulate, steps_of

DATUM = Datum(39.5, -1.1, 700.0)


def estimate(drive: Drive, rig: Rig | Carrier | None, motion: Motion, ahead_m: float) -> Estimate:
    """Poses of a vehicle whose antenna is `ahead_m` ahead of its axle."""
    fixes = fixes_of(drive, 0.2, 0.01, antenna=LeverArm(0.0, ahead_m, 0.0))
    return estimate_poses(fixes, rig, DATUM, motion=motion)


def off_deg(found: Estimate, drive: Drive) -> np.ndarray:
    time_ns = found.trajectory.time_ns
    truth = drive.at((time_ns - time_ns[found.fix_row[0]]) / 1e9)
    return np.abs(wrap_deg(found.trajectory.heading_deg - np.degrees(truth.heading_rad)))


UNSURE = pytest.mark.xfail(reason="four sigmas of what is supposed: most are refused", strict=True)


@pytest.mark.parametrize(
    ("commands", "ahead_m"),
    [
        *((K_TURN, ahead_m) for ahead_m in (-1.0, 0.4, 2.0)),
        *(pytest.param(SLALOM, ahead_m, marks=pytest.mark.long) for ahead_m in (-1.0, 0.4)),
        pytest.param(SLALOM, 2.0, marks=[pytest.mark.long, UNSURE]),
    ],
)
def test_a_camera_tells_the_axle(commands: list[Command], ahead_m: float) -> None:
    """The camera is where the antenna is, so what it sees tells where both are."""
    drive = simulate(commands, 35.0)
    motion = Motion(steps=steps_of(drive, ahead_m=ahead_m, noise=1.0))
    # Whole numbers in a file are numbers like others.
    found = estimate(drive, paper_rig(antenna=LeverArm(0, 0, 3)), motion, ahead_m)
    assert found.trajectory.accepted.mean() > 0.95
    assert off_deg(found, drive).max() < 1.0
    assert (off_deg(found, drive) < 3.0 * found.trajectory.heading_sigma_deg).all()
    (note,) = (note for note in found.report.notes if "axle" in note)
    told_m = float(note.split("by the drive it is ")[1].split(" m")[0])
    assert told_m == pytest.approx(ahead_m, abs=0.15)


@pytest.mark.parametrize("ahead_m", [-1.0, 0.4])
@pytest.mark.parametrize("commands", [SLALOM, K_TURN])
def test_a_gyro_tells_the_axle(commands: list[Command], ahead_m: float) -> None:
    drive = simulate(commands, 35.0)
    motion = Motion(gyro=gyro_of(drive, bias_dps=0.4, noise_dps=0.05))
    found = estimate(drive, None, motion, ahead_m)
    assert found.trajectory.accepted.mean() > 0.95
    assert off_deg(found, drive).max() < 1.0


@pytest.mark.parametrize("ahead_m", [-0.75, 0.75])  # 1.5 sigmas of what is supposed
@pytest.mark.parametrize("commands", [SLALOM, K_TURN])
def test_without_them_headings_are_unsure_in_turns(commands: list[Command], ahead_m: float) -> None:
    drive = simulate(commands, 35.0)
    found = estimate(drive, paper_rig(), Motion(), ahead_m)
    assert (off_deg(found, drive) < 3.0 * found.trajectory.heading_sigma_deg).mean() > 0.99
    assert off_deg(found, drive).max() > 5.0
    assert any("unsure in turns" in note for note in found.report.notes)
    # Who names the axle has headings that are right, and are known to be.
    rig = paper_rig(rear_axle_forward_m=-ahead_m)
    named = estimate(drive, rig, Motion(), ahead_m)
    assert named.trajectory.accepted.mean() > found.trajectory.accepted.mean()
    assert not any("axle" in note for note in named.report.notes)


def test_a_log_alone_says_what_it_takes_the_antenna_for() -> None:
    found = estimate(simulate(SLALOM, 35.0), None, Motion(), 0.0)
    (note,) = (note for note in found.report.notes if "axle" in note)
    assert "taken to be above it" in note
    assert "--antenna-ahead METRES" in note


def test_straight_on_the_axle_does_not_matter() -> None:
    drive = simulate([Command(20.0, 1.5)], 35.0, speed_mps=1.5)
    unnamed, named = (
        estimate(drive, rig, Motion(), 0.0).trajectory.heading_sigma_deg
        for rig in (paper_rig(), paper_rig(rear_axle_forward_m=0.0))
    )
    inner = slice(5, -5)
    assert (unnamed[inner] < 1.5 * named[inner]).all()


def test_what_is_declared_is_used() -> None:
    rig = paper_rig(antenna=LeverArm(0.2, 1.0, 3.0), rear_axle_forward_m=-0.5)
    declared = axle_of(rig)
    assert declared == Axle(rig)
    assert declared.frame() == ((0.2, 1.5), 0.5)
