"""A map that is verified."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import NamedTuple

from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.tiles import TileTables
from fieldgrid.mapfile.tiling import TileMatrixSet


class Subject(NamedTuple):
    """A map that is verified, and on how many threads."""

    connection: sqlite3.Connection
    path: Path
    header: Header
    jobs: int | None

    @property
    def tables(self) -> TileTables:
        """Its tiles, as far as their channel groups are known here."""
        matrices = TileMatrixSet(self.header.lattice)
        return TileTables(self.connection, matrices, self.header.known_groups())
