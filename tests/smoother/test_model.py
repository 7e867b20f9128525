"""Residuals and slopes of the vehicle's model, beside residuals written anew and differenced."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fieldgrid.smoother import model
from fieldgrid.smoother.model import GYRO, KAPPA, PHI, STATES, E, N, V

_Float64 = npt.NDArray[np.float64]
_Residuals = Callable[[_Float64], list[tuple[float, float]]]
"""Of states [n, 8]: pairs of a residual and its weight."""

SEEDS = st.integers(0, 10**6)


def dense(band: _Float64) -> _Float64:
    n = band.shape[1]
    full = np.zeros((n, n))
    for k in range(min(n, len(band))):
        rows = np.arange(n - k)
        full[rows + k, rows] = full[rows, rows + k] = band[k, : n - k]
        assert not band[k, n - k :].any()  # nothing falls off the matrix's end
    return full


_System = tuple[_Float64, _Float64, _Float64]
"""Banded matrix, right side, and the two sums of the likelihood."""


def empty(n: int, reach: int = 1) -> _System:
    return np.zeros((STATES * (reach + 1), n * STATES)), np.zeros(n * STATES), np.zeros(2)


def slopes(residuals: _Residuals, x: _Float64) -> _Float64:
    """Central differences [residuals, states]."""
    step = 1e-6
    columns = []
    for k in range(x.size):
        ahead, behind = x.copy(), x.copy()
        ahead.flat[k] += step
        behind.flat[k] -= step
        pairs = zip(residuals(ahead), residuals(behind), strict=True)
        columns.append([(a[0] - b[0]) / (2.0 * step) for a, b in pairs])
    return np.array(columns).T


def assert_normal_equations(
    system: _System,
    residuals: _Residuals,
    x: _Float64,
    approximate: Callable[[_Float64], _Float64] = lambda jacobian: jacobian,
) -> None:
    """The Gauss-Newton matrix JᵀWJ, the right side -JᵀWr, and the sums that tell how likely
    it is."""
    band, right, total = system
    jacobian = approximate(slopes(residuals, x))
    r, weight = np.array(residuals(x)).T
    matrix = jacobian.T @ (weight[:, None] * jacobian)
    scale = np.abs(matrix).max()
    assert dense(band) == pytest.approx(matrix, rel=1e-4, abs=1e-6 * scale)
    gradient = -jacobian.T @ (weight * r)
    assert right == pytest.approx(gradient, rel=1e-4, abs=1e-6 * np.abs(gradient).max() + 1e-9)
    assert total == pytest.approx([float(weight @ r**2), float(np.log(weight).sum())], rel=1e-6)


def states(seed: int, n: int) -> _Float64:
    random = np.random.default_rng(seed)
    scale = [30.0, 30.0, 3.0, 2.0, 0.3, 0.02, 1.0, 1.0]
    return random.normal(size=(n, STATES)) * scale


# --- what sensors see


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_fixes_with_lever_and_slow_error(seed: int) -> None:
    random = np.random.default_rng(seed)
    n, x = 4, states(seed, 4)
    fix, bias = x[:, :2] + random.normal(size=(n, 2)), random.uniform(0.1, 1.0, n)
    weight = random.uniform(0.5, 3.0, n)
    fix[2], weight[2] = np.nan, 0.0
    right_m, ahead_m = random.normal(size=2)

    def residuals(x: _Float64) -> list[tuple[float, float]]:
        found = []
        for k in (0, 1, 3):
            nose = np.array([np.sin(x[k, PHI]), np.cos(x[k, PHI])])
            side = np.array([nose[1], -nose[0]])
            antenna = x[k, :2] + ahead_m * nose + right_m * side + bias[k] * x[k, 6:8]
            found += [(float(off), weight[k]) for off in antenna - fix[k]]
        return found

    system = empty(n)
    off = model.add_fixes(system, x, fix, bias, weight, np.array([right_m, ahead_m]))
    assert_normal_equations(system, residuals, x)
    expected = np.hypot(*np.array([r for r, _ in residuals(x)]).reshape(3, 2).T)
    assert off == pytest.approx([expected[0], expected[1], 0.0, expected[2]])


@settings(deadline=None, max_examples=25)
@given(SEEDS, st.sampled_from([PHI, V]), st.integers(-2, 2))
def test_values_of_one_state(seed: int, state: int, turns: int) -> None:
    """A heading a full circle off is the same heading."""
    random = np.random.default_rng(seed)
    n, x = 3, states(seed, 3)
    off = random.uniform(-2.0, 2.0, n)
    circle = 2.0 * np.pi * turns if state == PHI else 0.0
    value, weight = x[:, state] - off + circle, np.array([1.0, 0.0, 2.5])
    value[1] = np.nan
    system = empty(n)
    found = model.add_values(system, x, state, value, weight)
    assert found == pytest.approx([off[0], 0.0, off[2]])

    def residuals(x: _Float64) -> list[tuple[float, float]]:
        return [(x[k, state] - (value[k] - circle), weight[k]) for k in (0, 2)]

    assert_normal_equations(system, residuals, x)


@settings(deadline=None, max_examples=25)
@given(SEEDS, st.integers(-1, 1))
def test_steps_of_a_point_ahead_of_the_axle(seed: int, turns: int) -> None:
    random = np.random.default_rng(seed)
    x, ends = states(seed, 5), np.array([[0, 1], [1, 4], [3, 4]])
    ahead_m, weight = random.normal(), random.uniform(0.5, 3.0, (3, 2))

    def seen(x: _Float64) -> _Float64:
        """Complex numbers, east + i·north: the nose points along i·exp(-i·phi)."""
        place, nose = x[:, E] + 1j * x[:, N], 1j * np.exp(-1j * x[:, PHI])
        point = place + ahead_m * nose
        step = (point[ends[:, 1]] - point[ends[:, 0]]) / nose[ends[:, 0]]
        return np.stack([step.real, -step.imag, np.diff(x[ends, PHI], axis=1)[:, 0]], axis=1)

    off = random.uniform(-1.0, 1.0, (3, 3))
    step = seen(x) - off
    told = step + np.array([0.0, 0.0, 2.0 * np.pi * turns])
    system = empty(5, reach=3)
    found = model.add_steps(system, x, ends, told, weight, ahead_m)
    assert found == pytest.approx(off)

    def residuals(x: _Float64) -> list[tuple[float, float]]:
        way = weight[:, [0, 0, 1]]
        return list(zip((seen(x) - step).ravel().tolist(), way.ravel().tolist(), strict=True))

    assert_normal_equations(system, residuals, x)


# --- what a vehicle can do


def vehicle_laws(
    step_s: _Float64,
    steering: _Float64,
    bias_s: _Float64,
    turned: _Float64,
    seen: list[bool],
    standing: list[bool],
) -> _Residuals:
    def residuals(x: _Float64) -> list[tuple[float, float]]:
        found = []
        for k, h in enumerate(step_s.tolist()):
            a, b = x[k], x[k + 1]
            fade = np.exp(-h / bias_s[k])
            for state in (model.BIAS_E, model.BIAS_N):
                found.append((b[state] - fade * a[state], 1.0 / (1.0 - fade**2)))
            found.append((b[GYRO] - a[GYRO], 1.0 / (model.GYRO_BIAS_NOISE**2 * h)))
            if np.isfinite(turned[k]):
                # A gyro shows the turn and its bias.
                shown = b[PHI] - a[PHI] + h * a[GYRO]
                found.append((shown - turned[k], 1.0 / (model.GYRO_NOISE**2 * h)))
            if not seen[k]:
                # Anew, from where the guess is: far places are as likely.
                found += [(0.0, 0.0)] * 3
                found += [(b[V], 1e-2), (b[KAPPA], 1.0 / model.CURVATURE_SIGMA**2)]
                continue
            speed, curvature = (a[V] + b[V]) / 2.0, (a[KAPPA] + b[KAPPA]) / 2.0
            nose = np.exp(1j * (np.pi / 2.0 - (a[PHI] + b[PHI]) / 2.0))
            moved = ((b[E] - a[E]) + 1j * (b[N] - a[N])) / nose
            found.append((moved.real - h * speed, 1.0 / (model.ALONG_NOISE**2 * h)))
            # Acceleration to the right in a right turn, in either gear; it slides to the left.
            slide = -model.SLIP_ANGLE * curvature * speed * abs(speed) * h * speed
            found.append((-moved.imag - slide, 1.0 / (model.ACROSS_NOISE**2 * h)))
            noise = model.FREE_TURN_NOISE if np.isfinite(turned[k]) else model.TURN_NOISE
            if standing[k] and standing[k + 1]:
                noise = model.STANDING_TURN_NOISE
            turn = h * speed * curvature
            found.append((b[PHI] - a[PHI] - turn, 1.0 / (noise**2 * h)))
            found.append((b[V] - a[V], 1.0 / (model.ACCELERATION_NOISE**2 * h)))
            fade = np.exp(-h / model.CURVATURE_S)
            found.append((b[KAPPA] - fade * a[KAPPA], 1.0 / steering[k]))
        return found

    return residuals


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.booleans(), st.lists(st.booleans(), min_size=4, max_size=4))
def test_the_laws_of_motion(seed: int, gyro: bool, standing: list[bool]) -> None:
    random = np.random.default_rng(seed)
    x, step_s = states(seed, 4), random.uniform(0.05, 0.6, 3)
    turned = np.where(random.random(3) < 0.7, random.normal(size=3), np.nan)
    turned = turned if gyro else np.full(3, np.nan)
    steering, bias_s = random.uniform(0.01, 0.1, 3), random.uniform(20.0, 300.0, 4)
    seen = [True, True, True]
    system = empty(4)
    model.add_motion(
        system, x, step_s, steering, bias_s, turned, np.array(seen), np.array(standing)
    )
    residuals = vehicle_laws(step_s, steering, bias_s, turned, seen, standing)
    own = _weights(model.ACROSS_NOISE, step_s)
    across = [k for k, (_, weight) in enumerate(residuals(x)) if weight in own]
    assert len(across) == 3

    def approximate(jacobian: _Float64) -> _Float64:
        """The slide's own slopes are left out on purpose: only its size counts."""
        for node, (row, h) in enumerate(zip(across, step_s.tolist(), strict=True)):
            a, b = x[node], x[node + 1]
            speed, curvature = (a[V] + b[V]) / 2.0, (a[KAPPA] + b[KAPPA]) / 2.0
            slide = -model.SLIP_ANGLE * curvature * speed * abs(speed)
            for k in (node, node + 1):
                jacobian[row, k * STATES + V] = -h / 2.0 * slide
                jacobian[row, k * STATES + KAPPA] = 0.0
        return jacobian

    assert_normal_equations(system, residuals, x, approximate)


