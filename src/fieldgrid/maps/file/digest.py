"""Fingerprints of the evidence: what tells damage, and the same drive under two names.

They are SHA-256 over values, not over their compressed form, so another compressor changes none.
The name of a session, when it was added and whether it is removed are not part of its own.
"""

from __future__ import annotations

import hashlib
import json
import math
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from fieldgrid.maps.file.arrays import Array, ArrayKind


def frame_digest(values: Iterable[Any]) -> str:
    """Of a frame: its columns up to the digest itself, the SHA-256 of its cells among them."""
    return hashlib.sha256(as_json(list(values))).hexdigest()


def session_digest(
    values: Iterable[Any],
    arrays: Mapping[ArrayKind, Mapping[str, Array]],
    frames: Iterable[str],
) -> str:
    """Of a session: its own columns, its arrays, and the digests of its frames, sorted."""
    hashed = hashlib.sha256(as_json(list(values)))
    for kind in ArrayKind:
        for name, array in sorted(arrays.get(kind, {}).items()):
            value = np.asarray(array)
            value = value.astype(value.dtype.newbyteorder("<"), copy=False)
            hashed.update(as_json([kind.value, name, value.dtype.str, list(value.shape)]))
            hashed.update(value.tobytes())
    for frame in sorted(frames):
        hashed.update(frame.encode())
    return hashed.hexdigest()


def as_json(values: list[Any]) -> bytes:
    """A compact JSON list and a line feed: what is hashed of plain values."""
    # A number that is not known is NULL in the file.
    known = [None if isinstance(v, float) and math.isnan(v) else v for v in values]
    return json.dumps(known, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"


_AS_WRITTEN: Mapping[type, str] = {
    bytes: "[%d]",  # a blob by its length
    bytearray: '"x%s"',  # a text by the digits of its bytes, which need be no UTF-8
    str: '"%s"',  # such digits already
    int: "%r",
    float: "%r",
    type(None): "null%.0s",  # which writes nothing of the value
}


@lru_cache
def _form_of(types: tuple[type, ...]) -> tuple[str, tuple[int, ...], tuple[int, ...]]:
    """How a row of values of some types is hashed: its line, and which values are blobs and texts.
    Rows of one table have few forms, and a map has many rows."""
    line = ",".join(_AS_WRITTEN[kind] for kind in types)
    blobs = tuple(k for k, kind in enumerate(types) if kind is bytes)
    texts = tuple(k for k, kind in enumerate(types) if kind is bytearray)
    return f"[{line}]\n", blobs, texts


def of_row(row: Sequence[Any]) -> int:
    """The SHA-256 of a row: a line of values, a blob as a list of its length, then the blobs."""
    line, blobs, texts = _form_of(tuple(map(type, row)))
    values = list(row)
    for k in texts:
        values[k] = row[k].hex().upper()
    for k in blobs:
        values[k] = len(row[k])
    hashed = hashlib.sha256((line % tuple(values)).encode())
    for k in blobs:
        hashed.update(row[k])
    return int.from_bytes(hashed.digest(), "big")


def of_rows(connection: sqlite3.Connection, table: str) -> int:
    """The sum of the digests of the rows of a table. No other thread may read meanwhile."""
    as_usual, connection.text_factory = connection.text_factory, bytearray
    try:
        return sum(map(of_row, connection.execute(f"SELECT * FROM {table}")))
    finally:
        connection.text_factory = as_usual
