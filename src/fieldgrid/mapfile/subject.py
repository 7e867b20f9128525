"""A map that is verified, here and by the workers of a cluster."""

from __future__ import annotations

import platform
import sqlite3
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.errors import ClusterError
from fieldgrid.layers import GROUPS
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.sharing import SharedMap, opened, shared
from fieldgrid.mapfile.tiles import TileTables
from fieldgrid.mapfile.tiling import TileMatrixSet
from fieldgrid.workers.order import Runner


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
        known = tuple(group.name for group in self.header.known_groups())
        return _arrived, (shared(self.connection), self.path, self.header, known)


def _arrived(there: SharedMap, path: Path, header: Header, known: tuple[str, ...]) -> Subject:
    """The map on a worker. ClusterError when it has another one, or none, or cannot read all."""
    for name in known:
        if name not in GROUPS:
            raise ClusterError(
                f"The worker on {platform.node()} does not know the channel group {name!r}; start "
                "it with --preload and the module that registers it."
            )
    return Subject(opened(there), path, header)
