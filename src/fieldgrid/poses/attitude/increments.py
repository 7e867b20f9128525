"""What gyro and accelerometer say from node to node: turn and change of speed.

Integrated once, in the vehicle's axes at the earlier node, so that the estimate can linearise
again without going back to the samples (Forster et al., On-Manifold Preintegration, 2017). Nodes
are at most some tenths of a second apart: rotations within an interval are small, and second
order in them is enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float32, Float64, Int64
from fieldgrid.geometry import Inertial

HOLE_NS = 250_000_000
"""Over a longer hole in its samples an IMU says nothing."""

LONGEST_NS = 1_000_000_000
"""Longer intervals are not of nodes that were laid for an IMU: rotations within are not small."""


class Increments(NamedTuple):
    """From node to node, [n - 1, 3] each: rotation vector (rad) and change of speed (m/s) by
    specific force alone, gravity not taken off; NaN where there was no sample."""

    turn_rad: Float64
    speed_mps: Float64


def increments(sensed: Inertial, node_ns: Int64) -> Increments:
    """The samples integrated over each interval between nodes."""
    at_ns = sensed.time_ns
    if len(at_ns) < 2 or len(node_ns) < 2:
        unknown = np.full((max(len(node_ns) - 1, 0), 3), np.nan)
        return Increments(unknown, unknown)
    # Nodes join the samples, so that every interval is a whole number of steps.
    times_ns = np.union1d(at_ns, node_ns[(node_ns > at_ns[0]) & (node_ns < at_ns[-1])])
    at = np.minimum(np.searchsorted(times_ns, node_ns), len(times_ns) - 1)
    first, stop = at[:-1], at[1:]
    owner = np.clip(np.searchsorted(node_ns, times_ns[:-1], side="right") - 1, 0, len(first) - 1)
    time_s = (times_ns - at_ns[0]) / 1e9
    step_s = np.diff(time_s)[:, None]
    rate, force = (
        np.stack([np.interp(time_s, (at_ns - at_ns[0]) / 1e9, axis) for axis in values.T], axis=1)
        for values in (sensed.rate_rad_s, sensed.force_mps2)
    )
    rate, force = (rate[1:] + rate[:-1]) / 2.0, (force[1:] + force[:-1]) / 2.0
    angle = np.vstack([np.zeros((1, 3)), np.cumsum(rate * step_s, axis=0)])
    before = angle[:-1] - angle[first[owner]]
    # What rotation vectors miss of rotations that follow each other about other axes.
    turn = (rate + np.cross(before, rate) / 2.0) * step_s
    half = before + rate * step_s / 2.0
    aside = np.cross(half, force)
    push = (force + aside + np.cross(half, aside) / 2.0) * step_s
    known = _is_whole(at_ns, node_ns)[:, None]
    sums = (np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)]) for steps in (turn, push))
    return Increments(*(np.where(known, total[stop] - total[first], np.nan) for total in sums))


def _is_whole(at_ns: Int64, node_ns: Int64) -> Bool:
    """Whether samples lie around each interval between nodes and throughout it, [n - 1]."""
    holes = np.concatenate([[0], np.cumsum(np.diff(at_ns) > HOLE_NS)])
    before = holes[np.maximum(np.searchsorted(at_ns, node_ns, side="right") - 1, 0)]
    after = holes[np.minimum(np.searchsorted(at_ns, node_ns), len(at_ns) - 1)]
    inside = (node_ns >= at_ns[0]) & (node_ns <= at_ns[-1])
    near = np.diff(node_ns) <= LONGEST_NS
    return np.asarray(inside[1:] & inside[:-1] & (after[1:] == before[:-1]) & near)


def sample_noise(values: Float32, time_ns: Int64) -> float:
    """White noise of samples [n, 3] along one axis, times √s: what their integral wanders by
    in a second. From second differences, of which motion leaves the middle ones alone."""
    if len(values) < 8:
        return 0.0
    second = values[2:] - 2.0 * values[1:-1] + values[:-2]
    spread = float(np.median(np.abs(second))) / 0.6745 / np.sqrt(6.0)
    return float(spread * np.sqrt(np.median(np.diff(time_ns)) / 1e9))
