"""What the page is told of a map before it draws anything."""

from __future__ import annotations

from typing import Any

from fieldgrid.core import palette
from fieldgrid.maps import FOUND_PREFIX, LAYERS, Farm, SessionInfo, in_drive_order
from fieldgrid.view import layers
from fieldgrid.view.maps import ShownSource


def describe_map(number: int, shown: ShownSource) -> dict[str, Any]:
    """Name, datum, extent, zoom levels, layers, sessions and marks; of a farm its maps, too."""
    version = shown.version()
    with shown.open() as universal:
        shown.describe(universal)
        infos = universal.sessions()
        has_cells = any(info.active and info.accepted for info in infos)
        return {
            "number": number,
            "name": shown.name,
            "version": version,
            "datum": {
                "lat_deg": universal.datum.lat_deg,
                "lon_deg": universal.datum.lon_deg,
                "height_m": universal.datum.height_m,
            },
            "cell_m": universal.cell_m,
            "levels": shown.levels(),
            "bounds": list(universal.bounds) if has_cells else None,
            "layers": [layers.describe(name) for name in LAYERS],
            "changes": layers.describe_changes(),
            "colours": {
                "unseen": palette.UNSEEN,
                "gears": {str(gear): colour for gear, colour in palette.GEARS.items()},
                "rejected": palette.REJECTED,
                "marks": palette.MARKS,
                "found": {FOUND_PREFIX + kind: colour for kind, colour in palette.FOUND.items()},
                "route": palette.ROUTE,
            },
            "marks": [mark._asdict() for mark in shown.marks()],
            "sessions": [_session(k, info) for k, info in enumerate(infos)],
            "order": [infos.index(info) for info in in_drive_order(infos)],
            "blocks": _blocks(universal, infos) if isinstance(universal, Farm) else None,
        }


def _session(number: int, info: SessionInfo) -> dict[str, Any]:
    return {
        "number": number,
        "name": info.name,
        "colour": palette.session_colour(number),
        "active": info.active,
        "created": info.created,
        "removed": info.removed,
        "driven": info.driven,
        "source": info.source,
        "heading_source": info.heading_source,
        "frames": info.frames,
        "accepted": info.accepted,
        "first_ms": None if info.first_time_ns is None else info.first_time_ns / 1e6,
        "last_ms": None if info.last_time_ns is None else info.last_time_ns / 1e6,
    }


def _blocks(farm: Farm, infos: list[SessionInfo]) -> list[dict[str, Any]]:
    """The maps of a farm, each with the numbers of its sessions; those that cannot be read with
    the reason."""
    numbers: dict[str, list[int]] = {}
    for k, info in enumerate(infos):
        numbers.setdefault(farm.map_of(info.name).name, []).append(k)
    extents = farm.extents()
    away_m = {one.block.name: one.distance_m for one in farm.moved}
    return [
        {
            "name": block.name,
            "bounds": list(extents[block.name]) if block.name in extents else None,
            "area_m2": round(block.area_m2, 1),
            "sessions": numbers.get(block.name, []),
            "problem": block.problem,
            "datum_away_m": round(away_m.get(block.name, 0.0), 1),
        }
        for block in farm.blocks
    ]
