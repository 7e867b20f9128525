"""Least squares over the nodes of a stretch: a banded system with a border of shared unknowns."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.attitude.model import SHARED, STATES, AttitudeRows, States
from fieldgrid.poses.smoother.rounds import OUTLIER_FREEDOM

LOST_SIGMA = np.repeat([1e4, 1e2, 1e1], 3)
"""No node is less sure of its position, velocity and axes, so that every system has a solution."""

_BELOW = STATES + np.subtract.outer(np.arange(STATES), np.arange(STATES))
_ROW, _COLUMN = np.tril_indices(STATES)


class AttitudeEquations(NamedTuple):
    """Normal equations: `band` [18, 9 n] in LAPACK's lower form, `border` [9 n, s] between nodes
    and s shared unknowns, `corner` [s, s] among these; right sides [9 n] and [s]."""

    band: Float64
    border: Float64
    corner: Float64
    right: Float64
    right_shared: Float64


def believed(off: Float64) -> Float64:
    """The share of the weight of residuals that are so many sigmas off, by Student."""
    return np.minimum((OUTLIER_FREEDOM + 1.0) / (OUTLIER_FREEDOM + off**2), 1.0)


def normal_equations(
    x: States, rows: Iterable[AttitudeRows], shared_sigma: Float64, *, robust: bool
) -> AttitudeEquations:
    """The system of all rows, linearised at `x`; the shared unknowns are known to be within
    `shared_sigma` [s] of 0 beforehand."""
    n, size = len(x.R), SHARED + len(x.shared)
    square, right = np.zeros((n, size, size)), np.zeros((n, size))
    for one in rows:
        off, slope = one.law(x, one.at, *one.said)
        weight = one.sigma**-2.0
        if one.robust and robust:
            weight = weight * believed(off / one.sigma)
        columns = np.flatnonzero(slope.any(axis=(0, 1)))
        slope = slope[:, :, columns]
        weighted = (slope * weight[:, :, None]).swapaxes(1, 2)
        square[np.ix_(one.at, columns, columns)] += weighted @ slope
        right[np.ix_(one.at, columns)] -= (weighted @ off[:, :, None])[:, :, 0]
    # What concerns the next node goes there.
    own, after = slice(0, STATES), slice(STATES, SHARED)
    square[1:, own, own] += square[:-1, after, after]
    square[1:, own, SHARED:] += square[:-1, after, SHARED:]
    right[1:, own] += right[:-1, after]
    square[:, own, own] += np.diag(LOST_SIGMA**-2.0)
    band = np.zeros((2 * STATES, n, STATES))
    band[_ROW - _COLUMN, :, _COLUMN] = square[:, _ROW, _COLUMN].T
    band[_BELOW, :, np.arange(STATES)] = square[:, after, own].transpose(1, 2, 0)
    return AttitudeEquations(
        band.reshape(2 * STATES, -1),
        square[:, own, SHARED:].reshape(STATES * n, -1),
        square[:, SHARED:, SHARED:].sum(axis=0) + np.diag(shared_sigma**-2.0),
        right[:, own].ravel(),
        right[:, SHARED:].sum(axis=0) - x.shared / shared_sigma**2,
    )


def _factored(system: AttitudeEquations, right: Float64) -> tuple[Float64, Float64]:
    """The Cholesky factor of the band, and its solution for right sides."""
    from scipy.linalg import cho_solve_banded, cholesky_banded  # late: most drives have no IMU

    lower = cholesky_banded(system.band, lower=True, check_finite=False)
    return lower, np.asarray(cho_solve_banded((lower, True), right, check_finite=False))


def solved(system: AttitudeEquations) -> tuple[Float64, Float64]:
    """The changes [n, 9] of the nodes and [s] of the shared unknowns."""
    _, found = _factored(system, np.column_stack([system.right, system.border]))
    alone, through = found[:, 0], found[:, 1:]
    rest = system.corner - system.border.T @ through
    shared = np.asarray(np.linalg.solve(rest, system.right_shared - system.border.T @ alone))
    return (alone - through @ shared).reshape(-1, STATES), shared


def covariances(system: AttitudeEquations) -> Float64:
    """The covariance [n, 9, 9] of each node's states, by Takahashi's recursion from the last node
    to the first."""
    lower, through = _factored(system, system.border)
    shared = np.asarray(np.linalg.inv(system.corner - system.border.T @ through))
    band = lower.reshape(2 * STATES, -1, STATES)
    triangle = np.zeros((band.shape[1], STATES, STATES))
    triangle[:, _ROW, _COLUMN] = band[_ROW - _COLUMN, :, _COLUMN].T
    own = np.asarray(np.linalg.inv(triangle))
    back = band[_BELOW, :, np.arange(STATES)].transpose(2, 0, 1) @ own
    blocks = own.swapaxes(1, 2) @ own
    for k in range(len(blocks) - 2, -1, -1):
        blocks[k] += back[k].T @ blocks[k + 1] @ back[k]
    slopes = through.reshape(-1, STATES, len(shared))
    return np.asarray(blocks + slopes @ shared @ slopes.swapaxes(1, 2))
