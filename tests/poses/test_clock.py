"""The offset between the clocks of camera and receiver, injected and found again."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import pytest

from fieldgrid.core import Severity
from fieldgrid.geometry import LeverArm, Motion, Steps
from fieldgrid.poses import estimate_poses
from tests.scenes import paper_rig
from tests.simulated import (
    DATUM,
    K_TURN,
    SLALOM,
    Command,
    Drive,
    fixes_of,
    gyro_of,
    simulate,
    steps_of,
)
from tests.told import codes

WEAVING = [*SLALOM, Command(4.0, 0.5), *SLALOM[1:]]
UNREPEATED = [*SLALOM, *K_TURN, *SLALOM[:4]]


def report(drive: Drive, late_s: float, *, seed: int = 0, noise_m: float = 0.01) -> Any:
    fixes = fixes_of(drive, 0.2, noise_m, seed=seed)
    steps = steps_of(drive, 0.4, noise=1.0, late_s=late_s, seed=seed + 1)
    return estimate_poses(fixes, None, DATUM, motion=Motion(steps=steps)).report


@pytest.mark.parametrize(
    "late_s", [*(pytest.param(s, marks=pytest.mark.long) for s in (-0.9, -0.2, 0.33)), 0.0, 1.5]
)
def test_late_images_are_found(late_s: float) -> None:
    """What is to be added to the images' stamps is minus what they are late by."""
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    for seed in range(2):
        found = report(drive, late_s, seed=seed).clock
        assert found is not None
        assert found.sigma_s < 0.05
        assert abs(found.offset_s + late_s) < 3.0 * found.sigma_s
        assert found.steps > 50


def test_the_note_names_the_setting() -> None:
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    (found,) = (one for one in report(drive, 0.5).findings if one.code == "clock-offset")
    assert found.severity is Severity.ERROR
    told = re.search(r"stamped \+(0\.\d{3}) s ± 0\.0\d\d s .*; at 1\.\d m/s", found.message)
    remedy = re.search(r"^Add -(0\.\d{3}) to --time-offset, or to image_time", found.remedy)
    assert told is not None
    assert remedy is not None
    assert told[1] == remedy[1]
    assert float(told[1]) == pytest.approx(0.5, abs=0.05)
    assert "clock-offset" not in codes(report(drive, 0.0))


@pytest.mark.parametrize(
    "commands", [[Command(40.0, 1.5)], [Command(3.0, 1.5, 0.2), Command(3.0, 1.0)]]
)
def test_an_even_or_short_drive_tells_no_offset(commands: list[Command]) -> None:
    assert report(simulate(commands, 20.0, speed_mps=1.5), 0.3).clock is None


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(one, marks=pytest.mark.long) for one in range(2, 6))]
)
def test_noise_on_an_even_drive_tells_no_offset(seed: int) -> None:
    even = simulate([Command(40.0, 1.5)], 20.0, speed_mps=1.5)
    assert report(even, 0.0, seed=seed, noise_m=0.02).clock is None


def test_with_a_gyro_thirty_milliseconds_are_told() -> None:
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    fixes = fixes_of(drive, 0.2, 0.02, seed=3)
    steps = steps_of(drive, 0.4, noise=1.0, late_s=0.03, seed=4)
    motion = Motion(gyro_of(drive), steps=steps)
    found = estimate_poses(fixes, None, DATUM, motion=motion).report.clock
    assert found is not None
    assert found.sigma_s < 0.01
    assert found.is_certain
    assert found.offset_s == pytest.approx(-0.03, abs=3.0 * found.sigma_s)


