"""All drives at once: the shifts, turns and slow errors that fit what pairs of submaps say.

Least squares over the shift of each submap and the turn of each drive. A shift has a share of the
whole drive, whose prior is the receiver's stated sigma with the heavy tails of Student's
distribution (receivers may be wrong, but the better one is believed), and a share that wanders
(Gauss-Markov, `WANDER_S`). Matches that contradict the rest lose their weight the same way.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu

from fieldgrid.align.drives import Drive, Role
from fieldgrid.array_types import Float64, Int64
from fieldgrid.mapfile import Transform
from fieldgrid.mapfile.transform import Wander

WANDER_S = 300.0
"""A receiver's slow error changes over some minutes."""

MOST_TURN_SIGMA_DEG = 0.5
"""What a receiver errs from one end of a drive to the other turns it, and a short one no more."""

COMMON_SIGMA_M, ALIKE = 0.03, 10
"""What all matches of two drives have in common, such as a mount that is a little off: this much,
in so many neighbouring matches."""

MATCH_TURN_SIGMA_DEG, COMMON_TURN_SIGMA_DEG = 0.25, 0.05
"""The same of turns: headings within a submap, and a slow error that bends it meanwhile, which a
turn of the picture cannot be told from; and what all submaps have in common."""

FACE_M, FACE_SIGMA_M = 0.07, 0.05
"""What is seen of a row from one lane and from the other agrees best so far apart. Either face
looks 6 to 11 cm off the middle, but posts, stems and tops, which both see, stand in one place."""

VIEW_M, VIEW_SIGMA_M = 0.05, 0.04
"""What is seen of a plant or a post lies on the side of the one who looks, by about so much."""

MATCH_SIGMA_M = 0.03
"""What poses within a submap, and cells, add to the error of a match."""

SCATTER_M = 0.09
"""The shifts that matches tell of drives that lie where they should: canopies that grew, other
faces, other views."""

OTHER_SIDE_SIGMA_M = 0.3
"""And along a row of which the two saw opposite faces, which are of other leaves."""

FREEDOM = 4.0
"""Degrees of freedom of Student's distribution, of priors and matches."""

ROUNDS = 20

MEDIAN_OF_TWO = 1.386
"""The median of chi squared of two degrees of freedom."""

HELD_M, LEAST_WANDER_M, LOOSE = 1e-4, 0.001, 10.0


def turn_sigma_deg(drive: Drive) -> float:
    """By how much the receiver may have turned a drive as a whole."""
    return min(float(np.degrees(drive.sigma_m / drive.half_length_m)), MOST_TURN_SIGMA_DEG)


class Match(NamedTuple):
    """Submap `l` of drive `b` lies `shift_m` [2] from where submap `k` of drive `a` has it, with
    the information [2, 2], and is to be turned by `turn_deg` clockwise, with the information
    1/degrees² (0: not told); the others as in `Pair`."""

    a: int
    k: int
    b: int
    l: int  # noqa: E741
    at_m: Float64
    across: Float64
    facing: Float64
    share: float
    shift_m: Float64
    information: Float64
    turn_deg: float = 0.0
    turn_information: float = 0.0


class Solution(NamedTuple):
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
    drives: Sequence[Drive],
    now: Sequence[Transform],
    matches: Sequence[Match],
) -> Solution:
    """The transforms that fit matches, which were made with drives placed by the transforms `now`.
    Only drives that move get another; with the others it is told how wrong they may be."""
    offsets = np.cumsum([0, *(3 + 2 * len(drive.submaps) for drive in drives)])
    face = int(offsets[-1])
    start = np.zeros(face + 2)
    for drive, transform, at in zip(drives, now, offsets, strict=False):
        start[at : at + 3] = _shift_and_turn(drive, transform)
        if transform.wander is not None:
            wander = np.column_stack(transform.wander.at(drive.time_ns))
            start[at + 3 : at + 3 + wander.size] = wander.ravel()
    start[face:] = FACE_M, VIEW_M
    x, misfit = start.copy(), np.zeros(len(matches))
    alike = Counter((match.a, match.b) for match in matches)
    rows = [_row(drives, offsets, start, match, alike[match.a, match.b]) for match in matches]
    turns = list(_turn_rows(offsets, start, matches, alike))
    for number in range(ROUNDS):
        # At first the matches are believed, so that a receiver that is far off is told as such.
        normal, side = _priors(drives, offsets, start, x, LOOSE if number == 0 else 1.0)
        misfit = np.array([row.misfit(x) for row in rows])
        weights = _student(misfit**2, 2.0) if number else np.ones(len(rows))
        for row, weight in zip(rows, weights, strict=True):
            normal.add(row.columns, weight * row.jacobian.T @ row.information @ row.jacobian)
            side[row.columns] += weight * row.jacobian.T @ row.information @ row.target
        for columns, target, information in turns:
            weight = _student(information * (x[columns[1]] - x[columns[0]] - target) ** 2, 1.0)
            block = weight * information * np.array([[1.0, -1.0], [-1.0, 1.0]])
            normal.add(columns, block)
            side[columns] += weight * information * target * np.array([-1.0, 1.0])
        factor = splu(normal.matrix(face + 2))
        before, x = x, factor.solve(side)
        if number and np.abs(x - before).max() < 1e-5:
            break
    # Where matches scatter by more than they say, all is less sure.
    factor_of_sigma = (
        max(float(np.sqrt(np.median(misfit**2) / MEDIAN_OF_TWO)), 1.0) if rows else 1.0
    )
    picked = np.zeros((face + 2, 3 * len(drives)))
    for n, (drive, at) in enumerate(zip(drives, offsets, strict=False)):
        count = len(drive.submaps)
        for axis in (0, 1):
            picked[at + axis, 3 * n + axis] = 1.0
            picked[at + 3 + axis : at + 3 + 2 * count : 2, 3 * n + axis] = 1.0 / count
        picked[at + 2, 3 * n + 2] = 1.0
    covariance = picked.T @ factor.solve(picked) * factor_of_sigma**2
    return Solution(
        tuple(
            _transform(drive, transform, x[at : at + 3 + 2 * len(drive.submaps)])
            for drive, transform, at in zip(drives, now, offsets, strict=False)
        ),
        _shift_sigmas(covariance, len(drives)),
        np.degrees(np.sqrt(covariance.diagonal()[2::3])),
        float(x[face]),
        float(x[face + 1]),
        np.array([row.left_m(x) for row in rows]).reshape(-1, 2),
        misfit,
    )


