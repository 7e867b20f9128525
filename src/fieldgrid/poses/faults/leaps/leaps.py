"""Steps between fixes that the motion before and after them does not make."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64

HOLE_S, HOLE_PERIODS = 2.0, 2.5
"""Longer without a fix, and over this number of a receiver's periods, a vehicle may have stopped
and turned back unseen."""

TORN_S, TORN_SIGMAS, TORN_MPS2 = 2.0, 15.0, 1.0
"""Between two fixes the positions have jumped when the step differs by more than this many sigmas
of their noise, the way that the pace makes in it, and what a vehicle gains by speeding up, from the
velocities over so long before and after it."""

DISPUTED_SHARE = 0.6
"""Where fixes in between were refused for how they lie, this share of the pace's way is enough."""


class Leaps(NamedTuple):
    """Of the steps [n - 1] between fixes: `hole`, which are too long to be known; `off_m`
    [n - 1, 2], how far east and north of where the motion leads each ends; and `free_m`, how much
    of that a vehicle, and noise, may do."""

    hole: Bool
    off_m: Float64
    free_m: Float64

    @property
    def torn(self) -> Bool:
        """The steps, but for holes, that are more."""
        return np.asarray((np.hypot(*self.off_m.T) > self.free_m) & ~self.hole)


def leaps(
    points_m: Float64, time_s: Float64, noise_m: Float64, disputed: Bool, least_m: float
) -> Leaps:
    """How n fixes [n, 2] with noise `noise_m` [n] follow each other; `disputed` [n] marks those
    that one side of the step to them denies. What is less than `least_m` is no leap."""
    n, step_s = len(points_m), np.diff(time_s)
    if n < 2:
        return Leaps(np.zeros(0, dtype=np.bool_), np.zeros((0, 2)), np.zeros(0))
    row = np.arange(n)
    before = np.minimum(np.searchsorted(time_s, time_s - TORN_S), np.maximum(row - 1, 0))
    after = np.maximum(
        np.searchsorted(time_s, time_s + TORN_S, side="right") - 1, np.minimum(row + 1, n - 1)
    )
    came, left = (
        (points_m[to] - points_m[of]) / np.maximum(time_s[to] - time_s[of], 1e-3)[:, None]
        for of, to in ((before, row), (row, after))
    )
    usual_m = (came[:-1] + left[1:]) / 2.0 * step_s[:, None]
    pace_mps = np.maximum(np.hypot(*came[:-1].T), np.hypot(*left[1:].T))
    free_m = np.maximum(least_m, TORN_SIGMAS * np.maximum(noise_m[1:], noise_m[:-1]))
    way_m = pace_mps * step_s
    free_m += np.where(disputed[1:], DISPUTED_SHARE * way_m, way_m + TORN_MPS2 * step_s**2)
    return Leaps(holes(step_s), np.diff(points_m, axis=0) - usual_m, free_m)


def usual_period_s(step_s: Float64) -> float:
    """The period of a receiver that took fixes at such steps; where many are missing, half of the
    steps may be holes."""
    return float(np.percentile(step_s, 25)) if len(step_s) else 1.0


def holes(step_s: Float64) -> Bool:
    """Which steps between fixes last long enough for a vehicle to turn back unseen."""
    return np.asarray(step_s > max(HOLE_S, HOLE_PERIODS * usual_period_s(step_s)))
