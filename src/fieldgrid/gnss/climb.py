"""Heights that run away: the sign of a solution that has come apart while it looks smooth.

An inertial receiver without satellites drifts on evenly. No jump and no covariance need give it
away, but it soon climbs or sinks as nothing on wheels can.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fieldgrid.array_types import Bool, Float64, Int64

HALF_WINDOW_S = 2.5
"""Rates of climb are taken over twice this."""

SPIKE_S = 1.0
"""A height that is off for less than half of this is a spike, and no climb."""

SPOILT_S = 10.0
"""How long before and after a climb the solution is not trusted either."""

VALUES_AT_ONCE = 1 << 16
"""As many are sorted together: windows are copied for it."""

MOST_APART = 0.5
"""Of a solution that climbs as nothing on wheels can in more of its fixes, none is trusted."""


def climb_mps(time_ns: Int64, height_m: Float64) -> Float64:
    """Rate of climb at each of n fixes ordered by time, m/s; 0 where too few are near."""
    if len(time_ns) < 3:
        return np.zeros(len(time_ns))
    time_s = (time_ns - time_ns[0]) / 1e9
    step_s = max(float(np.median(np.diff(time_s))), 1e-3)
    size = 2 * int(SPIKE_S / step_s / 2.0) + 1
    smooth_m = running_median(height_m, max(size, 3))
    first = np.searchsorted(time_s, time_s - HALF_WINDOW_S)
    last = np.searchsorted(time_s, time_s + HALF_WINDOW_S, side="right") - 1
    span_s = time_s[last] - time_s[first]
    rise_m = smooth_m[last] - smooth_m[first]
    return np.where(span_s >= HALF_WINDOW_S, rise_m / np.maximum(span_s, 1e-3), 0.0)


def running_median(values: Float64, size: int) -> Float64:
    """The median of `size` values, an odd number, around each of n; the first and the last one
    stand for those beyond them. SciPy's takes a tenth of a second to import."""
    half = size // 2
    windows = sliding_window_view(np.pad(values, half, mode="edge"), size)
    medians, step = np.empty(len(values)), max(VALUES_AT_ONCE // size, 1)
    for first in range(0, len(values), step):
        part = slice(first, first + step)
        medians[part] = np.partition(windows[part], half, axis=1)[:, half]
    return medians


def has_come_apart(climbing: Bool) -> bool:
    """Whether most fixes of a solution climb as no vehicle does."""
    return int(climbing.sum()) > MOST_APART * len(climbing)


def spoilt(time_ns: Int64, climbing: Bool) -> Bool:
    """Which of n fixes lie in or near a climb that no vehicle makes: all, where most climb so."""
    at = time_ns[climbing]
    if at.size == 0 or has_come_apart(climbing):
        return np.full(len(time_ns), at.size > 0)
    reach_ns = int(SPOILT_S * 1e9)
    near = np.searchsorted(at, time_ns + reach_ns, side="right") - np.searchsorted(
        at, time_ns - reach_ns
    )
    return np.asarray(near > 0)
