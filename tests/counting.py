"""Counts by cell in NumPy, with histogram2d: what the kernels of `binning` are held to."""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Bool, Float32, Int16, Int32
from fieldgrid.perception.binning import LOWEST_M
from fieldgrid.perception.cloud import Cloud


def bin_pixels_reference(
    disparity: Int16,
    row_start: int,
    depth_m: Float32,
    ray: Float32,
    du: Float32,
    dv: Float32,
    offset_m: Float32,
    ground_m: Float32,
    cell_m: float,
    bottom_m: np.float32,
    top_m: np.float32,
) -> Int32:
    """The same as `bin_pixels`, in NumPy, with histogram2d doing the counting."""
    row, u = np.nonzero(disparity > 0)
    depth = depth_m[disparity[row, u]]
    v, u = (row + row_start).astype(np.float32), u.astype(np.float32)
    per_cell = np.float32(1.0 / cell_m)
    middle = np.float32(0.5 * ground_m.shape[1])
    x = depth * ((ray[0] + v * dv[0]) * per_cell + u * (du[0] * per_cell))
    x = x + (offset_m[0] * per_cell + middle)
    y = depth * ((ray[1] + v * dv[1]) * per_cell + u * (du[1] * per_cell))
    y = y + offset_m[1] * per_cell
    z = depth * (ray[2] + v * dv[2] + u * du[2]) + offset_m[2]
    return _count(x, y, z, ground_m, bottom_m, top_m)


def bin_points_reference(
    points: Cloud,
    R_level_sensor: Float32,
    height_m: float,
    ground_m: Float32,
    cell_m: float,
    bottom_m: np.float32,
    top_m: np.float32,
) -> Int32:
    """The same as `bin_points`, in NumPy."""
    R, (x, y, z) = R_level_sensor, points.T
    level_x, level_y, level_z = (R[k, 0] * x + R[k, 1] * y + R[k, 2] * z for k in range(3))
    per_cell = np.float32(1.0 / cell_m)
    x = level_x * per_cell + np.float32(0.5 * ground_m.shape[1])
    return _count(x, level_y * per_cell, level_z + np.float32(height_m), ground_m, bottom_m, top_m)


def _count(
    x: Float32,
    y: Float32,
    z: Float32,
    ground_m: Float32,
    bottom_m: np.float32,
    top_m: np.float32,
) -> Int32:
    """Counts of points at x and y in cells and z in metres."""
    n_y, n_x = ground_m.shape
    inside = (x >= 0) & (y >= 0) & (x < n_x) & (y < n_y)
    c, r = x[inside].astype(np.intp), y[inside].astype(np.intp)
    above = z[inside] - ground_m[r, c]

    def count(mask: Bool) -> Int32:
        edges = (np.arange(n_y + 1), np.arange(n_x + 1))
        counted: Int32
        counted = np.histogram2d(r[mask], c[mask], bins=edges)[0].astype(np.int32)
        return counted

    ground = count((above > LOWEST_M) & (above <= bottom_m) & (above < top_m))
    return np.stack([ground, count((above > bottom_m) & (above < top_m))])
