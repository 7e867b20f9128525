"""Points to counts: how many lie on the ground of each cell of a local grid, and in its slice.

From an image of depths or from a cloud, in one go, without the points in between. Two things keep
the loops fast: the arithmetic is in loops without a branch, which run in vector registers, and
their results go through arrays that a kernel makes itself, of which the compiler knows that
nothing else points into them.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import kernel

LOWEST_M = np.float32(-0.5)
"""Points that are further below the ground of their cell than this are mistakes."""

BLOCK_POINTS = 1024
"""Points of a cloud in one block: they stay in the fastest cache."""


@kernel
def bin_pixels(  # type: ignore[no-untyped-def]
    disparity, row_start, depth_m, ray, du, dv, offset_m, ground_m, cell_m, bottom_m, top_m
):
    """From disparity to counts, fused: points on the ground and in the slice of each cell.

    Returns int32 [2, n_y, n_x]: [1] counts the points from `bottom_m` to `top_m` above the cell's
    ground, [0] those from 0.5 m below it up to `bottom_m`. Single precision: 2^-24 of 15 m is a
    micrometre.
    """
    n_y, n_x = ground_m.shape
    width = disparity.shape[1]
    cells = n_y * n_x
    counts, flat_ground = np.empty(2 * cells, dtype=np.int32), ground_m.reshape(-1)
    for k in range(2 * cells):
        counts[k] = 0
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
                    counts[k + (cells if above > bottom_m else 0)] += 1
    return counts.reshape((2, n_y, n_x))


@kernel
def bin_points(points, R_level_sensor, height_m, ground_m, cell_m, bottom_m, top_m):  # type: ignore[no-untyped-def]
    """Bin points float32 [n, 3] in the sensor's frame, `height_m` above the ground's plane.

    Points come in any order, so a processor guesses badly which of them are counted. Those inside
    are moved together, and those beyond the slice are counted in a place that nobody reads.
    """
    n_y, n_x = ground_m.shape
    n, cells = points.shape[0], n_y * n_x
    counts, spare = np.empty(2 * cells + 1, dtype=np.int32), 2 * cells
    for k in range(spare):
        counts[k] = 0
    flat_points, flat_ground = points.reshape(-1), ground_m.reshape(-1)
    per_cell, x0, up = np.float32(1.0 / cell_m), np.float32(0.5 * n_x), np.float32(height_m)
    R = R_level_sensor
    ax, ay, az, bx, by, bz = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    cx, cy, cz = R[2, 0], R[2, 1], R[2, 2]
    px, py = np.empty(BLOCK_POINTS, dtype=np.float32), np.empty(BLOCK_POINTS, dtype=np.float32)
    pz, height = np.empty(BLOCK_POINTS, dtype=np.float32), np.empty(BLOCK_POINTS, dtype=np.float32)
    cell = np.empty(BLOCK_POINTS, dtype=np.int32)
    for start in range(0, n, BLOCK_POINTS):
        size = min(BLOCK_POINTS, n - start)
        for k in range(size):
            px[k] = flat_points[3 * (start + k)]
            py[k] = flat_points[3 * (start + k) + 1]
            pz[k] = flat_points[3 * (start + k) + 2]
        for k in range(size):
            x = (ax * px[k] + ay * py[k] + az * pz[k]) * per_cell + x0
            y = (bx * px[k] + by * py[k] + bz * pz[k]) * per_cell
            inside = (x >= 0.0) & (y >= 0.0) & (x < n_x) & (y < n_y)  # never, where one is NaN
            cell[k] = np.int32(y) * n_x + np.int32(x) if inside else -1
            height[k] = cx * px[k] + cy * py[k] + cz * pz[k] + up
        kept = 0
        for k in range(size):
            cell[kept], height[kept] = cell[k], height[k]
            kept += 1 if cell[k] >= 0 else 0
        for k in range(kept):
            above = height[k] - flat_ground[cell[k]]
            place = cell[k] + (cells if above > bottom_m else 0)
            cell[k] = place if (above > LOWEST_M) & (above < top_m) else spare
        for k in range(kept):
            counts[cell[k]] += 1
    return counts[:-1].reshape((2, n_y, n_x))
