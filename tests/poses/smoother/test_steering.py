"""How much a vehicle steers, from its own curvatures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import Bool, Float64
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.steering import local_steering, usual_steering

SEEDS = st.integers(0, 10**6)


def steering(
    curvature: Float64,
    time_s: Float64,
    steering_noise: float,
    variance: Float64 | float = 0.0,
    onward: Float64 | float = 0.0,
    unseen: Bool | None = None,
) -> Float64:
    """The local steering of curvatures that are known exactly, or as well as is said."""
    zero = np.zeros(len(time_s))
    unseen = zero[1:] > 0.0 if unseen is None else unseen
    return local_steering(
        *(curvature, zero + variance, zero[1:] + onward), time_s, steering_noise, unseen
    )


def most_steering(step_s: float) -> float:
    """What is expected at most of a step: of a curvature that jumps to and fro."""
    wild = np.where(np.arange(9) % 2, 50.0, 0.0)
    most, *same = steering(wild, np.arange(9) * step_s, 0.02).tolist()
    assert same == pytest.approx([most] * 7)
    return float(most)


def test_steering_is_looked_for_nearby() -> None:
    """Straight for long, then a turn in: the curvature may change there, and not elsewhere."""
    n, h = 200, 0.2
    time_s, curvature = np.arange(n) * h, np.zeros(n)
    curvature[100:] = 0.25
    found = steering(curvature, time_s, 0.02)
    calm = steering(np.zeros(n), time_s, 0.02)
    away_s = np.abs(np.arange(n - 1) - 99) * h
    assert found[:90] == pytest.approx(calm[:90])
    assert (found[away_s < 0.9] > 50.0 * calm[away_s < 0.9]).all()
    assert (found < most_steering(h)).all()


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.integers(2, 30), st.sampled_from([0.01, 0.05, 0.2]))
def test_steering_is_what_is_expected_of_the_change(seed: int, n: int, noise: float) -> None:
    """Beside the expected square of each change, drawn from the joint distribution, node by
    node averaged over a second before and after."""
    random = np.random.default_rng(seed)
    time_s = np.cumsum(random.uniform(0.05, 0.7, n))
    curvature, variance = random.normal(0.0, 0.1, n), random.uniform(0.0, 0.01, n)
    onward = random.uniform(-1.0, 1.0, n - 1) * np.sqrt(variance[1:] * variance[:-1])
    step_s, middle_s = np.diff(time_s), (time_s[1:] + time_s[:-1]) / 2.0
    expected = np.zeros(n - 1)
    squared = np.zeros(n - 1)
    for k in range(n - 1):
        slope = np.array([-np.exp(-step_s[k] / model.CURVATURE_S), 1.0])
        joint = np.array([[variance[k], onward[k]], [onward[k], variance[k + 1]]])
        squared[k] = (slope @ curvature[k : k + 2]) ** 2 + slope @ joint @ slope
    for k in range(n - 1):
        near = np.abs(middle_s - middle_s[k]) <= 1.0
        rate = 0.5 * noise**2 + 0.5 * squared[near].sum() / step_s[near].sum()
        expected[k] = min(rate * step_s[k], most_steering(step_s[k]))
    found = steering(curvature, time_s, noise, variance, onward)
    assert found == pytest.approx(expected, rel=1e-9)
    assert (found > 0.0).all()


def test_what_noise_hides_counts_as_steering_and_what_both_nodes_share_does_not() -> None:
    time_s = np.arange(100) * 0.2
    straight = np.zeros(100)
    known = steering(straight, time_s, 0.02)
    hidden = steering(straight, time_s, 0.02, 0.03**2)
    shared = steering(straight, time_s, 0.02, 0.03**2, 0.03**2)
    assert (hidden > 5.0 * known).all()
    assert (shared < 1.5 * known).all()
    assert (shared > known).all()


def test_what_nobody_saw_is_no_steering_of_its_neighbours() -> None:
    """Wherever a hole lies, and however tightly the vehicle may turn in it."""
    time_s = np.arange(100) * 0.2
    hole = (time_s[1:] > 8.0) & (time_s[:-1] < 12.0)
    wild = np.where((time_s > 8.0) & (time_s < 12.0), 0.5 * (-1) ** np.arange(100), 0.0)
    away = steering(wild, time_s, 0.02, unseen=hole)
    assert away[~hole] == pytest.approx(steering(np.zeros(100), time_s, 0.02)[~hole])
    assert np.isfinite(away).all()
    assert (steering(wild, time_s, 0.02)[~hole] > 2.0 * away[~hole]).any()


@pytest.mark.parametrize("n", [1, 2])
def test_the_shortest_drives_have_a_steering(n: int) -> None:
    assert steering(np.zeros(n), np.arange(n) * 0.2, 0.05).shape == (n - 1,)


def test_the_usual_steering_keeps_the_usual_curvatures() -> None:
    """A step that lasts for ever leaves nothing but the usual spread."""
    step_s = np.array([0.01, 1.0, 1e3])
    usual = usual_steering(step_s)
    assert usual.kept == pytest.approx(np.exp(-step_s / model.CURVATURE_S))
    left = usual.kept**2 * model.CURVATURE_SIGMA**2 + usual.variance
    assert left == pytest.approx(model.CURVATURE_SIGMA**2)
