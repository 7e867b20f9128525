"""Which corner of one frame is which of the next, by how they look and where they can be."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64, Int64
from fieldgrid.kernel import kernel
from fieldgrid.odometry.corners import Features
from fieldgrid.odometry.rigid import Lens, Motion3, predicted

MAX_RATIO = 0.95
"""A match must differ in fewer bits than the next best candidate, times this."""

MAX_BITS = 80
"""Patches that differ in more of their 256 bits are not the same thing."""

HEAVE_M, LEAN = 0.3, 0.07
"""How much a point's height may change between frames: the vehicle heaves, pitches and rolls.
The second is per metre of range, 4°."""

RANGE_SHARE = 0.25
"""How much of its range forward a far point may gain or lose by the turn and by its error."""


class Matches(NamedTuple):
    """Rows of the features of the start and of the end that belong together, each length n."""

    start: Int64
    stop: Int64


def match_anywhere(
    start: Features, stop: Features, R_vehicle_camera: Float64, max_step_m: float
) -> Matches:
    """Mutual best matches of all that a step of up to `max_step_m` could bring together."""
    at_start, at_stop = (f.points_m @ R_vehicle_camera.T for f in (start, stop))
    return Matches(*mutual_best(start.descriptors, stop.descriptors, at_start, at_stop, max_step_m))


def match_near(
    start: Features,
    stop: Features,
    motion: Motion3,
    lens: Lens,
    radius_px: Float64,
    disparity_px: Float64,
) -> Matches:
    """Mutual best matches within `radius_px` [n] of where a motion puts the points of `start`.

    Their disparity must be within `disparity_px` [n] of the predicted one.
    """
    expected = predicted(start.points_m, motion.R_stop_start, motion.t_stop_start_m, *lens)
    return Matches(
        *mutual_near(
            start.descriptors,
            stop.descriptors,
            expected,
            stop.measured_px,
            radius_px,
            disparity_px,
        )
    )


@kernel
def bit_count(word):  # type: ignore[no-untyped-def]
    """How many bits of a uint64 are set; LLVM makes one instruction of it."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def differing_bits(one, other):  # type: ignore[no-untyped-def]
    """The Hamming distance of two descriptors."""
    return (
        bit_count(one[0] ^ other[0])
        + bit_count(one[1] ^ other[1])
        + bit_count(one[2] ^ other[2])
        + bit_count(one[3] ^ other[3])
    )


@kernel
def mutual(best_of_start, best_of_stop, good):  # type: ignore[no-untyped-def]
    """Rows of both sides that chose each other."""
    n = 0
    pairs = np.empty((2, len(best_of_start)), dtype=np.int64)
    for i in range(len(best_of_start)):
        j = best_of_start[i]
        if j >= 0 and good[i] and best_of_stop[j] == i:
            pairs[0, n], pairs[1, n] = i, j
            n += 1
    return pairs[0, :n].copy(), pairs[1, :n].copy()


@kernel
def mutual_best(start, stop, at_start, at_stop, max_step_m):  # type: ignore[no-untyped-def]
    """Matches among the points [n, 3] of the vehicle frame that keep their height roughly."""
    n, m = len(start), len(stop)
    best, second, to_start = np.full(n, 257), np.full(n, 257), np.full(m, 257)
    chosen, chosen_back = np.full(n, -1), np.full(m, -1)
    for i in range(n):
        for j in range(m):
            range_m = max(at_start[i, 1], at_stop[j, 1])
            if abs(at_start[i, 2] - at_stop[j, 2]) > HEAVE_M + LEAN * range_m:
                continue
            if abs(at_start[i, 1] - at_stop[j, 1]) > max_step_m + RANGE_SHARE * range_m:
                continue
            bits = differing_bits(start[i], stop[j])
            if bits < best[i]:
                second[i], best[i], chosen[i] = best[i], bits, j
            elif bits < second[i]:
                second[i] = bits
            if bits < to_start[j]:
                to_start[j], chosen_back[j] = bits, i
    return mutual(chosen, chosen_back, best <= MAX_RATIO * second)


@kernel
def mutual_near(start, stop, expected, measured, radius_px, disparity_px):  # type: ignore[no-untyped-def]
    """Matches within a radius of the expected column and row, at about the expected disparity."""
    n, m = len(start), len(stop)
    best, to_start = np.full(n, MAX_BITS + 1), np.full(m, MAX_BITS + 1)
    chosen, chosen_back = np.full(n, -1), np.full(m, -1)
    for i in range(n):
        for j in range(m):
            du, dv = expected[i, 0] - measured[j, 0], expected[i, 1] - measured[j, 1]
            if not du * du + dv * dv <= radius_px[i] * radius_px[i]:  # also when it is NaN
                continue
            if abs(expected[i, 2] - measured[j, 2]) > disparity_px[i]:
                continue
            bits = differing_bits(start[i], stop[j])
            if bits < best[i]:
                best[i], chosen[i] = bits, j
            if bits < to_start[j]:
                to_start[j], chosen_back[j] = bits, i
    return mutual(chosen, chosen_back, best <= MAX_BITS)
