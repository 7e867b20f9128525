"""`fieldgrid view`: maps in the browser."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from fieldgrid.cli import options, output

_OF_SERVING = {"recording", "datum_from", "port", "host", "read_only", "browser"}


def command(
    ctx: typer.Context,
    maps: Annotated[
        list[Path],
        typer.Argument(metavar="MAP.gpkg...", help="Maps, or a folder of maps: a farm."),
    ],
    recording: Annotated[
        list[Path] | None,
        typer.Option(metavar="FOLDER", help="Folder with the images of frames; may be repeated."),
    ] = None,
    route: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Draw a route: .geojson or .csv; may be repeated."),
    ] = None,
    datum_from: options.DatumFrom = None,
    port: Annotated[
        int | None, typer.Option(metavar="N", min=1, max=65535, help="Port [default: a free one].")
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address to serve on, for other machines too; then read-only by default.",
        ),
    ] = None,
    read_only: Annotated[
        bool | None,
        typer.Option("--read-only/--writable", help="Whether the page may change the map."),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html",
            help="Write a self-contained page of up to 20 MB and serve nothing.",
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
    ] = True,
    as_json: options.AsJson = False,
) -> None:
    """Show maps in the browser: layers, sessions, why a cell is an obstacle, what changed.

    The page needs no network. The server runs until Ctrl+C.

    Examples:

        fieldgrid view vineyard.gpkg

        fieldgrid view vineyard.gpkg --recording june-03 --port 8765

        fieldgrid view vineyard.gpkg --route spraying.geojson

        fieldgrid view vineyard.gpkg --html vineyard.html

        fieldgrid view maps
    """
    options.refuse(
        datum_from is not None and not any(path.is_dir() for path in maps),
        "--datum-from",
        "it is for a folder of maps; a map keeps its own datum",
    )
    if html is not None:
        options.refuse_idle(ctx, _OF_SERVING, "--html serves nothing; leave it out")
        from fieldgrid.view import write_report

        report = write_report(maps, html, routes=route or ())
        if as_json:
            output.print_json({"page": str(html), **report._asdict()})
            return
        for map_, cell_m in zip(maps, report.cells_m, strict=True):
            output.report_line(f"{map_.name} in cells of {cell_m * 100:g} cm")
        output.report_line(f"page {html}, {report.size_bytes / 1e6:.1f} MB")
        return
    from fieldgrid.view import view_maps

    def ready(link: str) -> None:
        # At once: a program that starts the viewer reads the link from a pipe.
        if as_json:
            output.print_json({"view": link})
        else:
            output.report_line(f"view {link}")
        sys.stdout.flush()

    view_maps(
        maps,
        datum=options.datum_or_from(None, datum_from),
        recordings=recording or (),
        routes=route or (),
        host=host,
        port=port,
        writable=not read_only if read_only is not None else host is None,
        open_browser=browser,
        ready=ready,
    )
