"""`fieldgrid verify`: whether a map is sound."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from fieldgrid.cli import options, output
from fieldgrid.core import MapError, counted


def command(
    map_: options.MapArgument,
    deep: Annotated[
        bool, typer.Option("--deep", help="Rebuild everything from the frames and compare.")
    ] = False,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    as_json: options.AsJson = False,
) -> None:
    """Check that a map is undamaged, by the checksums that it stores.

    With --deep, or if a checksum does not match, the evidence is checked against its hashes, and
    everything else is rebuilt from it and compared. Exit status 1 if something is wrong.

    Examples:

        fieldgrid verify vineyard.gpkg

        fieldgrid verify vineyard.gpkg --deep

        fieldgrid verify vineyard.gpkg --deep --scheduler tcp://10.0.0.5:8786
    """
    options.check_scheduler(scheduler, jobs)
    options.refuse(scheduler is not None and not deep, "--scheduler", "it is for --deep; add that")
    from fieldgrid.maps import open_map

    with open_map(map_) as universal:
        health = universal.verify(jobs, deep=deep, scheduler=scheduler)
    if as_json:
        output.print_json({"map": str(map_), "sound": health.sound, **asdict(health)})
    else:
        for line in (*health.problems, *health.notes):
            output.print_line(line)
        state = "sound" if health.sound else counted(len(health.problems), "problem")
        output.print_line(
            f"{map_}: {state}; {counted(health.sessions, 'session')} ({health.removed} removed), "
            f"{counted(health.frames, 'frame')}, {counted(health.tiles, 'tile')}"
        )
    if not health.sound:
        raise MapError(
            f"{map_} has {counted(len(health.problems), 'problem')}; the list says which, and "
            f"fieldgrid repair {map_} makes everything again that the frames hold."
        )
