"""Where the corners of an image are: spread over it, between pixels."""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import Float64, UInt8, kernel, part_of_kernel

BORDER_PX = 4
"""No corner lies so near to the edge of its image."""

PER_PRODUCT = np.float32(0.5 / (4.0 * 5.0 * 255.0) ** 2)
"""Makes strengths of sums of products those of OpenCV's `cornerMinEigenVal`, of images from 0 to 1;
half, for the mean of two."""


def find_corners(image: UInt8, cell_px: int, least: float) -> Float64:
    """The strongest corner above `least` of each cell of an image, [n, 2] column and row."""
    height, width = image.shape
    corners = np.empty((-(-height // cell_px) * -(-width // cell_px), 2))
    strength = np.zeros((height, width), dtype=np.float32)
    found: Float64 = corners[: _find_corners(image, cell_px, np.float32(least), strength, corners)]
    return found


@kernel
def _find_corners(image, cell_px, least, strength, corners):  # type: ignore[no-untyped-def]
    """Fill in strengths, which are zeros, and corners; return how many there are."""
    height, width = image.shape
    _fill_strength(image, strength)
    best, best_row = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.int32)
    n = 0
    for top in range(0, height, cell_px):
        for x in range(width):
            best[x] = least
        for row in range(max(top, BORDER_PX), min(top + cell_px, height - BORDER_PX)):
            for x in range(BORDER_PX, width - BORDER_PX):
                stronger = strength[row, x] > best[x]
                best[x] = strength[row, x] if stronger else best[x]
                best_row[x] = row if stronger else best_row[x]
        for start in range(0, width, cell_px):
            x = start
            for column in range(start, min(start + cell_px, width)):
                if best[column] > best[x]:
                    x = column
            if best[x] > least:
                y = best_row[x]
                # The strongest of a cell may lie on the slope of a stronger one next door.
                highest = best[x]
                for row in range(y - 1, y + 2):
                    for column in range(x - 1, x + 2):
                        highest = max(highest, strength[row, column])
                if highest == best[x]:
                    for axis in range(2):
                        dx, dy = 1 - axis, axis
                        before, after = strength[y - dy, x - dx], strength[y + dy, x + dx]
                        # Where the parabola through the three has its top: -0.5..0.5 from here.
                        curvature = before - 2.0 * highest + after
                        off = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
                        corners[n, axis] = (y if axis else x) + off
                    n += 1
    return n


@part_of_kernel
def _fill_strength(image, strength):  # type: ignore[no-untyped-def]
    """The smaller eigenvalue of the gradients' covariance over 5 x 5 px (Shi and Tomasi, 1994).

    Only five rows of products are kept, and their sums by column. 0 within 3 px of the edge.
    """
    height, width = image.shape
    across, down = np.empty(width, dtype=np.int32), np.empty(width, dtype=np.int32)
    last_xx, last_xy = np.empty(5 * width, dtype=np.int32), np.empty(5 * width, dtype=np.int32)
    last_yy = np.empty(5 * width, dtype=np.int32)
    sum_xx, sum_xy = np.empty(width, dtype=np.int32), np.empty(width, dtype=np.int32)
    sum_yy = np.empty(width, dtype=np.int32)
    for x in range(5 * width):
        last_xx[x] = last_xy[x] = last_yy[x] = 0
    for x in range(width):
        sum_xx[x] = sum_xy[x] = sum_yy[x] = 0
    for row in range(1, height - 1):
        for x in range(1, width - 1):
            a, b = np.int32(image[row - 1, x - 1]), np.int32(image[row - 1, x])
            c, d = np.int32(image[row - 1, x + 1]), np.int32(image[row, x - 1])
            e, f = np.int32(image[row, x + 1]), np.int32(image[row + 1, x - 1])
            g, h = np.int32(image[row + 1, x]), np.int32(image[row + 1, x + 1])
            across[x] = c + 2 * e + h - a - 2 * d - f
            down[x] = f + 2 * g + h - a - 2 * b - c
        last = np.uint64(row % 5 * width)
        for x in range(np.uint64(1), np.uint64(width - 1)):
            xx, xy, yy = across[x] * across[x], across[x] * down[x], down[x] * down[x]
            sum_xx[x] += xx - last_xx[last + x]
            sum_xy[x] += xy - last_xy[last + x]
            sum_yy[x] += yy - last_yy[last + x]
            last_xx[last + x], last_xy[last + x], last_yy[last + x] = xx, xy, yy
        if row >= 5:
            for x in range(3, width - 3):
                xx = sum_xx[x - 2] + sum_xx[x - 1] + sum_xx[x] + sum_xx[x + 1] + sum_xx[x + 2]
                xy = sum_xy[x - 2] + sum_xy[x - 1] + sum_xy[x] + sum_xy[x + 1] + sum_xy[x + 2]
                yy = sum_yy[x - 2] + sum_yy[x - 1] + sum_yy[x] + sum_yy[x + 1] + sum_yy[x + 2]
                # From 32 bits, since few processors convert 64 in vectors.
                mean = np.float32(np.int32(xx + yy)) * PER_PRODUCT
                half, mixed = (
                    np.float32(np.int32(xx - yy)) * PER_PRODUCT,
                    np.float32(np.int32(2 * xy)) * PER_PRODUCT,
                )
                strength[row - 2, x] = mean - np.float32(math.sqrt(half * half + mixed * mixed))
