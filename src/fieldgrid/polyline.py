"""Polylines [n, 2] in metres: how far along, at equal steps, sideways."""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Float64


def lengths(line: Float64) -> Float64:
    """How far along the line each of its points is, metres, from 0."""
    step = np.diff(line, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])


def resampled(line: Float64, step_m: float) -> Float64:
    """The same line by points at equal distances of about `step_m`, its ends included."""
    s = lengths(line)
    at = np.linspace(0.0, s[-1], max(2, round(float(s[-1]) / step_m) + 1))
    return np.column_stack([np.interp(at, s, line[:, 0]), np.interp(at, s, line[:, 1])])


def normals(line: Float64) -> Float64:
    """Unit vectors [n, 2] to the left of the direction of travel at each point."""
    along = np.gradient(line, axis=0)
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
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
    s = lengths(line)
    a, step = line[:-1], np.diff(line, axis=0)
    size = np.hypot(step[:, 0], step[:, 1])
    unit = step / size[:, None]
    offset = points_m[:, None] - a[None]
    along = (offset * unit[None]).sum(axis=2)
    inner = np.clip(along, 0.0, size[None])
    inner[:, 0] = np.minimum(along[:, 0], size[0])
    inner[:, -1] = np.maximum(along[:, -1], 0.0) if len(size) > 1 else along[:, -1]
    foot = inner[:, :, None] * unit[None]
    apart = np.hypot(*(offset - foot).transpose(2, 0, 1))
    best = apart.argmin(axis=1)
    rows = np.arange(len(points_m))
    left = unit[best, 0] * offset[rows, best, 1] - unit[best, 1] * offset[rows, best, 0]
    return s[best] + inner[rows, best], left
