"""What changed between two times as objects, for the page."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from fieldgrid.errors import ConfigError
from fieldgrid.lattice import Bounds
from fieldgrid.mapfile import MapFile

if TYPE_CHECKING:
    from fieldgrid.changes import ChangedObject

MOST_CELLS = 20_000_000
"""Cells that are looked through for one answer: some seconds."""


def changed_objects(
    universal: MapFile, before: str, after: str, bounds: Bounds | None
) -> list[dict[str, Any]]:
    """The objects that changed between two sessions, the surest first, as `find_changes` has them.

    `geometry` is as that of features: kind 3 and rings of (E, N), metres. Raises ConfigError for
    a part of more than 20 million cells, and as `find_changes` does.
    """
    from fieldgrid.changes import find_changes  # brings 40 MB of libraries

    west_m, south_m, east_m, north_m = universal.bounds if bounds is None else bounds
    if (east_m - west_m) * (north_m - south_m) > MOST_CELLS * universal.cell_m**2:
        raise ConfigError("That is too much of the map to look for changed objects; zoom in.")
    return [_as_dict(one) for one in find_changes(universal, before, after, bounds=bounds)]


def _as_dict(one: ChangedObject) -> dict[str, Any]:
    is_moved = math.isfinite(one.from_east_m)
    parts = getattr(one.area, "geoms", (one.area,))
    polygons = [(part.exterior, *part.interiors) for part in parts]
    return {
        "id": one.id,
        "kind": one.kind.value,
        "geometry": [
            [3, [[[round(e, 3), round(n, 3)] for e, n in ring.coords] for ring in rings]]
            for rings in polygons
        ],
        "east_m": round(one.east_m, 3),
        "north_m": round(one.north_m, 3),
        "from": [round(one.from_east_m, 3), round(one.from_north_m, 3)] if is_moved else None,
        "area_m2": round(one.area_m2, 3),
        "length_m": round(one.length_m, 2),
        "width_m": round(one.width_m, 2),
        "confidence": round(one.confidence, 3),
        "stood": list(one.stood),
        "freed": list(one.freed),
    }
