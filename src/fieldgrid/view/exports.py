"""What is seen as a file of any format that `export` writes, to be saved by the browser."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from pathlib import Path

from fieldgrid.core import ConfigError, quoted
from fieldgrid.export import Selection, export_map, formats as export_formats
from fieldgrid.maps import Readable

MOST_CELLS = 100_000_000
"""A larger part is for the command line, which says how far it is."""


def formats() -> list[dict[str, str]]:
    """The formats by name, and what each is."""
    return [{"name": name, "says": known.says} for name, known in export_formats().items()]


def write_export(
    universal: Readable, name: str, selection: Selection, format_: str
) -> tuple[Path, Path]:
    """Export a part of a map into a folder of its own; several files come as one zip archive.

    Returns the file, and the folder that is to be removed once it was sent. `name` is what the file
    is called. Raises ConfigError for a part that is too large, and what
    `export_map` raises.
    """
    known = export_formats()
    if format_ not in known:
        raise ConfigError(f"{quoted(format_)} is no format; known are {', '.join(known)}.")
    bounds = selection.bounds or universal.bounds
    cell_m = selection.cell_m or universal.cell_m
    cells = (bounds.east_m - bounds.west_m) * (bounds.north_m - bounds.south_m) / cell_m**2
    if cells > MOST_CELLS:
        raise ConfigError(
            f"{cells / 1e6:.0f} million cells are more than the page exports; zoom in, take larger "
            "cells, or use fieldgrid export."
        )
    folder = Path(tempfile.mkdtemp(prefix="fieldgrid-export-"))
    try:
        ending = known[format_].endings[0]
        inner = folder / name
        inner.mkdir()
        # Some formats are folders whose names are given, TASKDATA.
        out = inner / (f"{name}{ending}" if ending.startswith(".") else ending.upper())
        export_map(universal, out, selection, format=format_)
        files = [path for path in inner.rglob("*") if path.is_file()]
        if len(files) == 1:
            return files[0], folder
        archive = folder / f"{name}-{format_}.zip"
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
            for path in files:
                packed.write(path, path.relative_to(inner))
        return archive, folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
