"""Whether the fixes of a drive wander by more than their receiver states."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.batch import SmoothedDrive
from fieldgrid.poses.smoother.declared import unverified_nats
from fieldgrid.poses.smoother.equations import CONSTANTS
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.rounds import (
    SmoothingProblem,
    Solution,
    converged,
    linearized,
    stated_weights,
)
from fieldgrid.poses.smoother.steering import likelihood_by

RATES_M = (0.01, 0.02)
"""How much a slow error may wander beyond what is stated, m/√s, that is tried: a metre and a half
in a minute and a half, and half of that."""

OUTLIER_SIGMAS = 8.0
"""A step that is off the drive by more says nothing of a drift, which spreads over all steps: a
camera that is stuck looks like one that leaps."""

FREE_RATE_M = 0.1
"""Under this one the drift that is found hardly holds back."""

FOREVER_S = 1e9
"""For so long a part of the slow error lasts that joins it: none fades."""


LAGS_S = (2.0, 5.0, 10.0)
"""Over so long slow errors are compared with what is stated of them: about a turn."""

FEWEST_PAIRS = 10
"""Of fewer nodes so far apart a mean says nothing."""


def wander(
    known: SmoothedDrive, measured: Measurements, lever_m: tuple[float, float], step_ahead_m: float
) -> tuple[float, float, float, Float64]:
    """What an estimate `known` from the same measurements says of the wander of its fixes: a slow
    error that goes on from the stated one at random. Steps that are outliers are left out.

    Returns how much likelier the drive is when its fixes wander, nats; the same beside declarations
    that may be off by what is usual; how far apart the slow errors of its nodes lie then, metres;
    and by how much its headings [n] differ from those of fixes that do not wander, radians.
    """
    off = np.abs(known.step_off) / measured.step_sigma[:, [0, 0, 1]]
    measured = measured.with_steps(off.max(axis=1) < OUTLIER_SIGMAS)

    def found(rate_m: float) -> tuple[SmoothingProblem, Solution]:
        passed_s = measured.time_s - measured.time_s[0]
        wandering = measured
        if rate_m > 0.0:
            wandering = measured._replace(
                bias_m=np.sqrt(measured.bias_m**2 + rate_m**2 * passed_s),
                bias_s=np.full_like(measured.bias_s, FOREVER_S),
            )
        problem = SmoothingProblem.of(wandering, lever_m, step_ahead_m)
        weights = stated_weights(wandering, known.steering)
        return problem, converged(problem, known.state, np.zeros(CONSTANTS), weights)

    def likelihoods(rate_m: float) -> tuple[float, float]:
        problem, solution = found(rate_m)
        parts = solution.x, solution.constants, solution.weights
        linear, _ = linearized(problem, *parts, held=False)
        exact = likelihood_by(linear)
        return exact, exact + unverified_nats(problem, solution, linear)

    stated = likelihoods(0.0)
    others = zip(*(likelihoods(rate_m) for rate_m in RATES_M), strict=True)
    nats = [max(wandering) - one for wandering, one in zip(others, stated, strict=True)]
    free = found(FREE_RATE_M)[1].x
    extent_m = float(np.hypot(*np.ptp(free[:, model.BIAS_E :], axis=0)))
    turned = free[:, model.PHI] - known.state[:, model.PHI]
    return nats[0], nats[1], extent_m, np.asarray(turned)


def unstated_wander(state: Float64, measured: Measurements) -> float:
    """By how much the slow errors of the estimated states [n, 8] wander more than is stated of
    them: the ratio of the mean squares of their changes, the largest of :data:`LAGS_S`, and 1 where
    they wander by less.

    An estimate that holds a part of the wander for motion shows too small a ratio.
    """
    time_s, slow_m = measured.time_s, state[:, model.BIAS_E :]
    variance, lasts_s = measured.bias_m**2, measured.bias_s
    most = 1.0
    for lag_s in LAGS_S:
        later = np.searchsorted(time_s, time_s + lag_s)
        first = np.flatnonzero(later < len(time_s))
        later = later[first]
        passed_s = time_s[later] - time_s[first]
        near = passed_s < 1.5 * lag_s
        first, later, passed_s = first[near], later[near], passed_s[near]
        if len(first) < FEWEST_PAIRS:
            continue
        changed = float(np.mean((slow_m[later] - slow_m[first]) ** 2))
        # Of one part that fades and one that joins where the stated error grows.
        stated = 2.0 * variance[first] * (1.0 - np.exp(-passed_s / lasts_s[first]))
        stated += np.maximum(variance[later] - variance[first], 0.0)
        most = max(most, changed / max(float(np.mean(stated)), model.NO_BIAS_M**2))
    return most
