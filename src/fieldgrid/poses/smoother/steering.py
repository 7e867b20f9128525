"""How much a vehicle steers, learnt from its own drive.

Without a gyro, how much a vehicle steers decides how far positions are smoothed, and no constant
fits a robot in its row and a mower in the rough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.holes import ShownBends, Unseen, leaving, seen_way_m
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.rounds import (
    Covariances,
    CurvatureChange,
    Linear,
    SmoothingProblem,
    Solution,
    converged,
    improved,
    linearized,
    stated_weights,
)

STEERING_NOISES = (0.01, 0.02, 0.05, 0.1, 0.2)
"""How much a vehicle steers all the time, (1/m)/√s: a robot in its row, a mower in the rough."""

USUAL_STEERING_NOISE = 0.05

LEAST_BENT, MOST_BENT = 0.25, 2.0
"""The curvatures of a drive, as a share of the usual ones, count within these bounds."""

TIGHT_SHARE = 0.98
"""Share of its way on which a vehicle bends less than in its tightest turns."""

ENOUGH_TURN = np.radians(120.0)
"""A drive that never turned by this does not show how tightly its vehicle can turn."""

ALWAYS_SHARE = 0.5
"""Of the expected steering, what is due to what the vehicle always does."""

MOST_STEERING = 8.0 * model.CURVATURE_SIGMA**2 / model.CURVATURE_S
"""(1/m)²/s: from lock to lock in a second."""

LEAST_VARIANCE = 1e-12
"""No curvature is known better, 1/m²: rounding."""

STEERING_S = 2.0
"""Steering at one moment makes more of it likely for about a second before and after."""

ADAPTATIONS = 6
"""Number of rounds that update the expected steering. More of them make rows straighter,
and hides steering where noise could."""

CLEAR_NATS = 2.0
"""A drive is taken for a calm one only when its fixes clearly say so."""

ROUGHLY = 10.0
"""Before the steering is learnt, the rounds may end when nodes still move by this multiple of what
is enough."""

STRETCHES, STRETCH_NODES = 4, 1000
"""Number of places, and nodes in each, by which a longer drive shows how much it steers."""


class Steering(NamedTuple):
    """How a vehicle steers: `noise`, (1/m)/√s, is what it does all the time, and `bent` the
    curvatures that it drives, as a share of the usual: its steering where no fix shows it.
    `shown` are the curvatures that are expected where fixes return after a hole."""

    noise: float
    bent: float
    shown: ShownBends

    @classmethod
    def usual(cls) -> Steering:
        """That of a drive not looked at."""
        return cls(USUAL_STEERING_NOISE, 1.0, ShownBends.usual())


def usual_steering(step_s: Float64) -> CurvatureChange:
    """The curvature's change over steps [n - 1] of a drive not looked at yet."""
    variance = model.CURVATURE_SIGMA**2 * (1.0 - np.exp(-2.0 * step_s / model.CURVATURE_S))
    return CurvatureChange(np.exp(-step_s / model.CURVATURE_S), np.asarray(variance))


def local_steering(
    curvature: Float64,
    variance: Float64,
    onward: Float64,
    time_s: Float64,
    steering_noise: float,
    unseen: Bool,
) -> Float64:
    """The variance of its change by what the curvatures [n] do around each step, as far as that is
    known: `variance` [n] is theirs, `onward` [n - 1] their covariance with the next one. Steps
    [n - 1] that are `unseen` tell nothing of those around.

    A vehicle goes straight for long and then turns in. `steering_noise`, (1/m)/√s, is how much
    it steers always; a part of the variance is that, and the rest what was seen nearby. What
    noise hides counts as steering: it is expected there, not ruled out.
    """
    step_s = np.diff(time_s)
    fading = np.exp(-step_s / model.CURVATURE_S)
    change = (curvature[1:] - fading * curvature[:-1]) ** 2
    change += variance[1:] + fading**2 * variance[:-1] - 2.0 * fading * onward
    middle_s = (time_s[1:] + time_s[:-1]) / 2.0
    first = np.searchsorted(middle_s, middle_s - STEERING_S / 2.0)
    last = np.searchsorted(middle_s, middle_s + STEERING_S / 2.0, side="right")
    changed = np.concatenate([[0.0], np.cumsum(np.where(unseen, 0.0, change))])
    passed_s = np.concatenate([[0.0], np.cumsum(np.where(unseen, 0.0, step_s))])
    near = (changed[last] - changed[first]) / np.where(
        unseen, step_s, passed_s[last] - passed_s[first]
    )
    mixed = ALWAYS_SHARE * steering_noise**2 + (1.0 - ALWAYS_SHARE) * near
    return np.asarray(np.minimum(mixed, MOST_STEERING) * step_s)


