"""The points of a frame as they were before gridding, kept so that they can be gridded again.

A drive's attitude is complete only at its end. Then the grids are made again from these points, by
the code of a build.
"""

from __future__ import annotations

import json
import math
import zlib
from struct import Struct, error
from typing import Any

import numpy as np

from fieldgrid.core import AnyArray, UnfoldBudget, parse_json, quoted
from fieldgrid.perception import CodedDepth, LocalGridder, Sweep
from fieldgrid.pipeline import GridInput

_HEAD = Struct("<I")
"""How long the JSON is that is before the data."""
LEVEL = 1
"""Level of zlib: level 6 takes six times as long and saves a fifth."""

CARRIED_M = 10.0
"""How far a point is moved at most by the motion within a sweep."""


def packed(seen: GridInput, reach_m: float) -> bytes:
    """A record of what a grid is made of. Points of a cloud that cannot lie in a grid that reaches
    `reach_m`, however it leans, are NaN in it."""
    row_start, arrays = 0, list[AnyArray]()
    if isinstance(seen, CodedDepth):
        row_start, arrays = seen.row_start, [seen.codes]
    else:
        arrays = [_near(seen.points_m, reach_m)]
        arrays += [] if seen.after_s is None else [seen.after_s]
    arrays = [a.astype(a.dtype.newbyteorder("="), copy=False) for a in arrays]
    # One after the other along rows: neighbours differ little, and so do bytes of equal weight.
    kinds = [
        (str(a.dtype), list(a.shape), a.flags.f_contiguous and not a.flags.c_contiguous)
        for a in arrays
    ]
    header = json.dumps([isinstance(seen, CodedDepth), row_start, kinds]).encode()
    raw = b"".join(
        _differences(a)
        if a.dtype == np.int16
        else _planes(a.ravel(order="F" if by_column else "C"))
        for a, (_, _, by_column) in zip(arrays, kinds, strict=True)
    )
    return _HEAD.pack(len(header)) + header + zlib.compress(raw, LEVEL)


def unpacked(record: bytes, gridder: LocalGridder) -> GridInput | None:
    """What `packed` was given; None for the record of another program."""
    try:
        end = _HEAD.size + _HEAD.unpack_from(record)[0]
        return _read(record[_HEAD.size : end], record[end:], gridder)
    except (ValueError, TypeError, AttributeError, IndexError, OverflowError, zlib.error, error):
        return None


def _read(header: bytes, data: bytes, gridder: LocalGridder) -> GridInput:
    is_coded, row_start, kinds = parse_json(header)
    if any(length < 0 for _, shape, _ in kinds for length in shape):
        raise ValueError("a length is below 0")
    counts = [math.prod(shape) * _dtype(dtype).itemsize for dtype, shape, _ in kinds]
    UnfoldBudget("a record of points", len(data)).spend(sum(counts))
    raw, arrays = zlib.decompressobj().decompress(data, sum(counts) + 1), list[AnyArray]()
    if len(raw) != sum(counts):
        raise ValueError("it unfolds to another size than it says")
    for (dtype, shape, by_column), count in zip(kinds, counts, strict=True):
        part, raw = raw[:count], raw[count:]
        if dtype == "int16":
            codes = np.frombuffer(part, np.int16).reshape(shape)
            arrays.append(np.add.accumulate(codes, axis=1, dtype=np.int16))
            continue
        kind = _dtype(dtype)
        planes = np.frombuffer(part, np.uint8).reshape(kind.itemsize, -1)
        values = np.ascontiguousarray(planes.T).view(kind).ravel()
        values = values.astype(kind.newbyteorder("="), copy=False)
        arrays.append(values.reshape(shape, order="F" if by_column else "C"))
    if is_coded:
        return gridder.coded(arrays[0], row_start)
    return Sweep(arrays[0], arrays[1] if len(arrays) > 1 else None)


def _dtype(name: str) -> np.dtype[Any]:
    """A type by its name, that of another byte order too. ValueError for another text, which NumPy
    would parse as Python."""
    if not name.removeprefix(">").removeprefix("<").isalnum():
        raise ValueError(f"{quoted(name)} is no type of numbers")
    return np.dtype(name)


def _near(points_m: AnyArray, reach_m: float) -> AnyArray:
    """Points [n, 3], NaN where they are too far. They stay as many, and as they lie in memory: sums
    of floats must come out the same. Integers, which have no NaN, become floats."""
    if points_m.dtype.kind != "f":
        points_m = points_m.astype(np.float32)
    near = np.einsum("ni,ni->n", points_m, points_m) <= (2.0 * reach_m + CARRIED_M) ** 2
    found = points_m.copy(order="K")
    found[~near] = np.nan
    return found


def _differences(codes: AnyArray) -> bytes:
    """Codes int16 [row, column] as differences along the rows, modulo 2^16."""
    found = codes.copy()
    found[:, 1:] -= codes[:, :-1]
    return found.tobytes()


def _planes(values: AnyArray) -> bytes:
    """The first bytes of all values, then the second ones, and so on."""
    return values.view(np.uint8).reshape(-1, values.dtype.itemsize).T.tobytes()
