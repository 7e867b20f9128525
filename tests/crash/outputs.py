"""What every command that reads a map says of it, to be compared with what it said before."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import FieldgridError
from fieldgrid.export import export_map
from fieldgrid.maps import LAYERS, MapFile
from tests.maps.file.content import content

_EXPORTS = ("map.geojson", "map.yaml")
"""One of shapes, one of cells."""


def outputs(universal: MapFile, folder: Path | None = None) -> dict[str, str]:
    """A digest of what each command reads, by its name, or the error that it met; of exports and
    the rows that a GIS reads, too, where there is a folder for them."""
    reads: dict[str, Callable[[], Any]] = {
        "sessions": universal.sessions,
        "marks": lambda: universal.marks(removed=True),
        "found": universal.kept_features,
        "query": lambda: universal.query(2.1, 3.5),
        "diff": lambda: universal.diff("a", "b"),
        "trajectory": lambda: [universal.trajectory(name) for name in _names(universal)],
        "frames": lambda: [
            (record, record.load())
            for name in _names(universal)
            for record in universal.frames(name, with_grid=True)
        ],
        "inputs": lambda: [universal.session_inputs(name) for name in _names(universal)],
        "root": lambda: universal.root_sha256,
        "layers": lambda: universal.read(layers=sorted(LAYERS)),
        "coarse": lambda: universal.read(cell_m=0.4, layers=sorted(LAYERS)),
        "folded": lambda: universal.read(cell_m=0.25),
    }
    if folder is not None:
        reads["rows"] = lambda: content(universal.path)
        reads |= {name: _exporting(universal, folder, name) for name in _EXPORTS}
    return {name: _said(read) for name, read in reads.items()}


def _names(universal: MapFile) -> list[str]:
    return [info.name for info in universal.sessions()]


def _exporting(universal: MapFile, folder: Path, name: str) -> Callable[[], Any]:
    def export() -> Any:
        written = export_map(universal, folder / name, overwrite=True).paths
        return [path.read_bytes() for path in sorted(written)]

    return export


def _said(read: Callable[[], Any]) -> str:
    try:
        value = read()
    except FieldgridError as error:
        return f"{type(error).__name__}: {error}"
    hashed = hashlib.sha256()
    _hash(value, hashed.update)
    return hashed.hexdigest()


def _hash(value: Any, update: Callable[[bytes], None]) -> None:
    """Take all that a value holds into a hash, arrays bit for bit."""
    if isinstance(value, np.ndarray):
        update(f"{value.dtype}{value.shape}".encode())
        update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, bytes):
        update(value)
    elif isinstance(value, Mapping):
        _hash(list(value.items()), update)
    elif is_dataclass(value):
        _hash([getattr(value, field.name) for field in fields(value)], update)
    elif isinstance(value, list | tuple):
        update(b"(")
        for part in value:
            _hash(part, update)
        update(b")")
    elif not callable(value):
        update(repr(value).encode())
