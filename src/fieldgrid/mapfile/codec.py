"""The compressed values inside a map: a frame's local grid, and the cells of a tile.

All are zlib streams, so that any language can read them. Decoding never makes more bytes than
the value's known size asks for, whatever a file claims.
"""

from __future__ import annotations

import zlib

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import MapError
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.lattice import TILE_CELLS
from fieldgrid.moments import FRAMES, HIGHEST, PLANES, SQUARES, SUM, WEIGHT, Moments
from fieldgrid.transfer import CELL_WEIGHT

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


def encode_sums(sums: npt.NDArray[np.uint64]) -> bytes:
    """A tile's (weight, weighted sum), uint64 [256, 256, 2], as three bytes and a stream.

    The header says how many low bytes of the weights and of the sums follow, and how many
    zero bits were dropped from the right of both. The stream holds one plane of 65,536 cells
    a byte, low bytes first: high bytes are nearly all alike and cost nothing.
    """
    bits = int(np.bitwise_or.reduce(sums, axis=None))
    shift = min(_MAX_SHIFT, (bits & -bits).bit_length() - 1) if bits else 0
    shifted = sums >> np.uint64(shift)
    planes = tuple(max(1, -(-int(shifted[..., k].max()).bit_length() // 8)) for k in range(2))
    octets = shifted.astype("<u8", copy=False).view(np.uint8).reshape(_TILE_AREA, 2 * _WORD)
    header = bytes((*planes, shift))
    return header + deflate(octets[:, _columns(*planes)].T.tobytes())


def decode_sums(blob: object, what: str) -> npt.NDArray[np.uint64]:
    """The sums of a tile, uint64 [256, 256, 2]; `what` names it when the blob is damaged."""
    if not isinstance(blob, bytes) or len(blob) < 3:
        raise _damaged(what, "it has no header")
    weight_planes, sum_planes, shift = blob[:3]
    sound = 1 <= weight_planes <= _MAX_PLANES and 1 <= sum_planes <= _MAX_PLANES
    if not sound or shift > _MAX_SHIFT:
        raise _damaged(what, f"its header is {tuple(blob[:3])}")
    columns = _columns(weight_planes, sum_planes)
    data = np.frombuffer(inflate(blob[3:], _TILE_AREA * len(columns), what), dtype=np.uint8)
    octets = np.zeros((_TILE_AREA, 2 * _WORD), dtype=np.uint8)
    octets[:, columns] = data.reshape(len(columns), _TILE_AREA).T
    sums = octets.view("<u8").astype(np.uint64, copy=False)
    return sums.reshape(TILE_CELLS, TILE_CELLS, 2) << np.uint64(shift)


def encode_moments(moments: Moments) -> bytes:
    """A tile's moments, uint64 [256, 256, 5], as six bytes and a stream.

    The header says how many zero bits were dropped from the right of the first three, and how
    many low bytes follow of each quantity. Squares, frames and highest are stored as what they
    differ by from a cell that was seen once, or always alike: mostly 0, which costs nothing.
    """
    bits = int(np.bitwise_or.reduce(moments[..., :FRAMES], axis=None))
    shift = min(_MAX_SHIFT, (bits & -bits).bit_length() - 1) if bits else 0
    stored = np.empty((PLANES, _TILE_AREA), dtype="<u8")
    stored[:] = moments.reshape(_TILE_AREA, PLANES).T
    stored[:FRAMES] >>= np.uint64(shift)
    stored[SQUARES] -= _squares_when_alike(stored)
    stored[FRAMES] = _zigzag(stored[FRAMES] - _frames_when_whole(stored[WEIGHT], shift))
    stored[HIGHEST] = (stored[HIGHEST] - _mean_upwards(stored)) & np.uint64(0xFF)
    planes = [-(-int(quantity.max()).bit_length() // 8) for quantity in stored]
    octets = stored.view(np.uint8).reshape(PLANES, _TILE_AREA, _WORD)
    kept = [octets[k, :, byte] for k, count in enumerate(planes) for byte in range(count)]
    return bytes((shift, *planes)) + deflate(b"".join(plane.tobytes() for plane in kept))


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
    stored = np.zeros((PLANES, _TILE_AREA), dtype="<u8")
    octets = stored.view(np.uint8).reshape(PLANES, _TILE_AREA, _WORD)
    kept = [(k, byte) for k, count in enumerate(planes) for byte in range(count)]
    for plane, (k, byte) in zip(data, kept, strict=True):
        octets[k, :, byte] = plane
    stored[HIGHEST] = (stored[HIGHEST] + _mean_upwards(stored)) & np.uint64(0xFF)
    stored[FRAMES] = _unzigzag(stored[FRAMES]) + _frames_when_whole(stored[WEIGHT], shift)
    stored[SQUARES] += _squares_when_alike(stored)
    stored[:FRAMES] <<= np.uint64(shift)
    moments = stored.T.astype(np.uint64, order="C")
    return moments.reshape(TILE_CELLS, TILE_CELLS, PLANES)


def _squares_when_alike(stored: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """The sum of squares of a cell whose values are all its mean, rounded down, modulo 2^64."""
    alike: npt.NDArray[np.uint64] = stored[SUM] * stored[SUM]
    alike //= np.maximum(stored[WEIGHT], np.uint64(1))
    return alike


def _frames_when_whole(weight: npt.NDArray[np.uint64], shift: int) -> npt.NDArray[np.uint64]:
    """The frames of a cell to which each gave one whole local cell, rounded up."""
    whole: npt.NDArray[np.uint64] = (weight << np.uint64(shift)) + np.uint64(CELL_WEIGHT - 1)
    whole //= np.uint64(CELL_WEIGHT)
    return whole


def _mean_upwards(stored: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """The mean of a cell, rounded up, which the highest value is not below."""
    divisor = np.maximum(stored[WEIGHT], np.uint64(1))
    mean: npt.NDArray[np.uint64] = (stored[SUM] + divisor - np.uint64(1)) // divisor
    return mean


def _zigzag(difference: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """0, -1, 1, -2, ... (modulo 2^64) as 0, 1, 2, 3, ...: small numbers of both signs."""
    signed = difference.view(np.int64)
    stored: npt.NDArray[np.uint64] = ((signed << 1) ^ (signed >> 63)).view(np.uint64)
    return stored


def _unzigzag(stored: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    sign = np.uint64(0) - (stored & np.uint64(1))
    difference: npt.NDArray[np.uint64] = (stored >> np.uint64(1)) ^ sign
    return difference


def _columns(weight_planes: int, sum_planes: int) -> list[int]:
    return [*range(weight_planes), *range(_WORD, _WORD + sum_planes)]


def _damaged(what: str, why: str) -> MapError:
    return MapError(f"The stored {what} is damaged: {why}. Restore the map from a copy.")
