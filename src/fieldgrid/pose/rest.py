"""When the vehicle stood still: by what the receiver's speed says, or by where it stayed."""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Bool, Float64

HALF_WINDOW_S = 1.5
"""A vehicle at rest stays in place for this long before and after."""

REST_MPS = 0.1
"""Slower than this over the window, a vehicle stands and its positions wander."""

STAY_S, STAY_MPS = 5.0, 0.1
"""So does one whose positions all stay so near for this long before and after, though they may
wander faster in between."""

WANDER_MPS = 0.25
"""The positions of a standing vehicle may wander at this speed when its receiver says 0."""


def at_rest(
    time_s: Float64, east_m: Float64, north_m: Float64, noise_m: Float64, speed_mps: Float64
) -> Bool:
    """Which of n fixes were taken at rest. `speed_mps` is the receiver's own, NaN: none."""
    first = np.searchsorted(time_s, time_s - HALF_WINDOW_S)
    last = np.searchsorted(time_s, time_s + HALF_WINDOW_S, side="right") - 1
    span_s = time_s[last] - time_s[first]
    moved_m = np.hypot(east_m[last] - east_m[first], north_m[last] - north_m[first])
    long_enough = span_s >= 0.7 * HALF_WINDOW_S
    slow = long_enough & (moved_m < np.maximum(REST_MPS * span_s, 2.0 * noise_m))
    # Which fixes have all of their neighbours in time near them.
    near = np.ones(len(time_s), dtype=np.bool_)
    seen_s = np.zeros(len(time_s))
    for offset_s in np.linspace(-STAY_S, STAY_S, 9):
        at = np.clip(np.searchsorted(time_s, time_s + offset_s), 0, len(time_s) - 1)
        near &= np.hypot(east_m[at] - east_m, north_m[at] - north_m) < STAY_MPS * STAY_S
        seen_s = np.maximum(seen_s, np.abs(time_s[at] - time_s))
    slow |= near & (seen_s > 0.7 * STAY_S)
    if not _believable(speed_mps, moved_m, span_s):
        return slow
    said = np.nan_to_num(speed_mps, nan=np.inf) < REST_MPS
    near = moved_m < np.maximum(WANDER_MPS * span_s, 4.0 * noise_m)
    return np.asarray(np.where(np.isnan(speed_mps), slow, said & near))


def _believable(speed_mps: Float64, moved_m: Float64, span_s: Float64) -> bool:
    """Whether the receiver's speeds are those of this drive: some loggers write only zeros."""
    with np.errstate(invalid="ignore", divide="ignore"):
        driven = moved_m / span_s
        moving = (driven > 0.5) & np.isfinite(speed_mps)
    if not moving.any():
        return bool(np.isfinite(speed_mps).any())
    return bool(0.5 < np.median(speed_mps[moving] / driven[moving]) < 2.0)
