"""From chains of segments to reference lines: one polyline a row, holes bridged."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import cKDTree

from fieldgrid.array_types import Float64, Int64
from fieldgrid.polyline import lengths, resampled
from fieldgrid.rows.crops import Crop
from fieldgrid.rows.segments import Segments

_STEP_M = 2.0
_MAX_TURN_RAD = np.radians(8.0)


def reference_lines(segments: Segments, chain: Int64, crop: Crop) -> list[Float64]:
    """A polyline [n, 2] for each chain that is long enough for a row, then joined over holes."""
    lines = []
    for k in range(int(chain.max()) + 1 if len(chain) else 0):
        line = _ordered(segments, np.flatnonzero(chain == k))
        if lengths(line)[-1] >= 0.6 * crop.min_row_m:
            lines.append(line)
    return _without_doubles(_bridged(lines, crop), crop)


def _ordered(segments: Segments, members: Int64) -> Float64:
    """The segments of one chain, from one end to the other, as a smooth line through all.

    How far along the row a segment lies follows from its neighbours step by step, so a row may
    turn by any angle.
    """
    middle, along = segments.middle_m[members], segments.along[members].copy()
    half, weight = segments.half_m[members], segments.support[members].astype(np.float64)
    s = np.zeros(len(members))
    if len(members) > 1:
        gap = np.hypot(*(np.subtract.outer(v, v) for v in middle.T))
        # Zero would be no edge. The shortest tree follows a curve from neighbour to neighbour.
        tree = minimum_spanning_tree(gap + 1e-6)
        order, before = breadth_first_order(tree, int(weight.argmax()), directed=False)
        for k in order[1:]:
            parent = before[k]
            if along[k] @ along[parent] < 0.0:
                along[k] = -along[k]
            mean = along[k] + along[parent]
            s[k] = s[parent] + (middle[k] - middle[parent]) @ mean / np.hypot(*mean)
    low, high = float((s - half).min()), float((s + half).max())
    at = np.linspace(low, high, max(2, round((high - low) / _STEP_M) + 1))
    ahead = at[:, None] - s[None]
    # A segment speaks for itself, and fades into the next one.
    pull = weight * np.exp(-0.5 * (ahead / (0.6 * half + 0.5)) ** 2) + 1e-12
    pull /= pull.sum(axis=1, keepdims=True)
    points = middle[None] + ahead[:, :, None] * along[None]
    line: Float64 = (pull[:, :, None] * points).sum(axis=1)
    return line


def _bridged(lines: list[Float64], crop: Crop) -> list[Float64]:
    """Lines that go on in each other across a hole become one; the shortest holes first."""
    while len(lines) > 1:
        tips = np.concatenate([[line[0], line[-1]] for line in lines])
        outward = np.concatenate([_outward(line) for line in lines])
        pairs = cKDTree(tips).query_pairs(crop.max_bridge_m, output_type="ndarray")
        pairs = pairs[pairs[:, 0] // 2 != pairs[:, 1] // 2]
        a, b = pairs.T
        step = tips[b] - tips[a]
        apart = np.hypot(step[:, 0], step[:, 1])
        facing = (outward[a] * outward[b]).sum(axis=1) < -np.cos(_MAX_TURN_RAD)
        # Lines may also overlap by a little where a direction was found twice.
        onward = (step * outward[a]).sum(axis=1)
        off = [np.abs(step[:, 0] * outward[k, 1] - step[:, 1] * outward[k, 0]) for k in (a, b)]
        straight = np.maximum(*off) <= 0.2 * crop.min_spacing_m + 0.02 * apart
        good = facing & straight & (onward > -0.25 * crop.patch_m)
        if not good.any():
            return lines
        best = np.flatnonzero(good)[apart[good].argmin()]
        first, second = int(a[best]), int(b[best])
        head = lines[first // 2] if first % 2 else lines[first // 2][::-1]
        tail = lines[second // 2] if second % 2 == 0 else lines[second // 2][::-1]
        if onward[best] < 0.0:
            tail = tail[((tail - head[-1]) @ outward[first]) > 0.0]
        joined = resampled(np.concatenate([head, tail]), _STEP_M)
        rest = {first // 2, second // 2}
        lines = [line for k, line in enumerate(lines) if k not in rest] + [joined]
    return lines


def _outward(line: Float64) -> Float64:
    """Unit vectors [2, 2] that point out of a line at its first and its last point."""
    s = lengths(line)
    reach = min(8.0, float(s[-1]))
    inner = [np.interp(at, s, line[:, k]) for at in (reach, s[-1] - reach) for k in (0, 1)]
    out = np.array([line[0] - inner[:2], line[-1] - inner[2:]])
    unit: Float64 = out / np.hypot(out[:, 0], out[:, 1])[:, None]
    return unit


def _without_doubles(lines: list[Float64], crop: Crop) -> list[Float64]:
    """Of lines that run beside each other closer than rows can, the longest is kept."""
    if len(lines) < 2:
        return lines
    lines = sorted(lines, key=lambda line: -lengths(line)[-1])
    fine = [resampled(line, 0.5) for line in lines]
    owner = np.repeat(np.arange(len(lines)), [len(line) for line in fine])
    points = np.concatenate(fine)
    pairs = cKDTree(points).query_pairs(0.5 * crop.min_spacing_m, output_type="ndarray")
    mine, other = owner[pairs].T
    low, high = np.minimum(mine, other), np.maximum(mine, other)
    differs = low != high
    # How many points of the shorter line lie on the longer one.
    doubled = np.unique(
        np.column_stack([low, high, np.where(mine > other, pairs[:, 0], pairs[:, 1])])[differs],
        axis=0,
    )
    kept = np.ones(len(lines), dtype=np.bool_)
    for k in range(1, len(lines)):
        own = doubled[(doubled[:, 1] == k) & kept[doubled[:, 0]]]
        kept[k] = len(np.unique(own[:, 2])) < 0.5 * len(fine[k])
    return [line for line, keep in zip(lines, kept, strict=True) if keep]
