"""The laws, the band with its border, and the sums of an IMU beside plain arithmetic."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import Inertial, R_enu_level, R_level_vehicle, from_vectors, to_vectors
from fieldgrid.poses.attitude import model
from fieldgrid.poses.attitude.increments import increments, sample_noise
from fieldgrid.poses.attitude.model import SHARED, STATES, AttitudeRows, States
from fieldgrid.poses.attitude.solver import covariances, normal_equations, solved

N, OWN = 5, 1
RANDOM = np.random.default_rng(2)
BETWEEN, EVERY = np.arange(N - 1), np.arange(N)


def some(*shape: int) -> npt.NDArray[np.float64]:
    return RANDOM.normal(size=shape)


X = States(
    some(N, 3),
    some(N, 3),
    R_enu_level(some(N) * 50.0) @ R_level_vehicle(some(N) * 5.0, some(N) * 5.0),
    some(8 + OWN) * 1e-3,
)
BETWEEN_LAWS = {
    "turns": (model.turns, (to_vectors(X.R[:-1].swapaxes(1, 2) @ X.R[1:]), np.full(N - 1, 0.2))),
    "pushes": (model.pushes, (some(N - 1, 3), np.array([0.2, 0.2, 0.0, 0.2]))),
    "moves": (model.moves, (some(N - 1, 3), np.array([0.2, 0.0, 0.2, 0.2]))),
}
NODE_LAWS = {
    "sees_antenna": (model.sees_antenna, (some(N, 3), some(N, 3))),
    "follows_ground": (model.follows_ground, (np.ones(N),)),
    "points": (model.points, (some(N, 3), some(N, 3), some(N), np.ones((N, 2 + OWN)))),
}
ROWS = {
    **{
        name: AttitudeRows(law, BETWEEN, np.full((N - 1, 3), 0.5), said, between=True)
        for name, (law, said) in BETWEEN_LAWS.items()
    },
    **{
        name: AttitudeRows(
            law, EVERY, np.full((N, 3 if law is model.sees_antenna else 1), 0.5), said
        )
        for name, (law, said) in NODE_LAWS.items()
    },
}


@pytest.mark.parametrize("name", ROWS)
def test_slopes_are_those_of_the_residuals(name: str) -> None:
    rows, small = ROWS[name], 1e-6
    off, slope = rows.law(X, rows.at, *rows.said)
    for column in range(slope.shape[2]):
        change, shared = np.zeros((N, STATES)), np.zeros(len(X.shared))
        if column >= SHARED:
            shared[column - SHARED] = small
        else:  # of every other node, so that each is seen by itself
            change[column // STATES :: 2, column % STATES] = small
        moved = (rows.law(X.moved(change, shared), rows.at, *rows.said)[0] - off) / small
        seen = slice(None) if column >= SHARED else slice(0, None, 2)
        if model.GYRO.start <= column < model.GYRO.stop:
            continue  # what a gyro's bias does is within the sums of its samples
        np.testing.assert_allclose(slope[seen, :, column], moved[seen], atol=5e-3)


def test_a_ground_without_known_turns_says_nothing_of_the_roll() -> None:
    _, slope = model.follows_ground(X, EVERY, np.array([1.0, 0.0] * 2 + [1.0]))
    assert np.all(slope[1::2, 0, 7] == 0.0)
    assert np.all(slope[::2, 0, 7] != 0.0)


def test_the_bordered_band_is_the_dense_system() -> None:
    s = len(X.shared)
    sigma = np.full(s, 0.1)
    system = normal_equations(X, ROWS.values(), sigma, robust=False)
    dense, right = np.zeros((N * STATES + s,) * 2), np.zeros(N * STATES + s)
    dense[-s:, -s:], right[-s:] = np.diag(sigma**-2.0), -X.shared / sigma**2
    dense[:-s, :-s] = np.diag(np.tile(np.repeat([1e-8, 1e-4, 1e-2], 3), N))
    for rows in ROWS.values():
        off, slope = rows.law(X, rows.at, *rows.said)
        for k, node in enumerate(rows.at.tolist()):
            J = np.zeros((off.shape[1], len(right)))
            width = STATES * (1 + rows.between)
            J[:, node * STATES : node * STATES + width] = slope[k, :, :width]
            J[:, -s:] = slope[k, :, SHARED:]
            dense += J.T @ (rows.sigma[k][:, None] ** -2.0 * J)
            right -= J.T @ (rows.sigma[k] ** -2.0 * off[k])
    change, shared = solved(system)
    np.testing.assert_allclose(np.append(change, shared), np.linalg.solve(dense, right), atol=1e-8)
    inverse = np.linalg.inv(dense)
    for k, block in enumerate(covariances(system)):
        part = slice(k * STATES, (k + 1) * STATES)
        np.testing.assert_allclose(block, inverse[part, part], rtol=1e-5, atol=1e-9)


def spinning(rate_hz: float) -> Inertial:
    """A vehicle that turns about a slanted axis and is pushed along its own right."""
    n = round(2.0 * rate_hz) + 1
    time_s = np.arange(n) / rate_hz
    rate = np.stack([0.1 * np.cos(time_s), 0.2 * np.sin(time_s), np.full(n, 0.5)], axis=1)
    force = np.stack([np.sin(3 * time_s), np.cos(time_s), np.full(n, 9.8)], axis=1)
    return Inertial(np.round(time_s * 1e9).astype(np.int64), rate, force)  # type: ignore[arg-type]


def test_increments_are_those_of_small_steps() -> None:
    sensed = spinning(100.0)
    node_ns = np.array([103, 305, 552, 700]) * 1_000_000  # not at samples
    turn_rad, speed_mps = increments(sensed, node_ns)
    fine = spinning(20_000.0)
    h = 1.0 / 20_000.0
    for k in range(3):
        R, speed = np.eye(3), np.zeros(3)
        inside = (fine.time_ns >= node_ns[k]) & (fine.time_ns < node_ns[k + 1])
        for i in np.flatnonzero(inside):
            speed += R @ ((fine.force_mps2[i] + fine.force_mps2[i + 1]) / 2.0) * h
            R = R @ from_vectors((fine.rate_rad_s[i] + fine.rate_rad_s[i + 1]) / 2.0 * h)
        np.testing.assert_allclose(from_vectors(turn_rad[k]), R, atol=3e-5)
        np.testing.assert_allclose(speed_mps[k], speed, atol=2e-3)


def test_an_interval_with_a_hole_in_the_samples_or_too_long_is_not_known() -> None:
    sensed = spinning(100.0)
    keep = (sensed.time_ns < 500_000_000) | (sensed.time_ns > 900_000_000)
    holed = Inertial(*(column[keep] for column in sensed))
    turn_rad, speed_mps = increments(holed, np.arange(-1, 12, 2) * 200_000_000)
    assert np.isfinite(turn_rad[:, 0]).tolist() == [False, False, False, True, True, False]
    assert np.array_equal(np.isfinite(speed_mps), np.isfinite(turn_rad))
    nothing, _ = increments(Inertial(*(column[:1] for column in sensed)), np.arange(3))
    assert np.isnan(nothing).all()
    turn_rad, _ = increments(sensed, np.array([0, 200, 400, 1500, 1700]) * 1_000_000)
    assert np.isfinite(turn_rad[:, 0]).tolist() == [True, True, False, True]


def test_noise_of_samples_is_found_beside_their_motion() -> None:
    time_ns = np.arange(2000) * 10_000_000
    motion = np.sin(time_ns / 1e9)[:, None] * [1.0, 2.0, 3.0]
    noise = np.random.default_rng(1).normal(size=(2000, 3)) * 0.3
    assert sample_noise(motion + noise, time_ns) == pytest.approx(0.3 * 0.1, rel=0.05)  # type: ignore[arg-type]
    assert sample_noise(motion[:5], time_ns[:5]) == 0.0  # type: ignore[arg-type]
