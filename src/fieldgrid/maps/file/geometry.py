"""Points and polygons as GeoPackage stores them: a header, then well-known binary."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

from fieldgrid.maps.file.schema import SRS_ID

# 'GP', version 0, flags, srs_id; then WKB: little-endian, type, numbers.
_HEADER = struct.Struct("<2sBBi")
_POINT = struct.Struct("<BI dd")
_POLYGON = struct.Struct("<BI I")
_COUNT = struct.Struct("<I")
_ENVELOPE = struct.Struct("<dddd")
_LITTLE_ENDIAN, _WKB_POINT, _WKB_POLYGON = 1, 1, 3
_NO_ENVELOPE, _XY_ENVELOPE = 0b0000_0001, 0b0000_0011


def encode_point(east_m: float, north_m: float) -> bytes | None:
    """The blob of a point in the map's plane; None, no geometry, when it has no position."""
    if not (math.isfinite(east_m) and math.isfinite(north_m)):
        return None
    header = _HEADER.pack(b"GP", 0, _NO_ENVELOPE, SRS_ID)
    return header + _POINT.pack(_LITTLE_ENDIAN, _WKB_POINT, east_m, north_m)


Ring = tuple[tuple[float, float], ...]
"""Corners (east, north) in metres, without the first one again."""


def encode_polygon(
    corners: Sequence[tuple[float, float]], holes: Sequence[Ring] = ()
) -> bytes | None:
    """The blob of a polygon with these (east, north) corners, and holes in it; all rings are closed
    here. None where a corner has no position."""
    east, north = zip(*corners, strict=True)
    if not all(math.isfinite(value) for value in (*east, *north)):
        return None
    rings = [*corners, corners[0]], *([*hole, hole[0]] for hole in holes)
    return b"".join(
        (
            _HEADER.pack(b"GP", 0, _XY_ENVELOPE, SRS_ID),
            _ENVELOPE.pack(min(east), max(east), min(north), max(north)),
            _POLYGON.pack(_LITTLE_ENDIAN, _WKB_POLYGON, len(rings)),
            *(
                _COUNT.pack(len(ring)) + b"".join(struct.pack("<dd", *corner) for corner in ring)
                for ring in rings
            ),
        )
    )


def encode_shape(shape: Any) -> bytes:
    """The blob of a shapely geometry."""
    import shapely

    wkb: bytes = shapely.to_wkb(shapely.force_2d(shape), byte_order=1)
    return _HEADER.pack(b"GP", 0, _NO_ENVELOPE, SRS_ID) + wkb


def shape_of(blob: bytes) -> Any:
    """The shapely geometry of a blob that `encode_shape` made; ValueError for any other."""
    import shapely

    if blob[: _HEADER.size] != _HEADER.pack(b"GP", 0, _NO_ENVELOPE, SRS_ID):
        raise ValueError("a geometry has another header")
    try:
        return shapely.from_wkb(blob[_HEADER.size :])
    except shapely.errors.ShapelyError as error:
        raise ValueError(str(error)) from error


def decode_rings(blob: bytes) -> tuple[Ring, ...]:
    """The rings of a blob that `encode_point` or `encode_polygon` made: one corner of a point, or
    the outline of a polygon and its holes. ValueError for any other."""
    if len(blob) == _HEADER.size + _POINT.size:
        rings = [tuple(struct.iter_unpack("<dd", blob[-16:]))]
        made = encode_point(*rings[0][0])
    else:
        rings, at = [], _HEADER.size + _ENVELOPE.size + _POLYGON.size
        while at + _COUNT.size < len(blob):
            (count,) = _COUNT.unpack_from(blob, at)
            end = at + _COUNT.size + 16 * count
            if count < 2 or end > len(blob):
                raise ValueError("its geometry is cut off")
            rings.append(tuple(struct.iter_unpack("<dd", blob[at + _COUNT.size : end - 16])))
            at = end
        made = encode_polygon(rings[0], rings[1:]) if rings else None
    if made != blob:
        raise ValueError("its geometry is neither a point nor a plain polygon")
    return tuple(rings)
