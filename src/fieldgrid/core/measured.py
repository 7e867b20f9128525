"""A mean with its error, of values that follow each other in time and are not independent."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core.array_types import Bool, Float64

OUTLIER = 5.0
"""Values that are farther off than this number of scatters are left out."""


class MeasuredValue(NamedTuple):
    """A value and its 1-sigma error, in the unit that the name says that holds it."""

    value: float
    sigma: float

    def off(self, stated: float) -> float:
        """How many sigmas a stated value is above this one."""
        return (stated - self.value) / self.sigma


def kept(values: Float64) -> Bool:
    """Mask of the values [n] that are no outliers, by the median of their distances."""
    off = np.abs(values - np.median(values))
    return np.asarray(off <= OUTLIER * max(1.4826 * float(np.median(off)), 1e-9))


def repeated(residuals: Float64) -> float:
    """How many neighbours of a series [n] say the same thing, 1 when each speaks for itself.

    The sum of the autocorrelation up to its first value that is not positive.
    """
    n, r = len(residuals), residuals - residuals.mean()
    variance = float(r @ r)
    if variance <= 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, max(n // 3, 1)):
        correlation = float(r[lag:] @ r[:-lag]) / variance
        if correlation <= 0.0:
            break
        total += 2.0 * correlation
    return total


def mean_of(values: Float64, floor: float) -> MeasuredValue:
    """The mean of a series [n >= 2] without its outliers; `floor` is the error that all share."""
    used = values[kept(values)]
    spread = float(np.std(used, ddof=1)) if len(used) > 1 else 0.0
    sigma = spread * math.sqrt(min(repeated(used) / len(used), 1.0))
    return MeasuredValue(float(used.mean()), math.hypot(sigma, floor))
