"""A map that is verified, here and by the workers of a cluster."""

from __future__ import annotations

import platform
import sqlite3
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.errors import ClusterError
from fieldgrid.layers import GROUPS
from fieldgrid.mapfile.database import connect
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.tiles import TileTables
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.workers.order import Runner
from fieldgrid.workers.place import check_is_here

_FILE_HEADER_BYTES = 100
"""The header of an SQLite file, in which every commit changes a counter."""


class Subject(NamedTuple):
    """A map that is verified, and who does it. Pickled it is where the map lies; where it arrives,
    it is opened again, for reading."""

    connection: sqlite3.Connection
    path: Path
    header: Header
    runner: Runner | None = None
    """None where it has arrived."""

    @property
    def tables(self) -> TileTables:
        """Its tiles, as far as their channel groups are known here."""
        matrices = TileMatrixSet(self.header.lattice)
        return TileTables(self.connection, matrices, self.header.known_groups())

    def __reduce__(self) -> tuple[Any, ...]:
        (*_, file) = self.connection.execute("PRAGMA database_list").fetchone()
        (mode,) = self.connection.execute("PRAGMA journal_mode").fetchone()
        if not file or mode != "delete":
            raise ClusterError(
                f"{self.path} cannot be read by the workers of a cluster: it has a journal of the "
                f"kind {mode!r}. Close other programs that have it open, or leave out --scheduler."
            )
        path = Path(file)
        known = tuple(group.name for group in self.header.known_groups())
        return _opened, (path, path.stat().st_size, _file_header(path), self.header, known)


@lru_cache(maxsize=2)
def _opened(
    path: Path, size: int, file_header: bytes, header: Header, known: tuple[str, ...]
) -> Subject:
    """The map on a worker. ClusterError when it has another one, or none, or cannot read all."""
    check_is_here(path, size, "map")
    if _file_header(path) != file_header:
        raise ClusterError(
            f"{path} on the worker {platform.node()} is another state of the map; mount or copy "
            "the map to the same path on every worker."
        )
    for name in known:
        if name not in GROUPS:
            raise ClusterError(
                f"The worker on {platform.node()} does not know the channel group {name!r}; start "
                "it with --preload and the module that registers it."
            )
    return Subject(connect(path, path, writable=False), path, header)


def _file_header(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_FILE_HEADER_BYTES)
