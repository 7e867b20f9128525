"""The camera's yaw and the unsteered axle, by the way the vehicle goes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import Mount
from fieldgrid.perception import RigidMotion
from fieldgrid.pipeline.mounting.estimate import ground_steps
from fieldgrid.pipeline.mounting.plane import SensorGround
from fieldgrid.poses import Ways, travel

LEGS = [(10, 1.0, 0.0), (5, 1.0, 0.12), (10, 1.0, 0.0), (4, -1.0, 0.08), (8, 1.0, -0.05)]
"""Steps, metres forward of the axle in each, curvature to the right when driving forward."""


def motions(
    mount: Mount,
    ahead_m: float,
    legs: list[tuple[int, float, float]],
    noise_m: float = 0.0,
    seed: int = 0,
) -> list[RigidMotion | None]:
    """What a perfect camera `ahead_m` of the axle sees of itself on exact arcs."""
    random = np.random.default_rng(seed)
    R_vc = mount.rotation()
    found: list[RigidMotion | None] = []
    for count, distance_m, curvature in legs:
        for _ in range(count):
            turn = distance_m * curvature
            chord = distance_m * (math.sin(turn / 2.0) / (turn / 2.0) if turn else 1.0)
            axle = np.array([chord * math.sin(turn / 2.0), chord * math.cos(turn / 2.0), 0.0])
            cos, sin = math.cos(turn), math.sin(turn)
            R_start_stop = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
            place = np.array([0.0, ahead_m, mount.height_m])
            moved = axle + R_start_stop @ place - place + random.normal(0.0, noise_m, 3)
            R = R_vc.T @ R_start_stop.T @ R_vc
            found.append(RigidMotion(R, -R @ (R_vc.T @ moved)))
    return found


def plane_of(mount: Mount) -> SensorGround:
    return SensorGround(mount.rotation()[2], mount.height_m)


@settings(max_examples=30, deadline=None)
@given(st.floats(-20.0, 20.0), st.floats(-0.5, 2.5), st.floats(-10.0, 10.0), st.floats(0.0, 40.0))
def test_yaw_and_axle_are_found(yaw: float, ahead: float, roll: float, tilt: float) -> None:
    mount = Mount(2.0, tilt, roll, yaw)
    moved = travel(ground_steps(motions(mount, ahead, LEGS), plane_of(mount)))
    assert moved.yaw_deg is not None
    assert moved.ahead_m is not None
    assert moved.yaw_deg.value == pytest.approx(yaw, abs=0.1)
    assert moved.ahead_m.value == pytest.approx(ahead, abs=0.1)


@pytest.mark.parametrize("distance_m", [1.0, -1.0])
def test_the_sign_is_that_of_the_camera_also_in_reverse(distance_m: float) -> None:
    """A camera that looks to the right sees the vehicle go to its left."""
    mount = Mount(2.0, 15.0, 0.0, 3.0)
    steps = ground_steps(motions(mount, 1.0, [(12, distance_m, 0.0)]), plane_of(mount))
    np.testing.assert_allclose(steps.forward_m, distance_m, atol=1e-9)
    np.testing.assert_allclose(steps.direction_deg, -3.0, atol=1e-9)
    moved = travel(steps)
    assert moved.yaw_deg is not None
    assert moved.yaw_deg.value == pytest.approx(3.0, abs=1e-6)
    assert moved.ahead_m is None  # nothing turned


def test_curvature_is_to_the_right_when_driving_forward() -> None:
    mount = Mount(2.0, 15.0)
    for distance_m in (1.0, -1.0):
        steps = ground_steps(motions(mount, 0.0, [(3, distance_m, 0.1)]), plane_of(mount))
        np.testing.assert_allclose(steps.curvature_per_m, 0.1, rtol=0.01)
        np.testing.assert_allclose(steps.turn_deg, math.degrees(0.1 * distance_m), atol=1e-9)


def test_sway_of_a_high_camera_is_no_way() -> None:
    """The camera goes 5 cm aside since the vehicle rolls by 1.4°; the ground point does not."""
    mount, roll = Mount(2.0, 15.0), math.radians(1.4)
    R_vc = mount.rotation()
    cos, sin = math.cos(roll), math.sin(roll)
    rolled = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    place = np.array([0.0, 0.0, mount.height_m])
    moved = np.array([0.0, 1.0, 0.0]) + rolled @ place - place
    R = R_vc.T @ rolled.T @ R_vc
    steps = ground_steps([RigidMotion(R, -R @ (R_vc.T @ moved))], plane_of(mount))
    np.testing.assert_allclose(steps.direction_deg, 0.0, atol=1e-6)
    np.testing.assert_allclose(steps.forward_m, 1.0, atol=1e-6)


def test_the_truth_is_within_the_sigmas_that_are_told() -> None:
    mount, off_yaw, off_ahead = Mount(2.0, 15.0, 0.0, 1.5), [], []
    for seed in range(40):
        steps = ground_steps(motions(mount, 1.4, LEGS, 0.01, seed), plane_of(mount))
        moved = travel(steps)
        assert moved.yaw_deg is not None
        assert moved.ahead_m is not None
        off_yaw.append(moved.yaw_deg.off(1.5))
        off_ahead.append(moved.ahead_m.off(1.4))
    for off in (off_yaw, off_ahead):
        assert np.mean(np.abs(off) < 2.0) > 0.9
        assert np.std(off) > 0.3  # and are no exaggeration


def test_of_one_curve_the_yaw_is_told_only_with_the_axle() -> None:
    mount = Mount(2.0, 15.0, 0.0, 2.0)
    steps = ground_steps(motions(mount, 1.4, [(20, 1.0, 0.04)]), plane_of(mount))
    assert travel(steps).yaw_deg is None
    moved = travel(steps, 1.4)
    assert moved.yaw_deg is not None
    assert moved.yaw_deg.value == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("legs", [[(5, 1.0, 0.0)], [(30, 0.15, 0.0)], [(30, 1.0, 0.2)]])
def test_too_few_steps_or_too_little_straight_on_tell_no_yaw(
    legs: list[tuple[int, float, float]],
) -> None:
    mount = Mount(2.0, 15.0)
    moved = travel(ground_steps(motions(mount, 1.0, legs), plane_of(mount)))
    assert moved.yaw_deg is None
    assert moved.ahead_m is None


def test_steps_that_are_unknown_or_at_rest_are_left_out() -> None:
    mount = Mount(2.0, 15.0)
    known = motions(mount, 1.0, [(2, 1.0, 0.0), (1, 0.05, 0.0), (1, 1.0, 0.0)])
    steps = ground_steps([None, *known], plane_of(mount))
    assert list(steps.stop) == [2, 3, 5]
    assert isinstance(steps, Ways)
    assert len(ground_steps([None, None], plane_of(mount)).stop) == 0
