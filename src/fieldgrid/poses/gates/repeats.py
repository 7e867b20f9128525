"""Positions that a log writes again before the receiver had a new one.

A logger that is quicker than its receiver, or a receiver that hangs, repeats the last position
under a new time. Taken for fixes, such rows say that a moving vehicle stood.
"""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import Bool, Float64, Index, Int64
from fieldgrid.poses.gates.scatter import M_PER_DEG, SECOND_S, quantum_m

_STANDING_MPS = 0.1  # below this a vehicle stands, and its positions wander
_FASTEST_MPS = 40.0
_FEWEST_STEPS = 20
_FEWEST_POSITIONS = 4
_EARLY = 0.15  # of a receiver's period that a row may come early and still be a new fix


def held_ns(time_ns: Int64, lat_deg: Float64, lon_deg: Float64, speed_mps: Float64) -> Int64:
    """For each row the age of the position that it repeats, nanoseconds; -1 where it is a fix.

    Rows are ordered by time; an unknown speed is NaN. A vehicle that stands also writes the same
    position again, since positions are rounded: those rows are fixes, as many as the receiver can
    have made.
    """
    none = np.full(len(time_ns), -1, dtype=np.int64)
    if len(time_ns) < 2:
        return none
    is_new = np.ones(len(time_ns), dtype=np.bool_)
    is_new[1:] = (np.diff(lat_deg) != 0.0) | (np.diff(lon_deg) != 0.0)
    if len(np.unique(lat_deg + 1j * lon_deg)) < _FEWEST_POSITIONS:
        return np.where(_twice(time_ns, is_new), 0, none)  # it hardly moved, so they must repeat
    fresh = np.flatnonzero(is_new)
    run = np.cumsum(is_new) - 1
    age_ns = time_ns - time_ns[fresh][run]
    spacing_m = math.sqrt(2.0) * quantum_m(lat_deg, lon_deg)
    pace_mps = _pace_mps(time_ns[fresh], lat_deg[fresh], lon_deg[fresh])
    pace_mps[(pace_mps < _STANDING_MPS) | (speed_mps[fresh] < _STANDING_MPS)] = 0.0
    # Kept going, and would have been at another position by now.
    stale = pace_mps[run] * age_ns / 1e9 > spacing_m
    stale &= ~(speed_mps < _STANDING_MPS)
    stale |= _too_early(time_ns, is_new, run, age_ns, pace_mps, spacing_m)
    return np.where(~is_new & stale | _twice(time_ns, is_new), age_ns, none)


def _twice(time_ns: Int64, is_new: Bool) -> Bool:
    """Rows that are the row before them once more, place and time."""
    return np.asarray(~is_new & (np.diff(time_ns, prepend=time_ns[0] - 1) == 0))


def _pace_mps(time_ns: Int64, lat_deg: Float64, lon_deg: Float64) -> Float64:
    """The least speed at which the vehicle can have gone from each new position to the next.

    The least of this step, its neighbours and the second before and after: a vehicle that stood
    shows it in one of them. 0 beside a step that nothing drives, which tells of no motion.
    """
    n = len(time_ns)
    east = M_PER_DEG * np.cos(np.radians(np.median(lat_deg))) * lon_deg
    north = M_PER_DEG * lat_deg

    def speed(a: Index, b: Index) -> Float64:
        seconds = np.maximum(time_ns[b] - time_ns[a], 1) / 1e9
        return np.asarray(np.hypot(east[b] - east[a], north[b] - north[a]) / seconds)

    k = np.arange(n)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 1, n - 1)
    around_ns = round(SECOND_S * 1e9)
    lo = np.minimum(np.searchsorted(time_ns, time_ns - around_ns), before)
    hi = np.maximum(np.searchsorted(time_ns, time_ns + around_ns, side="right") - 1, after)
    step_mps = speed(k, after)
    sides = [step_mps, step_mps[before], step_mps[after], speed(lo, k), speed(after, hi[after])]
    wild = np.max(sides[:3], axis=0) > _FASTEST_MPS
    return np.where(wild, 0.0, np.min(sides, axis=0))


def _too_early(
    time_ns: Int64,
    is_new: Bool,
    run: Int64,
    age_ns: Int64,
    pace_mps: Float64,
    spacing_m: float,
) -> Bool:
    """Rows for which the receiver cannot have made a fix yet, by its period in this log."""
    steps_ns, row_ns = np.diff(time_ns[np.flatnonzero(is_new)]), np.diff(time_ns)
    quickly = pace_mps[:-1] > 0.0
    if np.count_nonzero(quickly) < _FEWEST_STEPS:
        return np.zeros(len(time_ns), dtype=np.bool_)
    quickly &= pace_mps[:-1] >= np.quantile(pace_mps[:-1][quickly], 0.75)
    period_ns = float(np.median(steps_ns[quickly]))
    covered_m = float(np.median(pace_mps[:-1][quickly])) * period_ns / 1e9
    # Rounding, too, makes one position of several fixes, but not over so long a way.
    if covered_m < 1.5 * spacing_m or period_ns < 1.5 * float(np.median(row_ns[row_ns > 0])):
        return np.zeros(len(time_ns), dtype=np.bool_)
    nth = np.floor(age_ns / period_ns + _EARLY)
    return np.concatenate([[False], (np.diff(nth) <= 0.0) & (np.diff(run) == 0)])
