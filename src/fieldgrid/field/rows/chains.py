"""From chains of segments to reference lines: one polyline a row, holes bridged."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree
from scipy.spatial import cKDTree

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.field.rows.crops import Crop
from fieldgrid.field.rows.segments import Segments
from fieldgrid.geometry import lengths, part, resampled

_STEP_M = 2.0
_MAX_TURN_RAD = np.radians(8.0)

_ARC_M = 10.0
"""Lines that bend are joined over holes up to this; it is also what tells of their bends."""


def reference_lines(segments: Segments, chain: Int64, crop: Crop) -> list[Float64]:
    """A polyline [n, 2] for each chain that is long enough for a row, then joined over holes."""
    lines = []
    for k in range(int(chain.max()) + 1 if len(chain) else 0):
        line = _ordered(segments, np.flatnonzero(chain == k))
        if lengths(line)[-1] >= 0.6 * crop.min_row_m:
            lines.append(line)
    bridged = _bridged(lines, crop)
    return [bridged[k] for k in without_doubles(bridged, crop)]


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
    return np.asarray((pull[:, :, None] * points).sum(axis=1))


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
        meeting = facing & (np.maximum(*off) <= 0.2 * crop.min_spacing_m + 0.02 * apart)
        near = np.flatnonzero(apart <= _ARC_M)
        meeting[near] |= _in_arcs(lines, pairs[near], crop)
        good = meeting & (onward > -0.25 * crop.patch_m)
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


def _in_arcs(lines: list[Float64], pairs: Int64, crop: Crop) -> Bool:
    """Of pairs of tips [n, 2], whether the lines go on in each other as they bend: half-way between
    them both come to the same place, in the same direction."""
    ends = {tip: _End.of(lines[tip // 2], at_last=bool(tip % 2)) for tip in np.unique(pairs)}
    found = np.zeros(len(pairs), dtype=np.bool_)
    for k, (a, b) in enumerate(pairs):
        one, other = ends[a], ends[b]
        onward = float((other.tip_m - one.tip_m) @ one.out)
        (here, ahead), (there, back) = one.after(0.5 * onward), other.after(0.5 * onward)
        off = float(np.hypot(*(there - here)))
        found[k] = off <= 0.25 * crop.min_spacing_m and ahead @ back < -np.cos(_MAX_TURN_RAD)
    return found


class _End(NamedTuple):
    """The end of a line, the direction out of it, and how the line bends there, 1/m to the left."""

    tip_m: Float64
    out: Float64
    bend: float

    @classmethod
    def of(cls, line: Float64, *, at_last: bool) -> _End:
        """By a parabola through the last metres of a line."""
        ordered = line if at_last else line[::-1]
        s = lengths(ordered)
        last = resampled(part(ordered, max(0.0, float(s[-1]) - _ARC_M), float(s[-1])), 1.0)
        step = last[-1] - last[0]
        along = step / np.hypot(*step)
        across = np.array([-along[1], along[0]])
        u, v = (last - last[-1]) @ along, (last - last[-1]) @ across
        half_bend, slope, off = np.polyfit(u, v, 2) if len(last) > 3 else (0.0, 0.0, 0.0)
        out = along + slope * across
        return cls(last[-1] + off * across, out / np.hypot(*out), float(2.0 * half_bend))

    def after(self, way_m: float) -> tuple[Float64, Float64]:
        """Where the line comes to beyond its end, and in which direction."""
        left = np.array([-self.out[1], self.out[0]])
        turn = self.bend * way_m
        ahead = np.cos(turn) * self.out + np.sin(turn) * left
        return self.tip_m + way_m * (self.out + 0.5 * turn * left), ahead


def _outward(line: Float64) -> Float64:
    """Unit vectors [2, 2] that point out of a line at its first and its last point."""
    s = lengths(line)
    reach = min(8.0, float(s[-1]))
    inner = [np.interp(at, s, line[:, k]) for at in (reach, s[-1] - reach) for k in (0, 1)]
    out = np.array([line[0] - inner[:2], line[-1] - inner[2:]])
    return np.asarray(out / np.hypot(out[:, 0], out[:, 1])[:, None])


def without_doubles(lines: list[Float64], crop: Crop) -> list[int]:
    """The numbers of the lines, the longest first; of those that run beside each other closer than
    rows can, the longest is kept."""
    if len(lines) < 2:
        return list(range(len(lines)))
    order = sorted(range(len(lines)), key=lambda k: -lengths(lines[k])[-1])
    # Points of two lines that run side by side are at most half a step apart along them.
    step_m = min(0.5, 0.3 * crop.min_spacing_m)
    fine = [resampled(lines[k], step_m) for k in order]
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
    return [k for k, keep in zip(order, kept, strict=True) if keep]
