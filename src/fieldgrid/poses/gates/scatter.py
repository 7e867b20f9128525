"""How fine a log's positions are written, and how much they scatter from fix to fix.

The error of a decimetre receiver is mostly a slow bias, which no log tells; what remains from one
fix to the next is a few centimetres. A smoother that takes the whole error for white smears the
track, so the white part is measured here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Bool, Float64, Index, Int64
from fieldgrid.poses.faults.leaps.leaps import HOLE_PERIODS

M_PER_DEG = 111_195.0
"""Metres of a degree on a sphere of Earth's mean radius: near enough for how fine a log is."""

_LEAST_SIGMA_M = 0.001
_ORDERS = (3, 4, 5)
_FEWEST_DIFFERENCES, _FEWEST_AT_ALL, _FEW_SIGMAS = 12, 5, 1.5
_CALM_SHARE = 0.7
_CALM_TO_SIGMA = 1.7976  # sigma of a normal distribution over the RMS of its inner 70 %

# Latitudes and longitudes are written in degrees or in minutes with some decimals, or were
# single-precision numbers once; coarsest first. A log's numbers are taken to lie on a lattice
# when this share of them does, to within this part of its spacing.
_LATTICES_DEG = sorted(
    [10.0**-k for k in range(3, 10)]
    + [10.0**-k / 60.0 for k in range(2, 9)]
    + [2.0**-k for k in range(14, 22)],
    reverse=True,
)
_ON_LATTICE_SHARE = 0.9
_ON_LATTICE_TOLERANCE = 0.01
_FEWEST_VALUES = 4

UNSEEN_SHARE = 0.05
"""Of a stated error, what is taken to change from fix to fix where that cannot be measured."""

SECOND_S = 1.0
_MOVING_MPS = 0.15
_ENOUGH_WINDOWS = 20_000
_MOST_LATE_S = 0.5


class FixNoise(NamedTuple):
    """The noise of n fixes beside their slow error, 1-sigma along one axis.

    `across_m` [n] is what changes from one to the next. `second_m` [n] is the scatter over about a
    second, in which motion has a part: a bound on all that comes and goes so fast, infinite where
    it is not known. `late_s` is the error of the time stamps, by which moving fixes lie ahead or
    behind.
    """

    across_m: Float64
    second_m: Float64
    late_s: float


def fix_noise(
    east_m: Float64,
    north_m: Float64,
    time_ns: Int64,
    sigma_m: Float64,
    quality: Int64,
    quantum_m: float,
) -> FixNoise:
    """The noise of accepted fixes, ordered by time, that their own scatter shows.

    It is measured across the path, where a vehicle moves evenly, and for each quality apart: a
    float solution is noisier than a fixed one. Where there are too few fixes of a quality, it is
    :data:`UNSEEN_SHARE` of their stated error. From fix to fix it is at most the stated error, and
    at least that of rounding.
    """
    time_s = (time_ns - time_ns[0]) / 1e9 if len(time_ns) else np.zeros(0)
    floor_m = max(quantum_m / math.sqrt(12.0), _LEAST_SIGMA_M)
    across = np.maximum(UNSEEN_SHARE * sigma_m, floor_m)
    second = np.full(len(time_ns), np.inf)
    late, points = [], np.stack([east_m, north_m])
    for code in np.unique(quality):
        own = quality == code
        even = _even(time_s) & own[1:] & own[:-1]
        found = _axis_sigmas(points, time_s, even)
        if math.isnan(found.across_m):
            continue
        across[own] = np.clip(found.across_m, floor_m, np.maximum(sigma_m[own], floor_m))
        slower = _axis_sigmas(
            points,
            time_s,
            even,
            max(1, round(SECOND_S / max(float(np.median(np.diff(time_s))), 1e-3))),
        )
        if math.isfinite(slower.across_m):
            second[own] = max(slower.across_m, found.across_m, floor_m)
        if found.pace_mps > 0.0:
            beyond_m = math.sqrt(max(found.along_m**2 - found.across_m**2, 0.0))
            late.append((int(own.sum()), beyond_m / found.pace_mps))
    late_s = max(late)[1] if late else 0.0  # of the commonest quality
    return FixNoise(across, second, min(late_s, _MOST_LATE_S))


def _even(time_s: Float64) -> Bool:
    """Steps that are no gaps."""
    steps_s = np.diff(time_s)
    if not np.any(steps_s > 0.0):
        return np.zeros(len(steps_s), dtype=np.bool_)
    return np.asarray(
        (steps_s > 0.0) & (steps_s <= HOLE_PERIODS * np.median(steps_s[steps_s > 0.0]))
    )


class _Scatter(NamedTuple):
    """Scatter along and across the path, and the speed at which it was measured; NaN: unknown."""

    along_m: float
    across_m: float
    pace_mps: float


