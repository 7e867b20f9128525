"""`fieldgrid verify`: whether a map is sound."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fieldgrid.cli import output


def command(
    map_: Annotated[Path, typer.Argument(metavar="MAP.gpkg")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check a map: its file, its evidence against hashes, and that all else follows from it.

    Exit status 1 when something is wrong. Example:

        fieldgrid verify vineyard.gpkg
    """
    from fieldgrid.mapfile import open_map

    with open_map(map_) as universal:
        verdict = universal.verify()
    if as_json:
        output.print_json({"map": str(map_), "sound": verdict.sound, **asdict(verdict)})
    else:
        for problem in verdict.problems:
            print(problem)
        state = "sound" if verdict.sound else f"{len(verdict.problems)} problems"
        print(
            f"{map_}: {state}; {verdict.sessions} sessions ({verdict.removed} removed), "
            f"{verdict.frames} frames, {verdict.tiles} tiles"
        )
    if not verdict.sound:
        raise typer.Exit(1)