def _weights(noise: float, step_s: _Float64) -> list[float]:
    return [1.0 / (noise**2 * h) for h in step_s.tolist()]


@pytest.mark.parametrize("gyro", [True, False])
def test_over_a_hole_only_the_gyro_and_the_drifts_go_on(gyro: bool) -> None:
    x, step_s = states(7, 2), np.array([30.0])
    turned = np.array([0.4 if gyro else np.nan])
    steering, bias_s = np.array([0.1]), np.array([300.0, 30.0])
    system = empty(2)
    seen, standing = np.array([False]), np.array([True, True])
    model.add_motion(system, x, step_s, steering, bias_s, turned, seen, standing)
    band, right, _ = system
    start = np.zeros((2 * STATES, 2 * STATES))
    for state, weight in ((E, 1e-10), (N, 1e-10), (PHI, 1e-2)):
        start[STATES + state, STATES + state] = weight
    residuals = vehicle_laws(step_s, steering, bias_s, turned, [False], [True, True])
    jacobian = slopes(residuals, x)
    r, weights = np.array(residuals(x)).T
    matrix = jacobian.T @ (weights[:, None] * jacobian) + start
    assert dense(band) == pytest.approx(matrix, rel=1e-4, abs=1e-8)
    assert right == pytest.approx(-jacobian.T @ (weights * r), rel=1e-4, abs=1e-6)
    # The two places know nothing of each other.
    assert dense(band)[:2, STATES : STATES + 2].any() == np.False_


