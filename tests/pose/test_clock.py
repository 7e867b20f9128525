"""The offset between the clocks of camera and receiver, injected and found again."""

from __future__ import annotations

import re

import numpy as np
import pytest

from fieldgrid.motion import Motion
from fieldgrid.pose import ClockOffset, ClockSearch, PoseReport, conditioned, estimate_poses
from fieldgrid.pose.axle import Axle
from fieldgrid.pose.drive import smooth_drive
from fieldgrid.rig import LeverArm
from fieldgrid.settings import PoseSettings
from tests.scenes import paper_rig
from tests.simulated import (
    DATUM,
    SLALOM,
    Command,
    Drive,
    fixes_of,
    gyro_of,
    simulate,
    steps_of,
)

WEAVING = [*SLALOM, Command(4.0, 0.5), *SLALOM[1:]]


def report(drive: Drive, late_s: float, *, seed: int = 0, noise_m: float = 0.01) -> PoseReport:
    fixes = fixes_of(drive, 0.2, noise_m, seed=seed)
    steps = steps_of(drive, 0.4, noise=1.0, late_s=late_s, seed=seed + 1)
    return estimate_poses(fixes, None, DATUM, motion=Motion(steps=steps)).report


@pytest.mark.parametrize(
    "late_s", [*(pytest.param(s, marks=pytest.mark.long) for s in (-0.9, 0.33)), -0.2, 0.0, 1.5]
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
    (note,) = (n for n in report(drive, 0.5).notes if "image_time_offset_s" in n)
    told = re.search(r"stamped \+(0\.\d{3}) s ± 0\.0\d\d s .* add -(0\.\d{3}) to image_time", note)
    assert told is not None
    assert told[1] == told[2]
    assert float(told[1]) == pytest.approx(0.5, abs=0.05)
    assert "image_time_offset_s in recording.toml, or to --time-offset" in note
    assert not any("image_time_offset_s" in n for n in report(drive, 0.0).notes)


@pytest.mark.parametrize(
    "commands", [[Command(40.0, 1.5)], [Command(3.0, 1.5, 0.2), Command(3.0, 1.0)]]
)
def test_an_even_or_short_drive_tells_no_offset(commands: list[Command]) -> None:
    assert report(simulate(commands, 20.0, speed_mps=1.5), 0.3).clock is None


@pytest.mark.parametrize("seed", range(6))
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


def test_an_offset_far_away_is_found_near_where_it_is_looked_for() -> None:
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    fixes = fixes_of(drive, 0.2, 0.02)
    steps = steps_of(drive, 0.4, noise=1.0, late_s=18.0)
    log = conditioned(fixes, PoseSettings(), DATUM)
    without = smooth_drive(log.accepted, fixes.time_ns, Motion(), Axle(None))
    search = ClockSearch(without, steps, Axle(None))
    scan = np.arange(-30.0, 30.0, 0.5)
    lowest = float(scan[int(np.argmin([search.misfit(offset) for offset in scan]))])
    found = search.best(lowest)
    assert found is not None
    assert found.offset_s == pytest.approx(-18.0, abs=3.0 * found.sigma_s)
    assert search.misfit(-18.0) < 0.5 * search.misfit(0.0)
    assert search.misfit(3600.0) == np.inf


def test_without_steps_there_is_none() -> None:
    drive = simulate(SLALOM, 20.0)
    assert estimate_poses(fixes_of(drive), None, DATUM).report.clock is None


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


def test_a_report_is_plain_values() -> None:
    drive = simulate(WEAVING, 20.0, speed_mps=1.5)
    told = report(drive, 0.5).as_dict()
    assert told["clock_offset"].keys() == set(ClockOffset._fields)
    assert told["gyro_bias_dps"] is None
    assert told["recorded_heading"] is None
    assert not np.isnan(told["clock_offset"]["offset_s"])
