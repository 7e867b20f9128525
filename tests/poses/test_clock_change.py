"""A clock of images or of fixes that is set within a drive, beside clocks that are not."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Gyro, LeverArm, Motion, Steps
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import smooth_drive
from fieldgrid.poses.faults.clock.offset import ClockFindings, check_clock
from fieldgrid.poses.fused import conditioned
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

MOVING = [*SLALOM, Command(8.0, 1.0), *SLALOM]


def accepted(drive: Drive, noise_m: float) -> AcceptedFixes:
    return conditioned(fixes_of(drive, 0.2, noise_m, seed=1), PoseSettings(), DATUM).accepted


def findings(drive: Drive, steps: Steps, gyro: Gyro | None, noise_m: float) -> ClockFindings:
    fixes = accepted(drive, noise_m)
    motion, axle = Motion(gyro=gyro, steps=steps), Axle(None)
    found = smooth_drive(fixes, fixes.time_ns, motion, axle)
    return check_clock(found, fixes, motion, axle, recorded=gyro)


def set_within(steps: Steps, gyro: Gyro, by_s: float) -> tuple[Steps, Gyro, int]:
    """Stamps of the second half later by `by_s`; the step and the samples in between are lost."""
    middle, by_ns = len(steps.start_ns) // 2, round(by_s * 1e9)
    from_ns = int(steps.start_ns[middle])
    later = np.arange(len(steps.start_ns)) >= middle
    moved = steps._replace(
        start_ns=steps.start_ns + by_ns * later, stop_ns=steps.stop_ns + by_ns * later
    )
    time_ns = gyro.time_ns + by_ns * (gyro.time_ns >= from_ns)
    keep = (gyro.time_ns < from_ns) | (time_ns > from_ns)
    keep &= ~((gyro.time_ns < from_ns) & (gyro.time_ns >= from_ns + by_ns))
    return (
        Steps(*(np.delete(column, middle - 1, axis=0) for column in moved)),
        Gyro(time_ns[keep], gyro.rate_rad_s[keep]),
        from_ns,
    )


@pytest.mark.parametrize("by_s", [1.0, -1.0])
@pytest.mark.parametrize("noise_m", [pytest.param(0.02, marks=pytest.mark.long), 0.1])
def test_a_clock_that_is_set_within_a_drive_is_found(by_s: float, noise_m: float) -> None:
    drive = simulate(MOVING, 20.0, speed_mps=1.2)
    steps, gyro, from_ns = set_within(steps_of(drive, 1.4, noise=1.0, seed=2), gyro_of(drive), by_s)
    found = findings(drive, steps, gyro, noise_m)
    assert found.offset is None
    change = found.change
    assert change is not None
    assert change.before_s == pytest.approx(0.0, abs=0.15)
    assert change.after_s == pytest.approx(-by_s, abs=0.2)
    assert change.time_ns == pytest.approx(from_ns, abs=12e9)
    assert change.gyro_too
    far_s = found.offset_s(np.array([0, change.time_ns]))
    assert far_s.tolist() == [change.before_s, change.after_s]


@pytest.mark.parametrize("late_s", [0.0, 0.4])
def test_one_clock_is_one_offset(late_s: float) -> None:
    drive = simulate(MOVING, 20.0, speed_mps=1.2)
    steps = steps_of(drive, 1.4, noise=1.0, seed=3)
    late_ns = round(late_s * 1e9)
    steps = steps._replace(start_ns=steps.start_ns + late_ns, stop_ns=steps.stop_ns + late_ns)
    found = findings(drive, steps, None, 0.02)
    assert found.change is None
    assert found.offset is not None
    assert found.offset.offset_s == pytest.approx(-late_s, abs=0.05)


def test_too_few_steps_tell_no_change() -> None:
    drive = simulate(MOVING, 20.0, speed_mps=1.2)
    steps, gyro, _ = set_within(steps_of(drive, 6.0, noise=1.0, seed=2), gyro_of(drive), 1.0)
    assert len(steps.start_ns) < 16
    assert findings(drive, steps, gyro, 0.02).change is None


def test_an_antenna_that_sits_elsewhere_is_no_clock() -> None:
    """Ahead it looks like an early clock, and backing up like a late one."""
    drive = simulate([*SLALOM, Command(8.0, -1.2), Command(20.0, -1.2, 0.1)], 20.0, speed_mps=1.2)
    log = conditioned(fixes_of(drive, 0.2, 0.02, antenna=LeverArm(0.0, 0.9, 2.0)), PoseSettings())
    steps, axle = steps_of(drive, 1.4, noise=1.0, seed=4), Axle(None)
    found = smooth_drive(log.accepted, log.accepted.time_ns, Motion(steps=steps), axle)
    assert check_clock(found, log.accepted, Motion(steps=steps), axle).change is None
