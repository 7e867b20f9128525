"""Which corner of one frame is which of the next, by how they look and where they can be."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64, kernel, part_of_kernel
from fieldgrid.perception.odometry.corners import Features
from fieldgrid.perception.odometry.rigid import Lens, RigidMotion, predicted

MAX_RATIO = 0.95
"""A match must differ in fewer bits than the next best candidate, times this."""

MAX_BITS, ALL_BITS = 80, 256
"""Patches that differ in more of their 256 bits are not the same thing."""

HEAVE_M, LEAN = 0.3, 0.07
"""How much a point's height may change between frames: the vehicle heaves, pitches and rolls.
The second is per metre of range, 4°."""

RANGE_SHARE = 0.25
"""How much of its range forward a far point may gain or lose by the turn and by its error."""

NEAR_DISPARITY_PX = 1.5
"""How far from its prediction by a motion a disparity may be."""


class Matches(NamedTuple):
    """Rows of the features of the start and of the end that belong together, each length n."""

    start: Int64
    stop: Int64


def match_anywhere(
    start: Features, stop: Features, R_vehicle_camera: Float64, max_step_m: float
) -> Matches:
    """Mutual best matches of all that a step of up to `max_step_m` could bring together."""
    at_start, at_stop = (f.points_m @ R_vehicle_camera[[1, 2, 2]].T for f in (start, stop))
    range_m = at_start[:, 0]
    height_m = HEAVE_M + LEAN * range_m
    slack = np.stack([max_step_m + RANGE_SHARE * range_m, height_m, height_m])
    rows, columns, bits, next_bits = _mutual(start, stop, at_start, at_stop, slack)
    clear = bits <= MAX_RATIO * next_bits
    return Matches(rows[clear], columns[clear])


def match_near(
    start: Features, stop: Features, motion: RigidMotion, lens: Lens, radius_px: float
) -> Matches:
    """Mutual best matches within `radius_px` of where a motion puts the points of `start`."""
    expected = predicted(start.points_m, motion, lens)[:, [1, 0, 2]]
    found = stop.measured_px[:, [1, 0, 2]]
    slack = np.tile([[radius_px], [radius_px], [NEAR_DISPARITY_PX]], len(expected))
    rows, columns, bits, _ = _mutual(start, stop, expected, found, slack)
    alike = bits <= MAX_BITS
    return Matches(rows[alike], columns[alike])


def _mutual(
    start: Features, stop: Features, expected: Float64, found: Float64, slack: Float64
) -> tuple[Int64, Int64, Int64, Int64]:
    """Rows of both frames that look most alike to each other, of those that can be the same.

    They can where `found` [m, 3] is within `slack` [3, n] of what is `expected` [n, 3], NaN where
    nothing is. Also in how many bits they differ, and in how many the next best one does.
    """
    order = np.argsort(found[:, 0])
    near, where, reach = (
        np.ascontiguousarray(array, dtype=np.float32)
        for array in (found[order].T, expected.T, slack)
    )
    # Unsigned: an index that might be negative keeps the kernel's loops out of vector registers.
    first = np.searchsorted(near[0], where[0] - reach[0]).astype(np.uint64)
    last = np.searchsorted(near[0], where[0] + reach[0], side="right").astype(np.uint64)
    chosen, bits, next_bits = (np.empty(len(first), dtype=np.int64) for _ in range(3))
    chosen_back = np.empty(len(order), dtype=np.int32)
    looks = np.ascontiguousarray(stop.descriptors[order].T)
    _compare(
        start.descriptors, looks, where, near, reach, first, last,
        chosen, bits, next_bits, chosen_back,
    )  # fmt: skip
    rows = np.flatnonzero(chosen >= 0)
    rows = rows[chosen_back[chosen[rows]] == rows]
    return rows, order[chosen[rows]], bits[rows], next_bits[rows]


@kernel
def _compare(  # type: ignore[no-untyped-def]
    start, stop, expected, found, slack, first, last, chosen, least, second, chosen_back
):
    """Fill in the last four arrays: the best of the stop, its differing bits and those of the
    next best, length n, and the best of the start, length m; -1 where there is none."""
    m = len(chosen_back)
    bits, least_back = np.empty(m, dtype=np.int32), np.empty(m, dtype=np.int32)
    found_y, found_z = found[1], found[2]
    for j in range(m):
        chosen_back[j], least_back[j] = -1, ALL_BITS + 1
    for i in range(len(chosen)):
        y, z, slack_y, slack_z = expected[1, i], expected[2, i], slack[1, i], slack[2, i]
        for j in range(first[i], last[i]):
            bits[j] = 0
        for word in range(4):
            mine, theirs = start[i, word], stop[word]
            for j in range(first[i], last[i]):
                bits[j] += np.int32(_ones(mine ^ theirs[j]))
        for j in range(first[i], last[i]):
            possible = (abs(y - found_y[j]) <= slack_y) & (abs(z - found_z[j]) <= slack_z)
            bits[j] = bits[j] if possible else np.int32(ALL_BITS + 1)
        for j in range(first[i], last[i]):
            nearer = bits[j] < least_back[j]
            least_back[j] = bits[j] if nearer else least_back[j]
            chosen_back[j] = np.int32(i) if nearer else chosen_back[j]
        best, best_bits, next_bits = np.int64(-1), ALL_BITS + 1, ALL_BITS + 1
        for j in range(first[i], last[i]):
            if bits[j] < best_bits:
                best, best_bits, next_bits = np.int64(j), bits[j], best_bits
            elif bits[j] < next_bits:
                next_bits = bits[j]
        chosen[i], least[i], second[i] = best, best_bits, next_bits


@part_of_kernel
def _ones(word):  # type: ignore[no-untyped-def]
    """How many bits of a uint64 are set; LLVM makes one instruction of it."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)
