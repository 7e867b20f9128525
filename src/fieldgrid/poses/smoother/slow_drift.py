"""Whether the fixes of a drive drift slowly beside what else measured its way.

A random walk as slow as that cannot be told from none by its steps. But what the whole drive says
of a few smooth shapes can: each is a constant that fixes, motion and the stated error resist.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.smoother.batch import SmoothedDrive
from fieldgrid.poses.smoother.declared import SCALE, UNVERIFIED_SIGMAS, couplings, told_by
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.equations import CONSTANTS
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.model import BIAS_E, BIAS_N, KAPPA, PHI, E, N, V
from fieldgrid.poses.smoother.rounds import (
    SmoothingProblem,
    Solution,
    converged,
    linearized,
    stated_weights,
)

SHAPES = 3
"""Number of cosines, of 1, 2 and 3 halves of a period over the drive.
What changes faster is that of a solution that converges."""

DRIFT_SIGMA_M = 5.0
"""How large each may be along one axis."""

_AXES = 2
_DECLARED = len(UNVERIFIED_SIGMAS)


class SlowDrift(NamedTuple):
    """What a drive makes of a slow drift of its fixes: how many sigmas it is from none, beside
    declarations that may be off by what is usual, `misfit`; how many sigmas these are off beside
    the drift, which it does not explain, `left`; how far apart the fixes lie by it,
    `extent_m`; by how much the headings [n] change without it, `turned_rad`; and the error of the
    cosine that the drive tells least, along one axis, `sigma_m`: fixes lie twice as far apart."""

    misfit: float
    left: float
    extent_m: float
    turned_rad: Float64
    sigma_m: float


def slow_drift(
    known: SmoothedDrive, measured: Measurements, lever_m: tuple[float, float], step_ahead_m: float
) -> SlowDrift:
    """What an estimate `known` from the same measurements says of a slow drift of its fixes: one
    step of Gauss and Newton, with all states and what was declared following."""
    # Wheels slip by some per cent uphill and not downhill, which is metres along rows.
    measured = measured._replace(speed_sigma_mps=np.full_like(measured.speed_sigma_mps, np.nan))
    problem = SmoothingProblem.of(measured, lever_m, step_ahead_m)
    weights = stated_weights(measured, known.steering)
    found = converged(problem, known.state, np.zeros(CONSTANTS), weights)
    linear, _ = linearized(problem, found.x, found.constants, found.weights, held=False)
    time_s = measured.time_s
    share = (time_s - time_s[0]) / max(float(time_s[-1] - time_s[0]), 1e-9)
    shapes = np.cos(np.pi * np.outer(share, np.arange(1, SHAPES + 1)))
    followed, information, right = told_by(linear, *_couplings(problem, found, shapes))
    declared, drifts = slice(None, _DECLARED), slice(_DECLARED, None)
    priors = [*UNVERIFIED_SIGMAS, *SHAPES * _AXES * [DRIFT_SIGMA_M]]
    schur = information + np.diag(1.0 / np.square(priors))
    values = np.linalg.solve(schur, right)
    explained = float(values @ right)
    by_declared, by_drift = (
        float(right[one] @ np.linalg.solve(schur[one, one], right[one]))
        for one in (declared, drifts)
    )
    # Of each shape alone, beside what was declared.
    shared = schur[declared, drifts]
    alone = np.diagonal(schur)[drifts] - np.einsum(
        "ak,ak->k", shared, np.linalg.solve(schur[declared, declared], shared)
    )
    drift = values[drifts]
    away_m = shapes @ drift.reshape(SHAPES, _AXES)
    return SlowDrift(
        math.sqrt(max(explained - by_declared, 0.0)),
        math.sqrt(max(explained - by_drift, 0.0)),
        float(np.hypot(*np.ptp(away_m, axis=0))),
        np.asarray(-followed[PHI::STATES, drifts] @ drift),
        float(1.0 / np.sqrt(alone.min())),
    )


def _couplings(
    problem: SmoothingProblem, found: Solution, shapes: Float64
) -> tuple[Float64, Float64, Float64]:
    """How the residuals of fixes and gyro depend on what was declared and on the shapes: the
    coupling with the states [states, k], the corner [k, k], the right side [k]."""
    measured, x, lever = problem.measured, found.x, problem.lever_m
    border, corner, right = couplings(
        *(x, measured.fix_m, found.weights.fix, lever),
        *(measured.turned_rad, np.diff(measured.time_s)),
    )
    count = SHAPES * _AXES
    border = np.pad(border, ((0, 0), (0, count)))
    corner, right = np.pad(corner, (0, count)), np.pad(right, (0, count))
    at = np.flatnonzero(found.weights.fix[:, 0] > 0.0)
    state, shape = x[at], shapes[at]
    sin, cos = np.sin(state[:, PHI]), np.cos(state[:, PHI])
    east = state[:, E] + lever[0] * cos + lever[1] * sin + state[:, BIAS_E] - measured.fix_m[at, 0]
    north = state[:, N] - lever[0] * sin + lever[1] * cos + state[:, BIAS_N] - measured.fix_m[at, 1]
    turn = state[:, V] * state[:, KAPPA]
    none, one = np.zeros(len(at)), np.ones(len(at))
    # Ahead and to the right: the residual, its part by each state, and by the antenna and stamps.
    axes = (
        (sin, cos, -lever[0] * one, (none, one, lever[0] * turn - state[:, V])),
        (cos, -sin, lever[1] * one, (one, none, -lever[1] * turn)),
    )
    for axis, (by_east, by_north, by_turn, by_place) in enumerate(axes):
        weight = found.weights.fix[at, axis]
        off = east * by_east + north * by_north
        by_drift = np.stack([by_east, by_north], axis=1)[:, None, :] * shape[:, :, None]
        by_drift = by_drift.reshape(len(at), count)
        weighted = weight[:, None] * by_drift
        by_states = by_east, by_north, by_turn, by_east, by_north
        for column, by_state in zip((E, N, PHI, BIAS_E, BIAS_N), by_states, strict=True):
            border[STATES * at + column, _DECLARED:] += weighted * by_state[:, None]
        cross = np.stack(by_place, axis=1).T @ weighted
        corner[:SCALE, _DECLARED:] += cross
        corner[_DECLARED:, :SCALE] += cross.T
        corner[_DECLARED:, _DECLARED:] += by_drift.T @ weighted
        right[_DECLARED:] -= weighted.T @ off
    return border, corner, right
