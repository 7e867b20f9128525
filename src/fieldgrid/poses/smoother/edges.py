"""How much a vehicle may steer just before a hole of its fixes and just after it.

In the middle of a drive the fixes that follow show a turn-in. At an edge none follow: that none is
seen yet does not say that there is none. So what is expected there are the changes of the curvature
that the drive shows elsewhere, each by its share of the way and by how well it fits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.holes import ShownBends, Unseen, seen_way_m
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.rounds import CurvatureChange

EDGE_S = 1.0
"""For so long beside an edge the fixes on one side do not show the steering yet."""

UNTOLD = 0.8
"""A position tells where the curvature's steady random changes up to it have led, which is 5/9 of
their own variance: beside what it tells, 4/9 stay open. As noise of a measurement, that is 4/5 of
the variance, however exact the position is."""

FEW_AND_LARGE = 2.0
"""Rows are long and turns are few: twice the mean square is expected, since three sigmas of the
mean square itself hold too few of changes that come seldom and are large then."""

LEAST_VARIANCE = 1e-12
"""No curvature is known better, 1/m²: rounding."""


class FixEdges(NamedTuple):
    """Where e stretches with fixes begin behind a hole, or end before one: nodes `at` [e], and
    nodes `inner` [e] of the same stretches :data:`EDGE_S` away, or at their other end."""

    at: Int64
    inner: Int64

    @classmethod
    def of(cls, time_s: Float64, unseen: Unseen) -> tuple[FixEdges, FixEdges]:
        """Those where stretches begin, and those where they end."""
        begin, end = unseen.stretches()
        after = np.minimum(next_nodes(time_s)[begin], end)
        before = np.searchsorted(time_s, time_s[end] - EDGE_S * (1.0 - 1e-6), side="right") - 1
        before = np.maximum(before, begin)
        # The drive itself begins and ends somewhere, which is no hole.
        return cls(begin[1:], after[1:]), cls(end[:-1], before[:-1])

    def steps(self) -> tuple[Int64, Int64]:
        """The first step beside each edge, and the one after the last."""
        return np.minimum(self.at, self.inner), np.maximum(self.at, self.inner)


def next_nodes(time_s: Float64) -> Int64:
    """For each node [n] the first one at least :data:`EDGE_S` later; n where there is none."""
    return np.searchsorted(time_s, time_s + EDGE_S * (1.0 - 1e-6))


def units(sides: tuple[FixEdges, ...], states: int) -> Float64:
    """Right sides [states, sides] whose solutions are the covariances with the curvature at the
    edges of each side. Those of one side share a column: beyond a hole curvatures are unrelated."""
    right = np.zeros((states, len(sides)))
    for side, edges in enumerate(sides):
        right[STATES * edges.at + model.KAPPA, side] = 1.0
    return right


def shown_changes(measured: Measurements, x: Float64, unseen: Unseen) -> ShownBends:
    """By how much the curvature changes within :data:`EDGE_S` where a drive with states [n, 8]
    shows it: outside of holes."""
    time_s, way_m = measured.time_s, seen_way_m(measured, x)
    later = next_nodes(time_s)[:-1]
    hidden = np.concatenate([[0], np.cumsum(unseen.holes)])
    inside = np.minimum(later, len(time_s) - 1)
    way_m[(later > inside) | (hidden[inside] > hidden[:-1])] = 0.0
    changed = np.abs(x[inside, model.KAPPA] - x[:-1, model.KAPPA])
    usual = ShownBends.usual()
    kept = np.exp(-2.0 * EDGE_S / model.CURVATURE_S)
    return ShownBends.by_way(way_m, changed, usual._replace(bend=np.sqrt(1.0 - kept) * usual.bend))


def expected_squared(
    shown: ShownBends, moved: Float64, variance: Float64, prior: Float64
) -> Float64:
    """The mean square of changes [e] of the curvature that are estimated as `moved` [e] with a
    `variance` [e], where a `prior` [e] variance was expected: of all that are shown, by how well
    they fit."""
    precision = np.maximum(1.0 / variance - 1.0 / prior, 1e-6 / prior)
    measured = moved / variance / precision
    untold = np.minimum(UNTOLD, 1.0 / (precision * prior))
    noise = np.maximum(1.0 / precision - untold * prior, LEAST_VARIANCE)
    spread = untold[:, None] * shown.bend**2 + noise[:, None]
    along = np.abs(measured[:, None] * shown.bend) / spread
    fit = along + np.log1p(np.exp(-2.0 * along)) - 0.5 * np.log(spread)
    fit -= 0.5 * (measured[:, None] ** 2 + shown.bend**2) / spread
    weight = shown.share * np.exp(fit - fit.max(axis=1, keepdims=True))
    return np.asarray(weight @ shown.bend**2 / weight.sum(axis=1))


def freed(
    change: Float64,
    most: Float64,
    edges: FixEdges,
    shown: ShownBends,
    known: tuple[Float64, Float64, Float64],
    prior: CurvatureChange,
    time_s: Float64,
) -> Float64:
    """The variance [n - 1] `change` of the curvature's change, and beside edges at least what is
    expected there, but no more than the `most` [n - 1] that is where no fix is near.

    `known` are the curvatures [n] that were estimated with the `prior`, their variances [n], and
    their covariances [n] with that at the edge of the same stretch."""
    curvature, own, shared = known
    at, inner = edges
    first, last = edges.steps()
    joined = np.concatenate([[0.0], np.cumsum(prior.variance)])
    expected = expected_squared(
        shown,
        curvature[at] - curvature[inner],
        np.maximum(own[at] + own[inner] - 2.0 * shared[inner], LEAST_VARIANCE),
        np.maximum(joined[last] - joined[first], LEAST_VARIANCE),
    )
    rate = FEW_AND_LARGE * expected / (time_s[last] - time_s[first])
    change = change.copy()
    for a, b, one in zip(first.tolist(), last.tolist(), rate.tolist(), strict=True):
        there = np.minimum(one * np.diff(time_s[a : b + 1]), most[a:b])
        change[a:b] = np.maximum(change[a:b], there)
    return change
