"""`fieldgrid merge`: several maps of one datum as one, or a copy of one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    maps: Annotated[list[Path], typer.Argument(metavar="MAP.gpkg...", help="Of one datum.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="NEW.gpkg", help="The new map.")],
    cell: Annotated[
        float | None, typer.Option(metavar="M", help="Universal cell [the first map's].")
    ] = None,
    transfer: Annotated[
        str | None,
        typer.Option(metavar="centre|area", help="Local to universal cells [the first map's]."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing map.")
    ] = False,
) -> None:
    """Make one new map of all sessions of some maps; of one map, a copy without removed ones.

    Examples:

        fieldgrid merge north.gpkg south.gpkg -o farm.gpkg

        fieldgrid merge vineyard.gpkg -o coarse.gpkg --cell 0.25
    """
    from fieldgrid.mapfile import merge_maps
    from fieldgrid.transfer import Transfer

    if transfer is not None and transfer not in {rule.value for rule in Transfer}:
        raise typer.BadParameter(
            f"{transfer!r} is neither centre nor area", param_hint="--transfer"
        )
    rule = None if transfer is None else Transfer(transfer)
    for merged in merge_maps(maps, out, cell_m=cell, transfer=rule, overwrite=overwrite):
        if merged.twin is not None:
            print(f"{merged.source}: session {merged.was} is in it already as {merged.twin}")
        elif merged.name != merged.was:
            print(f"{merged.source}: session {merged.was}, now called {merged.name}")
        else:
            print(f"{merged.source}: session {merged.was}")
    print(f"map {out}")
