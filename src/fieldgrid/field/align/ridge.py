"""Whether what two drives saw tells the shift along their rows, or only across them.

Pictures are noisy, and a correlation over n independent cells changes by chance from shift to
shift: the log-likelihood by about sqrt(n), which near any shift looks like a peak of a few
centimetres. So the peak at the best shift is compared with what chance makes of other shifts along
the same ridge.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from fieldgrid.core import Float64

LEAST_TIMES = 4.0
"""A peak that stands out less, in root mean squares of the others along its ridge, is chance. Of 42
made fields of even walls all have at most 2.4; of 42 of plants 8.0 and more; rendered rows, drives
displaced at random, 2.7 to 45, four of 60 less than this, which are left to the receivers."""

SIDES_M = (0.6, 0.8, 1.0, 1.2)
"""Distances to either side at which the mean is taken; a peak is higher than that mean. Neither a
slope nor what is alike over decimetres is a peak."""

PEAK_M, OTHERS_FROM_M, FEWEST_OTHERS = 0.3, 1.5, 10
"""The highest value within `PEAK_M` of the best shift is its peak. Other places are at least
`OTHERS_FROM_M` from it; `FEWEST_OTHERS` of them, `STEP_M` apart, are needed."""

STEP_M, DIRECTIONS, BESIDE_M = 0.1, 90, (0.0, -0.1, 0.1)
"""The ridge is looked for in this number of directions, through the best shift, which is that of a
cell, and through places beside it."""


def along_ridge(agreement: Float64, shifts_m: Float64, shift_m: Float64) -> Float64:
    """The unit vector [2] of the way along which the agreement of two drives tells nothing, by the
    log-likelihoods a cell [n, n] of shifts `shifts_m` along either axis, around the best one; zero
    where it tells the shift.

    Scores that reach too little beyond that tell their ridge no better, and are believed.
    """
    first_m, cell_m = shifts_m[0], float(shifts_m[1] - shifts_m[0])

    def at(places_m: Float64) -> Float64:
        index = (np.moveaxis(places_m, -1, 0)[::-1] - first_m) / cell_m
        return np.asarray(ndimage.map_coordinates(agreement, index, order=1, mode="nearest"))

    # Lines through and beside the best shift; the ridge is that along which all agrees best.
    reach_m = float(shifts_m[-1]) - SIDES_M[-1]
    along_m = np.arange(-2.0 * reach_m, 2.0 * reach_m, STEP_M)
    along_m = along_m[np.abs(along_m) >= OTHERS_FROM_M]
    turns = np.repeat(np.pi * np.arange(DIRECTIONS) / DIRECTIONS, len(BESIDE_M))
    ways = np.stack([np.sin(turns), np.cos(turns)], axis=1)
    beside_m = np.tile(BESIDE_M, DIRECTIONS)[:, None] * np.stack([ways[:, 1], -ways[:, 0]], axis=1)
    origins_m = shift_m + beside_m
    places_m = origins_m[:, None] + along_m[:, None] * ways[:, None]
    inside = np.abs(places_m).max(axis=2) <= reach_m
    enough = np.count_nonzero(inside, axis=1) >= FEWEST_OTHERS
    if not enough.any():
        return np.zeros(2)
    mean = np.where(inside, at(places_m), 0.0).sum(axis=1) / np.maximum(inside.sum(axis=1), 1)
    ridge = int(np.where(enough, mean, -1.0).argmax())

    def peaks(along_m: Float64) -> Float64:
        sides = np.concatenate([[0.0], SIDES_M, -np.asarray(SIDES_M)])
        values = at(origins_m[ridge] + (along_m[:, None] + sides)[..., None] * ways[ridge])
        return np.asarray(values[:, 0] - values[:, 1:].mean(axis=1))

    near = np.arange(-PEAK_M, PEAK_M + STEP_M / 2.0, STEP_M)
    chance = float(np.sqrt(np.mean(peaks(along_m[inside[ridge]]) ** 2)))
    return np.zeros(2) if peaks(near).max() > LEAST_TIMES * chance else ways[ridge]


def across_alone(information: Sequence[Float64], along: Float64) -> list[Float64]:
    """Matrices of information [2, 2] of matches without what they say along a ridge, which runs
    about `along`: where all of them together are weakest."""
    if not along.any() or not len(information):
        return list(information)
    _, axes = np.linalg.eigh(np.sum(information, axis=0))
    across = np.outer(axes[:, 1], axes[:, 1])
    return [across @ one @ across for one in information]
