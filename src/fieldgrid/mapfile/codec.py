"""The compressed values inside a map: a frame's local grid, and the cells of a tile.

All are zlib streams, so that any language can read them. Decoding never makes more bytes than
the value's known size asks for, whatever a file claims.
"""

from __future__ import annotations

import zlib

import numpy as np

from fieldgrid.array_types import UInt64
from fieldgrid.errors import MapError
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.lattice import TILE_CELLS
from fieldgrid.mapfile.planes import (
    bits_of,
    byte_planes,
    empty_stored,
    from_byte_planes,
    from_stored,
    to_stored,
)
from fieldgrid.moments import FRAMES, PLANES, Moments

# Level 1 is 6 to 9 times as fast as level 6 here, for 10 to 15 % more bytes.
_LEVEL = 1

_MAX_SHIFT = 4
_MAX_PLANES = 7
"""Bytes a sum may take: 7 of 8 leave room for the shift and for the rounding of a mean."""

_WORD = 8
"""Bytes of a weight, and of a weighted sum, in memory."""

_TILE_AREA = TILE_CELLS * TILE_CELLS


def deflate(data: bytes | memoryview, strategy: int = zlib.Z_DEFAULT_STRATEGY) -> bytes:
    """A zlib stream of `data`. Z_RLE suits bytes that repeat or are noise: faster and smaller."""
    stream = zlib.compressobj(_LEVEL, zlib.DEFLATED, zlib.MAX_WBITS, 8, strategy)
    return stream.compress(data) + stream.flush()


def inflate(blob: object, size: int, what: str) -> bytes:
    """The `size` bytes of a zlib stream, or MapError: neither fewer nor more are accepted."""
    stream = zlib.decompressobj()
    try:
        if not isinstance(blob, bytes):
            raise TypeError(f"a blob was expected, not {type(blob).__name__}")
        data = stream.decompress(blob, size + 1)
    except (zlib.error, TypeError) as error:
        raise _damaged(what, str(error)) from error
    if len(data) != size or not stream.eof:
        raise _damaged(what, f"it does not hold {size} bytes")
    return data


def encode_grid(grid: LocalGrid) -> tuple[bytes, bytes]:
    """A local grid as (density, observed): row-major bytes, and bits packed high bit first.

    The density of a cell that was not observed means nothing and is stored as 0.
    """
    density = np.where(grid.observed, grid.density, np.uint8(0))
    return deflate(density.data, zlib.Z_RLE), deflate(np.packbits(grid.observed).data)


def decode_grid(spec: GridSpec, density: object, observed: object, what: str) -> LocalGrid:
    """The local grid of two blobs; `what` names it in the error when they are damaged."""
    cells = spec.n_x * spec.n_y
    bits = np.frombuffer(inflate(observed, -(-cells // 8), what), dtype=np.uint8)
    values = np.frombuffer(inflate(density, cells, what), dtype=np.uint8)
    mask = np.unpackbits(bits, count=cells).view(np.bool_)
    return LocalGrid(spec, values.reshape(spec.shape), mask.reshape(spec.shape))


def encode_sums(sums: UInt64) -> bytes:
    """A tile's (weight, weighted sum), uint64 [256, 256, 2], as three bytes and a stream.

    The header says how many low bytes of the weights and of the sums follow, and how many
    zero bits were dropped from the right of both. The stream holds one plane of 65,536 cells
    a byte, low bytes first: high bytes are nearly all alike and cost nothing.
    """
    cells = sums.reshape(_TILE_AREA, 2)
    bits = int(bits_of(cells, 2))
    shift = min(_MAX_SHIFT, (bits & -bits).bit_length() - 1) if bits else 0
    stored = np.right_shift(cells.T, np.uint64(shift), order="C")
    counts = np.array([max(1, -(-int(row.max()).bit_length() // 8)) for row in stored])
    octets = np.empty((counts.sum(), _TILE_AREA), dtype=np.uint8)
    byte_planes(stored, counts, octets)
    return bytes((*counts.tolist(), shift)) + deflate(octets.data, zlib.Z_RLE)


def decode_sums(blob: object, what: str) -> UInt64:
    """The sums of a tile, uint64 [256, 256, 2]; `what` names it when the blob is damaged."""
    if not isinstance(blob, bytes) or len(blob) < 3:
        raise _damaged(what, "it has no header")
    weight_planes, sum_planes, shift = blob[:3]
    sound = 1 <= weight_planes <= _MAX_PLANES and 1 <= sum_planes <= _MAX_PLANES
    if not sound or shift > _MAX_SHIFT:
        raise _damaged(what, f"its header is {tuple(blob[:3])}")
    planes = weight_planes + sum_planes
    data = np.frombuffer(inflate(blob[3:], _TILE_AREA * planes, what), dtype=np.uint8)
    stored = np.zeros((2, _TILE_AREA), dtype=np.uint64)
    counts = np.array([weight_planes, sum_planes])
    from_byte_planes(data.reshape(planes, _TILE_AREA), counts, stored)
    sums = np.left_shift(stored.T, np.uint64(shift), order="C")
    return sums.reshape(TILE_CELLS, TILE_CELLS, 2)


def encode_moments(moments: Moments) -> bytes:
    """A tile's moments, uint64 [256, 256, 5], as six bytes and a stream.

    The header says how many zero bits were dropped from the right of the first three, and how
    many low bytes follow of each quantity, as :mod:`fieldgrid.mapfile.planes` makes them.
    """
    cells = moments.reshape(_TILE_AREA, PLANES)
    bits = int(bits_of(cells, FRAMES))
    shift = min(_MAX_SHIFT, (bits & -bits).bit_length() - 1) if bits else 0
    stored = empty_stored(_TILE_AREA)
    to_stored(cells, shift, stored)
    counts = np.array([-(-int(quantity.max()).bit_length() // 8) for quantity in stored])
    octets = np.empty((counts.sum(), _TILE_AREA), dtype=np.uint8)
    byte_planes(stored, counts, octets)
    return bytes((shift, *counts.tolist())) + deflate(
        octets.data if octets.size else b"", zlib.Z_RLE
    )


def decode_moments(blob: object, what: str) -> Moments:
    """The moments of a tile, uint64 [256, 256, 5]; `what` names it when the blob is damaged."""
    if not isinstance(blob, bytes) or len(blob) <= PLANES:
        raise _damaged(what, "it has no header")
    shift, *planes = blob[: PLANES + 1]
    if shift > _MAX_SHIFT or max(planes) > _WORD:
        raise _damaged(what, f"its header is {tuple(blob[: PLANES + 1])}")
    data = np.frombuffer(
        inflate(blob[PLANES + 1 :], _TILE_AREA * sum(planes), what), dtype=np.uint8
    ).reshape(-1, _TILE_AREA)
    stored = empty_stored(_TILE_AREA)
    from_byte_planes(data, np.array(planes), stored)
    moments = np.empty((TILE_CELLS, TILE_CELLS, PLANES), dtype=np.uint64)
    from_stored(stored, shift, moments.reshape(_TILE_AREA, PLANES))
    return moments


def _damaged(what: str, why: str) -> MapError:
    return MapError(f"The stored {what} is damaged: {why}. Restore the map from a copy.")
