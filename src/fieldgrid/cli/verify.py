"""`fieldgrid verify`: whether a map is sound."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fieldgrid.cli import output


def command(
    map_: Annotated[Path, typer.Argument(metavar="MAP.gpkg")],
    jobs: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Threads [all cores].")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check a map: its file, its evidence against hashes, and that all else follows from it.

    Exit status 1 when something is wrong. Example:

        fieldgrid verify vineyard.gpkg
    """
    from fieldgrid.mapfile import open_map

    with open_map(map_) as universal:
        health = universal.verify(jobs)
    if as_json:
        output.print_json({"map": str(map_), "sound": health.sound, **asdict(health)})
    else:
        for line in (*health.problems, *health.notes):
            print(line)
        state = "sound" if health.sound else f"{len(health.problems)} problems"
        print(
            f"{map_}: {state}; {health.sessions} sessions ({health.removed} removed), "
            f"{health.frames} frames, {health.tiles} tiles"
        )
    if not health.sound:
        raise typer.Exit(1)
