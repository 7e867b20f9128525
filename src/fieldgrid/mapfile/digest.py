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

from fieldgrid.grids import LocalGrid
from fieldgrid.mapfile.arrays import Array, Kind


def frame_digest(values: Iterable[Any], grid: LocalGrid) -> str:
    """Of a frame: its columns up to the digest itself, then its cells."""
    density = np.where(grid.observed, grid.density, np.uint8(0))
    hashed = hashlib.sha256(_as_json(list(values)))
    hashed.update(density.tobytes())
    hashed.update(np.packbits(grid.observed).tobytes())
    return hashed.hexdigest()


def session_digest(
    values: Iterable[Any],
    arrays: Mapping[Kind, Mapping[str, Array]],
    frames: Iterable[str],
) -> str:
    """Of a session: its own columns, its arrays, and the digests of its frames, sorted."""
    hashed = hashlib.sha256(_as_json(list(values)))
    for kind in Kind:
        for name, array in sorted(arrays.get(kind, {}).items()):
            value = np.asarray(array)
            value = value.astype(value.dtype.newbyteorder("<"), copy=False)
            hashed.update(_as_json([kind.value, name, value.dtype.str, list(value.shape)]))
            hashed.update(value.tobytes())
    for frame in sorted(frames):
        hashed.update(frame.encode())
    return hashed.hexdigest()


def _as_json(values: list[Any]) -> bytes:
    # A number that is not known is NULL in the file.
    known = [None if isinstance(v, float) and math.isnan(v) else v for v in values]
    return json.dumps(known, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"
