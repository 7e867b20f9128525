"""Whether what two drives saw tells the shift along their rows, or only across them.

Pictures are noisy, and a correlation over n independent cells changes by chance from shift to
shift: the log-likelihood by about sqrt(n), which near any shift looks like a peak of a few
centimetres. So the peak at the best shift is compared with what chance makes of other shifts along
the same ridge.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from fieldgrid.array_types import Float64

LEAST_TIMES = 4.0
"""A peak that stands out less, in root mean squares of the others along its ridge, is chance. Even
walls, made with noise, have up to 2.4; made plants 9.9 and more, rows of one vineyard in June and
in August, whose canopies are closed, 8.2 and more."""

SIDES_M = (0.6, 0.8, 1.0, 1.2)
"""A peak is what is higher than the mean so far to either side of it: neither a slope nor what is
alike over decimetres is one."""

PEAK_M, OTHERS_FROM_M, FEWEST_OTHERS = 0.3, 1.5, 10
"""The highest so near to the best shift is its peak; others are so far from it, and so many places
`STEP_M` apart."""

STEP_M, DIRECTIONS, BESIDE_M = 0.1, 90, (0.0, -0.1, 0.1)
"""The ridge is looked for in so many directions, and so far beside the best shift, which is that of
a cell."""


class _Line(NamedTuple):
    """A line of shifts through `origin_m` along the unit vector `way`, and how far along it others
    than the best lie."""

    origin_m: Float64
    way: Float64
    others_m: Float64

    def at(self, along_m: Float64) -> Float64:
        """Shifts [n, 2] on it."""
        return np.asarray(self.origin_m + along_m[:, None] * self.way)


def along_ridge(agreement: Float64, shifts_m: Float64, shift_m: Float64) -> Float64:
    """The unit vector [2] of the way along which the agreement of two drives tells nothing, by the
    log-likelihoods a cell [n, n] of shifts `shifts_m` along either axis, around the best one; zero
    where it tells the shift.

    Scores that reach too little beyond that tell their ridge no better, and are believed.
    """
    axis, cell_m = shifts_m, float(shifts_m[1] - shifts_m[0])

    def at(shifts_m: Float64) -> Float64:
        index = (shifts_m[:, ::-1].T - axis[0]) / cell_m
        return np.asarray(ndimage.map_coordinates(agreement, index, order=1, mode="nearest"))

    def peaks(line: _Line, along_m: Float64) -> Float64:
        sides = [at(line.at(along_m + side)) for by in SIDES_M for side in (-by, by)]
        return np.asarray(at(line.at(along_m)) - np.mean(sides, axis=0))

    lines = list(_lines(shift_m, axis[-1] - SIDES_M[-1]))
    if not lines:
        return np.zeros(2)
    ridge = max(lines, key=lambda line: float(at(line.at(line.others_m)).mean()))
    near = np.arange(-PEAK_M, PEAK_M + STEP_M / 2.0, STEP_M)
    chance = float(np.sqrt(np.mean(peaks(ridge, ridge.others_m) ** 2)))
    return np.zeros(2) if peaks(ridge, near).max() > LEAST_TIMES * chance else ridge.way


def _lines(shift_m: Float64, reach_m: float) -> Iterator[_Line]:
    """The lines through and beside a shift that have enough others within reach."""
    along_m = np.arange(-2.0 * reach_m, 2.0 * reach_m, STEP_M)
    along_m = along_m[np.abs(along_m) >= OTHERS_FROM_M]
    for turn in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        way = np.array([np.sin(turn), np.cos(turn)])
        for beside_m in BESIDE_M:
            line = _Line(shift_m + beside_m * np.array([way[1], -way[0]]), way, along_m)
            inside = np.abs(line.at(along_m)).max(axis=1) <= reach_m
            if np.count_nonzero(inside) >= FEWEST_OTHERS:
                yield line._replace(others_m=along_m[inside])


def across_alone(information: Sequence[Float64], along: Float64) -> list[Float64]:
    """Matrices of information [2, 2] of matches without what they say along a ridge, which runs
    about `along`: where all of them together are weakest."""
    if not along.any() or not len(information):
        return list(information)
    _, axes = np.linalg.eigh(np.sum(information, axis=0))
    across = np.outer(axes[:, 1], axes[:, 1])
    return [across @ one @ across for one in information]
