"""`fieldgrid repair`: rebuild the derived tables of a map from its stored frames."""

from __future__ import annotations

from typing import Annotated

import typer

from fieldgrid.cli import options, output


def command(
    map_: options.MapArgument,
    upgrade: Annotated[
        bool,
        typer.Option("--upgrade", help="Only bring a map of an older format to the present one."),
    ] = False,
    jobs: options.Jobs = None,
    as_json: options.AsJson = False,
) -> None:
    """Rebuild the tiles, pictures and layers of a map from its stored frames.

    The frames themselves, poses included, are not changed.

    Examples:

        fieldgrid repair vineyard.gpkg

        fieldgrid repair vineyard.gpkg --upgrade
    """
    from fieldgrid.mapfile import open_map

    done = "repaired"
    with open_map(map_, writable=True) as universal:
        if not upgrade:
            universal.repair(jobs)
        elif universal.upgrade():
            done = "upgraded"
        else:
            done = "of the present format already:"
    if as_json:
        output.print_json({"map": str(map_), "done": done.rstrip(":")})
    else:
        output.report_line(f"{done} {map_}")
