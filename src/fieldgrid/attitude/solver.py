"""Least squares over the nodes of a stretch: a banded system with a border of shared unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.attitude.banded import factor, inverse_blocks, solve
from fieldgrid.attitude.model import STATES, Law

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
