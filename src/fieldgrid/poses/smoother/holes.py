"""What a vehicle may do where no fix shows it, and what is expected of it where fixes return.

Holes come at random, so what the fixes show of a drive is a fair sample of it. Within a hole a
vehicle may turn as tightly as it ever does, and at least the usual steering is expected, from the
first moment on; where fixes return, it drives one of the curvatures that the drive shows, and the
fixes themselves tell which of them fit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.poses.faults.leaps.leaps import HOLE_PERIODS, HOLE_S
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.rounds import CurvatureChange

BLIND_S = 0.75
"""Farther in time from every fix, steering is not measured, and any is expected."""

BENDS = 64
"""Number of equal parts of a drive's way into which its curvatures are sorted."""

DOUBT_M = 10.0
"""Length of way, added to that of a drive, on which the usual curvatures are assumed: a short drive
shows few."""

USUAL_FIFTHS = np.array([0.146, 0.394, 0.683, 1.052, 1.803])
"""A normal distribution's absolute values, in sigmas: the root mean squares of its fifths."""


class Unseen(NamedTuple):
    """Steps [n - 1] of a drive on which steering is not measured: `blind` ones are far from every
    fix or in a hole, those in `holes` lie where fixes are missing, also before the first and after
    the last of them, and those `between` in a hole that a fix ends, and whose way is estimated."""

    blind: Bool
    holes: Bool
    between: Bool

    @classmethod
    def of(cls, measured: Measurements) -> Unseen:
        """Those of a drive."""
        fixes_s = measured.time_s[np.isfinite(measured.fix_sigma_m[:, 0])]
        at = np.concatenate([[-np.inf], fixes_s, [np.inf]])  # a stretch may have none
        middle = (measured.time_s[1:] + measured.time_s[:-1]) / 2.0
        last = np.searchsorted(at, middle)
        before, after = at[last - 1], at[last]
        period_s = float(np.percentile(np.diff(fixes_s), 25)) if len(fixes_s) > 1 else 0.0
        holes = after - before > max(HOLE_S, HOLE_PERIODS * period_s)
        between = holes & np.isfinite(after - before) & measured.seen
        blind = (np.minimum(middle - before, after - middle) > BLIND_S) | between
        return cls(blind, holes, between)

    def exits(self) -> Int64:
        """The last step of each hole, unless only one fix lies between it and the next."""
        return np.flatnonzero(self.between[:-1] & ~self.between[1:])


class ShownBends(NamedTuple):
    """The absolute curvatures `bend` [b], 1/m, that a drive shows outside of holes, each on a
    `share` [b] of its way. A part of them is what is usual, a large one in a short drive."""

    bend: Float64
    share: Float64

    @classmethod
    def of(cls, measured: Measurements, x: Float64) -> ShownBends:
        """Those of the states [n, 8] of a drive."""
        way_m = seen_way_m(measured, x)
        way_m[Unseen.of(measured).holes] = 0.0
        bend = np.abs(x[1:, model.KAPPA] + x[:-1, model.KAPPA]) / 2.0
        usual = cls.usual()
        order = np.argsort(bend)
        passed_m = np.cumsum(way_m[order])
        total_m = float(passed_m[-1])
        part = np.minimum(passed_m / max(total_m, 1e-9) * BENDS, BENDS - 1.0).astype(np.int64)
        in_part_m = np.bincount(part, way_m[order], BENDS)
        squared = np.bincount(part, way_m[order] * bend[order] ** 2, BENDS)
        shown = in_part_m > 0.0
        mean = np.sqrt(squared[shown] / in_part_m[shown])
        share_m = np.concatenate([in_part_m[shown], DOUBT_M * usual.share])
        return cls(np.concatenate([mean, usual.bend]), share_m / (total_m + DOUBT_M))

    @classmethod
    def usual(cls) -> ShownBends:
        """Those of a drive that shows none."""
        bend = model.CURVATURE_SIGMA * USUAL_FIFTHS
        return cls(bend, np.full(len(bend), 1.0 / len(bend)))

    def expected_squared(self, precision: Float64, information: Float64) -> Float64:
        """The mean square of the curvature at m places: of all that are shown, by how well they fit
        what is measured there, whichever way the vehicle turns. The measurements have a `precision`
        [m], one over the variance, and their mean is `information` [m] / precision."""
        along = np.abs(information[:, None] * self.bend)
        fit = along + np.log1p(np.exp(-2.0 * along)) - 0.5 * precision[:, None] * self.bend**2
        weight = self.share * np.exp(fit - fit.max(axis=1, keepdims=True))
        return np.asarray(weight @ self.bend**2 / weight.sum(axis=1))


def seen_way_m(measured: Measurements, x: Float64) -> Float64:
    """How far a vehicle drives in each step [n - 1]; 0 at rest, and where the way is unknown."""
    way_m = np.abs(x[1:, model.V] + x[:-1, model.V]) / 2.0 * np.diff(measured.time_s)
    way_m[~measured.seen | (measured.standing[1:] & measured.standing[:-1])] = 0.0
    return np.asarray(way_m)


def leaving(
    change: CurvatureChange, exits: Int64, inside: Float64, outside: Float64
) -> CurvatureChange:
    """The change of the curvature, but for the steps `exits` [m] out of holes: from curvatures
    with a sigma of `inside` [m] to those of `outside` [m].

    Forward and backward in time the same is said, and on each side the curvature has its own sigma:
    a vehicle that may turn tightly in a hole is not expected to do so beside it.
    """
    kept, variance = change.kept.copy(), change.variance.copy()
    correlation = kept[exits] * np.minimum(inside, outside) / np.maximum(inside, outside)
    kept[exits] = correlation * outside / inside
    variance[exits] = outside**2 * (1.0 - correlation**2)
    return CurvatureChange(kept, variance)
