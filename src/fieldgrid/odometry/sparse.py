"""The disparity of single points: where on its row of the right image each one is found."""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.kernel import kernel

COARSE_PX, FINE_PX = 3, 5
"""Half the side of the compared window, in the half-size images and in the full ones."""

MIN_CORRELATION = 0.7
MIN_LEAD = 0.05
"""The best place must correlate better than any other by this much: vines and wires repeat."""


@kernel
def row_disparities(left, right, left_half, right_half, points_px, least_px, most_px):  # type: ignore[no-untyped-def]
    """Disparity in pixels of each point [n, 2] of the left image, NaN where there is no match.

    The whole range from `least_px` to `most_px` is searched at half size, and a few pixels
    about the place found there at full size. The last fraction is that of a parabola through
    the correlations.
    """
    disparities = np.full(len(points_px), np.nan)
    least, most = math.floor(least_px / 2.0), math.ceil(most_px / 2.0)
    scores = np.empty(max(most - least + 1, 7), dtype=np.float32)
    for k in range(len(points_px)):
        x, y = int(points_px[k, 0] / 2.0 + 0.5), int(points_px[k, 1] / 2.0 + 0.5)
        n = correlations(left_half, right_half, x, y, least, most, COARSE_PX, scores)
        if n == 0:
            continue
        best = np.argmax(scores[:n])
        if scores[best] < MIN_CORRELATION or not leads(scores[:n], best):
            continue
        middle = 2 * (least + best)
        x, y = int(points_px[k, 0] + 0.5), int(points_px[k, 1] + 0.5)
        n = correlations(left, right, x, y, middle - 3, middle + 3, FINE_PX, scores)
        if n < 3:
            continue
        best = np.argmax(scores[:n])
        if scores[best] < MIN_CORRELATION or best == 0 or best == n - 1:
            continue
        before, at, after = scores[best - 1], scores[best], scores[best + 1]
        curvature = before - 2.0 * at + after
        if curvature < 0.0:
            disparities[k] = middle - 3 + best + 0.5 * (before - after) / curvature
    return disparities


@kernel
def leads(scores, best):  # type: ignore[no-untyped-def]
    """Whether no score away from the best one's own hill comes near it."""
    for d in range(len(scores)):
        if abs(d - best) > 2 and scores[d] > scores[best] - MIN_LEAD:
            return False
    return True


@kernel
def correlations(left, right, x, y, least, most, reach, scores):  # type: ignore[no-untyped-def]
    """Normalised correlation at the disparities from `least` on, and how many there are.

    None when the window leaves the left image; fewer than asked where it leaves the right one
    on its left, and -1 for those that leave it on its right. The normalisation undoes a
    difference of gain or exposure between the cameras.
    """
    height, width = left.shape
    if y < reach or y >= height - reach or x < reach or x >= width - reach:
        return 0
    n = min(most, x - reach) - least + 1
    if n <= 0:
        return 0
    side = 2 * reach + 1
    total, squares = 0.0, 0.0
    for row in range(y - reach, y + reach + 1):
        for column in range(x - reach, x + reach + 1):
            value = float(left[row, column])
            total += value
            squares += value * value
    count = side * side
    spread = count * squares - total * total
    mean = np.float32(total / count)
    # By column of the right image, from the left end of the last window to the right of the
    # first; the disparities run against the columns.
    first = x - least - n + 1
    products = np.zeros(n, dtype=np.float32)
    sums, square_sums = np.zeros(n + side - 1), np.zeros(n + side - 1)
    stop = min(n + side - 1, width - first + reach)
    for row in range(y - reach, y + reach + 1):
        for i in range(stop):
            value = float(right[row, first - reach + i])
            sums[i] += value
            square_sums[i] += value * value
        for j in range(side):
            weight = np.float32(left[row, x - reach + j]) - mean
            for i in range(min(n, stop - j)):
                products[i] += weight * np.float32(right[row, first - reach + i + j])
    total_right, squares_right = sums[: side - 1].sum(), square_sums[: side - 1].sum()
    for i in range(n):
        total_right += sums[i + side - 1]
        squares_right += square_sums[i + side - 1]
        spread_right = count * squares_right - total_right * total_right
        inside = i + side <= stop and spread > 0.0 and spread_right > 0.0
        norm = math.sqrt(spread * spread_right) if inside else 1.0
        scores[n - 1 - i] = count * products[i] / norm if inside else -1.0
        total_right -= sums[i]
        squares_right -= square_sums[i]
    return n
