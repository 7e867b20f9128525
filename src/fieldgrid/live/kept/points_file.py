"""The points of each frame as they were before gridding, kept so that they can be gridded again.

A drive's attitude is complete only at its end. Then the grids are made again from these points, by
the code of a build. A record is written whole or does not count; where it begins is kept with the
frame.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from contextlib import suppress
from pathlib import Path
from struct import Struct
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, Closing, MapError, UnfoldBudget, parse_json, quoted
from fieldgrid.perception import CodedDepth, LocalGridder, Sweep

GridInput = CodedDepth | Sweep
"""What a grid is made of: an image of depths, or points."""

MAGIC = b"fieldgrid points 1\n"
_RECORD = Struct("<4sIII")
"""The head of each record: a mark, the length of its JSON header and of its data, the CRC-32 of
both."""
_MARK = b"SEEN"
LEVEL = 1
"""Level of zlib: level 6 takes six times as long and saves a fifth."""

CARRIED_M = 10.0
"""How far a point is moved at most by the motion within a sweep."""


class RecordSpan(NamedTuple):
    """Where a record is in the file, bytes."""

    start: int
    size: int


class PointsFile(Closing):
    """A file of records that is open to append to it; appending is for one thread at a time."""

    def __init__(self, path: Path) -> None:
        """Open the file, or make it. MapError for another file, OSError where there can be
        none."""
        self._file: int | None = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            self.size = os.fstat(self._file).st_size
            if not self.size:
                self.size = os.pwrite(self._file, MAGIC, 0)
                os.fsync(self._file)  # records without their head are lost
            if os.pread(self._file, len(MAGIC), 0) != MAGIC:
                raise MapError(f"{path} holds no points of a live session. Check the name.")
        except BaseException:
            self.close()
            raise

    def append(self, record: bytes) -> RecordSpan:
        """Write what `packed` made behind the others. OSError on a full disk: then nothing was
        added."""
        assert self._file is not None, "the file of points is closed"
        start, left = self.size, memoryview(record)
        try:
            while left:  # a disk that fills up takes a part first
                left = left[os.pwrite(self._file, left, start + len(record) - len(left)) :]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file, start)  # other files need the room
            raise
        self.size += len(record)
        return RecordSpan(start, len(record))

    def take_back(self, place: RecordSpan) -> None:
        """Give the room of the last record back."""
        assert self._file is not None, "the file of points is closed"
        if place.start + place.size == self.size:
            with suppress(OSError):
                os.ftruncate(self._file, place.start)
                self.size = place.start

    def read(self, place: RecordSpan, gridder: LocalGridder) -> GridInput | None:
        """The points of the record there; None where it is cut off or damaged."""
        parts = self._parts(place)
        if parts is None:
            return None
        try:
            return _unpacked(*parts, gridder)
        except (ValueError, TypeError, AttributeError, IndexError, OverflowError, zlib.error):
            return None  # its sum fits, but it is no record of this program

    def has(self, place: RecordSpan) -> bool:
        """Whether the record there is whole."""
        return self._parts(place) is not None

    def _parts(self, place: RecordSpan) -> tuple[bytes, bytes] | None:
        assert self._file is not None, "the file of points is closed"
        record = os.pread(self._file, place.size, place.start)
        if len(record) < max(place.size, _RECORD.size):
            return None
        mark, size, length, check = _RECORD.unpack(record[: _RECORD.size])
        body = record[_RECORD.size :]
        if mark != _MARK or len(body) != size + length or zlib.crc32(body) != check:
            return None
        return body[:size], body[size:]

    def duplicate(self) -> int:
        """A descriptor of its own, to sync the file beside appending; the caller closes it."""
        assert self._file is not None, "the file of points is closed"
        return os.dup(self._file)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def points_end(path: Path) -> int | None:
    """How long a file of points is; None where there is none, or no head of one: all its records
    are lost."""
    try:
        with path.open("rb") as file:
            return path.stat().st_size if file.read(len(MAGIC)) == MAGIC else None
    except OSError:
        return None


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
    data = zlib.compress(raw, LEVEL)
    check = zlib.crc32(data, zlib.crc32(header))
    return _RECORD.pack(_MARK, len(header), len(data), check) + header + data


def _unpacked(header: bytes, data: bytes, gridder: LocalGridder) -> GridInput:
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
