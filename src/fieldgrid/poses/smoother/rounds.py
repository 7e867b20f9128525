"""Rounds of robust least squares over all nodes of a drive at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.envelope import STATES, Envelope, envelope, factor, invert, solve
from fieldgrid.poses.smoother.equations import CONSTANTS, NormalEquations, empty_system
from fieldgrid.poses.smoother.measurements import Measurements

MOST_ROUNDS = 25
ENOUGH_M, ENOUGH_RAD = 3e-3, 1e-3
"""Rounds end when no node moves or turns by more."""

SETTLED_SHARE, SETTLING_ROUNDS = 0.998, 5
"""After this number of rounds it is enough that this share of the nodes moves no more: where
nothing tells a heading, it may go to and fro forever, and its sigma says so."""

HELD, NOT_HELD = (1.0 / 3.0**2, 1.0 / 0.3**2), (0.0, 0.0)
"""From round to round a node keeps to where it was by 3 m and 0.3 rad (as weights), or a heading
that little tells would overshoot. Once it is settled that changes nothing."""

OUTLIER_FREEDOM = 4.0
"""Of Student's distribution, which a fix or a step is taken to err by: outliers are believed
the less the farther they lie."""


class SmoothingProblem(NamedTuple):
    """The measurements of a drive and where on the vehicle they are of: `lever_m` is the antenna's
    place (right, ahead) and `step_ahead_m` that of the point whose motion the steps tell, from the
    middle of the axle that does not steer; the antenna's place ahead is unsure by `ahead_sigma_m`.
    `values` is the memory of the normal equations, the
    same for each round: of a long drive, new memory costs as much as factoring."""

    measured: Measurements
    lever_m: Float64
    step_ahead_m: float
    ahead_sigma_m: float
    shape: Envelope
    values: Float64

    @classmethod
    def of(
        cls,
        measured: Measurements,
        lever_m: tuple[float, float],
        step_ahead_m: float,
        ahead_sigma_m: float = 0.0,
    ) -> SmoothingProblem:
        """The problem with the shape of its equations."""
        shape = envelope(len(measured.time_s), measured.step_nodes)
        values = np.empty(shape.size)
        return cls(measured, np.array(lever_m), step_ahead_m, ahead_sigma_m, shape, values)


class CurvatureChange(NamedTuple):
    """How the curvature changes over each step [n - 1]: the share of it that is `kept`, and the
    `variance` of what joins."""

    kept: Float64
    variance: Float64


class Weights(NamedTuple):
    """What each measurement counts, in 1/sigma², and how the curvature changes."""

    fix: Float64
    heading: Float64
    speed: Float64
    step: Float64
    steering: CurvatureChange


class Residuals(NamedTuple):
    """How far measurements lie from the estimate: `fix_m` [n, 2] ahead and right."""

    fix_m: Float64
    heading_rad: Float64
    speed_mps: Float64
    step: Float64


class Solution(NamedTuple):
    """States [n, 8] and constants of a drive, the weights that they were found with, and what the
    last round still changed."""

    x: Float64
    constants: Float64
    weights: Weights
    rounds: int
    last_change: Float64


class Linear(NamedTuple):
    """The normal equations of a solution, factored: what is known of the states beside the
    constants, and the constants that have measurements."""

    system: NormalEquations
    log_determinant: float
    active: Int64
    coupling: Float64
    schur: Float64


def stated_weights(measured: Measurements, steering: CurvatureChange) -> Weights:
    """What the measurements count by their own sigmas."""
    return Weights(
        _inverse_squared(measured.fix_sigma_m),
        _inverse_squared(measured.heading_sigma_rad),
        _inverse_squared(measured.speed_sigma_mps),
        1.0 / measured.step_sigma**2,
        steering,
    )


def _inverse_squared(sigma: Float64) -> Float64:
    known = np.isfinite(sigma)
    # A log may state an error of 0.
    return np.where(known, 1.0 / np.where(known, np.maximum(sigma, 1e-6), 1.0) ** 2, 0.0)


def converged(
    problem: SmoothingProblem,
    start: Float64,
    constants: Float64,
    weights: Weights,
    *,
    enough: float = 1.0,
) -> Solution:
    """Rounds of least squares until nothing moves by more than `enough` times the usual, each
    with the weights of the residuals that the one before has left."""
    found = Solution(start, constants, weights, 0, np.zeros_like(start))
    for rounds in range(1, MOST_ROUNDS + 1):
        linear = linearized(problem, found.x, found.constants, found.weights)
        found = improved(problem, found, linear)
        del linear  # a long drive's equations are large, and the next round makes its own
        moved_m = np.abs(found.last_change[:, : model.PHI]).max(axis=1)
        turned = np.abs(found.last_change[:, model.PHI])
        settled = (moved_m < enough * ENOUGH_M) & (turned < enough * ENOUGH_RAD)
        if rounds > 2 and (
            settled.all() or (rounds > SETTLING_ROUNDS and settled.mean() > SETTLED_SHARE)
        ):
            break
    return found


def improved(problem: SmoothingProblem, found: Solution, linear: Linear) -> Solution:
    """One round: the solution of the linear equations, whose right side becomes it, and the
    weights for the next."""
    system, active = linear.system, linear.active
    step = system.right
    solve(system.shape, system.values, step[:, None])
    turn = np.zeros(CONSTANTS)
    if len(active):
        aside = system.right_constants - system.border.T @ step
        turn[active] = inverse(linear.schur) @ aside[active]
        step -= linear.coupling @ turn[active]
    change = step.reshape(found.x.shape)
    # A first guess may be far off: no node turns by more than a radian a round.
    shrink = max(1.0, float(np.abs(change[:, model.PHI]).max()))
    moved = change / shrink if shrink > 1.0 else change
    x, constants = found.x + moved, found.constants + turn / shrink
    stated = stated_weights(problem.measured, found.weights.steering)
    weights = _robust(stated, residuals(problem, x, constants, stated))
    return Solution(x, constants, weights, found.rounds + 1, change)


def residuals(
    problem: SmoothingProblem, x: Float64, constants: Float64, weights: Weights
) -> Residuals:
    """How far each measurement that counts is off at a state."""
    measured = problem.measured
    offset, wheels, scale, yaw, _ = constants
    ends, moved = measured.step_nodes, measured.step
    return Residuals(
        model.fixes_off(x, measured.fix_m, weights.fix, problem.lever_m),
        model.headings_off(x, offset, measured.heading_rad, weights.heading),
        model.speeds_off(x, wheels, measured.speed_mps, weights.speed),
        model.step_rows(x, (scale, yaw), ends, moved, problem.step_ahead_m)[2],
    )


def linearized(
    problem: SmoothingProblem,
    x: Float64,
    constants: Float64,
    weights: Weights,
    *,
    held: bool = True,
) -> Linear:
    """The factored normal equations about a state. `held` for a round to come, not for sigmas.
    What an earlier call gave for this problem is overwritten."""
    measured = problem.measured
    seen = len(measured.step) > 0
    turns = np.isfinite(measured.turned_rad).any()
    given = (weights.heading > 0.0).any(), (weights.speed > 0.0).any(), seen, seen, turns
    active = np.flatnonzero(np.array(given, dtype=np.bool_))
    system = empty_system(problem.shape, problem.values, coupled=active.size > 0)
    _, wheels, scale, yaw, gyro = constants
    step_s = np.diff(measured.time_s)
    model.add_motion(
        system,
        x,
        step_s,
        *weights.steering,
        measured.bias_m,
        measured.bias_s,
        measured.leap_m2(),
        (1.0 + gyro) * measured.turned_rad,
        measured.seen,
        measured.standing,
    )
    model.add_still(system, x, measured.standing, *(HELD if held else NOT_HELD))
    if turns:
        _add_gyro_scale(system, x, gyro, measured.turned_rad, step_s)
    off = residuals(problem, x, constants, weights)
    model.add_fixes(system, x, off.fix_m, weights.fix, problem.lever_m)
    model.add_headings(system, off.heading_rad, weights.heading)
    model.add_speeds(system, x, wheels, off.speed_mps, weights.speed)
    steps = measured.step_nodes, measured.step, problem.step_ahead_m
    rows = model.step_rows(x, (scale, yaw), *steps)
    model.add_rows(system, *rows, weights.step[:, [0, 0, 1]].copy())
    sigmas = *model.SCALE_SIGMAS, model.CAMERA_YAW_SIGMA, model.GYRO_SCALE_SIGMA
    prior = 1.0 / np.array([measured.heading_offset_sigma_rad, *sigmas]) ** 2
    # What is usual of a constant has outliers, too.
    prior *= (OUTLIER_FREEDOM + 1.0) / (OUTLIER_FREEDOM + np.maximum(prior * constants**2, 1.0))
    system.corner[np.diag_indices(CONSTANTS)] += prior
    system.right_constants[:] -= prior * constants
    log_determinant = float(factor(system.shape, system.values))
    if not np.isfinite(log_determinant):
        raise np.linalg.LinAlgError("the normal equations of a drive are not positive definite")
    coupling = np.zeros((len(system.right), 0))
    schur = system.corner[np.ix_(active, active)]
    if len(active):
        coupling = system.border[:, active]
        solve(system.shape, system.values, coupling)
        schur = schur - system.border[:, active].T @ coupling
    return Linear(system, log_determinant, active, coupling, schur)


def _add_gyro_scale(
    system: NormalEquations, x: Float64, scale: float, turned: Float64, step_s: Float64
) -> None:
    """How the law of a gyro, which takes `turned` [n - 1] times 1 + `scale` (`model.add_motion`),
    depends on the scale."""
    at = np.flatnonzero(~np.isnan(turned))
    turned, step_s = turned[at], step_s[at]
    off = (
        x[at + 1, model.PHI]
        - x[at, model.PHI]
        - ((1.0 + scale) * turned - x[at, model.GYRO] * step_s)
    )
    scaled = -turned / (model.GYRO_NOISE**2 * step_s)
    border = system.border[:, model.GYRO_SCALE]
    border[STATES * (at + 1) + model.PHI] += scaled
    border[STATES * at + model.PHI] -= scaled
    border[STATES * at + model.GYRO] += scaled * step_s
    # In their order, whatever NumPy's is.
    system.corner[model.GYRO_SCALE, model.GYRO_SCALE] -= np.cumsum(np.append(0.0, scaled * turned))[
        -1
    ]
    system.right_constants[model.GYRO_SCALE] -= np.cumsum(np.append(0.0, scaled * off))[-1]


def _robust(stated: Weights, off: Residuals) -> Weights:
    """Student's weights for the next round; 1 sigma off costs nothing, 10 nearly everything."""

    def share(squared: Float64, size: int) -> Float64:
        return np.minimum((OUTLIER_FREEDOM + size) / (OUTLIER_FREEDOM + squared), 1.0)

    fix = share((stated.fix * off.fix_m**2).sum(axis=1), 2)
    distance = share(stated.step[:, 0] * (off.step[:, :2] ** 2).sum(axis=1), 2)
    turn = share(stated.step[:, 1] * off.step[:, 2] ** 2, 1)
    return Weights(
        stated.fix * fix[:, None],
        stated.heading * share(stated.heading * off.heading_rad**2, 1),
        stated.speed * share(stated.speed * off.speed_mps**2, 1),
        stated.step * np.stack([distance, turn], axis=1),
        stated.steering,
    )


