"""Numbers of a tile as planes of bytes and back: the loops of `tile_codec`.

What is expected of the numbers has no cells where nothing is.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.kernel import kernel


@kernel
def differences(values, expected, signed, row, column, stored):  # type: ignore[no-untyped-def]
    """Fill `stored` [rows, columns] with what the values of a tile from a row and column on are
    more than expected; `signed` ones become small numbers. Returns the bits that any of them has.
    """
    one, bits = np.uint64(1), np.uint64(0)
    width = stored.shape[1]
    for j in range(stored.shape[0]):
        out, own = stored[j], values[row + j, column : column + width]
        if expected.size > 0:
            others = expected[j * width : (j + 1) * width]
            for i in range(width):
                out[i] = own[i] - others[i]
        else:
            for i in range(width):
                out[i] = own[i]
        if signed:
            for i in range(width):
                out[i] = (out[i] << one) ^ np.uint64(np.int64(out[i]) >> 63)
        for i in range(width):
            bits |= out[i]
    return bits


@kernel
def split(stored, shift, planes):  # type: ignore[no-untyped-def]
    """Fill `planes`, uint8 [bytes, cells], with the bytes of `stored`, the low ones first."""
    for byte in range(planes.shape[0]):
        low = np.uint64(shift) + np.uint64(8 * byte)
        for k in range(stored.size):
            planes[byte, k] = np.uint8((stored[k] >> low) & np.uint64(0xFF))


@kernel
def join(planes, shift, expected, signed, row, column, values):  # type: ignore[no-untyped-def]
    """Fill the part of a tile that `planes` [bytes, rows, columns] were made of; it is 0 before."""
    zero, one = np.uint64(0), np.uint64(1)
    for j in range(planes.shape[1]):
        out = values[row + j, column : column + planes.shape[2]]
        for byte in range(planes.shape[0]):
            low = np.uint64(shift) + np.uint64(8 * byte)
            for i in range(planes.shape[2]):
                out[i] |= np.uint64(planes[byte, j, i]) << low
        if signed:
            for i in range(planes.shape[2]):
                out[i] = (out[i] >> one) ^ (zero - (out[i] & one))
        if expected.size > 0:
            first = j * planes.shape[2]
            for i in range(planes.shape[2]):
                out[i] += expected[first + i]
