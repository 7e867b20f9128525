"""One estimate of a whole drive: least squares over every node at once, robust to outliers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.smoother import model
from fieldgrid.smoother.banded import factor, inverse_blocks, solve

_Float64 = npt.NDArray[np.float64]

MOST_ROUNDS = 25
ENOUGH_M, ENOUGH_RAD = 1e-3, 1e-4
"""Rounds end when no node moves or turns by more."""

OUTLIER_FREEDOM = 4.0
"""Of Student's distribution, which a fix or a step is taken to err by: outliers are believed
the less the farther they lie."""

MOST_BAND = 4e8
"""Elements of the banded matrix: 3 GB, more than any drive that makes sense."""


class Sightings(NamedTuple):
    """What was seen at n nodes, ordered by `time_s`; NaN where nothing was.

    `fix_m` [n, 2] is the antenna's east and north, `fix_sigma_m` the noise of one axis and
    `fix_bias_m` the 1-sigma of its slow error. `nose_rad` is a recorded heading, `speed_mps` a
    signed speed. `turned_rad` [n - 1] is the gyro's integral from node to node, `seen` [n - 1]
    whether the way to the next node is short enough to be known; `standing` marks nodes at rest.

    `step_nodes` [s, 2] are the start and the end of relative motions, `step` [s, 3] = forward,
    right (metres in the vehicle frame at the start) and clockwise turn (rad), `step_sigma`
    [s, 2] the sigma of way and turn.
    """

    time_s: _Float64
    fix_m: _Float64
    fix_sigma_m: _Float64
    fix_bias_m: _Float64
    nose_rad: _Float64
    nose_sigma_rad: _Float64
    speed_mps: _Float64
    speed_sigma_mps: _Float64
    turned_rad: _Float64
    seen: npt.NDArray[np.bool_]
    standing: npt.NDArray[np.bool_]
    step_nodes: npt.NDArray[np.int64]
    step: _Float64
    step_sigma: _Float64


class Smoothed(NamedTuple):
    """The estimate at n nodes: `state` [n, 8] as in :mod:`fieldgrid.smoother.model`.

    `position_sigma_m` is absolute, `relative_sigma_m` that within the receiver's own frame:
    without the slow error that shifts neighbours alike. Both are 1-sigma along one axis.
    `fix_off_m` and `step_off_m` are how far fixes and steps lie from the estimate.
    """

    state: _Float64
    position_sigma_m: _Float64
    relative_sigma_m: _Float64
    heading_sigma_rad: _Float64
    fix_off_m: _Float64
    step_off: _Float64
    rounds: int


def smooth(
    seen: Sightings,
    start: _Float64,
    lever_m: tuple[float, float] = (0.0, 0.0),
    step_ahead_m: float = 0.0,
) -> Smoothed:
    """The likeliest drive from a first guess `start` [n, 8] that has its gears right.

    `lever_m` is the antenna's place (right, ahead) and `step_ahead_m` that of the point whose
    motion the steps tell, from the middle of the axle that does not steer. The same input
    gives the same bits.
    """
    x = start.copy()
    lever = np.array(lever_m)
    weights = _Weights(
        _squared_inverse(seen.fix_sigma_m),
        _squared_inverse(seen.nose_sigma_rad),
        _squared_inverse(seen.speed_sigma_mps),
        1.0 / seen.step_sigma**2,
    )
    now, rounds = weights, 0
    for rounds in range(1, MOST_ROUNDS + 1):
        band, right, off = _normal_equations(seen, x, now, lever, step_ahead_m)
        change = solve(factor(band), right).reshape(x.shape)
        # A first guess may be far off: no node turns by more than a radian a round.
        x += change / max(1.0, float(np.abs(change[:, model.PHI]).max()))
        moved_m = float(np.abs(change[:, : model.PHI]).max())
        if rounds > 2 and moved_m < ENOUGH_M and np.abs(change[:, model.PHI]).max() < ENOUGH_RAD:
            break
        now = _robust(weights, off)
    band, _, off = _normal_equations(seen, x, now, lever, step_ahead_m)
    return _with_sigmas(x, inverse_blocks(factor(band), model.STATES), seen, off, rounds)


class _Weights(NamedTuple):
    fix: _Float64
    nose: _Float64
    speed: _Float64
    step: _Float64


class _Off(NamedTuple):
    fix_m: _Float64
    nose_rad: _Float64
    speed_mps: _Float64
    step: _Float64


def _squared_inverse(sigma: _Float64) -> _Float64:
    return np.where(np.isnan(sigma), 0.0, 1.0 / np.where(np.isnan(sigma), 1.0, sigma) ** 2)


def _normal_equations(
    seen: Sightings, x: _Float64, weights: _Weights, lever: _Float64, step_ahead_m: float
) -> tuple[_Float64, _Float64, _Off]:
    """The banded matrix, the right side, and how far each sighting is off."""
    reach = int(np.diff(seen.step_nodes).max()) if len(seen.step_nodes) else 1
    band = np.zeros((model.STATES * (reach + 1), x.size))
    right = np.zeros(x.size)
    step_s = np.diff(seen.time_s)
    model.add_start(band, right, x, 0)
    model.add_motion(band, right, x, step_s, seen.turned_rad, seen.seen, seen.standing)
    still = np.where(seen.standing, 1.0 / model.STANDING_MPS**2, 0.0)
    model.add_values(band, right, x, model.V, np.zeros(len(x)), still)
    off = _Off(
        model.add_fixes(band, right, x, seen.fix_m, seen.fix_bias_m, weights.fix, lever),
        model.add_values(band, right, x, model.PHI, seen.nose_rad, weights.nose),
        model.add_values(band, right, x, model.V, seen.speed_mps, weights.speed),
        model.add_steps(band, right, x, seen.step_nodes, seen.step, weights.step, step_ahead_m),
    )
    return band, right, off


def _robust(weights: _Weights, off: _Off) -> _Weights:
    """Student's weights for the next round; 1 sigma off costs nothing, 10 nearly everything."""

    def less(weight: _Float64, squared: _Float64, size: int) -> _Float64:
        share = (OUTLIER_FREEDOM + size) / (OUTLIER_FREEDOM + weight * squared)
        return weight * np.minimum(share, 1.0)

    way = less(weights.step[:, 0], (off.step[:, :2] ** 2).sum(axis=1), 2)
    return _Weights(
        less(weights.fix, off.fix_m**2, 2),
        less(weights.nose, off.nose_rad**2, 1),
        less(weights.speed, off.speed_mps**2, 1),
        np.stack([way, less(weights.step[:, 1], off.step[:, 2] ** 2, 1)], axis=1),
    )


def _with_sigmas(
    x: _Float64, blocks: _Float64, seen: Sightings, off: _Off, rounds: int
) -> Smoothed:
    east, north, phi = model.E, model.N, model.PHI
    b = np.nan_to_num(seen.fix_bias_m)
    relative = sum(
        blocks[:, axis, axis] + 2.0 * b * blocks[:, axis, bias] + b**2 * blocks[:, bias, bias]
        for axis, bias in ((east, model.BIAS_E), (north, model.BIAS_N))
    )
    return Smoothed(
        x,
        np.sqrt((blocks[:, east, east] + blocks[:, north, north]) / 2.0),
        np.sqrt(np.maximum(relative, 0.0) / 2.0),
        np.sqrt(blocks[:, phi, phi]),
        off.fix_m,
        off.step,
        rounds,
    )
