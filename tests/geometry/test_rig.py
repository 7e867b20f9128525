"""The camera's attitude on the vehicle, and rigs that cannot be."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import CalibrationError, RecordingError
from fieldgrid.geometry import LeverArm, Mount, StereoCamera

CAMERA = StereoCamera(640, 480, 780.0, 320.0, 240.0, 0.2)

tilts = st.floats(-10.0, 75.0)
mounts = st.builds(
    Mount, st.floats(0.1, 10.0), tilts, st.floats(-20.0, 20.0), st.floats(-45.0, 45.0)
)


def seen_at(mount: Mount, right: float, forward: float, up: float) -> npt.NDArray[np.float64]:
    """(right, down) in the image of a far point in a direction of the vehicle frame."""
    x, y, z = mount.rotation().T @ np.array([right, forward, up])
    assert z > 0.0
    return np.array([x / z, y / z])


@given(mounts)
def test_the_rotation_is_proper(mount: Mount) -> None:
    R = mount.rotation()
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(tilts, st.tuples(*[st.floats(-20.0, 20.0)] * 3))
def test_a_tilt_alone_is_the_closed_form(
    tilt_deg: float, point: tuple[float, float, float]
) -> None:
    x_c, y_c, z_c = point
    s, c = math.sin(math.radians(tilt_deg)), math.cos(math.radians(tilt_deg))
    expected = [x_c, z_c * c - y_c * s, -z_c * s - y_c * c]
    assert Mount(2.8, tilt_deg).rotation() @ np.array(point) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("tilt_deg", [0.0, 12.0, 20.0])
def test_the_optical_axis_meets_the_ground_at_height_over_tangent(tilt_deg: float) -> None:
    axis = Mount(2.8, tilt_deg).rotation()[:, 2]
    if tilt_deg == 0.0:
        assert axis == pytest.approx([0.0, 1.0, 0.0])
    else:
        ahead_m = 2.8 / -axis[2] * axis[1]
        assert ahead_m == pytest.approx(2.8 / math.tan(math.radians(tilt_deg)))


def test_tilting_down_raises_the_horizon_in_the_image() -> None:
    assert seen_at(Mount(2.8, 15.0), 0.0, 1.0, 0.0)[1] < -0.2


@pytest.mark.parametrize("tilt_deg", [0.0, 15.0])
def test_with_the_right_side_down_the_horizon_climbs_to_the_right(tilt_deg: float) -> None:
    mount = Mount(2.8, tilt_deg, roll_deg=10.0)
    assert mount.rotation()[2, 0] < 0.0  # the camera's own right points at the ground
    right, left = seen_at(mount, 0.5, 1.0, 0.0), seen_at(mount, -0.5, 1.0, 0.0)
    assert right[1] < left[1]
    slope = math.degrees(math.atan2(left[1] - right[1], right[0] - left[0]))
    assert slope == pytest.approx(10.0, abs=0.5)


def test_looking_right_moves_what_is_ahead_to_the_left() -> None:
    mount = Mount(2.8, 15.0, yaw_deg=20.0)
    ahead, beside = seen_at(mount, 0.0, 1.0, 0.0), seen_at(mount, math.tan(math.radians(20)), 1, 0)
    assert ahead[0] < -0.3
    assert beside[0] == pytest.approx(0.0, abs=1e-12)


def test_yaw_turns_the_tilted_camera_about_the_vertical() -> None:
    axis = Mount(2.8, 15.0, yaw_deg=30.0).rotation()[:, 2]
    assert math.degrees(math.asin(-axis[2])) == pytest.approx(15.0)
    assert math.degrees(math.atan2(axis[0], axis[1])) == pytest.approx(30.0)


def test_roll_is_about_the_camera_s_own_forward_before_yaw() -> None:
    R = Mount(2.8, 0.0, roll_deg=10.0, yaw_deg=30.0).rotation()
    assert R[2, 2] == pytest.approx(0.0, abs=1e-12)  # a level camera stays level
    assert math.degrees(math.asin(-R[2, 0])) == pytest.approx(10.0)


@given(st.floats(1.0, 50.0), st.floats(0.01, 1.0))
def test_range_error_is_that_of_the_disparity(range_m: float, sigma_px: float) -> None:
    disparity = 780.0 * 0.2 / range_m
    step = 1e-5
    slope = abs(780.0 * 0.2 / (disparity + step) - 780.0 * 0.2 / (disparity - step)) / (2 * step)
    assert CAMERA.range_sigma_m(range_m, sigma_px) == pytest.approx(slope * sigma_px, rel=1e-3)


def test_range_error_of_the_paper() -> None:
    errors_cm = 100.0 * CAMERA.range_sigma_m([5.0, 10.0, 15.0], 0.25)
    assert errors_cm == pytest.approx([4.0, 16.0, 36.0], abs=0.5)


def test_the_disparity_of_a_point_at_infinity() -> None:
    assert CAMERA.disparity_offset_px == 0.0
    shifted = replace(CAMERA, cx_right_px=330.0)
    far_m = 1e9
    u_left, u_right = 320.0 + 780.0 / far_m, 330.0 + 780.0 * (1.0 - 0.2) / far_m
    assert shifted.disparity_offset_px == pytest.approx(u_left - u_right)


@pytest.mark.parametrize(
    ("change", "quoted"),
    [
        ({"width_px": 8}, "8 x 480"),
        ({"height_px": 30_000}, "640 x 30000"),
        ({"focal_px": 4.5}, "4.5 px"),
        ({"focal_px": math.nan}, "nan px"),
        ({"focal_px": -780.0}, "-780.0 px"),
        ({"baseline_m": -0.2}, "-0.2 m"),
        ({"baseline_m": 200.0}, "200.0 m"),
        ({"baseline_m": math.nan}, "nan m"),
        ({"cx_px": 2000.0}, "cx = 2000.0"),
        ({"cy_px": -500.0}, "cy = -500.0"),
        ({"cy_px": math.inf}, "cy = inf"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(change: dict[str, float], quoted: str) -> None:
    with pytest.raises(CalibrationError, match=quoted) as caught:
        replace(CAMERA, **change)
    assert isinstance(caught.value, RecordingError)


@pytest.mark.parametrize(
    ("values", "quoted"),
    [
        ((0.05, 15.0), "0.05 m"),
        ((280.0, 15.0), "280.0 m"),
        ((math.nan, 15.0), "nan m"),
        ((2.8, -15.0), "-15.0°"),
        ((2.8, 80.0), "80.0°"),
        ((2.8, 15.0, 21.0), "roll of 21.0°"),
        ((2.8, 15.0, math.nan), "roll of nan°"),
        ((2.8, 15.0, 0.0, -50.0), "yaw of -50.0°"),
    ],
)
def test_a_mount_that_cannot_be_is_refused(values: tuple[float, ...], quoted: str) -> None:
    with pytest.raises(CalibrationError, match=quoted):
        Mount(*values)


@pytest.mark.parametrize("values", [(0.0, 31.0, 0.0), (-1500.0, 0.0, 0.0), (0.0, 0.0, math.nan)])
def test_a_lever_arm_that_cannot_be_is_refused(values: tuple[float, float, float]) -> None:
    bad = next(str(v) for v in values if not abs(v) <= 30.0)
    with pytest.raises(CalibrationError, match=bad):
        LeverArm(*values)
