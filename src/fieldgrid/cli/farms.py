"""Commands that take a map or a folder of maps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import options, output

if TYPE_CHECKING:
    from fieldgrid.maps import Farm, MapFile

MapOrFarm = Annotated[
    Path,
    typer.Argument(
        metavar="MAP.gpkg", help="A map, or a folder of maps: a farm.", show_default=False
    ),
]


@contextmanager
def opened(path: Path, datum_from: Path | None) -> Iterator[MapFile | Farm]:
    """A map, or the maps of a folder; what of them is left out or moved is said."""
    from fieldgrid.maps import Farm, open_map

    if not path.is_dir():
        options.refuse(
            datum_from is not None,
            "--datum-from",
            f"{path} is no folder of maps, and keeps its own datum; `fieldgrid merge` makes a "
            "map of another one",
        )
        with open_map(path) as universal:
            yield universal
        return
    with Farm(path, datum=options.datum_or_from(None, datum_from)) as farm:
        for block in farm.problems:
            output.message(f"{block.path.name} is left out: {block.problem}")
        for moved in farm.moved:
            output.message(
                f"{moved.block.path.name} comes from a datum {moved.distance_m:.0f} m away: its "
                f"ground is up to {1e3 * moved.height_error_m:.1f} mm too high or low"
            )
        yield farm
