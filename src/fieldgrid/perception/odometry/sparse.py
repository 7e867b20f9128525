"""The disparity of single points: where on its row of the right image each one is found."""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import Float64, UInt8, kernel, part_of_kernel

COARSE_PX, FINE_PX = 3, 5
"""Half the side of the compared window, in the half-size images and in the full ones."""

FINE_SEARCH_PX = 3
"""How far to both sides of the coarse place the full images are searched."""

MIN_CORRELATION = 0.7
MIN_LEAD = 0.05
"""The best place must correlate better than any other by this much: vines and wires repeat."""


def row_disparities(
    left: UInt8,
    right: UInt8,
    left_half: UInt8,
    right_half: UInt8,
    points_px: Float64,
    least_px: float,
    most_px: float,
) -> Float64:
    """Disparity in pixels of each point [n, 2] of the left image, NaN where there is no match.

    The whole range from `least_px` to `most_px` is searched at half size, and a few pixels
    about the place found there at full size. The last fraction is that of a parabola through
    the correlations, which undo a difference of gain or exposure between the cameras.
    """
    least, most = math.floor(least_px / 2.0), math.ceil(most_px / 2.0)
    disparities = np.full(len(points_px), np.nan)
    # Images of bags are read-only; one kind of array is compiled once.
    left, right = np.require(left, requirements="W"), np.require(right, requirements="W")
    _search_rows(left_half, right_half, left, right, points_px, least, most, disparities)
    return disparities


@kernel
def _search_rows(  # type: ignore[no-untyped-def]
    left_half, right_half, left, right, points_px, least_half, most_half, disparities
):
    """Fill in `disparities` [n]."""
    widest = max(most_half - least_half, 2 * FINE_SEARCH_PX) + 1 + 2 * FINE_PX
    scores, pixels = np.empty(widest), np.empty(widest, dtype=np.int32)
    sums, squares = np.empty(widest, dtype=np.int32), np.empty(widest, dtype=np.int32)
    products = np.empty(widest, dtype=np.int32)
    for k in range(len(points_px)):
        least, most = least_half, most_half
        for fine in range(2):
            one, other = (left, right) if fine else (left_half, right_half)
            reach = FINE_PX if fine else COARSE_PX
            x, y = points_px[k, 0] / (2 - fine), points_px[k, 1] / (2 - fine)
            least, n = _correlate(
                one, other, int(x + 0.5), int(y + 0.5), least, most, reach,
                scores, pixels, sums, squares, products,
            )  # fmt: skip
            best = 0
            for d in range(n):
                if scores[d] > scores[best]:
                    best = d
            if n == 0 or scores[best] < MIN_CORRELATION:
                break
            if not fine:
                rival = -1.0
                for d in range(n):
                    if abs(d - best) > 2 and scores[d] > rival:
                        rival = scores[d]
                if rival > scores[best] - MIN_LEAD:
                    break
                least = 2 * (least + best) - FINE_SEARCH_PX
                most = least + 2 * FINE_SEARCH_PX
            elif 0 < best < n - 1:
                before, at, after = scores[best - 1], scores[best], scores[best + 1]
                curvature = before - 2.0 * at + after
                if curvature < 0.0:
                    disparities[k] = least + best + 0.5 * (before - after) / curvature


@part_of_kernel
def _correlate(  # type: ignore[no-untyped-def]
    left, right, x, y, least, most, reach, scores, pixels, sums, squares, products
):
    """Fill in the correlations of the window about (x, y) at disparities `least` to `most`.

    Returns the first disparity at which the window is inside the right image, and how many
    there are; none where it leaves the left one. All sums but the last are of integers.
    """
    height, width = left.shape
    least = max(least, x + reach + 1 - width)
    n = min(most, x - reach) - least + 1
    if x < reach or y < reach or x >= width - reach or y >= height - reach or n <= 0:
        return least, 0
    side = 2 * reach + 1
    count = side * side
    # By column of the right image, from the left end of the window farthest left. Unsigned: an
    # index that might be negative keeps loops out of vector registers.
    left_first, right_first = np.uint64(x - reach), np.uint64(x - reach - least - n + 1)
    for i in range(n + side - 1):
        sums[i], squares[i], products[i] = 0, 0, 0
    total, square = 0, 0
    for row in range(y - reach, y + reach + 1):
        for i in range(np.uint64(n + side - 1)):
            value = np.int32(right[row, right_first + i])
            pixels[i] = value
            sums[i] += value
            squares[i] += value * value
        for j in range(np.uint64(side)):
            weight = int(left[row, left_first + j])
            total += weight
            square += weight * weight
            for i in range(np.uint64(n)):
                products[i] += weight * pixels[i + j]
    spread = count * square - total * total
    right_total, right_square = 0, 0
    for i in range(n + side - 1):
        right_total += sums[i]
        right_square += squares[i]
        if i >= side - 1:
            at = i - side + 1
            right_spread = count * right_square - right_total * right_total
            score = -1.0
            if spread > 0 and right_spread > 0:
                both = count * products[at] - total * right_total
                score = both / math.sqrt(float(spread) * float(right_spread))
            scores[n - 1 - at] = score
            right_total -= sums[at]
            right_square -= squares[at]
    return least, n
