"""All drives at once: the shifts, turns and slow errors that fit what pairs of submaps say.

Least squares over the shift of each submap and the turn of each drive. A shift has a share of the
whole drive, whose prior is the receiver's stated sigma with the heavy tails of Student's
distribution (receivers may be wrong, but the better one is believed), and a share that wanders
(Gauss-Markov, `WANDER_S`). Matches that contradict the rest lose their weight the same way.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from fieldgrid.core import Float64, Int64
from fieldgrid.field.align.disagreement import MEDIAN_OF_TWO, between_camps, undecided
from fieldgrid.field.align.drives import Role, SubmapDrive
from fieldgrid.field.align.matches import (
    Equations,
    Match,
    information_of,
    shift_equations,
    turn_equations,
)
from fieldgrid.maps import Transform, Wander

WANDER_S = 300.0
"""A receiver's slow error changes over some minutes."""

MOST_TURN_SIGMA_DEG = 0.5
"""What a receiver errs from one end of a drive to the other turns it, and a short one no more."""

FACE_M, FACE_SIGMA_M = 0.07, 0.05
"""Distance at which the faces of a row agree best when they are seen from two lanes, and its
standard deviation. Either face is 6 to 11 cm off the middle, but posts, stems and tops, which both
see, stand in one place."""

VIEW_M, VIEW_SIGMA_M = 0.05, 0.04
"""A plant or a post is seen nearer to the vehicle than it is by this distance; with its standard
deviation."""

FREEDOM = 4.0
"""Degrees of freedom of Student's distribution, of priors and matches."""

ROUNDS = 20

HELD_M, LEAST_WANDER_M, LOOSE = 1e-4, 0.001, 10.0


def turn_sigma_deg(drive: SubmapDrive) -> float:
    """The standard deviation, in degrees, of the turn of a drive as a whole by its receiver's
    error."""
    return min(float(np.degrees(drive.sigma_m / drive.half_length_m)), MOST_TURN_SIGMA_DEG)


class NetworkSolution(NamedTuple):
    """What fits, of each drive: the transforms; the 1-sigma errors [n, n] of the shift of one
    against that of another (along the worse axis; on the diagonal: of itself); those of the turns
    in degrees [n]. `face_m` lies between the faces of a row, `view_m` is how much nearer all looks
    than it is; `left_m` [m, 2] is what remains of the shift of each match, `misfit` [m] that by its
    error."""

    transforms: tuple[Transform, ...]
    sigma_m: Float64
    turn_sigma_deg: Float64
    face_m: float
    view_m: float
    left_m: Float64
    misfit: Float64


