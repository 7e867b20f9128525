"""A map that is verified or repaired, here and by the workers of a cluster."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import Runner, Threads
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.tiles.tiles import TileTables
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.writing.sharing import SharedMap, check_known, known_groups, opened, shared


class PickledByArguments:
    """What is pickled as its arguments, of which it is made again where it arrives."""

    _of: tuple[Any, ...]

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._of


class Subject(NamedTuple):
    """A map that is verified or repaired, and who does it. Pickled it is where the map lies; where
    it arrives, it is opened again, for reading."""

    connection: sqlite3.Connection
    path: Path
    header: MapHeader
    runner: Runner = Threads(1)
    copy: sqlite3.Connection | None = None
    """A copy that is read where it arrives, of a map that is being changed here."""

    @property
    def tables(self) -> TileTables:
        """Its tiles, as far as their channel groups are known here."""
        matrices = TileMatrixSet(self.header.lattice)
        return TileTables(self.connection, matrices, self.header.known_groups())

    def __reduce__(self) -> tuple[Any, ...]:
        there = shared(self.copy or self.connection)
        return _arrived, (there, self.path, self.header, known_groups(self.header))


def _arrived(there: SharedMap, path: Path, header: MapHeader, known: tuple[str, ...]) -> Subject:
    """The map on a worker. ClusterError when it has another one, or none, or cannot read all."""
    check_known(known)
    return Subject(opened(there), path, header)