def _axis_sigmas(points: Float64, time_s: Float64, even: Bool, stride: int = 1) -> _Scatter:
    """The scatter between each `stride`-th of the positions. At rest the two axes have the same."""
    found = []
    for order in _ORDERS:
        differences, first = _differences(points, time_s, even, order, stride)
        if not len(first):
            continue
        chord = points[:, first + stride * order] - points[:, first]
        length_m, span_s = np.hypot(*chord), time_s[first + stride * order] - time_s[first]
        moving = length_m > _MOVING_MPS * span_s
        if np.count_nonzero(moving) < min(_FEWEST_DIFFERENCES, len(first)):
            both = _calm_rms(differences)
            found.append(_Scatter(both, both, 0.0))
            continue
        unit = chord[:, moving] / length_m[moving]
        d = differences[:, moving]
        along = _axis_rms(d[0] * unit[0] + d[1] * unit[1])
        across = _axis_rms(d[0] * unit[1] - d[1] * unit[0])
        found.append(_Scatter(along, across, float(np.median(length_m[moving] / span_s[moving]))))
    known = [one for one in found if math.isfinite(one.across_m)]
    if not known:
        return _Scatter(math.nan, math.nan, 0.0)
    # Where it is smallest, motion has the least part in it.
    return _Scatter(
        min(one.along_m for one in known),
        min(one.across_m for one in known),
        max(one.pace_mps for one in known),
    )


def short_term_sigma_m(
    east_m: Float64, north_m: Float64, time_ns: Int64, quantum_m: float
) -> float:
    """The white part of the error along one axis, metres, of positions ordered by time.

    Divided differences of the third to fifth order over the true time steps, scaled so that
    white noise keeps its variance: a slow bias and a smooth motion vanish in them, the quicker
    a motion the later, hence the least of the three. Outliers, turns and jolts leave the middle
    70 % of them alone. At least the error of rounding, `quantum_m` / √12, and 1 mm.
    """
    floor_m = max(quantum_m / math.sqrt(12.0), _LEAST_SIGMA_M)
    time_s = (time_ns - time_ns[0]) / 1e9 if len(time_ns) else np.zeros(0)
    even = _even(time_s)
    found = [
        _calm_rms(_differences(np.stack([east_m, north_m]), time_s, even, order)[0])
        for order in _ORDERS
    ]
    known = [sigma_m for sigma_m in found if math.isfinite(sigma_m)]
    return max(min(known), floor_m) if known else floor_m


def _differences(
    values: Float64, time_s: Float64, even: Bool, order: int, stride: int = 1
) -> tuple[Float64, Index]:
    """Divided differences of each `stride`-th value without a gap in them, whose weights have unit
    norm; (axes, n), and the first position of each."""
    span = stride * order
    evens = np.concatenate([[0], np.cumsum(even)])
    first = np.flatnonzero(evens[span:] - evens[:-span] == span)
    first = first[:: max(1, len(first) // _ENOUGH_WINDOWS)]
    rows = first[:, None] + stride * np.arange(order + 1)
    # In units of the window's own length, or products of small steps underflow.
    at = (time_s[rows] - time_s[rows[:, :1]]) / (time_s[rows[:, -1:]] - time_s[rows[:, :1]])
    apart = np.ones_like(at)
    for k in range(order + 1):
        step = at - at[:, k, None]
        step[:, k] = 1.0
        apart *= step
    weights = 1.0 / apart
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    # From the first position of each, so that large coordinates do not cost digits.
    local = values[:, rows] - values[:, rows[:, :1]]
    return np.asarray(np.einsum("awi,wi->aw", local, weights)), first


def _axis_rms(differences: Float64) -> float:
    """Root mean square of the differences along one axis; of few, a bound of it."""
    count = len(differences)
    if not _FEWEST_AT_ALL <= count < _FEWEST_DIFFERENCES:
        return _calm_rms(differences)
    return float(np.sqrt(np.mean(differences**2))) * (1.0 + _FEW_SIGMAS / math.sqrt(count))


def _calm_rms(differences: Float64) -> float:
    """Sigma of a normal distribution from its middle 70 %; NaN for too few.

    Not the median: differences of rounded positions have few values, and it would be one of them.
    """
    if differences.shape[-1] < _FEWEST_DIFFERENCES:
        return math.nan
    size = np.sort(np.abs(differences).ravel())
    calm = size[: round(_CALM_SHARE * size.size)]
    return _CALM_TO_SIGMA * float(np.sqrt(np.mean(calm**2)))


def quantum_m(lat_deg: npt.ArrayLike, lon_deg: npt.ArrayLike) -> float:
    """The spacing of the positions as they are written, metres; 0 when none is seen.

    The coarser one of the two axes: 0.185 m for minutes with four decimals (ddmm.mmmm).
    """
    lat, lon = np.asarray(lat_deg, dtype=np.float64), np.asarray(lon_deg, dtype=np.float64)
    finite = np.isfinite(lat) & np.isfinite(lon)
    if not finite.any():
        return 0.0
    shrink = math.cos(math.radians(float(np.median(lat[finite]))))
    north_m, east_m = _spacing_deg(lat[finite]), shrink * _spacing_deg(lon[finite])
    return M_PER_DEG * max(north_m, east_m)


def _spacing_deg(angles_deg: Float64) -> float:
    """The coarsest lattice that the distinct values lie on, degrees, or 0."""
    values = np.unique(angles_deg)
    if values.size < _FEWEST_VALUES:
        return 0.0
    for spacing_deg in _LATTICES_DEG:
        steps = values / spacing_deg
        nearest = np.round(steps)
        on_it = np.abs(steps - nearest) <= _ON_LATTICE_TOLERANCE
        # A drive along a round meridian lies near one point of a coarse lattice, or few.
        apart = 1 + np.count_nonzero(np.diff(nearest))  # both are in order
        if np.mean(on_it) >= _ON_LATTICE_SHARE and 2 * apart >= values.size:
            return spacing_deg
    return 0.0
