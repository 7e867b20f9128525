"""Points and polygons as GeoPackage stores them: a header, then well-known binary."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from fieldgrid.mapfile.schema import SRS_ID

# 'GP', version 0, flags, srs_id; then WKB: little-endian, type, numbers.
_HEADER = struct.Struct("<2sBBi")
_POINT = struct.Struct("<BI dd")
_POLYGON = struct.Struct("<BI II")
_ENVELOPE = struct.Struct("<dddd")
_LITTLE_ENDIAN, _WKB_POINT, _WKB_POLYGON = 1, 1, 3
_NO_ENVELOPE, _XY_ENVELOPE = 0b0000_0001, 0b0000_0011


def encode_point(east_m: float, north_m: float) -> bytes | None:
    """The blob of a point in the map's plane; None, no geometry, when it has no position."""
    if not (math.isfinite(east_m) and math.isfinite(north_m)):
        return None
    header = _HEADER.pack(b"GP", 0, _NO_ENVELOPE, SRS_ID)
    return header + _POINT.pack(_LITTLE_ENDIAN, _WKB_POINT, east_m, north_m)


def encode_polygon(corners: Sequence[tuple[float, float]]) -> bytes | None:
    """The blob of a polygon with these (east, north) corners, which are closed here."""
    east, north = zip(*corners, strict=True)
    if not all(math.isfinite(value) for value in (*east, *north)):
        return None
    ring = [*corners, corners[0]]
    return b"".join(
        (
            _HEADER.pack(b"GP", 0, _XY_ENVELOPE, SRS_ID),
            _ENVELOPE.pack(min(east), max(east), min(north), max(north)),
            _POLYGON.pack(_LITTLE_ENDIAN, _WKB_POLYGON, 1, len(ring)),
            *(struct.pack("<dd", *corner) for corner in ring),
        )
    )


def decode_corners(blob: bytes) -> tuple[tuple[float, float], ...]:
    """The corners of a blob that `encode_point` or `encode_polygon` made: one, or those of the
    outline without the first one again. ValueError for any other."""
    point = len(blob) == _HEADER.size + _POINT.size
    start = _HEADER.size + (_POINT.size - 16 if point else _ENVELOPE.size + _POLYGON.size)
    if len(blob) < start or (len(blob) - start) % 16:
        raise ValueError("its geometry has an odd length")
    corners = tuple(struct.iter_unpack("<dd", blob[start:]))
    made = encode_point(*corners[0]) if point else encode_polygon(corners[:-1])
    if made != blob:
        raise ValueError("its geometry is neither a point nor a plain polygon")
    return corners if point else corners[:-1]
