"""How large the slow error of a receiver is, and for how long it lasts, by what else saw the way.

A receiver states how large its error is, from a scatter that slow errors do not enter, and never
for how long it stays the same. Where a gyro or a camera saw the vehicle turn, the drive shows both:
what makes it likeliest. Multipath, a solution that converges, wrong numbers of waves and drifts of
minutes are all of this kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.poses.smoother.measurements import LEAP_M, Measurements
from fieldgrid.poses.smoother.model import BIAS_E, BIAS_N, NO_BIAS_M
from fieldgrid.poses.smoother.rounds import OUTLIER_FREEDOM, Covariances, Residuals

TIMES = 4.0
"""By this factor slow errors are tried larger, and shorter."""

MOST_LARGER, MOST_SHORTER = 4, 4
"""So often at most: of centimetres metres, of minutes a second."""

LARGER_NATS, SHORTER_NATS = -4.0, -1.0
"""How likely each step is before the drive: what a receiver states of its error is a promise, for
how long it lasts is a guess."""

CLEAR_NATS = 2.0
"""No drive is estimated again for less."""

LEAP_EVERY_S = 1000.0
"""A solution leaps once in so long: of fixed ones makers state that 99.9 % are right."""

APART_S = 3.0
"""Solutions that last no longer are excursions."""

BESIDE_S, OUTLYING = 1.0, 9.0
"""Fixes so near a leap, and three sigmas from an estimate without it, may fit one with it."""

TOLD_SHARE = 0.5
"""Of what a drive tells, what counts: the noise of its fixes is known to a third."""

USUAL_SQUARED = 2.0 * math.log(2.0)
"""The median of the squared length of two errors of one sigma."""


class SlowError(NamedTuple):
    """How many times larger the slow error is than stated, and how many times shorter it lasts than
    is usual, both as powers of :data:`TIMES`."""

    larger: int = 0
    shorter: int = 0

    @property
    def factor(self) -> float:
        """How many times larger it is."""
        return TIMES**self.larger

    def of(self, measured: Measurements) -> Measurements:
        """The measurements with this slow error instead of the usual one."""
        return measured._replace(
            bias_m=self.factor * measured.bias_m, bias_s=measured.bias_s / TIMES**self.shorter
        )

    def prior_nats(self) -> float:
        """How likely it is before the drive."""
        return self.larger * LARGER_NATS + self.shorter * SHORTER_NATS


def likeliest(nats: Callable[[SlowError], float]) -> SlowError:
    """The slow error that makes a drive likeliest, `nats` by nats, climbed from the stated one: to
    one that is larger, or that lasts shorter, or to a smaller one that changes as fast."""
    at = SlowError()
    tried = {at: nats(at)}
    while True:
        for larger, shorter in ((1, 0), (0, 1), (-1, 2)):
            one = SlowError(at.larger + larger, at.shorter + shorter)
            within = 0 <= one.larger <= MOST_LARGER and one.shorter <= MOST_SHORTER
            if within and one not in tried:
                tried[one] = nats(one) + one.prior_nats()
        best = max(tried, key=lambda one: tried[one])
        if tried[best] < tried[at] + CLEAR_NATS:
            return at
        at = best


class LeapOdds(NamedTuple):
    """What each step from node to node [n - 1] would be as a leap of the receiver's solution: how
    much likelier the drive may be with it, nats; and the error `sigma_m` [n - 1] of its size along
    one axis."""

    nats: Float64
    sigma_m: Float64

    def likeliest(self, time_s: Float64, fix_s: Float64) -> Int64:
        """The nodes before those that may be leaps, each the likeliest for some seconds around;
        between two of the fixes at `fix_s` there is one. None where none is likely, were all that
        is told of it counted twice."""
        before, after = _fixes_around(time_s[:-1], fix_s)
        odds = self.nats / TOLD_SHARE + _rare_nats(after - before)
        first = np.searchsorted(time_s, np.minimum(before, time_s[:-1] - APART_S))
        stop = np.searchsorted(time_s, np.maximum(after, time_s[1:] + APART_S), side="right") - 1
        at = np.flatnonzero((self.nats > 0.0) & (before < after) & (odds > 0.0).any())
        most = [first[k] + np.argmax(self.nats[first[k] : stop[k]]) for k in at.tolist()]
        return np.asarray(at[at == np.array(most, dtype=np.int64)])


class SlowChanges(NamedTuple):
    """What a drive tells of the slow error from node to node, [n - 1, 2] each, east and north:
    `score`, by how much its increment is larger than stated, in units of its stated variance, and
    what the rest of the drive leaves `open` of it, as a share of the stated variance, which is
    `stated_m2` [n - 1]."""

    score: Float64
    open: Float64
    stated_m2: Float64

    @classmethod
    def of(cls, measured: Measurements, x: Float64, known: Covariances) -> SlowChanges:
        """Those of a drive with the states `x` [n, 8]."""
        one, two = (np.maximum(measured.bias_m[k], NO_BIAS_M) for k in (slice(-1), slice(1, None)))
        fading = np.exp(-np.diff(measured.time_s) / measured.bias_s[:-1])
        kept = fading * np.minimum(one, two) / np.maximum(one, two)
        stated_m2 = two**2 * (1.0 - kept**2) + measured.leap_m2()
        kept = kept * two / one
        score, open_m2 = np.empty((2, len(kept), 2))
        for k, axis in enumerate((BIAS_E, BIAS_N)):
            own, before = known.own(axis, axis), known.with_before(axis, axis)
            open_m2[:, k] = own[1:] + kept**2 * own[:-1] - 2.0 * kept * before
            score[:, k] = x[1:, axis] - kept * x[:-1, axis]
        return cls(score / stated_m2[:, None], open_m2 / stated_m2[:, None], stated_m2)

    def wander_nats(self) -> float:
        """How much likelier the drive would be with a slow error that changes more from node to
        node, by one step from what is stated; 0 where it should change less."""
        changed = self.score**2 * self.stated_m2[:, None] + self.open
        score = 0.5 * float((changed - 1.0).sum())
        information = 0.5 * float((np.maximum(1.0 - self.open, 0.0) ** 2).sum())
        if score <= 0.0 or information <= 0.0:
            return 0.0
        return score**2 / (2.0 * information) if math.isfinite(score) else math.inf

    def leaps(self, measured: Measurements, off: Residuals) -> LeapOdds:
        """What each increment would be if it were free: the drive without it tells its size, as of
        a measurement that is left out. Fixes and steps near it that are `off` may fit."""
        told = np.maximum(1.0 - self.open, 1e-9) / self.stated_m2[:, None]
        # A drive that fits its own laws worse than usual tells of leaps as much less.
        squared = self.score**2 / told
        usual = float(np.median(np.append(squared.sum(axis=1), USUAL_SQUARED)))
        squared = squared / max(usual / USUAL_SQUARED, 1.0)
        share = told / (told + LEAP_M**-2.0)
        nats = 0.5 * (share * squared + np.log(1.0 - share)).sum(axis=1)
        squared = np.nan_to_num((off.fix_m / measured.fix_sigma_m) ** 2).sum(axis=1)
        by_step = (off.step[:, :2] / measured.step_sigma[:, :1]) ** 2
        np.maximum.at(squared, measured.step_nodes[:, 1], by_step.sum(axis=1))
        beyond = np.log((OUTLIER_FREEDOM + squared) / (OUTLIER_FREEDOM + OUTLYING))
        lost = np.cumsum(np.append(0.0, (OUTLIER_FREEDOM / 2.0 + 1.0) * np.maximum(beyond, 0.0)))
        time_s = measured.time_s
        first = np.searchsorted(time_s, time_s[:-1] - BESIDE_S)
        stop = np.searchsorted(time_s, time_s[1:] + BESIDE_S, side="right")
        open_m2 = (self.open * self.stated_m2[:, None]).mean(axis=1)
        return LeapOdds(nats + lost[stop] - lost[first], np.sqrt(np.maximum(open_m2, 0.0)))


def rare_nats(measured: Measurements, fix_s: Float64) -> float:
    """How likely leaps are before a drive, each at any time between two of the fixes at `fix_s`."""
    before, after = _fixes_around(measured.time_s[measured.leapt], fix_s)
    return float(_rare_nats(after - before).sum())


def _rare_nats(gap_s: Float64) -> Float64:
    """How likely a leap is before a drive in a gap between two fixes."""
    return np.asarray(np.log(np.clip(gap_s / LEAP_EVERY_S, 1e-9, 1.0)))


def _fixes_around(time_s: Float64, fix_s: Float64) -> tuple[Float64, Float64]:
    """The times of the last fix until some instants, and of the next one."""
    next_fix = np.searchsorted(fix_s, time_s, side="right")
    return fix_s[np.maximum(next_fix - 1, 0)], fix_s[np.minimum(next_fix, len(fix_s) - 1)]
