"""What gyro and accelerometer say from node to node: turn, change of speed, way.

Integrated once, in the vehicle's axes at the earlier node, so that the estimate can linearise
again without going back to the samples (Forster et al., On-Manifold Preintegration, 2017). Nodes
are at most some tenths of a second apart: rotations within an interval are small, and second
order in them is enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float32, Float64, Int64
from fieldgrid.geometry import Inertial

HOLE_NS = 250_000_000
"""Over a longer hole in its samples an IMU says nothing."""


LONGEST_NS = 1_000_000_000
"""Longer intervals are not of nodes that were laid for an IMU: rotations within are not small."""


class Increments(NamedTuple):
    """From node to node, [n - 1, 3] each: rotation vector (rad), change of speed (m/s) and way
    (m) by specific force alone, gravity not taken off; NaN where there was no sample."""

    turn_rad: Float64
    speed_mps: Float64
    way_m: Float64


def increments(sensed: Inertial, node_ns: Int64) -> Increments:
    """The samples integrated over each interval between nodes."""
    unknown = np.full((max(len(node_ns) - 1, 0), 3), np.nan)
    if len(sensed.time_ns) < 2 or len(node_ns) < 2:
        return Increments(unknown, unknown, unknown)
    # Nodes join the samples, so that every interval is a whole number of steps.
    inside = node_ns[(node_ns > sensed.time_ns[0]) & (node_ns < sensed.time_ns[-1])]
    times_ns = np.union1d(sensed.time_ns, inside)
    # Intervals between nodes that lie within samples without a hole.
    holes = np.concatenate([[0], np.cumsum(np.diff(sensed.time_ns) > HOLE_NS)])
    before = np.searchsorted(sensed.time_ns, node_ns, side="right") - 1
    after = np.searchsorted(sensed.time_ns, node_ns)
    inside = (before >= 0) & (after < len(sensed.time_ns))
    before, after = np.maximum(before, 0), np.minimum(after, len(sensed.time_ns) - 1)
    whole = inside[1:] & inside[:-1] & (holes[after[1:]] == holes[before[:-1]])
    known = whole & (np.diff(node_ns) <= LONGEST_NS)
    time_s = (times_ns - times_ns[0]) / 1e9
    at_s = (sensed.time_ns - times_ns[0]) / 1e9
    rate = _at(time_s, at_s, sensed.rate_rad_s)
    force = _at(time_s, at_s, sensed.force_mps2)
    first = np.clip(np.searchsorted(times_ns, node_ns[:-1]), 0, len(times_ns) - 1)
    stop = np.clip(np.searchsorted(times_ns, node_ns[1:]), 0, len(times_ns) - 1)
    owner = np.clip(np.searchsorted(node_ns, times_ns[:-1], side="right") - 1, 0, len(first) - 1)
    step_s = np.diff(time_s)[:, None]
    middle = (rate[1:] + rate[:-1]) / 2.0
    angle = _since(np.cumsum(middle * step_s, axis=0), first[owner])
    before = angle - middle * step_s
    # What rotation vectors miss of rotations that follow each other about other axes.
    coning = np.cross(before, middle) * (step_s / 2.0)
    turn = _sums(middle * step_s + coning, first, stop)
    half = (angle + before) / 2.0
    push = (force[1:] + force[:-1]) / 2.0
    aside = np.cross(half, push)
    push = (push + aside + np.cross(half, aside) / 2.0) * step_s
    speed = _since(np.cumsum(push, axis=0), first[owner])
    way = _sums((speed - push / 2.0) * step_s, first, stop)
    found = (turn, _sums(push, first, stop), way)
    return Increments(*(np.where(known[:, None], values, np.nan) for values in found))


def _at(time_s: Float64, at_s: Float64, values: Float32) -> Float64:
    return np.stack([np.interp(time_s, at_s, column) for column in values.T], axis=1)


def _since(total: Float64, first: Int64) -> Float64:
    """Running sums [m, 3] counted from the start of the interval that each step lies in."""
    return np.asarray(total - np.vstack([np.zeros((1, 3)), total])[first])


def _sums(steps: Float64, first: Int64, stop: Int64) -> Float64:
    total = np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return np.asarray(total[stop] - total[first])


def sample_noise(values: Float32, time_ns: Int64) -> float:
    """White noise of samples [n, 3] along one axis, times √s: what their integral wanders by
    in a second. From second differences, of which motion leaves the middle ones alone."""
    if len(values) < 8:
        return 0.0
    second = values[2:] - 2.0 * values[1:-1] + values[:-2]
    spread = float(np.median(np.abs(second))) / 0.6745 / np.sqrt(6.0)
    return float(spread * np.sqrt(np.median(np.diff(time_ns)) / 1e9))
