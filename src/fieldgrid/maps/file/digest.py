"""Fingerprints of the evidence: what tells damage, and the same drive under two names.

They are SHA-256 over values, not over their compressed form, so another compressor changes none.
The name of a session, when it was added and whether it is removed are not part of its own.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
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
