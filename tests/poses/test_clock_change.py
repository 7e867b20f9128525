"""A clock of images or of fixes that is set within a drive, beside clocks that are not."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import LeverArm, Motion, Steps
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM, SLALOM, Command, fixes_of, gyro_of, simulate, steps_of

MOVING = [*SLALOM, Command(8.0, 1.0), *SLALOM]


@pytest.mark.parametrize(
    ("by_s", "noise_m"), [(1.0, 0.02), (-1.0, 0.02), (1.5, 0.02), (1.0, 0.1), (-1.0, 0.1)]
)
def test_a_clock_that_is_set_within_a_drive_is_found(by_s: float, noise_m: float) -> None:
    """Stamps of the second half are later; the step and the samples in between are lost."""
    drive, by_ns = simulate(MOVING, 20.0, speed_mps=1.2), round(by_s * 1e9)
    steps, gyro = steps_of(drive, 1.4, noise=1.0, seed=2), gyro_of(drive)
    middle = len(steps.start_ns) // 2
    from_ns, later = int(steps.start_ns[middle]), np.arange(len(steps.start_ns)) >= middle
    start_ns, stop_ns = (ns + by_ns * later for ns in (steps.start_ns, steps.stop_ns))
    steps = steps._replace(start_ns=start_ns, stop_ns=stop_ns)
    steps = Steps(*(np.delete(column, middle - 1, axis=0) for column in steps))
    time_ns = gyro.time_ns + by_ns * (gyro.time_ns >= from_ns)
    keep = np.where(gyro.time_ns < from_ns, gyro.time_ns < from_ns + by_ns, time_ns > from_ns)
    gyro = gyro._replace(time_ns=time_ns[keep], rate_rad_s=gyro.rate_rad_s[keep])
    fixes = fixes_of(drive, 0.2, noise_m, seed=1)
    report = estimate_poses(fixes, None, DATUM, motion=Motion(gyro, steps=steps)).report
    change = report.clock_change
    assert report.clock is None
    assert change is not None
    assert change.before_s == pytest.approx(0.0, abs=0.15)
    assert change.after_s == pytest.approx(-by_s, abs=0.2)
    assert change.time_ns == pytest.approx(from_ns, abs=12e9)
    assert change.gyro_too


@pytest.mark.parametrize(
    ("commands", "every_s", "late_s", "ahead_m"),
    [
        (MOVING, 1.4, 0.0, 0.0),
        (MOVING, 1.4, 0.4, 0.0),
        # Ahead an antenna that sits elsewhere looks like an early clock, and backing up a late one.
        ([*SLALOM, Command(8.0, -1.2), Command(20.0, -1.2, 0.1)], 1.4, 0.0, 0.9),
    ],
)
def test_one_clock_is_one_offset(
    commands: list[Command], every_s: float, late_s: float, ahead_m: float
) -> None:
    drive = simulate(commands, 20.0, speed_mps=1.2)
    steps = steps_of(drive, every_s, noise=1.0, late_s=late_s, seed=3)
    fixes = fixes_of(drive, 0.2, 0.02, seed=1, antenna=LeverArm(0.0, ahead_m, 2.0))
    report = estimate_poses(fixes, None, DATUM, motion=Motion(steps=steps)).report
    assert report.clock_change is None
    if not ahead_m:
        assert report.clock is not None
        assert report.clock.offset_s == pytest.approx(-late_s, abs=0.05)
