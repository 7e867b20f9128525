"""The byte planes of a tile's moments, as `docs/map-format.md` defines them.

Squares, frames and the highest density are stored as what they differ by from a cell that was
seen once, or always alike: mostly 0, which costs nothing once it is compressed. A kernel does
the work cell by cell, and not at all for cells that were not seen; the NumPy functions beside
it are what it is held to.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import UInt64
from fieldgrid.kernel import kernel
from fieldgrid.moments import FRAMES, HIGHEST, PLANES, SQUARES, SUM, WEIGHT, Moments
from fieldgrid.transfer import CELL_WEIGHT

Stored = UInt64
"""What is stored of moments, uint64 [5, cells]."""

_BYTE = np.uint64(0xFF)
_ROUND_UP = np.uint64(CELL_WEIGHT - 1)


@kernel
def bits_of(values, columns):  # type: ignore[no-untyped-def]
    """The bits that are set in any of the first `columns` of values [cells, n]."""
    bits = np.uint64(0)
    for k in range(values.shape[0]):
        for column in range(columns):
            bits |= values[k, column]
    return bits


@kernel
def byte_planes(stored, counts, out):  # type: ignore[no-untyped-def]
    """The `counts` low bytes of each row of stored [n, cells], as planes uint8 [sum, cells]."""
    plane = 0
    for row in range(stored.shape[0]):
        for byte in range(counts[row]):
            shift = np.uint64(8 * byte)
            for k in range(stored.shape[1]):
                out[plane, k] = np.uint8((stored[row, k] >> shift) & _BYTE)
            plane += 1


@kernel
def from_byte_planes(planes, counts, stored):  # type: ignore[no-untyped-def]
    """The rows of stored [n, cells], which are 0 before, from such planes."""
    plane = 0
    for row in range(stored.shape[0]):
        for byte in range(counts[row]):
            shift = np.uint64(8 * byte)
            for k in range(stored.shape[1]):
                stored[row, k] |= np.uint64(planes[plane, k]) << shift
            plane += 1


@kernel
def to_stored(moments, shift, stored):  # type: ignore[no-untyped-def]
    """Fill `stored` from moments [cells, 5]; see `to_stored_reference`."""
    one, bits = np.uint64(1), np.uint64(shift)
    cell_weight = np.uint64(CELL_WEIGHT)
    for k in range(moments.shape[0]):
        whole = moments[k, WEIGHT]
        if (whole | moments[k, SUM] | moments[k, SQUARES] | moments[k, FRAMES]) == 0:
            for plane in range(HIGHEST):
                stored[plane, k] = 0
            stored[HIGHEST, k] = moments[k, HIGHEST] & _BYTE
            continue
        weight, total = whole >> bits, moments[k, SUM] >> bits
        alike, mean = total * total, total
        if weight > one:
            alike, mean = alike // weight, (total + weight - one) // weight
        stored[WEIGHT, k] = weight
        stored[SUM, k] = total
        stored[SQUARES, k] = (moments[k, SQUARES] >> bits) - alike
        difference = np.int64(moments[k, FRAMES] - ((weight << bits) + _ROUND_UP) // cell_weight)
        stored[FRAMES, k] = np.uint64((difference << 1) ^ (difference >> 63))
        stored[HIGHEST, k] = (moments[k, HIGHEST] - mean) & _BYTE


@kernel
def from_stored(stored, shift, moments):  # type: ignore[no-untyped-def]
    """Fill moments [cells, 5] from `stored`; see `from_stored_reference`."""
    zero, one, bits = np.uint64(0), np.uint64(1), np.uint64(shift)
    cell_weight = np.uint64(CELL_WEIGHT)
    for k in range(moments.shape[0]):
        weight, total, frames = stored[WEIGHT, k], stored[SUM, k], stored[FRAMES, k]
        if (weight | total | stored[SQUARES, k] | frames) == 0:
            for plane in range(HIGHEST):
                moments[k, plane] = 0
            moments[k, HIGHEST] = stored[HIGHEST, k] & _BYTE
            continue
        alike, mean = total * total, total
        if weight > one:
            alike, mean = alike // weight, (total + weight - one) // weight
        moments[k, WEIGHT] = weight << bits
        moments[k, SUM] = total << bits
        moments[k, SQUARES] = (stored[SQUARES, k] + alike) << bits
        difference = (frames >> one) ^ (zero - (frames & one))
        moments[k, FRAMES] = difference + ((weight << bits) + _ROUND_UP) // cell_weight
        moments[k, HIGHEST] = (stored[HIGHEST, k] + mean) & _BYTE


def to_stored_reference(moments: Moments, shift: int, stored: Stored) -> None:
    """The same as `to_stored`, in NumPy. All is modulo 2^64, so nothing is ever lost."""
    stored[:] = moments.T
    stored[:FRAMES] >>= np.uint64(shift)
    stored[SQUARES] -= _squares_when_alike(stored)
    difference = (stored[FRAMES] - _frames_when_whole(stored[WEIGHT], shift)).view(np.int64)
    # 0, -1, 1, -2, ... as 0, 1, 2, 3, ...: small numbers of both signs.
    stored[FRAMES] = ((difference << 1) ^ (difference >> 63)).view(np.uint64)
    stored[HIGHEST] = (stored[HIGHEST] - _mean_upwards(stored)) & _BYTE


def from_stored_reference(stored: Stored, shift: int, moments: Moments) -> None:
    """The same as `from_stored`, in NumPy."""
    values = stored.copy()
    values[HIGHEST] = (stored[HIGHEST] + _mean_upwards(stored)) & _BYTE
    sign = np.uint64(0) - (stored[FRAMES] & np.uint64(1))
    difference = (stored[FRAMES] >> np.uint64(1)) ^ sign
    values[FRAMES] = difference + _frames_when_whole(stored[WEIGHT], shift)
    values[SQUARES] += _squares_when_alike(stored)
    values[:FRAMES] <<= np.uint64(shift)
    moments[:] = values.T


def _squares_when_alike(stored: Stored) -> Stored:
    """The sum of squares of a cell whose values are all its mean, rounded down, modulo 2^64."""
    alike: Stored = stored[SUM] * stored[SUM]
    alike //= np.maximum(stored[WEIGHT], np.uint64(1))
    return alike


def _frames_when_whole(weight: Stored, shift: int) -> Stored:
    """The frames of a cell to which each gave one whole local cell, rounded up."""
    whole: Stored = (weight << np.uint64(shift)) + _ROUND_UP
    whole //= np.uint64(CELL_WEIGHT)
    return whole


def _mean_upwards(stored: Stored) -> Stored:
    """The mean of a cell, rounded up, which the highest value is not below."""
    divisor = np.maximum(stored[WEIGHT], np.uint64(1))
    mean: Stored = (stored[SUM] + divisor - np.uint64(1)) // divisor
    return mean


def empty_stored(cells: int) -> Stored:
    """Room for the stored form of so many cells."""
    return np.zeros((PLANES, cells), dtype=np.uint64)
