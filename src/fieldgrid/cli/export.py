"""`fieldgrid export`: the map for those who do not read GeoPackage."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import output, parse

if TYPE_CHECKING:
    from fieldgrid.export import Exported


def command(
    map_: Annotated[Path, typer.Argument(metavar="MAP.gpkg")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Its ending says the format.")],
    format_: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="Where the ending does not say it."),
    ] = None,
    layer: Annotated[
        str,
        typer.Option(
            metavar="LAYER",
            help="density|count|variance|max|sessions|persistence|height|peak|seen_share.",
        ),
    ] = "density",
    bounds: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="W S E N", help="Crop, metres east and north."),
    ] = None,
    cell: Annotated[
        float | None, typer.Option(metavar="M", help="Cell size, not under the local cells'.")
    ] = None,
    at: Annotated[
        str | None, typer.Option(metavar="SESSION|DATE", help="The map as of then.")
    ] = None,
    epsg: Annotated[
        int | None,
        typer.Option(metavar="CODE", help="Reproject to this system (geotiff, png)."),
    ] = None,
    mode: Annotated[
        str | None, typer.Option(metavar="trinary|scale|raw", help="Of the grey values (nav2).")
    ] = None,
    image: Annotated[
        str | None, typer.Option(metavar="pgm|png", help="Kind of the picture (nav2).")
    ] = None,
    free_up_to: Annotated[
        int | None,
        typer.Option(metavar="0..255", help="Density up to which a cell is free (nav2, ROS)."),
    ] = None,
    obstacle_above: Annotated[
        int | None,
        typer.Option(
            metavar="0..254", help="Density above which it is an obstacle (nav2, ROS, vectors)."
        ),
    ] = None,
    cost_shape: Annotated[
        float | None,
        typer.Option(metavar="POWER", help="How costs rise between them (nav2, ROS)."),
    ] = None,
    features: Annotated[
        str | None,
        typer.Option(
            metavar="A,B", help="obstacle, trajectory, pose, footprint; or all (vectors)."
        ),
    ] = None,
    min_area: Annotated[
        float | None, typer.Option(metavar="M2", help="Leave out smaller obstacles (vectors).")
    ] = None,
    simplify: Annotated[
        float | None, typer.Option(metavar="M", help="Straighten outlines by up to (vectors).")
    ] = None,
    storage: Annotated[
        str | None, typer.Option(metavar="mcap|sqlite3", help="Of the bag (rosbag2).")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing file or folder.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Write a map for another program; what comes out is whole, or nothing is changed.

    Formats, by their names and endings:

    \b
      geotiff    .tif .tiff      cloud-optimised GeoTIFF
      png        .png            picture with a world file
      kmz        .kmz            overlay and trajectories for Google Earth
      geojson    .geojson .json  obstacles, trajectory, poses, footprints in WGS84
      gpkg       .gpkg           the same as a GeoPackage in the map's plane
      shapefile  .shp.zip        the same as shapefiles, zipped or in a folder
      isoxml     taskdata        ISO 11783-10 task data, a folder
      nav2       .yaml .yml      Nav2 map: YAML, picture and georeference
      mcap       .mcap           MCAP for Foxglove: grids, paths, fixes, GeoJSON
      rosbag2    .rosbag2        ROS 2 bag, a folder
      csv        .csv            a row a cell as CSV
      parquet    .parquet        a row a cell as Parquet
      npz        .npz            arrays for NumPy
      zarr       .zarr           a Zarr store for xarray

    Examples:

        fieldgrid export vineyard.gpkg vineyard.tif --cell 0.25

        fieldgrid export vineyard.gpkg posts.tif --layer max --at 2026-06-03

        fieldgrid export vineyard.gpkg vineyard.png --epsg 25830
    """
    from fieldgrid.export import Selection, export_map, format_of
    from fieldgrid.mapfile import open_map

    if str(out) == "-":
        raise typer.BadParameter("it is the name of a file or a folder", param_hint="OUT")
    name = format_of(out, format_)
    selection = Selection(parse.bounds(bounds), cell, layer, at)
    options = {
        "epsg": epsg,
        "mode": mode,
        "image": image,
        "free_up_to": free_up_to,
        "obstacle_above": obstacle_above,
        "cost_shape": cost_shape,
        "features": features,
        "min_area_m2": min_area,
        "simplify_m": simplify,
        "storage": storage,
    }
    with open_map(map_) as universal:
        done = export_map(
            universal, out, selection, format=name, overwrite=overwrite, options=options
        )
    if as_json:
        output.print_json(_as_dict(map_, name, done))
        return
    written = [(path.name, _size(_bytes(path))) for path in done.paths]
    output.print_table(("", ""), [("format", name), *done.rows, *written])


def _as_dict(map_: Path, name: str, done: Exported) -> dict[str, Any]:
    return {
        "map": str(map_),
        "format": name,
        "files": [{"path": str(path), "bytes": _bytes(path)} for path in done.paths],
        "about": dict(done.rows),
    }


def _bytes(path: Path) -> int:
    """The size of a file, or of all files in a folder."""
    if path.is_dir():
        return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    return path.stat().st_size


def _size(count: int) -> str:
    return f"{count / 1e6:.2f} MB" if count >= 10_000 else f"{count} bytes"
