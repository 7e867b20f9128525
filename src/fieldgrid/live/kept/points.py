"""The points of a frame as they were before gridding, kept so that they can be gridded again.

A drive's attitude is complete only at its end. Then the grids are made again from these points, by
the code of a build.
"""

from __future__ import annotations

import io
import json
import zlib
from struct import Struct, error

import numpy as np

from fieldgrid.core import AnyArray, RecordingError, UnfoldBudget, parse_json
from fieldgrid.perception import CodedDepth, LocalGridder, Sweep
from fieldgrid.pipeline import GridInput
from fieldgrid.recordings import parse_npy

_HEAD = Struct("<I")
"""How long the JSON is that is before the data."""
LEVEL = 1
"""Level of zlib: level 6 takes six times as long and saves a fifth."""

CARRIED_M = 10.0
"""How far a point is moved at most by the motion within a sweep."""


def packed(seen: GridInput, reach_m: float) -> bytes:
    """A record of what a grid is made of: arrays of NumPy's own format. Points of a cloud that
    cannot lie in a grid that reaches `reach_m`, however it leans, are NaN in it."""
    row_start, arrays = None, list[AnyArray]()
    if isinstance(seen, CodedDepth):
        # Along rows neighbours differ little.
        differences = seen.codes.copy()
        differences[:, 1:] -= seen.codes[:, :-1]
        row_start, arrays, widths = seen.row_start, [differences], [1]
    else:
        arrays = [_near(seen.points_m, reach_m)]
        arrays += [] if seen.after_s is None else [seen.after_s]
        widths = [one.itemsize for one in arrays]
    parts = [_planes(one, width) for one, width in zip(arrays, widths, strict=True)]
    about = list(zip(map(len, parts), widths, strict=True))
    header = json.dumps([row_start, about]).encode()
    return _HEAD.pack(len(header)) + header + zlib.compress(b"".join(parts), LEVEL)


def _planes(array: AnyArray, width: int) -> bytes:
    """The first bytes of all values, of so many bytes, then the second ones, and so on: bytes of
    equal weight differ little."""
    file = io.BytesIO()
    np.save(file, array.astype(array.dtype.newbyteorder("="), copy=False), allow_pickle=False)
    return np.frombuffer(file.getvalue(), np.uint8).reshape(-1, width).T.tobytes()


def unpacked(record: bytes, gridder: LocalGridder) -> GridInput | None:
    """What `packed` was given; None for the record of another program."""
    try:
        end = _HEAD.size + _HEAD.unpack_from(record)[0]
        row_start, about = parse_json(record[_HEAD.size : end])
        size = sum(length for length, _ in about)
        UnfoldBudget("a record of points", len(record)).spend(size)
        raw = zlib.decompressobj().decompress(record[end:], size + 1)
        if len(raw) != size:
            return None
        arrays, at = list[AnyArray](), 0
        for length, width in about:
            planes = np.frombuffer(raw[at : at + length], np.uint8).reshape(width, -1)
            arrays.append(parse_npy(planes.T.tobytes(), "a record of points").copy(order="K"))
            at += length
        if row_start is not None:
            return gridder.coded(np.add.accumulate(arrays[0], axis=1, dtype=np.int16), row_start)
        return Sweep(arrays[0], arrays[1] if len(arrays) > 1 else None)
    except (ValueError, TypeError, IndexError, OverflowError, RecordingError, zlib.error, error):
        return None


def _near(points_m: AnyArray, reach_m: float) -> AnyArray:
    """Points [n, 3], NaN where they are too far. They stay as many, and as they lie in memory: sums
    of floats must come out the same. Integers, which have no NaN, become floats."""
    if points_m.dtype.kind != "f":
        points_m = points_m.astype(np.float32)
    near = np.einsum("ni,ni->n", points_m, points_m) <= (2.0 * reach_m + CARRIED_M) ** 2
    found = points_m.copy(order="K")
    found[~near] = np.nan
    return found
