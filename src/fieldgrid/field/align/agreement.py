"""Where two drives agree as wholes: the shift and turn of one against the other, or a doubt.

Rows repeat. So all shifts within reach are scored by how well a cell agrees, over all pairs of
submaps, and the best is believed only when nothing apart from it comes near.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from fieldgrid.core import Float64
from fieldgrid.field.align.network import FREEDOM
from fieldgrid.field.align.ridge import along_ridge
from fieldgrid.field.align.score import Scores

WEIGHT = 40.0
"""How much the log-posterior falls for shifts whose agreement, a cell, is none beside the best: a
sixth less of it is as bad as `MARGIN`. Not the sum over cells: of two hypotheses the one with more
ground in common, as after a slip by a row, is not the better one."""

MARGIN = 6.0
"""Shifts that are worse than the best by more than this are ruled out."""

APART_M = 0.6
"""Shifts that are not ruled out and lie farther from the best are another answer."""

LEAST_SHARE = 0.08
"""Shifts with a smaller share of the ground in common that others have are not told. It is small,
since after a slip by a row more may coincide than where drives really lie."""

LEAST_AGREEMENT = 0.144
"""Log-likelihood a cell of a correlation of 0.5; drives that agree less have nothing in common."""

BLUR_M = 0.2
"""What receivers wander by meanwhile, at most, within what is scored as one shift."""

MOST_TURN_DEG, TURN_STEP_DEG = 1.6, 0.2


class Agreement(NamedTuple):
    """How drive `b` lies against drive `a`: `shift_m` [2] at `at_m` [2], the middle of the ground
    that they share, `turn_deg` clockwise. `doubt` says why that is not believed, None where it is.

    `score` [n, n] is the log-posterior of shifts `shifts_m` along either axis, at the best turn of
    each, less its maximum; `rivals_m` [m, 2] are other shifts that are not ruled out, `alike_m`
    those that only the stated errors of receivers rule out, as where rows repeat. `along` [2] is
    the unit vector of the way along which nothing is told, and the shift is 0; zero without any.
    """

    a: int
    b: int
    at_m: Float64
    shift_m: Float64
    turn_deg: float
    score: Float64
    shifts_m: Float64
    rivals_m: Float64
    alike_m: Float64
    along: Float64
    doubt: str | None


def agree(
    a: int,
    b: int,
    found: Sequence[Scores],
    places_m: Float64,
    sigma_m: float,
    turn_sigma_deg: float,
    most_m: float,
) -> Agreement:
    """Where drives `a` and `b` agree, from the scores of their pairs of submaps at places [n, 2].

    `sigma_m` is what their receivers leave open between them, `most_m` the largest shift that is
    believed.
    """
    axis, cell_m = found[0].shifts_m, found[0].cell_m
    blur = 2 * round(min(sigma_m, BLUR_M) / cell_m) + 1
    likelihoods = [one.independent * ndimage.maximum_filter(one.by_cell, blur) for one in found]
    away = places_m - places_m.mean(axis=0)
    turns = np.arange(-MOST_TURN_DEG, MOST_TURN_DEG + 1e-9, TURN_STEP_DEG)
    # Turns that move nothing by a quarter of a cell are one.
    extent_m = float(np.hypot(*away.T).max())
    turns = turns if np.radians(MOST_TURN_DEG) * extent_m > cell_m / 4.0 else np.zeros(1)

    # A clockwise turn of b moves it there by turn · (north, -east).
    by = np.radians(turns)[:, None, None] * (away * (1.0, -1.0)) / cell_m

    def together(of_pairs: Sequence[Float64], by: Float64 = by) -> Float64:
        """The sums for each turn, of what its places were moved by: linear between cells."""
        return np.array(
            [
                sum(ndimage.shift(of, to, order=1) for of, to in zip(of_pairs, turn, strict=True))
                for turn in by
            ]
        )

    agreement = together(likelihoods)
    cells = together([one.independent for one in found])
    agreement = np.where(cells > LEAST_SHARE * cells.max(), agreement / np.maximum(cells, 1.0), 0.0)
    # Less its own 1-sigma error: of few cells some agree by chance.
    error = np.sqrt(-np.expm1(-2.0 * agreement) / np.maximum(cells, 1.0))
    agreement = np.maximum(agreement - error, 0.0)
    squared = (axis[:, None] ** 2 + axis[None, :] ** 2) / sigma_m**2
    evidence = WEIGHT * agreement / max(float(agreement.max()), LEAST_AGREEMENT)
    posterior = evidence - (FREEDOM + 2.0) / 2.0 * np.log1p(squared / FREEDOM)
    by_turn = (turns / turn_sigma_deg) ** 2
    posterior -= ((FREEDOM + 1.0) / 2.0 * np.log1p(by_turn / FREEDOM))[:, None, None]
    turn, j, i = np.unravel_index(int(posterior.argmax()), posterior.shape)
    shift = np.array([axis[i], axis[j]])
    score = posterior.max(axis=0) - posterior.max()
    rivals = _rivals(score, axis, shift)
    alike = _rivals(evidence.max(axis=0) - evidence[turn, j, i], axis, shift)
    (sharp,) = together([one.independent * one.by_cell for one in found], by[[turn]])
    along = along_ridge(sharp / np.maximum(cells[turn], 1.0), axis, shift)
    # Of the best shift itself: where rows repeat, the way from row to row may look like a ridge.
    doubt = _doubt(float(agreement[turn, j, i]), shift, rivals, most_m)
    shift = shift - along * (along @ shift)
    return Agreement(
        a, b, places_m.mean(axis=0), shift, float(turns[turn]), score, axis, rivals, alike, along,
        doubt,
    )  # fmt: skip


def _rivals(score: Float64, axis: Float64, shift: Float64) -> Float64:
    """The best of each region that is not ruled out and does not hold the best shift."""
    labels, count = ndimage.label(score > -MARGIN, np.ones((3, 3)))
    rivals = []
    for n in range(1, count + 1):
        j, i = np.unravel_index(int(np.where(labels == n, score, -np.inf).argmax()), score.shape)
        place = np.array([axis[i], axis[j]])
        if np.hypot(*(place - shift)) > APART_M:
            rivals.append(place)
    return np.array(rivals).reshape(-1, 2)


def _doubt(agreement: float, shift: Float64, rivals: Float64, most_m: float) -> str | None:
    """Why a shift is not believed."""
    if agreement < LEAST_AGREEMENT:
        return "what they saw has too little in common"
    if len(rivals):
        every = ", ".join(f"{east:+.1f} {north:+.1f}" for east, north in (shift, *rivals[:3]))
        return f"several shifts fit (metres east, north: {every}), as where rows repeat"
    size = float(np.hypot(*shift))
    if size > most_m:
        return f"they agree best {size:.1f} m away, beyond the {most_m:g} m that --reach allows"
    return None
