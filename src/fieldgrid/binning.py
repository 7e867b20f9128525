"""Points to counts: how many lie on the ground of each cell of a local grid, and in its slice.

From an image of depths in one go, without the points in between; from a cloud point by point.
The references in NumPy are what the compiled loops are held to.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Bool, Float32, Int16, Int32
from fieldgrid.cloud import Cloud
from fieldgrid.kernel import kernel

LOWEST_M = np.float32(-0.5)
"""Points that are further below the ground of their cell than this are mistakes."""


@kernel
def bin_pixels(  # type: ignore[no-untyped-def]
    disparity, row_start, depth_m, ray, du, dv, offset_m, ground_m, cell_m, bottom_m, top_m
):
    """From disparity to counts, fused: points on the ground and in the slice of each cell.

    Returns int32 [n_y, n_x, 2]: [..., 1] counts the points from `bottom_m` to `top_m` above
    the cell's ground, [..., 0] those from 0.5 m below it up to `bottom_m`. Three short loops
    a row, because the middle one then runs in vector registers. Single precision: 2^-24 of
    15 m is a micrometre.
    """
    n_y, n_x = ground_m.shape
    width = disparity.shape[1]
    counts = np.zeros((n_y, n_x, 2), dtype=np.int32)
    flat_counts, flat_ground = counts.reshape(-1), ground_m.reshape(-1)
    per_cell = np.float32(1.0 / cell_m)
    dx, dy, dz = du[0] * per_cell, du[1] * per_cell, du[2]
    x0, y0, z0 = offset_m[0] * per_cell + np.float32(0.5 * n_x), offset_m[1] * per_cell, offset_m[2]
    depth, height = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
    cell = np.empty(width, dtype=np.int32)
    for row in range(disparity.shape[0]):
        v = np.float32(row + row_start)
        rx, ry = (ray[0] + v * dv[0]) * per_cell, (ray[1] + v * dv[1]) * per_cell
        rz = ray[2] + v * dv[2]
        for u in range(width):
            depth[u] = depth_m[max(disparity[row, u], 0)]
        for u in range(width):
            z, uf = depth[u], np.float32(u)
            x, y = z * (rx + uf * dx) + x0, z * (ry + uf * dy) + y0
            inside = (x >= 0.0) & (y >= 0.0) & (x < n_x) & (y < n_y)
            cell[u] = np.int32(y) * n_x + np.int32(x) if inside else -1
            height[u] = z * (rz + uf * dz) + z0
        for u in range(width):
            k = cell[u]
            if k >= 0:
                above = height[u] - flat_ground[k]
                if above > LOWEST_M and above < top_m:
                    flat_counts[2 * k + (1 if above > bottom_m else 0)] += 1
    return counts


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


@kernel
def bin_points(level_m, ground_m, cell_m, bottom_m, top_m):  # type: ignore[no-untyped-def]
    """The same of points in the level frame, float32 [n, 3]: counts, int32 [n_y, n_x, 2]."""
    n_y, n_x = ground_m.shape
    counts = np.zeros((n_y, n_x, 2), dtype=np.int32)
    per_cell, x0 = np.float32(1.0 / cell_m), np.float32(0.5 * n_x)
    for k in range(level_m.shape[0]):
        x, y = level_m[k, 0] * per_cell + x0, level_m[k, 1] * per_cell
        if x >= 0.0 and y >= 0.0 and x < n_x and y < n_y:  # never, where one is NaN
            r, c = int(y), int(x)
            above = level_m[k, 2] - ground_m[r, c]
            if above > LOWEST_M and above < top_m:
                counts[r, c, 1 if above > bottom_m else 0] += 1
    return counts


def bin_points_reference(
    level_m: Cloud, ground_m: Float32, cell_m: float, bottom_m: np.float32, top_m: np.float32
) -> Int32:
    """The same as `bin_points`, in NumPy."""
    per_cell = np.float32(1.0 / cell_m)
    x = level_m[:, 0] * per_cell + np.float32(0.5 * ground_m.shape[1])
    return _count(x, level_m[:, 1] * per_cell, level_m[:, 2], ground_m, bottom_m, top_m)


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
    return np.stack([ground, count((above > bottom_m) & (above < top_m))], axis=-1)
