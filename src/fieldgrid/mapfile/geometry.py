"""Points as GeoPackage stores them: a header, then well-known binary."""

from __future__ import annotations

import math
import struct

from fieldgrid.errors import MapError
from fieldgrid.mapfile.schema import SRS_ID

# 'GP', version 0, flags (little-endian, no envelope), srs_id; then WKB: little-endian, type 1.
_POINT = struct.Struct("<2sBBi BI dd")
_FLAGS = 0b0000_0001
_LITTLE_ENDIAN, _WKB_POINT = 1, 1


def encode_point(east_m: float, north_m: float) -> bytes | None:
    """The blob of a point in the map's plane; None, no geometry, when it has no position."""
    if not (math.isfinite(east_m) and math.isfinite(north_m)):
        return None
    return _POINT.pack(b"GP", 0, _FLAGS, SRS_ID, _LITTLE_ENDIAN, _WKB_POINT, east_m, north_m)


def decode_point(blob: object) -> tuple[float, float]:
    """East and north in metres of a point as written here; NaN where there is no geometry."""
    if blob is None:
        return math.nan, math.nan
    try:
        if not isinstance(blob, bytes):
            raise TypeError(f"a blob was expected, not {type(blob).__name__}")
        magic, _, flags, _, order, kind, east_m, north_m = _POINT.unpack(blob)
    except (struct.error, TypeError) as error:
        raise MapError(f"A point of the trajectory layer is damaged: {error}.") from error
    if (magic, flags, order, kind) != (b"GP", _FLAGS, _LITTLE_ENDIAN, _WKB_POINT):
        raise MapError("A point of the trajectory layer has a form that this package never writes.")
    return float(east_m), float(north_m)
