"""`fieldgrid repair`: rebuild the derived tables of a map from its stored frames."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    map_: Annotated[Path, typer.Argument(metavar="MAP.gpkg")],
    upgrade: Annotated[
        bool,
        typer.Option("--upgrade", help="Only bring a map of an older format to the present one."),
    ] = False,
    jobs: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Threads [all cores].")
    ] = None,
) -> None:
    """Rebuild the tiles, pictures and layers of a map from its stored frames.

    The frames themselves, poses included, are not changed. Examples:

        fieldgrid repair vineyard.gpkg

        fieldgrid repair vineyard.gpkg --upgrade
    """
    from fieldgrid.mapfile import open_map

    with open_map(map_, writable=True) as universal:
        if upgrade:
            done = universal.upgrade()
            print(f"{'upgraded' if done else 'of the present format already:'} {map_}")
            return
        universal.repair(jobs)
    print(f"repaired {map_}")