def _turn_rows(
    offsets: Int64, start: Float64, matches: Sequence[Match], alike: Mapping[tuple[int, int], int]
) -> Iterator[tuple[Int64, float, float]]:
    """Of each match that tells a turn: the unknown turns of `a` and `b`, their difference in
    radians, and its information."""
    for match in matches:
        if match.turn_information > 0.0 and match.a != match.b:
            columns = np.array([offsets[match.a] + 2, offsets[match.b] + 2])
            common = min(alike[match.a, match.b], ALIKE) * COMMON_TURN_SIGMA_DEG**2
            variance = 1.0 / match.turn_information + MATCH_TURN_SIGMA_DEG**2 + common
            target = start[columns[1]] - start[columns[0]] + np.radians(match.turn_deg)
            yield columns, float(target), float(np.degrees(1.0) ** 2 / variance)


def _student(misfit_squared: npt.ArrayLike, dimensions: float) -> Float64:
    """The weights by which least squares follow Student's distribution, at most 1."""
    weight = (FREEDOM + dimensions) / (FREEDOM + np.asarray(misfit_squared, np.float64))
    return np.minimum(weight, 1.0)


class _Normal:
    """A sparse normal matrix, block by block."""

    def __init__(self) -> None:
        self._blocks: list[tuple[Int64, Float64]] = []

    def add(self, columns: Int64, block: Float64) -> None:
        """Add a dense symmetric block on some of the unknowns."""
        self._blocks.append((columns, block))

    def matrix(self, size: int) -> sparse.csc_matrix:
        """The sum of the blocks."""
        rows = np.concatenate([np.repeat(c, len(c)) for c, _ in self._blocks])
        columns = np.concatenate([np.tile(c, len(c)) for c, _ in self._blocks])
        values = np.concatenate([block.ravel() for _, block in self._blocks])
        return sparse.coo_matrix((values, (rows, columns)), (size, size)).tocsc()


def _priors(
    drives: Sequence[Drive],
    offsets: Int64,
    start: Float64,
    x: Float64,
    loose: float,
) -> tuple[_Normal, Float64]:
    """What is known before any match: the stated errors of receivers, as far as they are in
    keeping with the present estimate; of shifts and turns times `loose`."""
    normal, side = _Normal(), np.zeros(len(x))
    for drive, at in zip(drives, offsets, strict=False):
        every = np.arange(at, at + 3 + 2 * len(drive.submaps))
        # What moves was driven without a transform; what does not is taken to be where it lies.
        rest = np.zeros(len(every)) if drive.role is Role.MOVES else start[every]
        if drive.role is Role.HOLDS:
            block = np.eye(len(every)) / HELD_M**2
        else:
            block = _prior(drive, x[every] - rest, loose)
        normal.add(every, block)
        side[every] += block @ rest
    both = np.arange(len(x) - 2, len(x))
    normal.add(both, np.diag([FACE_SIGMA_M**-2, VIEW_SIGMA_M**-2]))
    side[both] += FACE_M / FACE_SIGMA_M**2, VIEW_M / VIEW_SIGMA_M**2
    return normal, side


