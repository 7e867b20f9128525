"""One estimate of a whole drive: least squares over every node at once, robust to outliers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.smoother import model
from fieldgrid.smoother.envelope import STATES, solve
from fieldgrid.smoother.measurements import Measurements
from fieldgrid.smoother.rounds import (
    Linear,
    Problem,
    Solution,
    converged,
    covariance_blocks,
    inverse,
    linearized,
    stated_weights,
)
from fieldgrid.smoother.steering import (
    USUAL_STEERING_NOISE,
    adapted,
    likeliest_noise,
    roughly,
    usual_steering,
)

GYRO_SHARE = 0.9
"""With a gyro over more of the drive than this, nothing needs to be expected of its steering."""

TESTED_SIGMAS = np.array([5.0, 5.0, 5.0])
"""What a place of the antenna (metres) and a stamp (seconds) could be off by, before the drive."""


class Constant(NamedTuple):
    """A constant of the drive, with its 1-sigma error."""

    value: float
    sigma: float


class Declared(NamedTuple):
    """What the drive would have added to what was declared of its fixes: to the antenna's place,
    to the right and ahead (metres), and to how late the fixes are stamped (seconds). Nothing of it
    is applied."""

    right_m: Constant
    ahead_m: Constant
    late_s: Constant


class Smoothed(NamedTuple):
    """The estimate at n nodes: `state` [n, 8] as in :mod:`fieldgrid.smoother.model`.

    `position_sigma_m` is absolute, `relative_sigma_m` that within the receiver's own frame:
    without the slow error that shifts neighbours alike. Both are 1-sigma along one axis.
    `fix_off_m` [n, 2] are how far fixes lie ahead and to the right of where pose, lever and slow
    error have them, `step_off` [s, 3] the same of the steps.

    `heading_offset` (radians), `wheel_scale` and `camera_scale` are the constants; None where
    nothing measures them. `heading_per_m` [n] is how headings would change (radians) with a place
    of the antenna that is a metre farther ahead than was declared. `steering` [n - 1] is the
    variance of the curvature's change that was learnt.
    """

    state: Float64
    position_sigma_m: Float64
    relative_sigma_m: Float64
    heading_sigma_rad: Float64
    fix_off_m: Float64
    step_off: Float64
    heading_offset: Constant | None
    wheel_scale: Constant | None
    camera_scale: Constant | None
    declared: Declared
    heading_per_m: Float64
    steering: Float64
    steering_noise: float
    rounds: int


def smooth(
    measured: Measurements,
    start: Float64,
    lever_m: tuple[float, float] = (0.0, 0.0),
    step_ahead_m: float = 0.0,
) -> Smoothed:
    """The likeliest drive from a first guess `start` [n, 8] that has its gears right.

    `lever_m` is the antenna's place (right, ahead) and `step_ahead_m` that of the point whose
    motion the steps tell, from the middle of the axle that does not steer. How much the vehicle
    steers is what makes its own fixes likeliest. The same input gives the same bits.
    """
    problem = Problem.of(measured, lever_m, step_ahead_m)
    # A gyro sees the steering; without one the drive has to tell what to expect of it.
    gyro = np.isfinite(measured.turned_rad)
    learns = bool(gyro.size) and float(gyro.mean()) < GYRO_SHARE
    constants, steering_noise = np.zeros(model.CONSTANTS), USUAL_STEERING_NOISE
    if not learns:
        found = converged(
            problem,
            start,
            constants,
            stated_weights(measured, usual_steering(np.diff(measured.time_s))),
        )
    else:
        found = roughly(problem, start, constants)
        steering_noise = likeliest_noise(problem, found)
        found = adapted(problem, found, steering_noise)
    return _with_sigmas(problem, found, steering_noise)


def refine(
    known: Smoothed, measured: Measurements, lever_m: tuple[float, float], step_ahead_m: float
) -> Smoothed:
    """The same drive by other measurements at its nodes, with the steering that was learnt."""
    problem = Problem.of(measured, lever_m, step_ahead_m)
    weights = stated_weights(measured, known.steering)
    found = converged(problem, known.state, np.zeros(model.CONSTANTS), weights)
    return _with_sigmas(problem, found, known.steering_noise)


def _with_sigmas(problem: Problem, found: Solution, steering_noise: float) -> Smoothed:
    """The estimate with its sigmas; where it has not settled, what still changes counts too."""
    linear, off = linearized(problem, found.x, found.constants, found.weights, held=False)
    declared, heading_per_m = _tested(problem, found, linear)
    blocks, _ = covariance_blocks(linear)
    east, north, phi = model.E, model.N, model.PHI
    relative = sum(
        blocks[:, axis, axis] + 2.0 * blocks[:, axis, bias] + blocks[:, bias, bias]
        for axis, bias in ((east, model.BIAS_E), (north, model.BIAS_N))
    )
    moved, turned = found.last_change[:, : model.PHI], found.last_change[:, model.PHI]
    unsettled = (moved**2).sum(axis=1)
    absolute = blocks[:, east, east] + blocks[:, north, north]
    constants = _constants(found, linear)
    return Smoothed(
        found.x,
        np.sqrt((np.maximum(absolute, 0.0) + unsettled) / 2.0),
        np.sqrt((np.maximum(relative, 0.0) + unsettled) / 2.0),
        np.sqrt(np.maximum(blocks[:, phi, phi], 0.0) + turned**2),
        off.fix_m,
        off.step,
        constants[model.HEADING_OFFSET],
        constants[model.WHEEL_SCALE],
        constants[model.CAMERA_SCALE],
        declared,
        heading_per_m,
        found.weights.steering,
        steering_noise,
        found.rounds,
    )


def _constants(found: Solution, linear: Linear) -> list[Constant | None]:
    constants: list[Constant | None] = [None] * model.CONSTANTS
    if len(linear.active):
        variances = np.diagonal(inverse(linear.schur))
        # Of fixes that contradict each other wildly, rounding leaves nothing known.
        sigmas = np.sqrt(np.where(variances > 0.0, variances, np.inf))
        for k, sigma in zip(linear.active.tolist(), sigmas.tolist(), strict=True):
            constants[k] = Constant(float(found.constants[k]), sigma)
    return constants


def _tested(problem: Problem, found: Solution, linear: Linear) -> tuple[Declared, Float64]:
    """What would have to be added to the antenna's place and to the fixes' stamps for the drive
    to fit best: one step of Gauss and Newton with all states following; and how headings follow a
    place farther ahead."""
    border, corner, right = model.lever_and_clock(
        found.x, problem.measured.fix_m, found.weights.fix, problem.lever_m
    )
    followed = solve(linear.system.shape, linear.system.values, border)
    if len(linear.active):
        shared = linear.coupling.T @ border
        followed -= linear.coupling @ (inverse(linear.schur) @ shared)
    schur = corner - border.T @ followed + np.diag(1.0 / TESTED_SIGMAS**2)
    values = np.linalg.solve(schur, right - followed.T @ linear.system.right)
    sigmas = np.sqrt(np.diagonal(np.linalg.inv(schur)))
    right_m, ahead_m, late_s = map(Constant, values.tolist(), sigmas.tolist())
    return Declared(right_m, ahead_m, late_s), -followed[model.PHI :: STATES, 1]
