"""`fieldgrid sessions`: what is in a map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fieldgrid.cli import output


def command(
    map_: Annotated[Path, typer.Argument(metavar="MAP.gpkg")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """List the drives that a map was made from.

    Example:

        fieldgrid sessions vineyard.gpkg
    """
    from fieldgrid.mapfile import open_map
    from fieldgrid.trajectory import Status

    found: list[dict[str, Any]] = []
    with open_map(map_) as universal:
        for info in universal.sessions():
            statuses = [record.pose.status for record in universal.frames(info.name)]
            found.append(
                {
                    "name": info.name,
                    "created": info.created,
                    "source": info.source,
                    "frames_used": sum(status is Status.OK for status in statuses),
                    "frames_rejected": sum(status is not Status.OK for status in statuses),
                }
            )
        if as_json:
            datum = universal.datum
            output.print_json(
                {
                    "map": str(map_),
                    "datum": {
                        "lat_deg": datum.lat_deg,
                        "lon_deg": datum.lon_deg,
                        "height_m": datum.height_m,
                    },
                    "cell_m": universal.cell_m,
                    "bounds_m": universal.bounds._asdict(),
                    "sessions": found,
                }
            )
            return
    output.print_table(
        ("session", "created", "GNSS", "used", "rejected"),
        [
            (
                row["name"],
                row["created"],
                row["source"],
                str(row["frames_used"]),
                str(row["frames_rejected"]),
            )
            for row in found
        ],
    )
