"""The ground under the vehicle, carried there by the sensor's own motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fieldgrid.geometry import Mount
from fieldgrid.perception import RigidMotion
from fieldgrid.pipeline.mounting.ground_under_vehicle import Patches, ground_under_vehicle
from fieldgrid.pipeline.mounting.plane import SensorGround

STEP_M = 1.0


def climb(y: np.ndarray) -> np.ndarray:
    """A field that is level for 12 m and then rises by 5°: what is ahead is not what is below."""
    return np.maximum(y - 12.0, 0.0) * math.tan(math.radians(5.0))


def drive(mount: Mount, frames: int) -> tuple[list[Patches], list[RigidMotion | None]]:
    """A vehicle that stays level on the level part of the field, with the patches 4-9 m ahead."""
    R = mount.rotation()
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-1.5, 1.6, 0.25), np.arange(4.0, 9.0, 0.25)))
    seen = []
    for k in range(frames):
        level = np.column_stack([x, y, climb(y + k * STEP_M)]) - [0.0, 0.0, mount.height_m]
        seen.append(Patches(level @ R, np.full(len(x), 0.03)))
    step = RigidMotion(np.eye(3), R.T @ np.array([0.0, -STEP_M, 0.0]))
    return seen, [step] * (frames - 1)


@pytest.mark.parametrize("mount", [Mount(2.0, 15.0, 2.0), Mount(1.2, 30.0, -4.0)])
def test_the_ground_under_the_vehicle_is_what_counts(mount: Mount) -> None:
    seen, motions = drive(mount, 11)
    start = SensorGround(Mount(1.0, mount.tilt_deg + 2.0, mount.roll_deg - 1.0).rotation()[2], 2.1)
    found, plane = ground_under_vehicle(seen, motions, start)
    assert list(found.frame) == list(range(5, 11))  # before, nothing had been seen of the ground
    np.testing.assert_allclose(found.tilt_deg, mount.tilt_deg, atol=1e-6)
    np.testing.assert_allclose(found.roll_deg, mount.roll_deg, atol=1e-6)
    np.testing.assert_allclose(found.height_m, mount.height_m, atol=1e-6)
    assert plane.tilt_deg == pytest.approx(mount.tilt_deg, abs=1e-6)


def test_in_reverse_the_ground_is_seen_afterwards() -> None:
    mount = Mount(2.0, 15.0, 2.0)
    seen, motions = drive(mount, 11)
    back: list[RigidMotion | None] = [
        RigidMotion(m.R_stop_start.T, -m.R_stop_start.T @ m.t_stop_start_m) for m in motions if m
    ]
    found, _ = ground_under_vehicle(seen[::-1], back[::-1], SensorGround(mount.rotation()[2], 2.0))
    assert list(found.frame) == list(range(6))
    np.testing.assert_allclose(found.roll_deg, 2.0, atol=1e-6)


def test_a_step_that_is_not_known_cuts_the_way() -> None:
    mount = Mount(2.0, 15.0)
    seen, motions = drive(mount, 11)
    motions[8] = None
    found, _ = ground_under_vehicle(seen, motions, SensorGround(mount.rotation()[2], 2.0))
    assert list(found.frame) == [5, 6, 7, 8]


def test_without_motion_there_are_no_stands() -> None:
    mount = Mount(2.0, 15.0)
    seen, _ = drive(mount, 4)
    start = SensorGround(mount.rotation()[2], 2.0)
    found, plane = ground_under_vehicle(seen, [None] * 3, start)
    assert len(found.frame) == 0
    assert plane is start


def test_a_vehicle_that_sways_and_turns_stands_as_it_does() -> None:
    """Each frame's own attitude is found, though every patch was seen from another one."""
    random = np.random.default_rng(4)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-3.0, 3.1, 0.25), np.arange(4.0, 9.0, 0.25)))
    mounts, places, seen = [], [], []
    at, heading = np.zeros(2), 0.0
    for _ in range(12):
        mount = Mount(2.0, *(np.array([15.0, 2.0]) + random.normal(0.0, 1.0, 2)), heading)
        mounts.append(mount)
        places.append(np.array([*at, mount.height_m]))
        R_level = Mount(2.0, mount.tilt_deg, mount.roll_deg).rotation()
        level = np.column_stack([x, y, np.zeros(len(x))]) - [0.0, 0.0, mount.height_m]
        seen.append(Patches(level @ R_level, np.full(len(x), 0.03)))
        ahead = math.radians(heading)
        at = at + np.array([math.sin(ahead), math.cos(ahead)])
        heading += 2.0
    motions: list[RigidMotion | None] = []
    for k in range(11):
        R_start, R_stop = mounts[k].rotation(), mounts[k + 1].rotation()
        motions.append(RigidMotion(R_stop.T @ R_start, R_stop.T @ (places[k] - places[k + 1])))
    found, _ = ground_under_vehicle(
        seen, motions, SensorGround(Mount(2.0, 15.0, 2.0).rotation()[2], 2.0)
    )
    assert len(found.frame) >= 6
    for k, tilt, roll in zip(found.frame, found.tilt_deg, found.roll_deg, strict=True):
        assert tilt == pytest.approx(mounts[k].tilt_deg, abs=1e-6)
        assert roll == pytest.approx(mounts[k].roll_deg, abs=1e-6)
    np.testing.assert_allclose(found.height_m, 2.0, atol=1e-6)
