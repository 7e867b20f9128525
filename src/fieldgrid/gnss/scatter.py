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

from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.fixes import FixColumns

M_PER_DEG = 111_195.0
"""Metres of a degree on a sphere of Earth's mean radius: near enough for how fine a log is."""

_LEAST_SIGMA_M = 0.001
_ORDERS = (3, 4, 5)
_FEWEST_DIFFERENCES = 12
_MAX_STEP = 2.5  # steps longer than this many usual ones are gaps
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


class FixScatter(NamedTuple):
    """The spacing of a log's coordinates and the white part of their error along one axis."""

    quantum_m: float
    short_term_sigma_m: float


def scatter(used: FixColumns) -> FixScatter:
    """The scatter of accepted fixes, ordered by time; never more than the receiver's own sigma."""
    if not len(used):
        return FixScatter(0.0, _LEAST_SIGMA_M)
    lat_deg, lon_deg = used.lat_deg, used.lon_deg
    spacing_m = quantum_m(lat_deg, lon_deg)
    east_m = (lon_deg - lon_deg[0]) * M_PER_DEG * math.cos(math.radians(lat_deg[0]))
    north_m = (lat_deg - lat_deg[0]) * M_PER_DEG
    told_m = float(np.median(used.position_sigma_m()))
    white_m = short_term_sigma_m(east_m, north_m, used.time_ns, spacing_m)
    floor_m = spacing_m / math.sqrt(12.0)
    return FixScatter(spacing_m, max(min(white_m, told_m), floor_m))


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
        on_it = np.abs(steps - np.round(steps)) <= _ON_LATTICE_TOLERANCE
        if np.mean(on_it) >= _ON_LATTICE_SHARE:
            return spacing_deg
    return 0.0


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
    steps_s = np.diff(time_s)
    if not np.any(steps_s > 0.0):
        return floor_m
    even = (steps_s > 0.0) & (steps_s <= _MAX_STEP * np.median(steps_s[steps_s > 0.0]))
    found = [
        _calm_rms(_differences(np.stack([east_m, north_m]), time_s, even, order))
        for order in _ORDERS
        if np.convolve(even, np.ones(order), "valid").max(initial=0.0) >= order
    ]
    known = [sigma_m for sigma_m in found if math.isfinite(sigma_m)]
    return max(min(known), floor_m) if known else floor_m


def _differences(values: Float64, time_s: Float64, even: Bool, order: int) -> Float64:
    """Divided differences without a gap in them, whose weights have unit norm; (axes, n)."""
    whole = np.convolve(even, np.ones(order), "valid") >= order
    first = np.flatnonzero(whole)
    rows = first[:, None] + np.arange(order + 1)
    # In units of the window's own length, or products of small steps underflow.
    at = (time_s[rows] - time_s[rows[:, :1]]) / (time_s[rows[:, -1:]] - time_s[rows[:, :1]])
    apart = at[:, :, None] - at[:, None, :] + np.eye(order + 1)
    weights = 1.0 / np.prod(apart, axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    # From the first position of each, so that large coordinates do not cost digits.
    local = values[:, rows] - values[:, rows[:, :1]]
    return np.asarray(np.einsum("awi,wi->aw", local, weights))


def _calm_rms(differences: Float64) -> float:
    """Sigma of a normal distribution from its middle 70 %; NaN for too few.

    Not the median: differences of rounded positions have few values, and it would be one of them.
    """
    size = np.sort(np.abs(differences).ravel())
    if size.size < 2 * _FEWEST_DIFFERENCES:
        return math.nan
    calm = size[: round(_CALM_SHARE * size.size)]
    return _CALM_TO_SIGMA * float(np.sqrt(np.mean(calm**2)))
