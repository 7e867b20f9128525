"""`fieldgrid sessions`: what is in a map, and what should not be."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import output

if TYPE_CHECKING:
    from fieldgrid.mapfile import MapFile, SessionInfo


def command(
    map_: Annotated[Path, typer.Argument(metavar="MAP.gpkg")],
    remove: Annotated[
        str | None, typer.Option(metavar="NAME", help="Take a session out; its evidence stays.")
    ] = None,
    restore: Annotated[
        str | None, typer.Option(metavar="NAME", help="Put a removed session back.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the drives that a map was made from; take one out, or put it back.

    Examples:

        fieldgrid sessions vineyard.gpkg

        fieldgrid sessions vineyard.gpkg --remove june-17
    """
    if remove is not None and restore is not None:
        raise typer.BadParameter("--remove and --restore exclude each other", param_hint="--remove")
    from fieldgrid.mapfile import open_map

    change = remove is not None or restore is not None
    with open_map(map_, writable=change) as universal:
        if remove is not None:
            universal.remove_session(remove)
        if restore is not None:
            universal.restore_session(restore)
        infos = universal.sessions()
        if as_json:
            output.print_json(_as_dict(map_, universal, infos))
            return
    output.print_table(
        ("session", "driven", "GNSS", "used", "rejected", ""), [_row(info) for info in infos]
    )


def _row(info: SessionInfo) -> tuple[str, ...]:
    return (
        info.name,
        info.driven,
        info.source,
        str(info.accepted),
        str(info.frames - info.accepted),
        "" if info.active else "removed",
    )


def _as_dict(path: Path, universal: MapFile, infos: list[SessionInfo]) -> dict[str, Any]:
    datum = universal.datum
    has_cells = any(info.active and info.accepted for info in infos)
    return {
        "map": str(path),
        "datum": {
            "lat_deg": datum.lat_deg,
            "lon_deg": datum.lon_deg,
            "height_m": datum.height_m,
        },
        "cell_m": universal.cell_m,
        "transfer": universal.transfer.value,
        "bounds_m": universal.bounds._asdict() if has_cells else None,
        "sessions": [
            {
                "name": info.name,
                "created": info.created,
                "removed": info.removed,
                "source": info.source,
                "source_sha256": info.source_sha256,
                "first_time_ns": info.first_time_ns,
                "last_time_ns": info.last_time_ns,
                "heading_source": info.heading_source,
                "software_version": info.software_version,
                "frames_used": info.accepted,
                "frames_rejected": info.frames - info.accepted,
                "digest": info.digest,
            }
            for info in infos
        ],
    }
