"""`fieldgrid export`: the map for those who do not read GeoPackage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fieldgrid.cli import parse


def command(
    map_: Annotated[Path, typer.Argument(metavar="MAP.gpkg")],
    out: Annotated[Path, typer.Argument(metavar="OUT.tif", help="A GeoTIFF.")],
    cell: Annotated[
        float | None, typer.Option(metavar="M", help="Cell size, not under the local cells'.")
    ] = None,
    bounds: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="W S E N", help="Crop, metres east and north."),
    ] = None,
    layer: Annotated[
        str,
        typer.Option(metavar="LAYER", help="density|count|variance|max|sessions|persistence."),
    ] = "density",
    at: Annotated[
        str | None, typer.Option(metavar="SESSION|DATE", help="The map as of then.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing file.")
    ] = False,
) -> None:
    """Write a layer as GeoTIFF; of the density band 2 says whether a cell was seen.

    Examples:

        fieldgrid export vineyard.gpkg vineyard.tif --cell 0.25

        fieldgrid export vineyard.gpkg spring.tif --at 2026-06-03

        fieldgrid export vineyard.gpkg posts.tif --layer persistence
    """
    if out.suffix.lower() not in {".tif", ".tiff"}:
        raise typer.BadParameter(f"{out.name} does not end in .tif, the format there is")
    from fieldgrid.export import export_geotiff, export_layer
    from fieldgrid.mapfile import open_map

    crop = parse.bounds(bounds)
    with open_map(map_) as universal:
        if crop is not None:
            parse.check_inside(crop, universal.bounds, universal.cell_m)
        view = universal.read(crop, cell, layers=[layer], at=at)
    if layer == "density":
        export_geotiff(view, out, overwrite=overwrite)
    else:
        export_layer(view, layer, out, overwrite=overwrite)
    typer.echo(f"GeoTIFF {out}")