def solve(
    drives: Sequence[SubmapDrive],
    now: Sequence[Transform],
    matches: Sequence[Match],
) -> NetworkSolution:
    """The transforms that fit matches, which were made with drives placed by the transforms `now`.
    Only drives that move get another; with the others it is told how wrong they may be."""
    offsets = np.cumsum([0, *(3 + 2 * len(drive.submaps) for drive in drives)])
    face = int(offsets[-1])
    start = np.zeros(face + 2)
    for drive, transform, at in zip(drives, now, offsets, strict=False):
        # Shift of the drive's pivot and turn (radians), whatever pivot the transform has.
        east_m, north_m = drive.pivot_m
        east, north = replace(transform, wander=None).points(east_m, north_m, 0)
        start[at : at + 3] = east - east_m, north - north_m, np.radians(transform.turn_deg)
        if transform.wander is not None:
            wander = np.column_stack(transform.wander.at(drive.time_ns))
            start[at + 3 : at + 3 + wander.size] = wander.ravel()
    start[face:] = FACE_M, VIEW_M
    x, misfit = start.copy(), np.zeros(len(matches))
    counts = Counter((match.a, match.b) for match in matches)
    alike = [counts[match.a, match.b] for match in matches]
    shifts_m = shift_equations(drives, offsets, start, matches)
    information = information_of(matches, alike)
    shifts = shifts_m.by_error(information)
    turns = turn_equations(offsets, start, matches, alike)
    for number in range(ROUNDS):
        # At first the matches are believed, so that a receiver that is far off is told as such.
        prior = _priors(drives, offsets, start, x, LOOSE if number == 0 else 1.0)
        misfit = np.hypot(*shifts.left(x).reshape(-1, 2).T)
        weights = _student(misfit**2, 2.0) if number else np.ones(len(misfit))
        told = (shifts, np.repeat(weights, 2)), (turns, _student(turns.left(x) ** 2, 1.0))
        factor, side = _factor(prior, told)
        before, x = x, factor.solve(side)
        if number and np.abs(x - before).max() < 1e-5:
            break
    left_m = shifts_m.left(x).reshape(-1, 2)
    if matches:
        # Matches that scatter by more than they say, or that fall into camps, say less.
        scale = _scale(misfit**2)
        variance = np.array(alike) * between_camps(matches, left_m, information)
        less = np.linalg.inv(scale * np.eye(2) + variance[:, None, None] * information)
        factor, _ = _factor(prior, ((shifts_m.by_error(information @ less), told[0][1]), told[1]))
    picked = np.zeros((face + 2, 3 * len(drives)))
    for n, (drive, at) in enumerate(zip(drives, offsets, strict=False)):
        count = len(drive.submaps)
        for axis in (0, 1):
            picked[at + axis, 3 * n + axis] = 1.0
            picked[at + 3 + axis : at + 3 + 2 * count : 2, 3 * n + axis] = 1.0 / count
        picked[at + 2, 3 * n + 2] = 1.0
    covariance = picked.T @ factor.solve(picked)
    transforms = tuple(
        _transform(drive, transform, x[at : at + 3 + 2 * len(drive.submaps)])
        for drive, transform, at in zip(drives, now, offsets, strict=False)
    )
    return NetworkSolution(
        transforms,
        np.maximum(
            _shift_sigmas(covariance, len(drives)),
            undecided(drives, transforms, matches, left_m, information),
        ),
        np.degrees(np.sqrt(covariance.diagonal()[2::3])),
        float(x[face]),
        float(x[face + 1]),
        left_m,
        misfit,
    )


def _factor(
    prior: tuple[sparse.csr_array, Float64], told: Sequence[tuple[Equations, Float64]]
) -> tuple[SuperLU, Float64]:
    """The normal equations, factored, and their other side, of what is known before and of
    equations with their weights."""
    normal, side = prior
    for equations, weights in told:
        weighted = equations.jacobian.T.multiply(weights)
        normal = normal + weighted @ equations.jacobian
        side = side + weighted @ equations.target
    return splu(normal.tocsc(), "MMD_AT_PLUS_A", options={"SymmetricMode": True}), side


def _student(misfit_squared: npt.ArrayLike, dimensions: float) -> Float64:
    """The weights by which least squares follow Student's distribution, at most 1."""
    weight = (FREEDOM + dimensions) / (FREEDOM + np.asarray(misfit_squared, np.float64))
    return np.minimum(weight, 1.0)


def _scale(misfit_squared: Float64) -> float:
    """By how much variances of two dimensions exceed what is stated, at least 1: the median."""
    return max(float(np.median(misfit_squared)) / MEDIAN_OF_TWO, 1.0)


def _priors(
    drives: Sequence[SubmapDrive],
    offsets: Int64,
    start: Float64,
    x: Float64,
    loose: float,
) -> tuple[sparse.csr_array, Float64]:
    """What is known before any match: the stated errors of receivers, as far as they are in
    keeping with the present estimate; of shifts and turns times `loose`."""
    blocks, side = [], np.zeros(len(x))
    for drive, at in zip(drives, offsets, strict=False):
        every = np.arange(at, at + 3 + 2 * len(drive.submaps))
        # What moves was driven without a transform; what does not is taken to be where it lies.
        rest = np.zeros(len(every)) if drive.role is Role.MOVES else start[every]
        if drive.role is Role.HOLDS:
            block = np.eye(len(every)) / HELD_M**2
        else:
            block = _prior(drive, x[every] - rest, loose)
        blocks.append(sparse.csr_array(block))
        side[every] = block @ rest
    of_sides = np.array([FACE_SIGMA_M, VIEW_SIGMA_M]) ** -2
    side[-2:] = of_sides * (FACE_M, VIEW_M)
    return sparse.block_diag([*blocks, sparse.diags_array(of_sides)], "csr"), side


