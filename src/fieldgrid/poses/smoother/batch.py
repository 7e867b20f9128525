"""One estimate of a whole drive: least squares over every node at once, robust to outliers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.declared import Constant, DeclaredCorrection, Unsure, tested
from fieldgrid.poses.smoother.equations import CONSTANTS
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.rounds import (
    Covariances,
    CurvatureChange,
    SmoothingProblem,
    Solution,
    converged,
    inverse,
    linearized,
    outlier_nats,
    residuals,
    stated_weights,
)
from fieldgrid.poses.smoother.slow_error import TOLD_SHARE, LeapOdds, SlowChanges
from fieldgrid.poses.smoother.steering import (
    Steering,
    adapted,
    likeliest_steering,
    likelihood_by,
    roughly,
    usual_steering,
)

GYRO_SHARE = 0.9
"""With a gyro over more of the drive than this, nothing needs to be expected of its steering."""


class SmoothedDrive(NamedTuple):
    """The estimate at n nodes: `state` [n, 8] as in `poses.smoother.model`.

    `position_sigma_m` is absolute, `relative_sigma_m` that within the receiver's own frame:
    without the slow error that shifts neighbours alike. Both are 1-sigma along one axis.
    `fix_off_m` [n, 2] are how far fixes lie ahead and to the right of where pose, lever and slow
    error have them, `step_off` [s, 3] the same of the steps.

    `heading_offset`, `camera_yaw_rad` (radians), `wheel_scale`, `camera_scale`, `gyro_scale` are
    the constants; None where nothing measures them. `declared` is what the drive makes of what was
    declared, and `unsure` what that does to poses. `nats` is how likely the measurements are, and
    `wander_nats` by how much likelier they would be with a slow error that changes more, or by
    `leaps`.
    `steering` is the change of the curvature that was learnt, and `steers` how the vehicle steers.
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
    camera_yaw_rad: Constant | None
    gyro_scale: Constant | None
    declared: DeclaredCorrection
    unsure: Unsure
    nats: float
    wander_nats: float
    leaps: LeapOdds
    steering: CurvatureChange
    steers: Steering
    rounds: int


def smooth(
    measured: Measurements,
    start: Float64,
    lever_m: tuple[float, float] = (0.0, 0.0),
    step_ahead_m: float = 0.0,
    ahead_sigma_m: float = 0.0,
) -> SmoothedDrive:
    """The likeliest drive from a first guess `start` [n, 8] that has its gears right.

    `lever_m` is the antenna's place (right, ahead) and `step_ahead_m` that of the point whose
    motion the steps tell, from the middle of the axle that does not steer. How much the vehicle
    steers is what makes its own fixes likeliest. The same input gives the same bits.
    """
    problem = SmoothingProblem.of(measured, lever_m, step_ahead_m, ahead_sigma_m)
    # A gyro sees the steering; without one the drive has to tell what to expect of it.
    gyro = np.isfinite(measured.turned_rad)
    learns = bool(gyro.size) and float(gyro.mean()) < GYRO_SHARE
    constants, steers = np.zeros(CONSTANTS), Steering.usual()
    if not learns:
        found = converged(
            problem,
            start,
            constants,
            stated_weights(measured, usual_steering(np.diff(measured.time_s))),
        )
    else:
        found = roughly(problem, start, constants)
        del start  # as large as the solution, of a long drive
        steers = likeliest_steering(problem, found)
        found = adapted(problem, found, steers)
    return _with_sigmas(problem, found, steers)


def refine(
    known: SmoothedDrive,
    measured: Measurements,
    lever_m: tuple[float, float],
    step_ahead_m: float,
    ahead_sigma_m: float = 0.0,
) -> SmoothedDrive:
    """The drive by other measurements at its nodes, with the steering that was learnt."""
    problem = SmoothingProblem.of(measured, lever_m, step_ahead_m, ahead_sigma_m)
    weights = stated_weights(measured, known.steering)
    found = converged(problem, known.state, np.zeros(CONSTANTS), weights)
    return _with_sigmas(problem, found, known.steers)


def _with_sigmas(problem: SmoothingProblem, found: Solution, steers: Steering) -> SmoothedDrive:
    """The estimate with its sigmas; where it has not settled, what still changes counts too."""
    linear = linearized(problem, found.x, found.constants, found.weights, held=False)
    off = residuals(problem, found.x, found.constants, found.weights)
    declared, unsure = tested(problem, found, linear)
    nats = TOLD_SHARE * (likelihood_by(linear) + outlier_nats(problem, found)) + declared.nats()
    known = Covariances.of(linear)
    slow = SlowChanges.of(problem.measured, found.x, known)
    east, north, phi = model.E, model.N, model.PHI
    relative = sum(
        known.own(axis, axis) + 2.0 * known.own(axis, bias) + known.own(bias, bias)
        for axis, bias in ((east, model.BIAS_E), (north, model.BIAS_N))
    )
    moved, turned = found.last_change[:, : model.PHI], found.last_change[:, model.PHI]
    unsettled = (moved**2).sum(axis=1)
    absolute = known.own(east, east) + known.own(north, north)
    constants: list[Constant | None] = [None] * CONSTANTS
    if len(linear.active):
        variances = np.diagonal(inverse(linear.schur))
        # Of fixes that contradict each other wildly, rounding leaves nothing known.
        sigmas = np.sqrt(np.where(variances > 0.0, variances, np.inf))
        for k, sigma in zip(linear.active.tolist(), sigmas.tolist(), strict=True):
            constants[k] = Constant(float(found.constants[k]), sigma)
    return SmoothedDrive(
        found.x,
        np.sqrt((np.maximum(absolute, 0.0) + unsettled) / 2.0),
        np.sqrt((np.maximum(relative, 0.0) + unsettled) / 2.0),
        np.sqrt(np.maximum(known.own(phi, phi), 0.0) + turned**2),
        off.fix_m,
        off.step,
        constants[model.HEADING_OFFSET],
        constants[model.WHEEL_SCALE],
        constants[model.CAMERA_SCALE],
        constants[model.CAMERA_YAW],
        constants[model.GYRO_SCALE],
        declared,
        unsure,
        nats,
        slow.wander_nats(),
        slow.leaps(problem.measured, off),
        found.weights.steering,
        steers,
        found.rounds,
    )
