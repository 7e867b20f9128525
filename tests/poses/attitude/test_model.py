"""The slopes of each law beside differences of its residuals; the increments of an IMU."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from fieldgrid.geometry import Inertial, from_vectors, to_vectors
from fieldgrid.poses.attitude import model
from fieldgrid.poses.attitude.increments import increments, sample_noise
from fieldgrid.poses.attitude.model import SHARED, STATES, Law, States
from fieldgrid.poses.attitude.solver import covariances, normal_equations, solved

N = 5
RANDOM = np.random.default_rng(0)
X = States(
    RANDOM.normal(size=(N, 3)),
    RANDOM.normal(size=(N, 3)),
    # From node to node a vehicle turns little.
    from_vectors([0.3, -0.4, 0.9] + RANDOM.normal(size=(N, 3)) * 0.03),
    RANDOM.normal(size=SHARED) * 0.01,
    RANDOM.normal(size=N),
)
VECTORS = RANDOM.normal(size=(N, 3)) * 0.3
AT, EVERY, H = np.arange(N - 1), np.arange(N), np.full(N - 1, 0.05)
# Slopes of turns are those of small residuals, as there are in an estimate.
TURNS = to_vectors(X.R[:-1].swapaxes(1, 2) @ X.R[1:])


def ones(rows: int, count: int = N) -> np.ndarray:
    return np.ones((count, rows))


LAWS: dict[str, Callable[[States], Law]] = {
    "turns": lambda x: model.turns(x, AT, TURNS, ones(3, N - 1), H),
    "pushes": lambda x: model.pushes(x, AT, H, VECTORS[1:], VECTORS[1:] / 9, ones(6, N - 1)),
    "coasts": lambda x: model.coasts(x, AT, H, ones(6, N - 1)),
    "moves": lambda x: model.moves(x, AT, VECTORS[1:], ones(3, N - 1)),
    "antenna": lambda x: model.sees_antenna(x, EVERY, np.array([0.3, -1, 0.5]), VECTORS, ones(3)),
    "ground": lambda x: model.follows_ground(x, EVERY, ones(1), np.full(N, True)),
    "heads": lambda x: model.heads(x, EVERY, np.zeros(N), ones(1)),
    "leans": lambda x: model.leans(x, EVERY, VECTORS[:, :2], ones(2)),
}
SMALL = 1e-6


@pytest.mark.parametrize("name", LAWS)
def test_slopes_are_those_of_the_residuals(name: str) -> None:
    law = LAWS[name](X)
    tolerance = 2e-3 if name == "turns" else 1e-5
    for k, node in enumerate(law.node.tolist()):
        for column in range(law.slope.shape[2]):
            change = np.zeros((N, STATES))
            change[node + column // STATES, column % STATES] = SMALL
            moved = LAWS[name](X.moved(change, np.zeros(SHARED)))
            slope = (moved.residual[k] - law.residual[k]) / SMALL
            np.testing.assert_allclose(law.slope[k, :, column], slope, atol=tolerance)


@pytest.mark.parametrize("name", ["turns", "pushes"])
def test_slopes_by_the_biases_are_those_of_the_residuals(name: str) -> None:
    law = LAWS[name](X)
    assert law.shared is not None
    for column in range(SHARED):
        change = np.zeros(SHARED)
        change[column] = SMALL
        moved = LAWS[name](X.moved(np.zeros((N, STATES)), change))
        slope = (moved.residual - law.residual) / SMALL
        if name == "pushes" and column < 3:
            continue  # what a gyro's bias does to a push is within its sums
        np.testing.assert_allclose(law.shared[:, :, column], slope, atol=2e-3)


def test_a_ground_without_known_turns_says_nothing_of_the_roll() -> None:
    law = model.follows_ground(X, EVERY, ones(1), np.array([True, False] * 2 + [True]))
    assert np.all(law.slope[1::2, 0, 7] == 0.0)
    assert np.all(law.slope[::2, 0, 7] != 0.0)


def test_the_bordered_band_is_the_dense_system() -> None:
    laws = [law(X) for law in LAWS.values()]
    sigma = np.full(SHARED, 0.1)
    system = normal_equations(laws, N, X.shared, sigma)
    dense = np.zeros((N * STATES + SHARED,) * 2)
    right = np.zeros(N * STATES + SHARED)
    dense[-SHARED:, -SHARED:] = np.diag(sigma**-2.0)
    right[-SHARED:] = -X.shared / sigma**2
    dense[: N * STATES, : N * STATES] = np.diag(np.tile(np.repeat([1e-8, 1e-4, 1e-2], 3), N))
    for law in laws:
        for k, node in enumerate(law.node.tolist()):
            J = np.zeros((law.residual.shape[1], len(right)))
            J[:, node * STATES : node * STATES + law.slope.shape[2]] = law.slope[k]
            if law.shared is not None:
                J[:, -SHARED:] = law.shared[k]
            dense += J.T @ (law.weight[k][:, None] * J)
            right -= J.T @ (law.weight[k] * law.residual[k])
    change, shared = solved(system)
    np.testing.assert_allclose(np.append(change, shared), np.linalg.solve(dense, right), atol=1e-8)
    blocks, of_shared = covariances(system)
    inverse = np.linalg.inv(dense)
    for k in range(N):
        part = slice(k * STATES, (k + 1) * STATES)
        np.testing.assert_allclose(blocks[k], inverse[part, part], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(of_shared, inverse[-SHARED:, -SHARED:], rtol=1e-6)


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
    found = increments(sensed, node_ns)
    fine = spinning(20_000.0)
    h = 1.0 / 20_000.0
    for k in range(3):
        R, speed, way = np.eye(3), np.zeros(3), np.zeros(3)
        inside = (fine.time_ns >= node_ns[k]) & (fine.time_ns < node_ns[k + 1])
        for i in np.flatnonzero(inside):
            push = R @ ((fine.force_mps2[i] + fine.force_mps2[i + 1]) / 2.0)
            way += speed * h + push * h * h / 2.0
            speed += push * h
            R = R @ from_vectors((fine.rate_rad_s[i] + fine.rate_rad_s[i + 1]) / 2.0 * h)
        np.testing.assert_allclose(from_vectors(found.turn_rad[k]), R, atol=3e-5)
        np.testing.assert_allclose(found.speed_mps[k], speed, atol=2e-3)
        np.testing.assert_allclose(found.way_m[k], way, atol=3e-4)


def test_an_interval_with_a_hole_in_the_samples_is_not_known() -> None:
    sensed = spinning(100.0)
    keep = (sensed.time_ns < 500_000_000) | (sensed.time_ns > 900_000_000)
    holed = Inertial(*(column[keep] for column in sensed))
    found = increments(holed, np.arange(-1, 12, 2) * 200_000_000)
    assert np.isfinite(found.turn_rad[:, 0]).tolist() == [False, False, False, True, True, False]
    assert np.array_equal(np.isfinite(found.speed_mps), np.isfinite(found.turn_rad))
    nothing = increments(Inertial(*(column[:1] for column in sensed)), np.arange(3))
    assert np.isnan(nothing.turn_rad).all()


def test_noise_of_samples_is_found_beside_their_motion() -> None:
    time_ns = np.arange(2000) * 10_000_000
    motion = np.sin(time_ns / 1e9)[:, None] * [1.0, 2.0, 3.0]
    noise = np.random.default_rng(1).normal(size=(2000, 3)) * 0.3
    assert sample_noise(motion + noise, time_ns) == pytest.approx(0.3 * 0.1, rel=0.05)  # type: ignore[arg-type]
    assert sample_noise(motion[:5], time_ns[:5]) == 0.0  # type: ignore[arg-type]


def test_an_interval_that_is_too_long_for_small_rotations_is_not_known() -> None:
    found = increments(spinning(100.0), np.array([0, 200, 400, 1500, 1700]) * 1_000_000)
    assert np.isfinite(found.way_m[:, 0]).tolist() == [True, True, False, True]