def adapted(problem: SmoothingProblem, found: Solution, steering: Steering) -> Solution:
    """The drive when steering is expected where it was seen, and where it may be hidden: in
    holes."""
    k, measured = model.KAPPA, problem.measured
    unseen = Unseen.of(measured)
    exits = unseen.exits()
    bent = np.where(unseen.holes, max(steering.bent, 1.0), steering.bent)
    usual = usual_steering(np.diff(measured.time_s))
    hidden = usual._replace(variance=bent**2 * usual.variance)
    inside = outside = bent[exits] * model.CURVATURE_SIGMA
    found = found._replace(weights=found.weights._replace(steering=hidden))
    for _ in range(ADAPTATIONS):
        linear = linearized(problem, found.x, found.constants, found.weights)
        curvature = found.x[:, k]
        found = improved(problem, found, linear)
        known = Covariances.of(linear)
        own, onward = known.own(k, k), known.with_before(k, k)
        del linear, known  # large, and the next round makes its own
        seen = local_steering(
            *(curvature, own, onward), measured.time_s, steering.noise, unseen.between
        )
        there = np.maximum(own[exits + 1], LEAST_VARIANCE)
        measured_precision = np.maximum(1.0 / there - 1.0 / outside**2, 0.0)
        information = curvature[exits + 1] / there
        outside = np.sqrt(steering.shown.expected_squared(measured_precision, information))
        change = usual._replace(variance=np.where(unseen.blind, hidden.variance, seen))
        change = leaving(change, exits, inside, outside)
        found = found._replace(weights=found.weights._replace(steering=change))
    return converged(problem, found.x, found.constants, found.weights)


def bent_share(measured: Measurements, x: Float64) -> float:
    """How tightly a vehicle turns, as a share of :data:`model.CURVATURE_SIGMA`, by the states
    [n, 8] of its drive: a harvester bends its path less within a second than a garden tractor."""
    turned = np.where(measured.seen, np.diff(x[:, model.PHI]), 0.0)
    if not np.ptp(np.cumsum([0.0, *turned])) > ENOUGH_TURN:
        return 1.0
    way_m = seen_way_m(measured, x)
    bend = np.abs(x[1:, model.KAPPA] + x[:-1, model.KAPPA]) / 2.0
    order = np.argsort(bend)
    passed_m = np.cumsum(way_m[order])
    tight = bend[order][np.searchsorted(passed_m, TIGHT_SHARE * passed_m[-1])]
    return float(np.clip(tight / model.CURVATURE_SIGMA, LEAST_BENT, MOST_BENT))


def likeliest_steering(problem: SmoothingProblem, found: Solution) -> Steering:
    """The curvatures of the drive, and the steering noise of :data:`STEERING_NOISES` under which
    its measurements are likeliest.

    Their likelihood rises to one top, so it is climbed from the usual one. Of a long drive
    some stretches are enough.
    """
    parts = [(part, roughly(part, x, found.constants)) for part, x in stretches(problem, found)]
    bent = bent_share(problem.measured, found.x)
    shown = ShownBends.of(problem.measured, found.x)
    tried: dict[int, float] = {}

    def likelihood(k: int) -> float:
        if k not in tried:
            steering = Steering(STEERING_NOISES[k], bent, shown)
            tried[k] = sum(log_likelihood(part, near, steering) for part, near in parts)
        return tried[k]

    at = STEERING_NOISES.index(USUAL_STEERING_NOISE)
    for step in (-1, 1):
        while 0 <= at + step < len(STEERING_NOISES):
            if likelihood(at + step) <= likelihood(at) - step * CLEAR_NATS:
                break
            at += step
    return Steering(STEERING_NOISES[at], bent, shown)


def stretches(problem: SmoothingProblem, found: Solution) -> list[tuple[SmoothingProblem, Float64]]:
    """Parts of a drive that stand for it, each with its states."""
    n = len(found.x)
    if n <= STRETCHES * STRETCH_NODES:
        return [(problem, found.x)]
    starts = np.linspace(0, n - STRETCH_NODES, STRETCHES).astype(int).tolist()
    lever_m = (float(problem.lever_m[0]), float(problem.lever_m[1]))
    return [
        (
            SmoothingProblem.of(
                problem.measured.part(a, a + STRETCH_NODES), lever_m, problem.step_ahead_m
            ),
            found.x[a : a + STRETCH_NODES],
        )
        for a in starts
    ]


def roughly(problem: SmoothingProblem, start: Float64, constants: Float64) -> Solution:
    """The drive with the usual steering, to within centimetres."""
    usual = usual_steering(np.diff(problem.measured.time_s))
    weights = stated_weights(problem.measured, usual)
    return converged(problem, start, constants, weights, enough=ROUGHLY)


def log_likelihood(problem: SmoothingProblem, near: Solution, steering: Steering) -> float:
    """Of the measurements under a steering, every drive around its solution considered: Laplace's
    approximation, up to a constant."""
    solution = adapted(problem, near, steering)
    return likelihood_by(
        linearized(problem, solution.x, solution.constants, solution.weights, held=False)
    )


def likelihood_by(linear: Linear) -> float:
    """Log likelihood by the normal equations of a solution, whose nodes are not held."""
    _, schur = np.linalg.slogdet(linear.schur)
    squared, log_weights = linear.system.total
    return 0.5 * float(log_weights - squared - linear.log_determinant - schur)
