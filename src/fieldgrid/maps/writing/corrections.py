"""What is added to a drive's places and heights over its time, and how it is read between times."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from fieldgrid.core import ConfigError, Float64, Int64

MOST_M = 1000.0

MOST_KNOTS = 100_000

MOST_TIME_NS = 2**62


@dataclass(frozen=True, slots=True)
class Wander:
    """What is added to a shift at times: metres east and north, linear between the times and the
    same before the first and after the last. The times increase."""

    time_ns: tuple[int, ...]
    east_m: tuple[float, ...]
    north_m: tuple[float, ...]

    def __post_init__(self) -> None:
        _check("A wander", self.time_ns, self.east_m, self.north_m)

    def at(self, time_ns: int | Int64) -> tuple[Float64, Float64]:
        """Metres east and north at times."""
        return (
            _at(time_ns, self.time_ns, self.east_m),
            _at(time_ns, self.time_ns, self.north_m),
        )


@dataclass(frozen=True, slots=True)
class HeightCorrection:
    """What is added to heights at times: metres up, linear between the times and the same before
    the first and after the last. The times increase. Heights are no surer than their poses state,
    and no surer than `least_sigma_m`."""

    time_ns: tuple[int, ...]
    up_m: tuple[float, ...]
    least_sigma_m: float = 0.0

    def __post_init__(self) -> None:
        _check("A correction of heights", self.time_ns, self.up_m)
        if not 0.0 <= self.least_sigma_m < math.inf:
            raise ConfigError(f"Heights with an error of {self.least_sigma_m} m cannot be.")

    @property
    def mean_m(self) -> float:
        """What is added in the mean of the times."""
        return math.fsum(self.up_m) / len(self.up_m)

    def at(self, time_ns: int | Int64) -> Float64:
        """Metres up at times."""
        return _at(time_ns, self.time_ns, self.up_m)


def _check(what: str, time_ns: tuple[int, ...], *series: tuple[float, ...]) -> None:
    """Raise ConfigError for a correction that cannot be."""
    n = len(time_ns)
    if not 0 < n <= MOST_KNOTS or any(len(values) != n for values in series):
        raise ConfigError(
            f"{what} of {n} times and {' and '.join(str(len(values)) for values in series)} values "
            f"cannot be; give as many of each, 1 to {MOST_KNOTS}."
        )
    if any(b <= a for a, b in itertools.pairwise(time_ns)):
        raise ConfigError(f"{what} has times that do not increase.")
    if not -MOST_TIME_NS <= time_ns[0] <= time_ns[-1] <= MOST_TIME_NS:
        raise ConfigError(f"{what} has times beyond what nanoseconds of 64 bits can say.")
    values = tuple(itertools.chain.from_iterable(series))
    if not all(math.isfinite(value) and abs(value) <= MOST_M for value in values):
        raise ConfigError(f"{what} goes up to {MOST_M:.0f} m; {max(values, key=abs)} m cannot be.")


def _at(time_ns: int | Int64, knots_ns: tuple[int, ...], values: tuple[float, ...]) -> Float64:
    """Linear between the values of knots, the same before the first and after the last."""
    # Whole numbers of nanoseconds since 1970 are more than a float can tell.
    after_s = (np.asarray(time_ns, np.int64) - knots_ns[0]) / 1e9
    knots_s = (np.asarray(knots_ns, np.int64) - knots_ns[0]) / 1e9
    return np.asarray(np.interp(after_s, knots_s, np.asarray(values)))
