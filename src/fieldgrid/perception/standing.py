"""What stands above the ground of one frame: how high it reaches, and how low it begins.

Heights are collected on blocks of a local grid, in bins of 10 cm above the ground of the block, so
that no single false match tells a height.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Int32, UInt8, kernel
from fieldgrid.geometry import GROUND_BELOW

BLOCK_M = 0.2
"""Side of the blocks."""

BINS_PER_M = 10

LOWEST_M = np.float32(-0.2)
"""Points from here up to the bottom of the slice are the ground of a block."""

STEP_PX = 2
"""Every second pixel of every second row is enough."""


@kernel
def stack_pixels(  # type: ignore[no-untyped-def]
    disparity, row_start, depth_m, ray, du, dv, offset_m, ground_m, block_m, bottom_m, top_m, counts
):
    """Count the points of blocks by their height above `ground_m` [n_y, n_x], in `counts`, int32
    [n_y, n_x, bins].

    Bin k holds those of the slice from k to k + 1 decimetres, and bin 1 lower ones, too; bin 0 has
    the ground.
    """
    n_y, n_x = ground_m.shape
    per_block, per_m = np.float32(1.0 / block_m), np.float32(BINS_PER_M)
    x0 = offset_m[0] * per_block + np.float32(0.5 * n_x)
    for row in range(0, disparity.shape[0], STEP_PX):
        v = np.float32(row + row_start)
        rx, ry, rz = ray[0] + v * dv[0], ray[1] + v * dv[1], ray[2] + v * dv[2]
        for u in range(0, disparity.shape[1], STEP_PX):
            d = disparity[row, u]
            if d > 0:
                depth, uf = depth_m[d], np.float32(u)
                x = depth * (rx + uf * du[0]) * per_block + x0
                y = (depth * (ry + uf * du[1]) + offset_m[1]) * per_block
                if x >= 0.0 and y >= 0.0 and x < n_x and y < n_y:
                    j, i = int(y), int(x)
                    above = depth * (rz + uf * du[2]) + offset_m[2] - ground_m[j, i]
                    if above > LOWEST_M and above < top_m:  # never, where no ground is known
                        counts[j, i, max(int(above * per_m), 1) if above > bottom_m else 0] += 1


@kernel
def stack_points(points, R_level_sensor, height_m, ground_m, block_m, bottom_m, top_m, counts):  # type: ignore[no-untyped-def]
    """Stack points float32 [n, 3] in the sensor's frame, `height_m` above the ground's plane;
    all of them."""
    n_y, n_x = ground_m.shape
    per_block, per_m = np.float32(1.0 / block_m), np.float32(BINS_PER_M)
    x0, up, R = np.float32(0.5 * n_x), np.float32(height_m), R_level_sensor
    for k in range(points.shape[0]):
        px, py, pz = points[k, 0], points[k, 1], points[k, 2]
        x = (R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz) * per_block + x0
        y = (R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz) * per_block
        if x >= 0.0 and y >= 0.0 and x < n_x and y < n_y:
            j, i = int(y), int(x)
            above = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz + up - ground_m[j, i]
            if above > LOWEST_M and above < top_m:
                counts[j, i, max(int(above * per_m), 1) if above > bottom_m else 0] += 1


def reach_dm(counts: Int32, needed: Int32) -> tuple[UInt8, UInt8]:
    """How high what stands in each block reaches, and how low it begins, decimetres above the
    ground, both [n_y, n_x], 0 where nothing stands.

    A bin counts from `needed` points on [2, n_y, n_x], of the ground and of what stands. To the
    lower height `GROUND_BELOW` is added where the ground below shows: so there is room.
    """
    stands = counts >= needed[1][..., None]
    stands[..., 0] = False
    bins = counts.shape[2]
    foot = stands.argmax(axis=2)  # bin 0, where nothing stands, is none of what stands
    any_stands = foot > 0
    top = np.where(any_stands, bins - stands[..., ::-1].argmax(axis=2), 0)
    below = any_stands & (counts[..., 0] >= needed[0])
    return top.astype(np.uint8), (foot + GROUND_BELOW * below).astype(np.uint8)