@pytest.mark.parametrize("late_s", [2.0, pytest.param(-18.0, marks=pytest.mark.long)])
def test_fixes_of_another_clock_than_images_and_gyro_are_told(late_s: float) -> None:
    """A computer of another time stamps images and gyro alike: it is the fixes to move."""
    drive = simulate(UNREPEATED, 20.0, speed_mps=1.5)
    fixes = fixes_of(drive, 0.2, 0.02, seed=6)
    gyro = gyro_of(drive, noise_dps=0.1)
    gyro = gyro._replace(time_ns=gyro.time_ns + round(late_s * 1e9))
    steps = steps_of(drive, 1.2, noise=1.0, late_s=late_s, seed=7)
    told = estimate_poses(fixes, None, DATUM, motion=Motion(gyro, steps=steps)).report
    assert told.clock is not None
    assert told.clock.gyro_too
    assert told.clock.offset_s == pytest.approx(-late_s, abs=3.0 * told.clock.sigma_s)
    assert told.clock.sigma_s < 0.05
    (note,) = (one.remedy for one in told.findings if one.code == "clock-offset")
    moved = re.search(r"add (-?\d+\.\d+) to --gnss-offset, or to gnss_time_offset_s", note)
    assert moved is not None
    assert float(moved[1]) == pytest.approx(late_s, abs=0.1)
    # A gyro of the receiver's clock says that it is the images.
    motion = Motion(gyro_of(drive, noise_dps=0.1), steps=steps)
    other = estimate_poses(fixes, None, DATUM, motion=motion).report.clock
    assert other is not None
    assert not other.gyro_too
    assert other.offset_s == pytest.approx(-late_s, abs=3.0 * other.sigma_s)


def exchanged(steps: Steps, order: Sequence[int]) -> Steps:
    """The motions of other moments at these stamps."""
    others = Steps(*(column[list(order)] for column in steps))
    return others._replace(start_ns=steps.start_ns, stop_ns=steps.stop_ns)


def contradiction(drive: Drive, steps: Steps, noise_m: float = 0.02) -> Any:
    fixes = fixes_of(drive, 0.2, noise_m, seed=8)
    motion = Motion(gyro_of(drive, noise_dps=0.1), steps=steps)
    found = estimate_poses(fixes, None, DATUM, motion=motion).report.contradiction
    assert found is not None
    return found


def test_images_of_other_moments_than_stamped_are_told() -> None:
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    steps = steps_of(drive, 1.2, noise=1.0, seed=9)
    count = len(steps.start_ns)
    as_text = sorted(range(count), key=str)
    found = contradiction(drive, exchanged(steps, as_text))
    assert found.is_certain
    assert not found.gyro_too
    one_late = [*range(count // 2), *range(count // 2 - 1, count - 1)]
    found = contradiction(drive, exchanged(steps, one_late))
    assert found.is_certain
    assert not found.gyro_too


def test_a_gyro_that_turns_as_the_images_do_blames_the_fixes() -> None:
    """They scatter by a metre and state two centimetres."""
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    found = contradiction(drive, steps_of(drive, 1.2, noise=1.0, seed=10), 1.0)
    assert found.is_certain
    assert found.gyro_too


@pytest.mark.parametrize(
    ("scale", "noise_m"),
    [
        (1.08, 0.1),
        *(
            pytest.param(*one, marks=pytest.mark.long)
            for one in ((1.0, 0.02), (1.0, 0.1), (1.08, 0.02))
        ),
    ],
)
def test_images_of_their_moments_do_not_contradict(scale: float, noise_m: float) -> None:
    """With fixes that are poorer than they state, and a calibration that is somewhat off."""
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    steps = steps_of(drive, 1.2, noise=1.0, seed=10)
    longer = steps._replace(forward_m=scale * steps.forward_m, right_m=scale * steps.right_m)
    found = contradiction(drive, longer, noise_m)
    assert found.off == 0
    assert not found.is_certain


def test_without_steps_there_is_none() -> None:
    drive = simulate(SLALOM, 20.0)
    found = estimate_poses(fixes_of(drive), None, DATUM).report
    assert found.clock is None
    assert found.contradiction is None
    assert found.camera_yaw is None


def test_the_camera_s_place_is_regarded() -> None:
    """Steps are those of the grid origin, ahead of the axle."""
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    antenna = LeverArm(0.3, -0.5, 2.0)
    rig = paper_rig(antenna=antenna, rear_axle_forward_m=-2.0)
    at_axle = LeverArm(0.3, 1.5, 2.0)
    fixes = fixes_of(drive, 0.2, 0.01, antenna=at_axle)
    steps = steps_of(drive, 0.4, 2.0, noise=1.0, late_s=0.3)
    found = estimate_poses(fixes, rig, DATUM, motion=Motion(steps=steps)).report.clock
    assert found is not None
    assert abs(found.offset_s + 0.3) < 3.0 * found.sigma_s
