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

from fieldgrid.core import Float64
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.model import BIAS_E, BIAS_N, NO_BIAS_M
from fieldgrid.poses.smoother.rounds import Covariances

TIMES = 4.0
"""By this factor slow errors are tried larger, and shorter."""

MOST_LARGER, MOST_SHORTER = 4, 4
"""So often at most: of centimetres metres, of minutes a second."""

LARGER_NATS, SHORTER_NATS = -4.0, -1.0
"""How likely each step is before the drive: what a receiver states of its error is a promise, for
how long it lasts is a guess."""

CLEAR_NATS = 2.0
"""No drive is estimated again for less."""


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


def wander_nats(measured: Measurements, x: Float64, known: Covariances) -> float:
    """How much likelier a drive with the states `x` [n, 8] would be with a slow error that changes
    more from node to node, by one step from what is stated; 0 where it should change less."""
    score = information = 0.0
    one, two = (np.maximum(measured.bias_m[k], NO_BIAS_M) for k in (slice(-1), slice(1, None)))
    fading = np.exp(-np.diff(measured.time_s) / measured.bias_s[:-1])
    kept = fading * np.minimum(one, two) / np.maximum(one, two)
    stated = two**2 * (1.0 - kept**2)
    kept = kept * two / one
    for axis in (BIAS_E, BIAS_N):
        own, before = known.own(axis, axis), known.with_before(axis, axis)
        open_m2 = own[1:] + kept**2 * own[:-1] - 2.0 * kept * before
        changed = (x[1:, axis] - kept * x[:-1, axis]) ** 2 + open_m2
        score += 0.5 * float((changed / stated - 1.0).sum())
        information += 0.5 * float((np.maximum(1.0 - open_m2 / stated, 0.0) ** 2).sum())
    if score <= 0.0 or information <= 0.0:
        return 0.0
    return score**2 / (2.0 * information) if math.isfinite(score) else math.inf
