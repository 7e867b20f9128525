"""Numbers of a tile as planes of bytes and back: the loops of `tile_codec`."""

from __future__ import annotations

import numpy as np

from fieldgrid.kernel import kernel


@kernel
def differences(values, expected, signed, stored):  # type: ignore[no-untyped-def]
    """Fill `stored` with values less what is expected of them, all flat; `signed` ones become small
    numbers. Returns the bits that any of them has."""
    one, bits = np.uint64(1), np.uint64(0)
    for k in range(stored.size):
        value = values[k] - expected[k]
        if signed:
            value = (value << one) ^ np.uint64(np.int64(value) >> 63)
        stored[k] = value
        bits |= value
    return bits


@kernel
def split(stored, shift, planes):  # type: ignore[no-untyped-def]
    """Fill `planes`, uint8 [bytes, cells], with the bytes of `stored`, the low ones first."""
    for byte in range(planes.shape[0]):
        low = np.uint64(shift) + np.uint64(8 * byte)
        for k in range(stored.size):
            planes[byte, k] = np.uint8((stored[k] >> low) & np.uint64(0xFF))


@kernel
def join(planes, shift, expected, signed, values):  # type: ignore[no-untyped-def]
    """Fill `values` from such planes, with what was expected of them; they are 0 before."""
    zero, one = np.uint64(0), np.uint64(1)
    for byte in range(planes.shape[0]):
        low = np.uint64(shift) + np.uint64(8 * byte)
        for k in range(values.size):
            values[k] |= np.uint64(planes[byte, k]) << low
    for k in range(values.size):
        value = values[k]
        if signed:
            value = (value >> one) ^ (zero - (value & one))
        values[k] = value + expected[k]
