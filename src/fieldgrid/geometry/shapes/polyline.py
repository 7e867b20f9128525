"""Polylines [n, 2] in metres: how far along, at equal steps, sideways, far enough from a point."""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import Float64, Int64, kernel


def lengths(line: Float64) -> Float64:
    """How far along the line each of its points is, metres, from 0."""
    step = line[1:] - line[:-1]
    s = np.zeros(len(line))
    np.cumsum(np.hypot(step[:, 0], step[:, 1]), out=s[1:])
    return s


def resampled(line: Float64, step_m: float) -> Float64:
    """The line as points at equal distances of about `step_m`, with its ends."""
    s = lengths(line)
    at = np.linspace(0.0, s[-1], max(2, round(float(s[-1]) / step_m) + 1))
    return np.column_stack([np.interp(at, s, line[:, 0]), np.interp(at, s, line[:, 1])])


def normals(line: Float64) -> Float64:
    """Unit vectors [n, 2] to the left of the direction of travel at each point.

    A point between two that are the same, as where points repeat, has that of the next point that
    has one, or of the last; a line that goes nowhere has none, and zeros.
    """
    along = np.gradient(line, axis=0)
    size = np.hypot(along[:, 0], along[:, 1])
    told = np.flatnonzero(size > 0.0)
    if not len(told):
        return np.zeros_like(along)
    at = told[np.minimum(np.searchsorted(told, np.arange(len(line))), len(told) - 1)]
    along = along[at] / size[at, None]
    return np.column_stack([-along[:, 1], along[:, 0]])


def extended(line: Float64, before_m: float, after_m: float) -> Float64:
    """The line carried on straight at both ends, in the direction of its last 6 m."""
    s = lengths(line)
    reach = min(6.0, float(s[-1]))
    head, tail = (
        np.array([np.interp(at, s, line[:, k]) for k in (0, 1)]) for at in (reach, s[-1] - reach)
    )
    out = np.array([line[0] - head, line[-1] - tail])
    out /= np.hypot(out[:, 0], out[:, 1])[:, None]
    first = [line[0] + before_m * out[0]] if before_m > 0.0 else []
    last = [line[-1] + after_m * out[1]] if after_m > 0.0 else []
    return np.array([*first, *line, *last])


def part(line: Float64, start_m: float, stop_m: float) -> Float64:
    """The stretch of a line between two distances along it."""
    s = lengths(line)
    inside = (s > start_m) & (s < stop_m)
    at = np.concatenate([[start_m], s[inside], [stop_m]])
    return np.column_stack([np.interp(at, s, line[:, 0]), np.interp(at, s, line[:, 1])])


def project(points_m: Float64, line: Float64) -> tuple[Float64, Float64]:
    """How far along a line each point [n, 2] lies, and how far to its left; ends carried on."""
    along, left = np.empty(len(points_m)), np.empty(len(points_m))
    points, line = (np.ascontiguousarray(p, dtype=np.float64) for p in (points_m, line))
    project_points(points, line, np.full(len(points), np.inf), along, left)
    return along, left


@kernel
def project_points(points, line, nearest, along, left):  # type: ignore[no-untyped-def]
    """Write along and left of each point: of its nearest piece of the line, the first of equals.
    `nearest` is infinite at first."""
    last, before = len(line) - 2, 0.0
    for k in range(last + 1):
        step_x, step_y = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
        size = math.sqrt(step_x * step_x + step_y * step_y)
        unit_x, unit_y = step_x / size, step_y / size
        low, high = 0.0 if k > 0 else -np.inf, size if k < last else np.inf
        for p in range(len(points)):
            x, y = points[p, 0] - line[k, 0], points[p, 1] - line[k, 1]
            at = min(max(x * unit_x + y * unit_y, low), high)
            apart = (x - at * unit_x) ** 2 + (y - at * unit_y) ** 2
            if apart < nearest[p]:
                nearest[p] = apart
                along[p], left[p] = before + at, unit_x * y - unit_y * x
        before += size


def first_beyond(points: Float64, reach_m: float, step: int, parts: Int64 | None = None) -> Int64:
    """For each of n points the nearest index before (step -1) or after (+1) it that is `reach_m`
    away and of the same part, [n]; -1 where there is none. `parts` numbers the parts [n]; without
    it all points are one.

    By distance and not by length of path: a vehicle that stands still draws a long path.
    """
    numbers = np.zeros(len(points), np.int64) if parts is None else parts
    return np.asarray(find_first_beyond(points, numbers, reach_m, step))


@kernel
def find_first_beyond(points, parts, reach_m, step):  # type: ignore[no-untyped-def]
    """The loop of :func:`first_beyond`."""
    n = points.shape[0]
    found = np.empty(n, dtype=np.int64)
    for k in range(n):
        found[k], i = -1, k + step
        while 0 <= i < n and parts[i] == parts[k]:
            d_east, d_north = points[i, 0] - points[k, 0], points[i, 1] - points[k, 1]
            if d_east * d_east + d_north * d_north >= reach_m * reach_m:
                found[k] = i
                break
            i += step
    return found
