"""The curve of a row: a robust fit of low order through its stations, with its sigma.

The order is what the evidence asks for (Schwarz's criterion): posts and wires are straight, a
contour row is not. Offsets of neighbouring stations are correlated, as a plant is longer than a
station, so they count as fewer.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from fieldgrid.core import Float64
from fieldgrid.geometry import lengths, normals, project, resampled

_STEP_M = 1.0
_ORDER_EVERY_M = 7.0
_MAX_ORDER = 24
_CORRELATED = 5.0
"""Stations that tell as much as one: foliage wanders by decimetres over some metres."""

_STRAIGHT = 6.0
"""How much better than a straight one a curved row has to fit: most rows hang on wires."""

_HUBER = 1.5
_FLOOR_M = 0.01


class Curve(NamedTuple):
    """A fitted line [n, 2] with the standard deviation of its place across, at each point, and the
    scatter of the stations about it."""

    line: Float64
    sigma_m: Float64
    scatter_m: float


def fit_curve(points_m: Float64, weight: Float64) -> Curve:
    """The curve through stations [n, 2] in their order along the row; weight 0 counts for none.

    The line begins at the first station and ends at the last.
    """
    base = _base(points_m, weight)
    s_base, left = lengths(base), normals(base)
    s, v = project(points_m, base)
    known = weight > 0.0
    low, high = float(s.min()), float(s.max())
    length = max(high - low, 1e-6)
    # A station with many cells is not better by as much: what differs is the plant.
    trust = np.minimum(weight / max(float(np.median(weight[known])), 1e-9), 2.0) ** 0.5 * known
    most = int(min(_MAX_ORDER, max(1, length // _ORDER_EVERY_M), max(1, known.sum() // 4)))
    x = 2.0 * (s - low) / length - 1.0
    best: tuple[float, Float64, Float64, float] | None = None
    count = max(float(known.sum()) / _CORRELATED, 3.0)
    robust = np.ones(len(v))
    design = np.asarray(legendre.legvander(x, most), dtype=np.float64)
    for order in range(1, most + 1):
        coefficients, inverse, robust, scatter = _robust(design[:, : order + 1], v, trust, robust)
        cost = count * np.log(scatter**2 + _FLOOR_M**2) + (order + 1) * np.log(count)
        cost += _STRAIGHT if order > 1 else 0.0
        if best is None or cost < best[0]:
            best = (cost, coefficients, inverse, scatter)
        elif order > 6 and cost > best[0] + 12.0:
            break
    assert best is not None
    _, coefficients, inverse, scatter = best
    at = np.linspace(low, high, max(2, round(length / _STEP_M) + 1))
    terms = legendre.legvander(2.0 * (at - low) / length - 1.0, len(coefficients) - 1)
    offset = terms @ coefficients
    variance = np.einsum("ij,jk,ik->i", terms, inverse, terms) * scatter**2 * _CORRELATED
    middle = np.column_stack([np.interp(at, s_base, base[:, k]) for k in (0, 1)])
    side = np.column_stack([np.interp(at, s_base, left[:, k]) for k in (0, 1)])
    side /= np.hypot(side[:, 0], side[:, 1])[:, None]
    return Curve(middle + offset[:, None] * side, np.sqrt(np.maximum(variance, 0.0)), scatter)


def _robust(
    design: Float64, v: Float64, trust: Float64, robust: Float64
) -> tuple[Float64, Float64, Float64, float]:
    """Huber's fit: coefficients, the inverse of the normal matrix, weights, and the scatter."""
    known, ridge = trust > 0.0, 1e-9 * np.eye(design.shape[1])
    for _ in range(4):
        weighted = design.T * (trust * robust)
        inverse = np.asarray(np.linalg.inv(weighted @ design + ridge), dtype=np.float64)
        coefficients = inverse @ (weighted @ v)
        residual = v - design @ coefficients
        size = np.abs(residual)
        used = size[known]
        ascending = np.sort(used)
        half = len(used) // 2
        scatter = max(
            1.4826 * (0.5 * float(ascending[half] + ascending[-1 - half])),
            0.3 * math.sqrt(float(used @ used) / len(used)),
        )
        scatter = max(scatter, 1e-4)
        robust = np.minimum(1.0, _HUBER * scatter / np.maximum(size, 1e-12))
    left = max(float(known.sum()) - design.shape[1], 1.0)
    rms = float(np.sqrt((robust * trust * residual**2).sum() / max((robust * trust).sum(), 1e-9)))
    return coefficients, inverse, robust, rms * float(np.sqrt((left + design.shape[1]) / left))


def _base(points_m: Float64, weight: Float64) -> Float64:
    """A line to measure offsets from: the chord, or for a row that turns far a smoothed copy."""
    used = points_m[weight > 0.0] if (weight > 0.0).sum() > 1 else points_m
    middle = used.mean(axis=0)
    _, _, axes = np.linalg.svd(used - middle, full_matrices=False)
    along = axes[0] if (points_m[-1] - points_m[0]) @ axes[0] >= 0.0 else -axes[0]
    s = (points_m - middle) @ along
    v = (points_m - middle) @ np.array([-along[1], along[0]])
    if np.ptp(v) < 0.2 * np.ptp(s) and np.all(np.diff(s) > 0.0):
        ends = np.array([s.min() - 1.0, s.max() + 1.0])
        return np.asarray(middle + ends[:, None] * along[None])
    size = max(3, min(len(points_m) // 2, 25))
    kernel = np.hanning(size + 2)[1:-1]
    padded = np.concatenate(
        [2 * points_m[0] - points_m[size - 1 : 0 : -1], points_m,
         2 * points_m[-1] - points_m[-2 : -size - 1 : -1]]
    )  # fmt: skip
    half = size - 1
    smooth = np.column_stack(
        [np.convolve(padded[:, k], kernel / kernel.sum(), mode="same") for k in (0, 1)]
    )[half : half + len(points_m)]
    return resampled(smooth, _STEP_M)