def _prior(drive: Drive, off: Float64, loose: float) -> Float64:
    """The information of shift, turn and wander of a drive that is `off` where it is expected."""
    sigma_m, sigma = loose * drive.sigma_m, loose * np.radians(turn_sigma_deg(drive))
    block = np.zeros((len(off), len(off)))
    shift = np.eye(2) / sigma_m**2
    block[:2, :2] = shift * _student(off[:2] @ shift @ off[:2], 2.0)
    block[2, 2] = _student((off[2] / sigma) ** 2, 1.0) / sigma**2
    # The Gauss-Markov chain of the wander, whose first shift may be any that is usual.
    fading = np.exp(-np.diff(drive.time_ns) / 1e9 / WANDER_S)
    usual = drive.wander_m**2
    information = 1.0 / (usual * np.concatenate([[1.0], np.maximum(1.0 - fading**2, 1e-6)]))
    knots = off[3:].reshape(-1, 2)
    steps = knots - np.vstack([np.zeros(2), fading[:, None] * knots[:-1]])
    chain = np.diag(information)
    chain[:-1, :-1] += np.diag(information[1:] * fading**2)
    chain -= np.diag(information[1:] * fading, 1) + np.diag(information[1:] * fading, -1)
    # One scale for all of them: a receiver that wanders more than it says does so throughout.
    weight = _student(float((steps**2 * information[:, None]).sum()), float(steps.size))
    for axis in (0, 1):
        block[3 + axis :: 2, 3 + axis :: 2] = weight * chain
    return block


class _Row(NamedTuple):
    """A match, linear in the unknowns: jacobian [2, n] · x[columns] = target [2]."""

    columns: Int64
    jacobian: Float64
    target: Float64
    information: Float64

    def left_m(self, x: Float64) -> Float64:
        """The residual [2]."""
        return np.asarray(self.target - self.jacobian @ x[self.columns])

    def misfit(self, x: Float64) -> float:
        """The normalised residual."""
        off = self.left_m(x)
        return math.sqrt(max(float(off @ self.information @ off), 0.0))


def _row(drives: Sequence[Drive], offsets: Int64, start: Float64, match: Match, alike: int) -> _Row:
    """What the place of a match is moved by on one side, less that on the other, makes up for the
    shift that was found, but for what is due to the sides from which they looked."""
    columns = [len(start) - 2, len(start) - 1]
    blocks = [match.across[:, None], match.facing[:, None]]
    target = match.shift_m.copy()
    for sign, n, k in ((1.0, match.a, match.k), (-1.0, match.b, match.l)):
        at = int(offsets[n])
        shift, turn = start[at : at + 2], start[at + 2]
        wander = start[at + 3 + 2 * k : at + 5 + 2 * k]
        from_pivot = match.at_m - shift - wander - drives[n].pivot_m  # as driven, turned
        by_turn = np.array([[from_pivot[1]], [-from_pivot[0]]])
        for first, block in (
            (at, np.eye(2)), (at + 2, by_turn), (at + 3 + 2 * k, np.eye(2)),
        ):  # fmt: skip
            columns.extend(range(first, first + block.shape[1]))
            blocks.append(sign * block)
        target += sign * (shift + wander + by_turn[:, 0] * turn)
    # A submap may be matched with another of its drive: the same unknown twice.
    found, where = np.unique(columns, return_inverse=True)
    jacobian = np.zeros((2, len(found)))
    for column, values in zip(where, np.hstack(blocks).T, strict=True):
        jacobian[:, column] += values
    return _Row(found, jacobian, target, information_of(match, alike))


def information_of(match: Match, alike: int) -> Float64:
    """What a match tells of the shift [2, 2], with all that may be wrong with it, as one of so
    many that are `alike`."""
    noise = (MATCH_SIGMA_M**2 + min(alike, ALIKE) * COMMON_SIGMA_M**2) * np.eye(2)
    if match.across.any():
        noise += OTHER_SIDE_SIGMA_M**2 * (np.eye(2) - np.outer(match.across, match.across))
    told = match.information @ np.linalg.inv(np.eye(2) + noise @ match.information)
    return (told + told.T) / 2.0


def left_between(matches: Sequence[Match], solution: Solution) -> dict[tuple[int, int], float]:
    """What is left of the shifts of matches between each two drives, root mean square, as far as
    each match tells it, beyond what matches scatter by."""
    squared, told = (defaultdict[tuple[int, int], float](float) for _ in range(2))
    for match, left in zip(matches, solution.left_m, strict=True):
        if match.a != match.b:
            information = information_of(match, 1)
            squared[match.a, match.b] += float(left @ information @ left)
            told[match.a, match.b] += float(np.trace(information)) / 2.0
    return {
        pair: math.sqrt(max(squared[pair] / told[pair] - SCATTER_M**2, 0.0))
        for pair in squared
        if told[pair] > 0.0
    }


def _shift_and_turn(drive: Drive, transform: Transform) -> Float64:
    """Shift of the drive's pivot and turn (radians) of a transform, whatever pivot it has."""
    east_m, north_m = drive.pivot_m
    east, north = replace(transform, wander=None).points(east_m, north_m, 0)
    return np.array([east - east_m, north - north_m, np.radians(transform.turn_deg)])


def _transform(drive: Drive, now: Transform, x: Float64) -> Transform:
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
