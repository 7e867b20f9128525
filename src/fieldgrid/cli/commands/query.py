"""`fieldgrid query`: where the value of a cell comes from."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output
from fieldgrid.core import quoted

if TYPE_CHECKING:
    from fieldgrid.maps import MapFile, Provenance

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)"

# A number below zero is no option.
CONTEXT = {"ignore_unknown_options": True}


def command(
    map_: options.MapArgument,
    place: Annotated[
        list[str],
        typer.Argument(
            metavar="E N | LAT,LON",
            help="Metres east and north, or degrees with a comma between; both may be negative.",
        ),
    ],
    cell: options.Cell = None,
    as_json: options.AsJson = False,
) -> None:
    """List the sessions and frames behind a cell's value, and what each of them saw.

    Examples:

        fieldgrid query vineyard.gpkg -5.1 55.3

        fieldgrid query vineyard.gpkg 41.6505,-4.7201 --json
    """
    from fieldgrid.maps import open_map

    numbers = _numbers(" ".join(place))
    with open_map(map_) as universal:
        east_m, north_m = _position(universal, *numbers)
        found = universal.query(east_m, north_m, cell)
        marks = universal.marks(within=found.bounds)
    if as_json:
        output.print_json(
            {
                **_as_dict(map_, found),
                "marks": [{key: getattr(mark, key) for key in _SAID} for mark in marks],
            }
        )
        return
    west, south, east, north = found.bounds
    value = "not observed" if found.density is None else f"density {found.density}"
    where = f"{west:.3f} {south:.3f} {east:.3f} {north:.3f} (west south east north)"
    output.print_line(f"cell {where}: {value}")
    for mark in marks:
        words = (f"{key} {value}" for key in _SAID if (value := getattr(mark, key)))
        output.print_line(f"mark {', '.join(words)}")
    if found.contributions:
        output.print_table(
            _COLUMNS,
            [
                (
                    one.session,
                    one.frame_id,
                    f"{one.density:.0f}",
                    f"{one.cells:.2f}",
                    f"{one.pose.heading_deg:.1f}",
                    f"{one.pose.heading_sigma_deg:.2f}",
                    f"{one.pose.position_sigma_m:.3f}",
                    # With the folder: the images of a pair often have one name.
                    ", ".join("/".join(Path(image).parts[-2:]) for image in one.images),
                )
                for one in found.contributions
            ],
        )


_SAID = ("id", "kind", "name", "note", "author", "created")
_COLUMNS = ("session", "frame", "density", "cells", "heading °", "sigma °", "sigma m", "images")


def _numbers(text: str) -> tuple[float, float, bool]:
    """The two numbers, and whether they are latitude and longitude."""
    for part in text.split():
        if part.startswith("-") and not re.match(r"-[\d.]", part):
            raise typer.BadParameter(f"There is no option {part}")
    match = re.fullmatch(rf"({_NUMBER})(\s*,\s*|\s+)({_NUMBER})", text.strip())
    if not match:
        raise typer.BadParameter(
            f"{quoted(text)} is neither EAST NORTH in metres, as in 12.5 -3, nor LAT,LON in "
            "degrees, as in 41.6505,-4.7201"
        )
    return float(match[1]), float(match[3]), "," in match[2]


def _position(
    universal: MapFile, first: float, second: float, is_geodetic: bool
) -> tuple[float, float]:
    if not is_geodetic:
        return first, second
    from fieldgrid.geometry import Datum

    point = Datum(first, second, universal.datum.height_m)  # refuses what is not on Earth
    east, north, _ = universal.datum.to_enu(point.lat_deg, point.lon_deg, point.height_m)
    return float(east), float(north)


def _as_dict(path: Path, found: Provenance) -> dict[str, Any]:
    return {
        "map": str(path),
        "east_m": found.east_m,
        "north_m": found.north_m,
        "cell_m": found.bounds._asdict(),
        "density": found.density,
        "contributions": [
            {
                "session": one.session,
                "frame_id": one.frame_id,
                "time_ns": one.pose.time_ns,
                "density": one.density,
                "cells": one.cells,
                "east_m": one.pose.east_m,
                "north_m": one.pose.north_m,
                "up_m": output.known(one.pose.up_m),
                "heading_deg": one.pose.heading_deg,
                "position_sigma_m": output.known(one.pose.position_sigma_m),
                "heading_sigma_deg": output.known(one.pose.heading_sigma_deg),
                "quality": one.quality,
                "images": list(one.images),
                "images_sha256": list(one.images_sha256),
            }
            for one in found.contributions
        ],
    }
