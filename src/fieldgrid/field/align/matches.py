"""What pairs of submaps say of the shifts and turns of their drives, as linear equations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import sparse

from fieldgrid.core import Float64, Int64
from fieldgrid.field.align.drives import SubmapDrive

COMMON_SIGMA_M, ALIKE = 0.03, 10
"""The error that all matches of two drives have in common, such as a mount that is a little off,
and the number of neighbouring matches that share it."""

MATCH_TURN_SIGMA_DEG, COMMON_TURN_SIGMA_DEG = 0.25, 0.05
"""Errors of turns: of one match, from headings within a submap and from a slow error that bends it,
which cannot be told from a turn of the picture; and the error that all submaps have in common."""

MATCH_SIGMA_M = 0.03
"""What poses within a submap, and cells, add to the error of a match."""

OTHER_SIDE_SIGMA_M = 0.3
"""And along a row of which the two saw opposite faces, which are of other leaves."""


class Match(NamedTuple):
    """Submap `l` of drive `b` lies `shift_m` [2] from where submap `k` of drive `a` has it, with
    the information [2, 2], and is to be turned by `turn_deg` clockwise, with the information
    1/degrees² (0: not told); the others as in `Pair`."""

    a: int
    k: int
    b: int
    l: int  # noqa: E741 - the letter after k
    at_m: Float64
    across: Float64
    facing: Float64
    share: float
    shift_m: Float64
    information: Float64
    turn_deg: float = 0.0
    turn_information: float = 0.0


class Equations(NamedTuple):
    """Linear in the unknowns: jacobian [n, unknowns] · x = target [n]."""

    jacobian: sparse.csr_array
    target: Float64

    def left(self, x: Float64) -> Float64:
        """The residuals [n]."""
        return np.asarray(self.target - self.jacobian @ x)

    def by_error(self, information: Float64) -> Equations:
        """The equations in units of their errors; `information` [n / 2, 2, 2] is that of each two
        of them."""
        values, axes = np.linalg.eigh(information)
        roots = np.sqrt(np.maximum(values, 0.0))[:, :, None] * axes.swapaxes(1, 2)
        count = len(roots)
        root = sparse.bsr_array(
            (roots, np.arange(count), np.arange(count + 1)), shape=(2 * count, 2 * count)
        )
        return Equations((root @ self.jacobian).tocsr(), root @ self.target)


def information_of(matches: Sequence[Match], alike: Sequence[int]) -> Float64:
    """The information [n, 2, 2] of the shifts of matches, 1/m², less all that may be wrong with
    them. `alike` [n] is the number of matches of the same two drives."""
    across = np.array([match.across for match in matches]).reshape(-1, 2, 1)
    told = np.array([match.information for match in matches]).reshape(-1, 2, 2)
    common = np.minimum(np.array(alike), ALIKE)[:, None, None] * COMMON_SIGMA_M**2
    noise = (MATCH_SIGMA_M**2 + common) * np.eye(2)
    along = np.eye(2) - across * across.swapaxes(1, 2)
    noise += np.where(across.any(axis=1, keepdims=True), OTHER_SIDE_SIGMA_M**2 * along, 0.0)
    told = told @ np.linalg.inv(np.eye(2) + noise @ told)
    return np.asarray((told + told.swapaxes(1, 2)) / 2.0)


def shift_equations(
    drives: Sequence[SubmapDrive], offsets: Int64, start: Float64, matches: Sequence[Match]
) -> Equations:
    """How the place of a match moves with one drive, less how it moves with the other, equals the
    shift that was found, but for what is due to the sides from which they looked: two equations a
    match, east and north.

    The unknowns of drive n begin at `offsets[n]`: shift, turn, the wander of each submap; those of
    the sides are the last two. `start` has them as they were when matches were made.
    """
    count = len(matches)
    a, k, b, l = np.array([match[:4] for match in matches], np.intp).reshape(-1, 4).T  # noqa: E741
    at_m, across, facing, shift_m = (
        np.array([getattr(match, name) for match in matches]).reshape(-1, 2)
        for name in ("at_m", "across", "facing", "shift_m")
    )
    pivots_m = np.array([drive.pivot_m for drive in drives])
    both, axes, ones = np.zeros((count, 2), np.intp), np.arange(2), np.ones((count, 2))
    columns, values = [both + len(start) - 2, both + len(start) - 1], [across, facing]
    target = shift_m.copy()
    for sign, n, part in ((1.0, a, k), (-1.0, b, l)):
        first = offsets[n][:, None]
        shift, turn, wander = first + axes, first + 2, first + 3 + 2 * part[:, None] + axes
        moved_m = start[shift] + start[wander]
        from_pivot_m = at_m - moved_m - pivots_m[n]  # as driven, turned
        by_turn = np.column_stack([from_pivot_m[:, 1], -from_pivot_m[:, 0]])
        columns += [shift, both + turn, wander]
        values += [sign * ones, sign * by_turn, sign * ones]
        target += sign * (moved_m + by_turn * start[turn])
    rows = np.tile(np.arange(2 * count), len(columns))
    # A submap may be matched with another of its drive: the same unknown twice, which adds up.
    where = rows, np.concatenate([one.ravel() for one in columns])
    jacobian = sparse.csr_array(
        (np.concatenate([one.ravel() for one in values]), where), shape=(2 * count, len(start))
    )
    return Equations(jacobian, target.ravel())


def turn_equations(
    offsets: Int64, start: Float64, matches: Sequence[Match], alike: Sequence[int]
) -> Equations:
    """The turn of one drive less that of another, from each match that measures it, in units of
    its error. Unknowns as in :func:`shift_equations`."""
    told = [n for n, one in enumerate(matches) if one.turn_information > 0.0 and one.a != one.b]
    some = [matches[n] for n in told]
    a, b = (offsets[np.array([match[n] for match in some], np.intp)] + 2 for n in (0, 2))
    turn = np.radians([match.turn_deg for match in some])
    common = np.minimum(np.array([alike[n] for n in told]), ALIKE) * COMMON_TURN_SIGMA_DEG**2
    own = 1.0 / np.array([match.turn_information for match in some])
    by_error = 1.0 / np.radians(np.sqrt(own + MATCH_TURN_SIGMA_DEG**2 + common))
    every = np.arange(len(told))
    jacobian = sparse.csr_array(
        (np.concatenate([by_error, -by_error]), (np.tile(every, 2), np.concatenate([b, a]))),
        shape=(len(told), len(start)),
    )
    return Equations(jacobian, by_error * (start[b] - start[a] + turn))
