"""`fieldgrid verify`: whether a map is sound."""

from __future__ import annotations

from dataclasses import asdict

import typer

from fieldgrid.cli import options, output


def command(
    map_: options.MapArgument,
    jobs: options.Jobs = None,
    as_json: options.AsJson = False,
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
            output.print_line(line)
        state = "sound" if health.sound else f"{len(health.problems)} problems"
        output.print_line(
            f"{map_}: {state}; {health.sessions} sessions ({health.removed} removed), "
            f"{health.frames} frames, {health.tiles} tiles"
        )
    if not health.sound:
        raise typer.Exit(1)
