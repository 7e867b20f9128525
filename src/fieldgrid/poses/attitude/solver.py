"""Least squares over the nodes of a stretch: a banded system with a border of shared unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, kernel
from fieldgrid.poses.attitude.model import STATES, Law

# Symmetric banded systems: their solution by LAPACK, and the variances of their unknowns.


def factor(band: Float64) -> Float64:
    """Cholesky factor of a positive definite matrix in LAPACK's lower banded form.

    `band[i - j, j]` is element (i, j), i >= j; the factor has the same form.
    """
    from scipy.linalg import cholesky_banded  # late: most drives have no IMU

    result: Float64 = cholesky_banded(band, lower=True, check_finite=False)
    return result


def solve(lower: Float64, right: Float64) -> Float64:
    """Solution of the system whose factor is `lower`."""
    from scipy.linalg import cho_solve_banded

    result: Float64 = cho_solve_banded((lower, True), right, check_finite=False)
    return result


def inverse_blocks(lower: Float64, size: int) -> Float64:
    """The diagonal blocks [n/size, size, size] of the inverse, from the factor of the matrix."""
    width, n = lower.shape
    columns = np.ascontiguousarray(lower.T)  # neighbours in a column lie side by side
    inverse, blocks = np.zeros((n + width, 2 * width - 1)), np.empty((n // size, size, size))
    _fill_inverse(columns, inverse, blocks)
    return blocks


@kernel
def _fill_inverse(columns, inverse, blocks):  # type: ignore[no-untyped-def]
    """Takahashi's recursion from the last column to the first: an element of the inverse inside
    the band needs only later ones inside the band, so the others are never made.

    Row j of the `inverse` holds its elements from column j - width + 1 to j + width - 1, so that
    the sums run along rows.
    """
    n, width = columns.shape
    middle, size = width - 1, blocks.shape[1]
    for j in range(n - 1, -1, -1):
        top = min(width, n - j)
        pivot = columns[j, 0]
        for i in range(1, top):
            total = 0.0
            for k in range(1, top):
                total += columns[j, k] * inverse[j + i, middle + k - i]
            inverse[j, middle + i] = inverse[j + i, middle - i] = -total / pivot
        total = 0.0
        for k in range(1, top):
            total += columns[j, k] * inverse[j, middle + k]
        inverse[j, middle] = (1.0 / pivot - total) / pivot
    for block in range(len(blocks)):
        for a in range(size):
            for b in range(a + 1):
                value = inverse[block * size + b, middle + a - b]
                blocks[block, a, b] = value
                blocks[block, b, a] = value


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


LOST_SIGMA = np.repeat([1e4, 1e2, 1e1], 3)
"""No node is less sure of its position, velocity and axes, so that every system has a solution."""


def normal_equations(
    laws: Sequence[Law], n: int, shared: Float64, shared_sigma: Float64
) -> AttitudeEquations:
    """The system of all laws over n nodes; the `shared` unknowns are known to be within
    `shared_sigma` [s] of 0 beforehand."""
    diagonal, below = np.zeros((n, STATES, STATES)), np.zeros((n, STATES, STATES))
    diagonal[:] = np.diag(LOST_SIGMA**-2.0)
    border, right = np.zeros((n, STATES, len(shared))), np.zeros((n, STATES))
    corner, right_shared = np.diag(shared_sigma**-2.0), -shared / shared_sigma**2
    for node, residual, slope, weight, by_shared in laws:
        turned = (slope * weight[:, :, None]).swapaxes(1, 2)
        square = turned @ slope
        gradient = (turned @ residual[:, :, None])[:, :, 0]
        diagonal[node] += square[:, :STATES, :STATES]
        right[node] -= gradient[:, :STATES]
        both = slope.shape[2] > STATES
        if both:
            diagonal[node + 1] += square[:, STATES:, STATES:]
            below[node] += square[:, STATES:, :STATES]
            right[node + 1] -= gradient[:, STATES:]
        if by_shared is not None:
            across, count = turned @ by_shared, by_shared.shape[2]
            border[node, :, :count] += across[:, :STATES]
            if both:
                border[node + 1, :, :count] += across[:, STATES:]
            weighted = (by_shared * weight[:, :, None]).reshape(-1, count)
            corner[:count, :count] += by_shared.reshape(-1, count).T @ weighted
            right_shared[:count] -= weighted.T @ residual.ravel()
    band = np.zeros((2 * STATES, n, STATES))
    band[_ROW - _COLUMN, :, _COLUMN] = diagonal[:, _ROW, _COLUMN].T
    band[_BELOW, :, np.arange(STATES)] = below.transpose(1, 2, 0)
    return AttitudeEquations(
        band.reshape(2 * STATES, -1),
        border.reshape(-1, len(shared)),
        corner,
        right.ravel(),
        right_shared,
    )


def solved(system: AttitudeEquations) -> tuple[Float64, Float64]:
    """The changes [n, 9] of the nodes and [s] of the shared unknowns."""
    lower = factor(system.band)
    found = solve(lower, np.column_stack([system.right, system.border]))
    alone, through = found[:, 0], found[:, 1:]
    rest = system.corner - system.border.T @ through
    shared = np.asarray(
        np.linalg.solve(rest, system.right_shared - system.border.T @ alone), np.float64
    )
    return (alone - through @ shared).reshape(-1, STATES), shared


def covariances(system: AttitudeEquations) -> tuple[Float64, Float64]:
    """The covariance [n, 9, 9] of each node's states, and [s, s] of the shared unknowns."""
    lower = factor(system.band)
    through = solve(lower, system.border)
    shared = np.asarray(np.linalg.inv(system.corner - system.border.T @ through), np.float64)
    slopes = through.reshape(-1, STATES, shared.shape[0])
    blocks = inverse_blocks(lower, STATES)
    return blocks + slopes @ shared @ slopes.swapaxes(1, 2), shared
