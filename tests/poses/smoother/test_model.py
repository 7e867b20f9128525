"""Residuals and slopes of the vehicle's model, beside residuals written anew and differenced."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import Float64, Int64
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.envelope import STATES, envelope
from fieldgrid.poses.smoother.equations import CONSTANTS, NormalEquations, empty_system
from fieldgrid.poses.smoother.model import GYRO, KAPPA, PHI, E, N, V

Residuals = Callable[[Float64, Float64], list[tuple[float, float]]]
"""Of states [n, 8] and constants: pairs of a residual and its weight."""

SEEDS = st.integers(0, 10**6)
NO_STEPS = np.zeros((0, 2), np.int64)


def dense(system: NormalEquations) -> Float64:
    """The symmetric matrix of the states and, behind them, the constants."""
    shape, n = system.shape, len(system.right)
    lower = np.zeros((n + CONSTANTS, n + CONSTANTS))
    for node, first in enumerate(shape.first.tolist()):
        at = shape.start[node]
        for row in range(STATES * node, STATES * (node + 1)):
            length = row + 1 - STATES * first
            lower[row, STATES * first : row + 1] = system.values[at : at + length]
            at += length
        assert at == shape.start[node + 1]
    full = lower + np.tril(lower, -1).T
    full[:n, n:], full[n:, :n] = system.border, system.border.T
    full[n:, n:] = system.corner
    return full


def right_side(system: NormalEquations) -> Float64:
    return np.concatenate([system.right, system.right_constants])


def empty(n: int, far: Int64 = NO_STEPS) -> NormalEquations:
    return empty_system(envelope(n, far))


def slopes(residuals: Residuals, x: Float64, constants: Float64) -> Float64:
    """Central differences [residuals, states and constants]."""
    step, columns = 1e-6, []
    at = np.concatenate([x.ravel(), constants])
    for k in range(at.size):
        moved = []
        for sign in (1.0, -1.0):
            near = at.copy()
            near[k] += sign * step
            moved.append(residuals(near[: x.size].reshape(x.shape), near[x.size :]))
        pairs = zip(*moved, strict=True)
        columns.append([(a[0] - b[0]) / (2.0 * step) for a, b in pairs])
    return np.array(columns).T


UNKNOWN = np.zeros(CONSTANTS)


def assert_normal_equations(
    system: NormalEquations,
    residuals: Residuals,
    x: Float64,
    constants: Float64 = UNKNOWN,
    approximate: Callable[[Float64], Float64] = lambda jacobian: jacobian,
) -> None:
    """The Gauss-Newton matrix JᵀWJ, the right side -JᵀWr, and the sum of squares."""
    jacobian = approximate(slopes(residuals, x, constants))
    r, weight = np.array(residuals(x, constants)).T
    matrix = jacobian.T @ (weight[:, None] * jacobian)
    assert dense(system) == pytest.approx(matrix, rel=1e-4, abs=1e-6 * np.abs(matrix).max())
    gradient = -jacobian.T @ (weight * r)
    close = {"rel": 1e-4, "abs": 1e-6 * np.abs(gradient).max() + 1e-9}
    assert right_side(system) == pytest.approx(gradient, **close)
    assert system.total[0] == pytest.approx(float(weight @ r**2), rel=1e-6)


def states(seed: int, n: int) -> Float64:
    random = np.random.default_rng(seed)
    scale = [30.0, 30.0, 3.0, 2.0, 0.3, 0.02, 1.0, 1.0]
    return random.normal(size=(n, STATES)) * scale


# --- what sensors measure


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_fixes_with_lever_and_slow_error(seed: int) -> None:
    """Along the heading and across it, each with its own weight; the axes stand still."""
    random = np.random.default_rng(seed)
    n, x = 4, states(seed, 4)
    fix = x[:, :2] + random.normal(size=(n, 2))
    weight = random.uniform(0.5, 3.0, (n, 2))
    fix[2], weight[2] = np.nan, 0.0
    lever = right_m, ahead_m = random.normal(size=2)
    axes = np.stack([np.exp(-1j * x[:, PHI]) * 1j, np.exp(-1j * x[:, PHI])], axis=1)

    def residuals(x: Float64, _: Float64) -> list[tuple[float, float]]:
        found = []
        for k in (0, 1, 3):
            heading = 1j * np.exp(-1j * x[k, PHI])
            place = (x[k, E] + x[k, model.BIAS_E]) + 1j * (x[k, N] + x[k, model.BIAS_N])
            antenna = place + (ahead_m - 1j * right_m) * heading
            off = antenna - (fix[k, 0] + 1j * fix[k, 1])
            for axis in (0, 1):
                found.append(((off * np.conj(axes[k, axis])).real, float(weight[k, axis])))
        return found

    system = empty(n)
    off = model.fixes_off(x, fix, weight, np.array(lever))
    model.add_fixes(system, x, off, weight, np.array(lever))
    assert_normal_equations(system, residuals, x)
    expected = -np.array([r for r, _ in residuals(x, UNKNOWN)]).reshape(3, 2)
    assert off[[0, 1, 3]] == pytest.approx(expected)
    assert off[2].tolist() == [0.0, 0.0]
    assert system.total[1] == pytest.approx(np.log(weight[[0, 1, 3]]).sum())


@settings(deadline=None, max_examples=25)
@given(SEEDS, st.integers(-2, 2))
def test_recorded_headings_are_off_by_one_angle(seed: int, turns: int) -> None:
    """And a heading a full circle off is the same heading."""
    random = np.random.default_rng(seed)
    x, offset = states(seed, 3), random.normal(0.0, 0.1)
    off, circle = random.uniform(-2.0, 2.0, 3), 2.0 * np.pi * turns
    heading, weight = x[:, PHI] + offset - off + circle, np.array([1.0, 0.0, 2.5])
    heading[1] = np.nan
    system = empty(3)
    found = model.headings_off(x, offset, heading, weight)
    model.add_headings(system, found, weight)
    assert found == pytest.approx([off[0], 0.0, off[2]])

    def residuals(x: Float64, constants: Float64) -> list[tuple[float, float]]:
        turned = constants[model.HEADING_OFFSET] - (heading - circle)
        return [(x[k, PHI] + turned[k], weight[k]) for k in (0, 2)]

    assert_normal_equations(system, residuals, x, np.array([offset, 0.0, 0.0, 0.0, 0.0]))


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_wheels_are_off_by_one_share(seed: int) -> None:
    random = np.random.default_rng(seed)
    x, scale = states(seed, 3), random.normal(0.0, 0.1)
    speed, weight = random.normal(0.0, 2.0, 3), np.array([1.0, 0.0, 2.5])
    system = empty(3)
    found = model.speeds_off(x, scale, speed, weight)
    model.add_speeds(system, x, scale, found, weight)

    def residuals(x: Float64, constants: Float64) -> list[tuple[float, float]]:
        size = 1.0 + constants[model.WHEEL_SCALE]
        return [(size * x[k, V] - speed[k], weight[k]) for k in (0, 2)]

    constants = np.array([0.0, scale, 0.0, 0.0, 0.0])
    assert found[[0, 2]] == pytest.approx([r for r, _ in residuals(x, constants)])
    assert_normal_equations(system, residuals, x, constants)


@settings(deadline=None, max_examples=25)
@given(SEEDS, st.integers(-1, 1))
def test_steps_of_a_point_ahead_of_the_axle(seed: int, turns: int) -> None:
    random = np.random.default_rng(seed)
    x, ends = states(seed, 5), np.array([[0, 1], [1, 4], [3, 4]])
    ahead_m, weight = random.normal(), random.uniform(0.5, 3.0, (3, 2))
    scale, yaw = random.normal(0.0, 0.03), random.normal(0.0, 0.1)

    def seen(x: Float64, scale: float, yaw: float) -> Float64:
        """Complex numbers, east + i·north: the heading points along i·exp(-i·phi)."""
        place, heading = x[:, E] + 1j * x[:, N], 1j * np.exp(-1j * x[:, PHI])
        point = place + ahead_m * heading
        looks = heading[ends[:, 0]] * np.exp(-1j * yaw)
        step = (1.0 + scale) * (point[ends[:, 1]] - point[ends[:, 0]]) / looks
        return np.stack([step.real, -step.imag, np.diff(x[ends, PHI], axis=1)[:, 0]], axis=1)

    off = random.uniform(-1.0, 1.0, (3, 3))
    step = seen(x, scale, yaw) - off
    told = step + np.array([0.0, 0.0, 2.0 * np.pi * turns])
    system = empty(5, ends)
    index, slope, found = model.step_rows(x, (scale, yaw), ends, told, ahead_m)
    model.add_rows(system, index, slope, found, weight[:, [0, 0, 1]].copy())
    assert found == pytest.approx(off)

    def residuals(x: Float64, constants: Float64) -> list[tuple[float, float]]:
        away = (seen(x, *constants[[model.CAMERA_SCALE, model.CAMERA_YAW]]) - step).ravel().tolist()
        return list(zip(away, weight[:, [0, 0, 1]].ravel().tolist(), strict=True))

    assert_normal_equations(system, residuals, x, np.array([0.0, 0.0, scale, yaw, 0.0]))


# --- what a vehicle can do


class Way:
    """A stretch of nodes with everything that the laws of motion ask for."""

    def __init__(self, seed: int, n: int, *, gyro: bool) -> None:
        random = np.random.default_rng(seed)
        self.step_s = random.uniform(0.05, 0.6, n - 1)
        self.kept = random.uniform(0.1, 1.0, n - 1)
        self.steering = random.uniform(0.01, 0.1, n - 1)
        self.bias_m, self.bias_s = random.uniform(0.1, 1.0, n), random.uniform(20.0, 300.0, n)
        self.leap_m2 = random.uniform(0.0, 1.0, n - 1) * (random.random(n - 1) < 0.3)
        told = random.random(n - 1) < 0.7 if gyro else np.zeros(n - 1, np.bool_)
        self.turned = np.where(told, random.normal(size=n - 1), np.nan)
        self.seen, self.standing = np.ones(n - 1, np.bool_), random.random(n) < 0.4

    def system(self, x: Float64, system: NormalEquations | None = None) -> NormalEquations:
        system = system or empty(len(x))
        model.add_motion(
            system,
            x,
            self.step_s,
            self.kept,
            self.steering,
            self.bias_m,
            self.bias_s,
            self.leap_m2,
            self.turned,
            self.seen,
            self.standing,
        )
        return system

    def laws(self, x: Float64, _: Float64 = UNKNOWN) -> list[tuple[float, float]]:
        first = x[0]
        found = [(0.0, 0.0), (first[V], 1e-2), (first[KAPPA], 1.0 / model.CURVATURE_SIGMA**2)]
        found.append((first[GYRO], 1.0 / model.GYRO_BIAS_SIGMA**2))
        found += [(first[k], 1.0 / self.bias_m[0] ** 2) for k in (model.BIAS_E, model.BIAS_N)]
        for k, h in enumerate(self.step_s.tolist()):
            found += self.between(x[k], x[k + 1], k, h)
        return found

    def between(self, a: Float64, b: Float64, k: int, h: float) -> list[tuple[float, float]]:
        one, two = self.bias_m[k], self.bias_m[k + 1]
        # Of the variances of both ends, and their covariance: what the first tells of the second.
        covariance = np.exp(-h / self.bias_s[k]) * min(one, two) ** 2
        slope = covariance / one**2
        left = two**2 - slope * covariance + self.leap_m2[k]
        found = [(b[s] - slope * a[s], 1.0 / left) for s in (model.BIAS_E, model.BIAS_N)]
        found.append((b[GYRO] - a[GYRO], 1.0 / (model.GYRO_BIAS_NOISE**2 * h)))
        if np.isfinite(self.turned[k]):
            # A gyro shows the turn and its bias.
            shown = b[PHI] - a[PHI] + h * a[GYRO]
            found.append((shown - self.turned[k], 1.0 / (model.GYRO_NOISE**2 * h)))
        if not self.seen[k]:
            # Anew, from where the guess is: far places are as likely.
            return [*found, (b[V], 1e-2), (b[KAPPA], 1.0 / model.CURVATURE_SIGMA**2)]
        speed, curvature = (a[V] + b[V]) / 2.0, (a[KAPPA] + b[KAPPA]) / 2.0
        heading = np.exp(1j * (np.pi / 2.0 - (a[PHI] + b[PHI]) / 2.0))
        moved = ((b[E] - a[E]) + 1j * (b[N] - a[N])) / heading
        found.append((moved.real - h * speed, 1.0 / (model.ALONG_NOISE**2 * h)))
        # Acceleration to the right in a right turn, in either gear; it slides to the left.
        slide = -model.SLIP_ANGLE * curvature * speed * abs(speed) * h * speed
        found.append((-moved.imag - slide, 1.0 / (model.ACROSS_NOISE**2 * h)))
        noise = model.FREE_TURN_NOISE if np.isfinite(self.turned[k]) else model.TURN_NOISE
        if self.standing[k] and self.standing[k + 1]:
            noise = model.STANDING_TURN_NOISE
        found.append((b[PHI] - a[PHI] - h * speed * curvature, 1.0 / (noise**2 * h)))
        found.append((b[V] - a[V], 1.0 / (model.ACCELERATION_NOISE**2 * h)))
        found.append((b[KAPPA] - self.kept[k] * a[KAPPA], 1.0 / self.steering[k]))
        return found


def test_motion_replaces_what_the_memory_of_the_matrix_held() -> None:
    n, shape = 8, envelope(8, np.array([[0, 5], [2, 6]]))
    way, x = Way(1, n, gyro=True), np.random.default_rng(1).normal(size=(n, STATES))
    spoilt = empty_system(shape, np.full(shape.size, np.nan))
    found, clean = way.system(x, spoilt), way.system(x, empty_system(shape))
    assert found.values.tobytes() == clean.values.tobytes()
    assert dense(found) == pytest.approx(dense(way.system(x)))


def with_start(matrix: Float64, nodes: list[int]) -> Float64:
    """What is known of places and headings before the drive: little, wherever they are."""
    for node in nodes:
        for state, weight in ((E, 1e-10), (N, 1e-10), (PHI, 1e-2)):
            matrix[STATES * node + state, STATES * node + state] += weight
    return matrix


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.booleans())
def test_the_laws_of_motion(seed: int, gyro: bool) -> None:
    x, way = states(seed, 4), Way(seed, 4, gyro=gyro)
    system = way.system(x)
    r, weight = np.array(way.laws(x)).T
    across = np.flatnonzero(np.isin(weight, 1.0 / (model.ACROSS_NOISE**2 * way.step_s)))
    assert len(across) == 3
    jacobian = slopes(way.laws, x, UNKNOWN)
    for node, row in enumerate(across.tolist()):
        # The slide's own slopes are left out on purpose: only its size counts.
        a, b, h = x[node], x[node + 1], way.step_s[node]
        speed, curvature = (a[V] + b[V]) / 2.0, (a[KAPPA] + b[KAPPA]) / 2.0
        for k in (node, node + 1):
            jacobian[row, k * STATES + V] = (
                h / 2.0 * model.SLIP_ANGLE * curvature * speed * abs(speed)
            )
            jacobian[row, k * STATES + KAPPA] = 0.0
    matrix = with_start(jacobian.T @ (weight[:, None] * jacobian), [0])
    assert dense(system) == pytest.approx(matrix, rel=1e-4, abs=1e-6 * np.abs(matrix).max())
    gradient = -jacobian.T @ (weight * r)
    close = {"rel": 1e-4, "abs": 1e-6 * np.abs(gradient).max()}
    assert right_side(system) == pytest.approx(gradient, **close)
    # Only what is learnt of steering and slow error changes how likely a drive is.
    slow = np.log([first[1] for first in way.laws(x)[4:6]]).sum()
    slow += sum(
        np.log([law[1] for law in way.between(x[k], x[k + 1], k, h)[:2]]).sum()
        for k, h in enumerate(way.step_s.tolist())
    )
    assert system.total[1] == pytest.approx(slow - np.log(way.steering).sum())


@pytest.mark.parametrize("gyro", [True, False])
def test_over_a_hole_only_the_gyro_and_the_drifts_go_on(gyro: bool) -> None:
    x, way = states(7, 2), Way(7, 2, gyro=gyro)
    way.step_s, way.seen = np.array([30.0]), np.array([False])
    way.turned = np.array([0.4 if gyro else np.nan])
    system = way.system(x)
    jacobian = slopes(way.laws, x, UNKNOWN)
    r, weights = np.array(way.laws(x)).T
    matrix = with_start(jacobian.T @ (weights[:, None] * jacobian), [0, 1])
    assert dense(system) == pytest.approx(matrix, rel=1e-4, abs=1e-8)
    assert right_side(system) == pytest.approx(-jacobian.T @ (weights * r), rel=1e-4, abs=1e-6)
    # The two places know nothing of each other.
    assert not dense(system)[:2, STATES : STATES + 2].any()


@settings(deadline=None, max_examples=25)
@given(SEEDS, st.sampled_from([0.2, 1.0, 5.0]))
def test_a_slow_error_has_the_sigma_that_is_stated_at_each_time(seed: int, growth: float) -> None:
    """However the stated sigma changes, and the same said forward and backward in time."""
    n, way = 30, Way(seed, 30, gyro=False)
    way.bias_m = np.geomspace(0.1, 0.1 * growth, n)
    way.step_s, way.leap_m2 = np.full(n - 1, 5.0), np.zeros(n - 1)
    covariance = np.linalg.inv(dense(way.system(np.zeros((n, STATES))))[: n * STATES, : n * STATES])
    east = np.sqrt(np.diag(covariance)[model.BIAS_E :: STATES])
    assert east == pytest.approx(way.bias_m, rel=1e-3)


def test_at_rest_a_node_does_not_move() -> None:
    x = states(3, 2)
    system = empty(2)
    model.add_still(system, x, np.array([True, False]), 0.0, 0.0)
    matrix = dense(system)
    assert matrix[V, V] == 1.0 / model.STANDING_MPS**2
    assert system.right[V] == pytest.approx(-x[0, V] / model.STANDING_MPS**2)
    assert matrix[STATES + V, STATES + V] == 0.0
    for node in (0, 1):
        assert matrix[STATES * node + E, STATES * node + E] == 1.0 / model.LOST_M**2
