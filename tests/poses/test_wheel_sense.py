"""Wheels whose sign is turned round."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Motion, WheelSpeed
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.fused import with_right_wheels
from tests.simulated import DATUM, K_TURN, SLALOM, Drive, fixes_of, simulate, steps_of, time_ns


def wheels_of(drive: Drive, sign: float) -> WheelSpeed:
    return WheelSpeed(time_ns(drive.time_s)[::10], sign * drive.speed_mps[::10])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_camera_tells_their_sense(sign: float) -> None:
    drive = simulate([*K_TURN, *SLALOM], 30.0, speed_mps=1.5)
    motion = Motion(steps=steps_of(drive, 1.0, noise=1.0, seed=2), wheels=wheels_of(drive, sign))
    right, note = with_right_wheels(motion)
    assert right.wheels is not None
    assert np.array_equal(right.wheels.speed_mps, wheels_of(drive, 1.0).speed_mps)
    assert (note is None) is (sign > 0.0)
    found = estimate_poses(fixes_of(drive, 0.2, 0.02, seed=1), None, DATUM, motion=motion)
    assert any("other way than the camera" in told for told in found.report.notes) is (sign < 0.0)
    trajectory = found.trajectory
    true = np.interp(trajectory.time_ns, time_ns(drive.time_s), drive.gear())
    moving = trajectory.accepted & (np.abs(true) == 1.0)
    assert (np.sign(trajectory.speed_mps[moving]) == true[moving]).mean() > 0.97


def test_without_a_camera_a_drive_that_only_backs_up_is_told() -> None:
    drive = simulate([*SLALOM, *K_TURN], 30.0, speed_mps=1.5)
    for sign in (1.0, -1.0):
        motion = Motion(wheels=wheels_of(drive, sign))
        same, note = with_right_wheels(motion)
        assert same is motion
        assert (note is not None) is (sign < 0.0)


def test_wheels_that_cannot_turn_back_are_left_alone() -> None:
    drive = simulate(K_TURN, 30.0, speed_mps=1.5)
    wheels = WheelSpeed(time_ns(drive.time_s), np.abs(drive.speed_mps))
    motion = Motion(steps=steps_of(drive, 1.0, noise=1.0, seed=3), wheels=wheels)
    assert with_right_wheels(motion) == (motion, None)
