"""A clock of images and gyro that is set within a drive, beside holes that are holes."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Gyro, Steps
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.faults.clock.jump import clock_jump
from fieldgrid.poses.fused import conditioned
from tests.simulated import (
    DATUM,
    SLALOM,
    STOP,
    Command,
    Drive,
    fixes_of,
    gyro_of,
    simulate,
    steps_of,
)

MOVING = [Command(30.0, 1.2), *SLALOM[1:3], Command(30.0, 1.2)]


def accepted(drive: Drive, noise_m: float = 0.02) -> AcceptedFixes:
    return conditioned(fixes_of(drive, 0.2, noise_m, seed=1), PoseSettings(), DATUM).accepted


def set_ahead(steps: Steps, gyro: Gyro, at: int, jump_s: float) -> tuple[Steps, Gyro]:
    """All stamps later by `jump_s` from the end of a step on."""
    jump_ns, from_ns = round(jump_s * 1e9), int(steps.stop_ns[at])
    start_ns = steps.start_ns + jump_ns * (steps.start_ns >= from_ns)
    stop_ns = steps.stop_ns + jump_ns * (steps.stop_ns >= from_ns)
    return (
        steps._replace(start_ns=start_ns, stop_ns=stop_ns),
        gyro._replace(time_ns=gyro.time_ns + jump_ns * (gyro.time_ns >= from_ns)),
    )


def without(gyro: Gyro, first_ns: int, last_ns: int) -> Gyro:
    keep = (gyro.time_ns < first_ns) | (gyro.time_ns >= last_ns)
    return Gyro(gyro.time_ns[keep], gyro.rate_rad_s[keep])


@pytest.mark.parametrize("jump_s", [0.5, 3.0])
@pytest.mark.parametrize("period_s", [0.2, 1.6])
def test_a_clock_that_is_set_ahead_is_found(jump_s: float, period_s: float) -> None:
    drive = simulate(MOVING, 20.0, speed_mps=1.2)
    steps = steps_of(drive, period_s, noise=1.0, seed=2)
    at = len(steps.start_ns) // 4
    moved, gyro = set_ahead(steps, gyro_of(drive), at, jump_s)
    found = clock_jump(accepted(drive), moved, gyro)
    assert found is not None
    assert found.jump_s == pytest.approx(jump_s, abs=0.03)
    assert found.time_ns == pytest.approx(int(moved.stop_ns[at]), abs=5e7)
    assert found.driven_m - found.seen_m == pytest.approx(1.2 * jump_s, abs=0.3)


def test_a_hole_is_a_hole() -> None:
    """A recorder that paused: the camera went as far in it as the fixes."""
    drive = simulate(MOVING, 20.0, speed_mps=1.2)
    steps = steps_of(drive, 2.0, noise=1.0, seed=3)
    gyro = gyro_of(drive)
    first_ns = int(steps.start_ns[5]) + 300_000_000
    assert clock_jump(accepted(drive), steps, without(gyro, first_ns, first_ns + 10**9)) is None
    assert clock_jump(accepted(drive), steps, gyro) is None
    joined = Steps(*(np.delete(column, slice(6, 9)) for column in steps))
    assert clock_jump(accepted(drive), joined, without(gyro, first_ns, first_ns + 10**9)) is None


def test_at_rest_nothing_tells_a_jump_from_a_hole() -> None:
    drive = simulate(STOP, 20.0, speed_mps=1.5)
    steps = steps_of(drive, 1.0, noise=1.0, seed=4)
    standing = int(np.searchsorted(drive.time_s, 20.0) / len(drive.time_s) * len(steps.start_ns))
    moved, gyro = set_ahead(steps, gyro_of(drive), standing, 2.0)
    assert clock_jump(accepted(drive), moved, gyro) is None


def test_fixes_of_a_metre_tell_no_jump_of_less() -> None:
    drive = simulate(MOVING, 20.0, speed_mps=1.2)
    steps = steps_of(drive, 1.6, noise=1.0, seed=5)
    moved, gyro = set_ahead(steps, gyro_of(drive), len(steps.start_ns) // 4, 0.5)
    assert clock_jump(accepted(drive, 1.0), moved, gyro) is None


def test_without_camera_or_gyro_there_is_none() -> None:
    drive = simulate(MOVING, 20.0, speed_mps=1.2)
    steps = steps_of(drive, 1.6)
    assert clock_jump(accepted(drive), None, gyro_of(drive)) is None
    assert clock_jump(accepted(drive), steps, None) is None
