"""`fieldgrid repair`: make anew what follows from a map's evidence."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(map_: Annotated[Path, typer.Argument(metavar="MAP.gpkg")]) -> None:
    """Make the tiles, pictures and layers of a map anew from its frames.

    The frames themselves, poses included, are not changed. Example:

        fieldgrid repair vineyard.gpkg
    """
    from fieldgrid.mapfile import open_map

    with open_map(map_, writable=True) as universal:
        universal.repair()
    print(f"repaired {map_}")