def outlier_nats(problem: SmoothingProblem, found: Solution) -> float:
    """How likely it is that fixes and steps err by as much more than they state as their weights
    say: the prior of the weights, of which Student's distribution is made."""
    stated, weights = stated_weights(problem.measured, found.weights.steering), found.weights
    known = stated.fix[:, 0] > 0.0
    fix = weights.fix[known, 0] / stated.fix[known, 0]
    shares = np.concatenate([fix, (weights.step / stated.step).ravel()])
    terms = np.log(shares) + 1.0 - shares
    return OUTLIER_FREEDOM / 2.0 * float(np.cumsum(np.append(0.0, terms))[-1])


def inverse(symmetric: Float64) -> Float64:
    """The inverse of a symmetric matrix [k, k]; in directions of which nothing is known, 0."""
    return np.asarray(np.linalg.pinv(symmetric, hermitian=True))


class Covariances(NamedTuple):
    """The covariances of the states of a drive: the inverse of the normal equations of the nodes,
    and what being unsure of the constants adds."""

    shape: Envelope
    values: Float64
    coupling: Float64
    constants: Float64

    @classmethod
    def of(cls, linear: Linear) -> Covariances:
        """Those of a solution, whose linear system is spoilt."""
        shape, values = linear.system.shape, linear.system.values
        invert(shape, values)
        coupling = linear.coupling.reshape(shape.nodes, STATES, len(linear.active))
        return cls(shape, values, coupling, inverse(linear.schur))

    def own(self, a: int, b: int) -> Float64:
        """Of the states a and b of each node [n]."""
        added = self._added(self.coupling[:, a], self.coupling[:, b])
        return self.shape.own(self.values, a, b) + added

    def with_before(self, a: int, b: int) -> Float64:
        """Of state a of each node but the first and state b of the one before it [n - 1]."""
        added = self._added(self.coupling[1:, a], self.coupling[:-1, b])
        return self.shape.with_before(self.values, a, b) + added

    def _added(self, one: Float64, other: Float64) -> Float64:
        return np.asarray(np.einsum("ni,ij,nj->n", one, self.constants, other))
