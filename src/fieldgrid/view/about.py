"""What the page is told of a map before it draws anything."""

from __future__ import annotations

from typing import Any

from fieldgrid import palette
from fieldgrid.layers import LAYERS
from fieldgrid.mapfile import MapFile, SessionInfo, in_drive_order
from fieldgrid.view import layers, pyramid
from fieldgrid.view.maps import ShownMap


def describe_map(number: int, shown: ShownMap) -> dict[str, Any]:
    """Name, datum, extent, zoom levels, layers, sessions and marks."""
    version = shown.version()
    with pyramid.stored(shown.path) as connection:
        levels = pyramid.read_levels(connection)
    with shown.open() as universal:
        shown.describe(universal)
        infos = universal.sessions()
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
            "levels": levels.above,
            "bounds": _bounds(universal, infos),
            "layers": [layers.describe(name) for name in LAYERS],
            "changes": layers.describe_changes(),
            "colours": {
                "unseen": palette.UNSEEN,
                "gears": {str(gear): colour for gear, colour in palette.GEARS.items()},
                "rejected": palette.REJECTED,
                "marks": palette.MARKS,
            },
            "marks": [mark._asdict() for mark in universal.marks(removed=True)],
            "sessions": [_session(k, info) for k, info in enumerate(infos)],
            "order": [infos.index(info) for info in in_drive_order(infos)],
        }


def _bounds(universal: MapFile, infos: list[SessionInfo]) -> list[float] | None:
    has_cells = any(info.active and info.accepted for info in infos)
    return list(universal.bounds) if has_cells else None


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
