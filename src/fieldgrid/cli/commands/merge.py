"""`fieldgrid merge`: several maps as one, or a copy of one, also in the plane of another datum."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.core import quoted


def command(
    maps: Annotated[
        list[Path],
        typer.Argument(
            metavar="MAP.gpkg...",
            help="Maps with one datum, or with any datums if --datum is given.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="NEW.gpkg", help="The new map.")],
    cell: Annotated[
        float | None, typer.Option(metavar="M", help="Universal cell [default: the first map's].")
    ] = None,
    transfer: Annotated[
        str | None,
        typer.Option(
            metavar="centre|area",
            help="Transfer of values to cells [default: as in the first map].",
        ),
    ] = None,
    datum: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON,HEIGHT",
            help="Transform all maps to this datum [default: their own].",
        ),
    ] = None,
    datum_from: Annotated[
        Path | None,
        typer.Option(
            "--datum-from",
            metavar="MAP.gpkg",
            help="Transform all maps to the datum of another map.",
        ),
    ] = None,
    wait_s: options.Wait = options.USUAL_WAIT_S,
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """Make one new map of all sessions of several maps, or a copy of one map without its removed
    sessions.

    Examples:

        fieldgrid merge north.gpkg south.gpkg -o farm.gpkg

        fieldgrid merge vineyard.gpkg -o coarse.gpkg --cell 0.25

        fieldgrid merge vineyard.gpkg -o there.gpkg --datum-from farm.gpkg
    """
    from fieldgrid.maps import Transfer, merge_maps

    options.refuse(
        transfer is not None and transfer not in {rule.value for rule in Transfer},
        "--transfer",
        f"{quoted(transfer)} is neither centre nor area",
    )
    options.check_new_map(out)
    done = merge_maps(
        maps,
        out,
        cell_m=cell,
        transfer=None if transfer is None else Transfer(transfer),
        datum=options.datum_or_from(datum, datum_from),
        overwrite=overwrite,
        patience=partial(progress.patience, wait_s=wait_s),
    )
    if as_json:
        output.print_json(
            {
                "map": str(out),
                "sessions": [{**asdict(one), "source": str(one.source)} for one in done],
            }
        )
        return
    for merged in done:
        where = f"{merged.source}: session {merged.was}"
        if merged.twin is not None:
            output.report_line(f"{where} is in it already as {merged.twin}")
        elif merged.name != merged.was:
            output.report_line(f"{where}, now called {merged.name}")
        else:
            output.report_line(where)
    output.report_line(f"map {out}")