def _prior(drive: SubmapDrive, off: Float64, loose: float) -> Float64:
    """The information of shift, turn and wander of a drive that is `off` where it is expected."""
    sigma_m, sigma = loose * drive.sigma_m, loose * np.radians(turn_sigma_deg(drive))
    block = np.zeros((len(off), len(off)))
    shift = np.eye(2) / sigma_m**2
    block[:2, :2] = shift * _student(off[:2] @ shift @ off[:2], 2.0)
    block[2, 2] = _student((off[2] / sigma) ** 2, 1.0) / sigma**2
    # The wander, whose first shift may be any that is usual.
    chain = wander_chain(drive.time_ns, (loose * drive.wander_m) ** 2)
    knots = off[3:].reshape(-1, 2)
    steps = knots - np.vstack([np.zeros(2), chain.fading[:, None] * knots[:-1]])
    # One scale for all of them: a receiver that wanders more than it says does so throughout.
    scale = _scale((steps**2).sum(axis=1) * chain.information)
    of_wander = np.diag(chain.diagonal) + np.diag(chain.beside, 1) + np.diag(chain.beside, -1)
    for axis in (0, 1):
        block[3 + axis :: 2, 3 + axis :: 2] = of_wander / scale
    return block


class WanderChain(NamedTuple):
    """A Gauss-Markov chain: each value is the one before it times `fading` [n - 1] and a step of
    the `information` [n], the first one a step from 0."""

    fading: Float64
    information: Float64

    @property
    def diagonal(self) -> Float64:
        """That of the inverse covariance of the values [n]."""
        return np.asarray(self.information + np.append(self.information[1:] * self.fading**2, 0.0))

    @property
    def beside(self) -> Float64:
        """What lies beside its diagonal [n - 1]; all else is 0."""
        return np.asarray(-self.information[1:] * self.fading)


def wander_chain(time_ns: Int64, variance: float) -> WanderChain:
    """What a slow error of some variance at each time may change by from time to time."""
    fading = np.exp(-np.diff(time_ns) / 1e9 / WANDER_S)
    return WanderChain(
        fading, 1.0 / (variance * np.concatenate([[1.0], np.maximum(1.0 - fading**2, 1e-6)]))
    )


def _transform(drive: SubmapDrive, now: Transform, x: Float64) -> Transform:
    if drive.role is not Role.MOVES:
        return now
    wander = x[3:].reshape(-1, 2)
    mean = wander.mean(axis=0)
    wander = wander - mean
    # What is less than a millimetre moves nothing.
    wanders = len(wander) > 1 and float(np.abs(wander).max()) > LEAST_WANDER_M
    return Transform(
        float(x[0] + mean[0]),
        float(x[1] + mean[1]),
        float(np.degrees(x[2])),
        float(drive.pivot_m[0]),
        float(drive.pivot_m[1]),
        Wander(
            tuple(int(t) for t in drive.time_ns), tuple(wander[:, 0].tolist()),
            tuple(wander[:, 1].tolist()),
        ) if wanders else None,
    )  # fmt: skip


def _shift_sigmas(covariance: Float64, count: int) -> Float64:
    """The errors of shifts against each other, along the worse axis [count, count]."""

    def block(m: int, n: int) -> Float64:
        return covariance[3 * m : 3 * m + 2, 3 * n : 3 * n + 2]

    sigmas = np.zeros((count, count))
    for m in range(count):
        for n in range(count):
            both = block(m, m)
            if m != n:
                both = both + block(n, n) - block(m, n) - block(n, m)
            sigmas[m, n] = math.sqrt(max(float(np.linalg.eigvalsh(both)[-1]), 0.0))
    return sigmas
