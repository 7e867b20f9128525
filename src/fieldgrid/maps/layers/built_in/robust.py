"""How heights of one place meet, robustly: those of frames in a session, and those of sessions.

Both are a weighted median: the mean of the middle fifth of the weight. It must not depend on order,
and sessions must be taken out again exactly. So a session settles on one height for each block, and
sessions add up in a histogram of heights.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Int64, kernel, part_of_kernel

WIDEST_SIGMA_M, MOST_HALVINGS = 4.0, 14
"""Weights are powers of 2, so that their sums are stored in few bytes: 1 is a sigma of 4 m, and
each halving of its square doubles the weight, up to a sigma of 3 cm."""

BINS, BIN_CM = 16, 25
"""Of the histogram of sessions: canopies, wrong antenna heights and poor fixes are less than the
4 m after which it repeats. A height that is off by more shares a bin with the others in one of 16
cases. Heights of one turn have at most the variance of the bin's two ends; a bin that has more is
not believed. A mix that has less has moved the mean by less than 5 mm."""

LOW_SHARE = 0.4
"""Heights meet by the mean of what lies between this share of their weight from below and from
above: wrong ones of less than this share do not move it, and it does not jump where the weights of
two become equal, as a median does."""

LEAST_MAJORITY, NEAR_SIGMAS = 3, 2.0
"""The majority is clear where there are `LEAST_MAJORITY` sessions or more, of whose weight all but
`LOW_SHARE` lies within `NEAR_SIGMAS` sigmas, or a bin, of the height. Elsewhere the sigma is at
least the root mean square of the distances of all sessions from the height."""

IQR_OF_SIGMA = 1.349
"""Width of the middle half of normal errors, in sigmas."""

MOST_HEIGHTS = 24
"""Different heights that are kept of a block; where there are more, they are kept in steps of 2, 4,
8 ... cm, the finest of which there are no more than that."""


class Heights:
    """The heights of blocks, each with the weight of its frame.

    Of each height, or step of heights, there are the sums of weights and of weights times height.
    The step of a block depends on all of its heights and not on their order, as no height that is
    added can make them fewer. A block takes up to `MOST_HEIGHTS` times 20 bytes, half a kilobyte,
    however many frames saw it; what a part of the window does not need is never taken.
    """

    def __init__(self, blocks: int) -> None:
        self._steps = np.zeros((MOST_HEIGHTS, blocks), np.int32)
        self._weight = np.zeros((MOST_HEIGHTS, blocks), np.int64)
        self._weighted_cm = np.zeros((MOST_HEIGHTS, blocks), np.int64)
        self._count, self._level = (np.zeros(blocks, np.int8) for _ in range(2))
        self._frames = np.zeros(blocks, np.int32)

    def add(self, found: Int64) -> None:
        """Add those of a frame: block, centimetres (int32) and halvings [heights, 3]."""
        steps = self._steps, self._weight, self._weighted_cm
        enter(found, *steps, self._count, self._level, self._frames)

    def settled(self) -> tuple[Int64, Int64, Int64]:
        """What a session says of each block: 1 where it saw it, its weight and height."""
        said = [np.zeros(self._count.size, np.int64) for _ in range(3)]
        settle(self._weight, self._weighted_cm, self._count, self._frames, *said)
        return said[0], said[1], said[2]


@kernel
def enter(found, steps, weight, weighted_cm, count, level, frames):  # type: ignore[no-untyped-def]
    """Add heights, [heights, 3], to those of their blocks; all else is as in `Heights`."""
    for n in range(found.shape[0]):
        b, height, own = found[n, 0], found[n, 1], np.int64(1) << found[n, 2]
        frames[b] += 1
        while True:
            step, k = height >> level[b], 0
            while k < count[b] and steps[k, b] != step:
                k += 1
            if k < MOST_HEIGHTS:
                break
            level[b] += 1
            kept = 0
            for old in range(MOST_HEIGHTS):
                wider, into = steps[old, b] >> 1, 0
                while into < kept and steps[into, b] != wider:
                    into += 1
                if into == kept:
                    steps[kept, b], kept = wider, kept + 1
                    weight[into, b], weighted_cm[into, b] = weight[old, b], weighted_cm[old, b]
                else:
                    weight[into, b] += weight[old, b]
                    weighted_cm[into, b] += weighted_cm[old, b]
            count[b] = kept
        if k == count[b]:
            count[b], steps[k, b], weight[k, b], weighted_cm[k, b] = k + 1, step, 0, 0
        weight[k, b] += own
        weighted_cm[k, b] += own * height


@part_of_kernel
def spread(values, weights, count):  # type: ignore[no-untyped-def]
    """The sigma of `count` values, sorted, by how far the middle half of their weight reaches."""
    total = 0.0
    for k in range(count):
        total += weights[k]
    low = high = values[count - 1]
    passed = 0.0
    for k in range(count):
        before, passed = passed, passed + weights[k]
        if before < 0.25 * total <= passed:
            low = values[k]
        if before < 0.75 * total <= passed:
            high = values[k]
    return (high - low) / IQR_OF_SIGMA


@part_of_kernel
def middle(values, weights, count):  # type: ignore[no-untyped-def]
    """The mean of the middle fifth of the weight of `count` values, sorted."""
    total = 0.0
    for k in range(count):
        total += weights[k]
    low, high = LOW_SHARE * total, (1.0 - LOW_SHARE) * total
    passed = inside = 0.0
    for k in range(count):
        before, passed = passed, passed + weights[k]
        inside += values[k] * max(min(passed, high) - max(before, low), 0.0)
    return inside / (high - low)


@kernel
def settle(weight, weighted_cm, count, frames, seen, said_weight, said_cm):  # type: ignore[no-untyped-def]
    """Fill what a session says of each block [blocks], from the sums of its heights."""
    values, weights = np.empty(MOST_HEIGHTS), np.empty(MOST_HEIGHTS)
    for b in range(count.size):
        if count[b] == 0:
            continue
        # Of another type of number Numba would compile `spread` and `middle` anew.
        total, own = 0.0, np.int64(count[b])
        for k in range(own):
            value, place = weighted_cm[k, b] / weight[k, b], k
            while place > 0 and values[place - 1] > value:
                values[place], weights[place] = values[place - 1], weights[place - 1]
                place -= 1
            values[place], weights[place] = value, weight[k, b]
            total += weight[k, b]
        apart_m = spread(values, weights, own) / 100.0
        sigma_m = max(WIDEST_SIGMA_M / np.sqrt(total / frames[b]), apart_m)
        twice = np.floor(2.0 * np.log2(WIDEST_SIGMA_M / sigma_m) + 0.5)
        seen[b] = 1
        said_weight[b] = 1 << np.int64(min(max(twice, 0.0), MOST_HALVINGS))
        said_cm[b] = np.int64(np.floor(middle(values, weights, own) + 0.5))


@kernel
def read_bins(number, weight, weighted_cm, squares, sessions, height_cm, sigma_cm):  # type: ignore[no-untyped-def]
    """Fill the height and its sigma [n] of what the bins [bins, n] hold, which are those of
    `number`: weights, weights times height, and weights times its square, modulo 2^64. They stay
    where there is no height, or none to be believed."""
    values, weights = np.empty(number.size), np.empty(number.size)  # of those that are believed
    means, variances = np.empty(number.size), np.empty(number.size)
    for at in range(height_cm.size):
        count, every, believed, moment = np.int64(0), 0.0, 0.0, 0.0
        for k in range(number.size):
            own = weight[k, at]
            if own == 0:
                continue
            about = weighted_cm[k, at] // own
            past = (weighted_cm[k, at] - about * own) / own
            value = about + past
            # Exact, as it is small, though the sums are modulo 2^64.
            scatter = squares[k, at] - 2 * about * weighted_cm[k, at] + about * about * own
            variance = max(scatter / own - past * past, 0.0)
            means[k], variances[k], every = value, variance, every + own
            if variance > BIN_CM * BIN_CM / 4:
                continue
            believed += own
            place = count
            while place > 0 and values[place - 1] > value:
                values[place], weights[place] = values[place - 1], weights[place - 1]
                place -= 1
            values[place], weights[place] = value, own
            count += 1
        if count == 0 or believed < (1.0 - LOW_SHARE - 1e-9) * every:
            continue
        height = middle(values, weights, count)
        sigma = 100.0 * WIDEST_SIGMA_M * np.sqrt(sessions[at] / every)
        near, agreeing, inside = max(NEAR_SIGMAS * sigma, float(BIN_CM)), 0.0, 0.0
        for k in range(number.size):
            if weight[k, at] == 0:
                continue
            away = means[k] - height
            moment += weight[k, at] * (variances[k] + away * away)
            if abs(away) <= near and variances[k] <= BIN_CM * BIN_CM / 4:
                agreeing += weight[k, at]
                inside += weight[k, at] * (variances[k] + away * away)
        apart = spread(values, weights, count)
        if agreeing > 0.0:
            apart = max(apart, np.sqrt(inside / agreeing))
        if sessions[at] < LEAST_MAJORITY or agreeing < (1.0 - LOW_SHARE - 1e-9) * every:
            apart = max(apart, np.sqrt(moment / every))
        height_cm[at], sigma_cm[at] = height, max(sigma, apart)