def test_a_start_knows_little() -> None:
    x = states(3, 3)
    system = empty(3)
    model.add_start(system, x, 0)
    band, right, _ = system
    variance = 1.0 / np.diag(dense(band))[:STATES]
    expected = [1e5, 1e5, 10.0, 10.0, model.CURVATURE_SIGMA, model.GYRO_BIAS_SIGMA, 1.0, 1.0]
    assert np.sqrt(variance) == pytest.approx(expected)
    assert right[:3].tolist() == [0.0, 0.0, 0.0]
    assert right[3:STATES] == pytest.approx(-x[0, 3:] / variance[3:])
    later = empty(3)
    model.add_start(later, x, 2)
    assert not dense(later[0])[: 2 * STATES].any()
    assert not dense(later[0])[2 * STATES + GYRO :, 2 * STATES + GYRO :].any()


# --- how it steers


def steering(
    curvature: _Float64,
    time_s: _Float64,
    restlessness: float,
    variance: _Float64 | float = 0.0,
    onward: _Float64 | float = 0.0,
) -> _Float64:
    """The local steering of curvatures that are known exactly, or as well as is said."""
    zero = np.zeros(len(time_s))
    return model.local_steering(curvature, zero + variance, zero + onward, time_s, restlessness)


def test_steering_is_looked_for_nearby() -> None:
    """Straight for long, then a turn in: the curvature may change there, and not elsewhere."""
    n, h = 200, 0.2
    time_s, curvature = np.arange(n) * h, np.zeros(n)
    curvature[100:] = 0.25
    found = steering(curvature, time_s, 0.02)
    calm = model.ALWAYS_SHARE * 0.02**2 * h
    assert found[:90] == pytest.approx(calm)
    assert found[99] > 50.0 * calm
    middle_s = (time_s[1:] + time_s[:-1]) / 2.0
    near = np.abs(middle_s - middle_s[99]) <= model.STEERING_S / 2.0 - h
    least = (1.0 - model.ALWAYS_SHARE) * 0.25**2 / (model.STEERING_S + h) * h
    assert (found[near] >= calm + least).all()
    assert (found[np.abs(middle_s - middle_s[99]) <= model.STEERING_S] < model.MOST_STEERING).all()
    wild = curvature.copy()
    wild[::2] = 50.0
    assert steering(wild, time_s, 0.02) == pytest.approx(model.MOST_STEERING * h)


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.integers(2, 30), st.sampled_from([0.01, 0.05, 0.2]))
def test_steering_is_what_is_expected_of_the_change(seed: int, n: int, restless: float) -> None:
    """Beside the expected square of each change, drawn from the joint distribution, node by
    node averaged over a second before and after."""
    random = np.random.default_rng(seed)
    time_s = np.cumsum(random.uniform(0.05, 0.7, n))
    curvature, variance = random.normal(0.0, 0.1, n), random.uniform(0.0, 0.01, n)
    onward = np.zeros(n)
    onward[:-1] = random.uniform(-1.0, 1.0, n - 1) * np.sqrt(variance[1:] * variance[:-1])
    step_s, middle_s = np.diff(time_s), (time_s[1:] + time_s[:-1]) / 2.0
    expected = np.zeros(n - 1)
    squared = np.zeros(n - 1)
    for k in range(n - 1):
        slope = np.array([-np.exp(-step_s[k] / model.CURVATURE_S), 1.0])
        joint = np.array([[variance[k], onward[k]], [onward[k], variance[k + 1]]])
        squared[k] = (slope @ curvature[k : k + 2]) ** 2 + slope @ joint @ slope
    for k in range(n - 1):
        near = np.abs(middle_s - middle_s[k]) <= model.STEERING_S / 2.0
        rate = 0.5 * restless**2 + 0.5 * squared[near].sum() / step_s[near].sum()
        expected[k] = min(rate, model.MOST_STEERING) * step_s[k]
    found = steering(curvature, time_s, restless, variance, onward)
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


@pytest.mark.parametrize("n", [1, 2])
def test_the_shortest_drives_have_a_steering(n: int) -> None:
    assert steering(np.zeros(n), np.arange(n) * 0.2, 0.05).shape == (n - 1,)


def test_the_usual_steering_keeps_the_usual_curvatures() -> None:
    """A step that lasts for ever leaves nothing but the usual spread."""
    step_s = np.array([0.01, 1.0, 1e3])
    fade = np.exp(-step_s / model.CURVATURE_S)
    kept = fade**2 * model.CURVATURE_SIGMA**2 + model.usual_steering(step_s)
    assert kept == pytest.approx(model.CURVATURE_SIGMA**2)
