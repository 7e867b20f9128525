"""Named arrays that a session carries along: its trajectory, and whatever made it.

Each is stored without loss, in parts of some megabytes: low bytes first, the first byte of every
value, then the second of every value, in a zlib stream.
"""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from enum import StrEnum
from typing import Any

import numpy as np

from fieldgrid.core import (
    AnyArray,
    ConfigError,
    FieldgridError,
    MapError,
    parse_json,
    quoted,
    shortened,
)
from fieldgrid.geometry import Datum, Status, Trajectory
from fieldgrid.maps.file.codec import deflate, inflate, stored_dtype

Array = AnyArray

_PART_BYTES = 8 << 20
_KINDS = "biufcSUmM"
"""Kinds of NumPy values that are no objects and have no fields."""


class ArrayKind(StrEnum):
    """What an array of a session is for."""

    TRAJECTORY = "trajectory"
    INPUT = "input"


def array_rows(kind: ArrayKind, arrays: Mapping[str, Array]) -> Iterator[tuple[Any, ...]]:
    """The rows of `fieldgrid_array`, without a session, of named arrays; ConfigError for one that
    cannot be stored."""
    for name, array in sorted(arrays.items()):
        values = np.asarray(array)
        if values.dtype.kind not in _KINDS or values.dtype.names:
            raise ConfigError(
                f"Array {quoted(name)} holds {values.dtype}, which a map does not store; "
                "give numbers, texts or times, an array a field."
            )
        dtype, shape = values.dtype.newbyteorder("<"), json.dumps(values.shape)
        # Not ascontiguousarray, which would make a vector of a single value.
        flat = values.astype(dtype, copy=False).reshape(-1)
        step = max(1, _PART_BYTES // max(dtype.itemsize, 1))
        for part in range(max(1, -(-flat.size // step))):
            octets = np.frombuffer(flat[part * step : (part + 1) * step].tobytes(), dtype=np.uint8)
            if dtype.itemsize:
                octets = octets.reshape(-1, dtype.itemsize).T
            yield kind.value, name, part, dtype.str, shape, deflate(octets.tobytes())


def read_arrays(
    connection: sqlite3.Connection, session_id: int, kind: ArrayKind
) -> dict[str, Array]:
    """All arrays of one kind that a session has, in the order of their names."""
    rows = connection.execute(
        "SELECT name, part, dtype, shape, data FROM fieldgrid_array "
        "WHERE session_id = ? AND kind = ? ORDER BY name, part",
        (session_id, kind.value),
    )
    parts: dict[str, list[tuple[Any, ...]]] = {}
    for name, *row in rows:
        parts.setdefault(str(name), []).append(tuple(row))
    return {name: _array(name, *zip(*found, strict=True)) for name, found in parts.items()}


def _array(
    name: str,
    parts: Sequence[Any],
    dtypes: Sequence[Any],
    shapes: Sequence[Any],
    blobs: Sequence[object],
) -> Array:
    what = f"array {quoted(name)}"
    try:
        dtype, shape = stored_dtype(dtypes[0]), tuple(map(int, parse_json(shapes[0])))
        if dtype.kind not in _KINDS or min(shape, default=0) < 0:
            raise ValueError(f"its type is {dtype}, its shape {shape}")
        size = int(np.prod(shape, dtype=np.int64))
        step = max(1, _PART_BYTES // max(dtype.itemsize, 1))
        # Checked before memory is taken for what the shape claims.
        if list(parts) != list(range(len(parts))):
            raise ValueError("a part is missing")
        if len(parts) != max(1, -(-size // step)):
            raise ValueError(f"it has {len(parts)} parts, but the shape {shape}")
        flat = np.empty(size, dtype=dtype)
        for part, blob in zip(parts, blobs, strict=True):
            place = flat[part * step : (part + 1) * step]
            octets = inflate(blob, place.nbytes, what)
            if dtype.itemsize:
                planes = np.frombuffer(octets, dtype=np.uint8).reshape(dtype.itemsize, -1)
                place[:] = np.frombuffer(planes.T.tobytes(), dtype=dtype)
        return flat.astype(dtype.newbyteorder("="), copy=False).reshape(shape)
    except (TypeError, ValueError, OverflowError, MemoryError, zlib.error) as error:
        if isinstance(error, FieldgridError):
            raise
        raise MapError(
            f"The stored {what} is damaged: {shortened(error)}. Restore the map from a copy."
        ) from error


def trajectory_arrays(track: Trajectory) -> dict[str, Array]:
    """Every column of a trajectory by its name; texts as the bytes of a JSON list."""
    columns: dict[str, Array] = {}
    for column in fields(track):
        value = getattr(track, column.name)
        if column.init and isinstance(value, np.ndarray):
            columns[column.name] = value
        elif column.init and isinstance(value, tuple):
            text = json.dumps([str(item) for item in value], ensure_ascii=False)
            columns[column.name] = np.frombuffer(text.encode(), dtype=np.uint8)
    return columns


def trajectory_of(columns: Mapping[str, Array], datum: Datum, heading_source: str) -> Trajectory:
    """A trajectory from its stored columns, bit for bit."""
    values: dict[str, Any] = {**columns}
    try:
        for name in ("status", "reason"):
            values[name] = tuple(parse_json(columns[name].tobytes()))
        values["status"] = tuple(Status(value) for value in values["status"])
        return Trajectory(datum=datum, heading_source=heading_source, **values)
    except (KeyError, TypeError, ValueError, FieldgridError) as error:
        raise MapError(f"A stored trajectory is damaged: {shortened(error)}.") from error
