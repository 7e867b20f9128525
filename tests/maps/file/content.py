"""All that a map says, for comparison: tiles, pictures, layers, extents, but no row numbers.

Cells are compared before compression: ISA-L does not make the same bytes of the same cells each
time.
"""

from __future__ import annotations

import sqlite3
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np

_QUERIES = {
    "tiles": "SELECT zoom, ty, tx, channels, data FROM fieldgrid_tile ORDER BY 1, 2, 3, 4",
    "tiles whoever drove": "SELECT zoom, ty, tx, channels, data FROM fieldgrid_tile "
    "WHERE channels NOT IN ('sessions', 'terrain', 'surface', 'vehicle_height') "
    "ORDER BY 1, 2, 3, 4",
    "pictures": "SELECT zoom_level, tile_column, tile_row, tile_data FROM density ORDER BY 1, 2, 3",
    "extents": "SELECT table_name, min_x, min_y, max_x, max_y FROM gpkg_contents ORDER BY 1",
    "levels": "SELECT * FROM gpkg_tile_matrix ORDER BY 2",
    "window": "SELECT value FROM fieldgrid_meta WHERE key = 'data_window'",
    "fixes": "SELECT session, time_ns, geom, up_m, heading_deg, heading_sigma_deg, quality, "
    "position_sigma_m, speed_mps, status, reason FROM trajectory ORDER BY session, time_ns",
    "frames": "SELECT session, frame_id, time_ns, geom, heading_deg, quality, status, reason "
    "FROM frame_position ORDER BY session, frame_id",
    "footprints": "SELECT session, frame_id, geom, status FROM footprint ORDER BY 1, 2",
    "digests": "SELECT name, digest FROM fieldgrid_session WHERE removed IS NULL ORDER BY 1",
}

ANONYMOUS = ("tiles whoever drove", "pictures", "extents", "levels", "window")
"""What does not depend on how frames are divided into sessions."""


def content(path: Path, *kinds: str) -> dict[str, list[tuple[Any, ...]]]:
    """The rows of the active sessions by kind, all kinds when none is named."""
    database = sqlite3.connect(path)
    try:
        return {
            kind: [tuple(map(unpacked, row)) for row in database.execute(query)]
            for kind, query in _QUERIES.items()
            if not kinds or kind in kinds
        }
    finally:
        database.close()


def unpacked(value: Any) -> Any:
    """The header of a tile and its values, which follow as a zlib stream; of a stream alone,
    as of a frame's channel, the values; the pixels of a picture; others as they are."""
    if not isinstance(value, bytes) or not value:
        return value
    if value.startswith(b"\x89PNG"):
        return cv2.imdecode(np.frombuffer(value, np.uint8), cv2.IMREAD_UNCHANGED).tobytes()
    for head in (0, 5 + 2 * value[0]):
        with suppress(zlib.error):
            return value[:head], zlib.decompress(value[head:])
    return value
