"""An IMU that is mounted sideways, by the camera's rolling and pitching."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.geometry import Inertial, Steps
from fieldgrid.poses.faults.gyro.imu_turn import imu_turn

N, HZ, STEP_S = 40, 100, 1.5


def driven(turned_deg: float, rolling_deg: float = 1.0) -> tuple[Steps, Inertial]:
    """Steps over rough ground, and an IMU with a bias that is turned to the left."""
    random = np.random.default_rng(4)
    tilt_deg = rolling_deg * random.normal(size=(N + 1, 2))  # pitch, roll
    time_s = np.arange(round(N * STEP_S * HZ) + 1) / HZ
    knots_s = STEP_S * np.arange(N + 1)
    rate = np.stack([np.gradient(np.interp(time_s, knots_s, one), time_s) for one in tilt_deg.T])
    turn = np.exp(-1j * np.radians(turned_deg)) * (rate[0] + 1j * rate[1])
    sensed = np.radians(np.stack([turn.real, turn.imag, np.zeros_like(turn.real)], axis=1))
    sensed += random.normal(0.0, 0.002, sensed.shape) + 0.003
    force = np.broadcast_to(np.array([0.0, 0.0, 9.81]), sensed.shape)
    seen_deg = np.diff(tilt_deg, axis=0) + random.normal(0.0, 0.05, (N, 2))
    start_ns = np.round(knots_s[:-1] * 1e9).astype(np.int64)
    zero, small = np.zeros(N), np.full(N, 0.02)
    steps = Steps(
        start_ns=start_ns,
        stop_ns=start_ns + round(STEP_S * 1e9),
        forward_m=np.ones(N),
        right_m=zero,
        turn_deg=zero,
        sigma_m=small,
        sigma_deg=small,
        up_m=zero,
        roll_deg=seen_deg[:, 1],
        pitch_deg=seen_deg[:, 0],
        tilt_sigma_deg=small,
    )
    time_ns = np.round(time_s * 1e9).astype(np.int64)
    return steps, Inertial(time_ns, sensed.astype(np.float32), force.astype(np.float32))


@pytest.mark.parametrize("turned_deg", [0.0, 8.0, 90.0, -90.0, 178.0])
def test_the_turn_is_found(turned_deg: float) -> None:
    found = imu_turn(*driven(turned_deg))
    assert found is not None
    assert found.off_deg == pytest.approx(turned_deg, abs=max(4.0 * found.sigma_deg, 0.5))
    assert found.sigma_deg < 1.5
    assert found.is_off is (turned_deg != 0.0)
    assert found.as_dict()["is_off"] is found.is_off


def test_even_ground_few_steps_and_other_axes_tell_nothing() -> None:
    steps, sensed = driven(90.0, rolling_deg=0.02)
    assert imu_turn(steps, sensed) is None
    steps, sensed = driven(90.0)
    assert imu_turn(Steps(*(column[:10] for column in steps)), sensed) is None
    upside_down = sensed._replace(rate_rad_s=sensed.rate_rad_s * np.float32([1.0, -1.0, -1.0]))
    assert imu_turn(steps, upside_down) is None
    assert imu_turn(None, sensed) is None
    assert imu_turn(steps, None) is None
