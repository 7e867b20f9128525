"""`fieldgrid repair`: rebuild the derived tables of a map from its stored frames."""

from __future__ import annotations

import os
from itertools import chain, count
from pathlib import Path
from typing import Annotated

import typer

from fieldgrid.cli import options, output, progress


def command(
    map_: options.MapArgument,
    upgrade: Annotated[
        bool,
        typer.Option(
            "--upgrade",
            help="Only upgrade a map of an older format.",
        ),
    ] = False,
    in_place: Annotated[
        bool, typer.Option("--in-place", help="Keep no copy of the old map.")
    ] = False,
    layers: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Layers that the tiles hold beside the core from now on, with commas: names, "
            "frames, terrain, standing, time or all; '' for the core alone.",
        ),
    ] = None,
    wait_s: options.Wait = options.USUAL_WAIT_S,
    jobs: options.Jobs = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:8786",
            help="Dask scheduler; its workers check and fold the frames, and need the folder of "
            "the map at the same path.",
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Rebuild the tiles, images and layers of a map from its stored frames.

    Frames and poses are not changed. The map is replaced only if the rebuilt map verifies. The old
    map is kept beside it as NAME.before-repair.gpkg.

    Examples:

        fieldgrid repair vineyard.gpkg

        fieldgrid repair vineyard.gpkg --upgrade

        fieldgrid repair vineyard.gpkg --scheduler tcp://10.0.0.5:8786
    """
    options.check_scheduler(scheduler, jobs)
    options.refuse(upgrade and layers is not None, "--layers", "leave out --upgrade")
    options.refuse(
        scheduler is not None and (upgrade or in_place),
        "--scheduler",
        "its workers read the copy of the map that is kept; leave out "
        + ("--upgrade" if upgrade else "--in-place"),
    )
    from fieldgrid.core import MapError, MapSettings, counted
    from fieldgrid.maps import open_map

    done, left = "repaired", tuple[str, ...]()
    keep = None if upgrade or in_place else _unused(map_)
    patience = progress.patience(map_, wait_s)
    with open_map(map_, writable=True, patience=patience) as universal:
        if not upgrade:
            kept = None if layers is None else MapSettings(layers=layers).kept_layers()
            left = universal.repair(jobs, layers=kept, keep=keep, scheduler=scheduler)
        elif universal.upgrade():
            done = "upgraded"
        else:
            done = "of the present format already:"
    if as_json:
        as_it_was = None if keep is None else str(keep)
        output.print_json(
            {"map": str(map_), "done": done.rstrip(":"), "kept": as_it_was, "problems": left}
        )
    else:
        for line in left:
            output.print_line(line)
        output.report_line(f"{done} {map_}" + (f"; as it was: {keep}" if keep else ""))
    if left:
        raise MapError(
            f"{map_} is repaired but for {counted(len(left), 'problem')} in what no repair makes "
            "again, removed drives and features; the list says which."
        )


def _unused(map_: Path) -> Path:
    """A name beside the map for the map as it was."""
    names = chain([""], (f"-{k}" for k in count(2)))
    beside = (map_.with_name(f"{map_.stem}.before-repair{k}{map_.suffix}") for k in names)
    return next(path for path in beside if not os.path.lexists(path))
