"""What changed in a field between two moments: cells that appeared, vanished or stayed.

What the drives up to the first moment knew of a cell, the latest of them that observed it, is
compared with what the drives after it and up to the second found there, again the latest.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fieldgrid.array_types import UInt8
from fieldgrid.geodesy import Datum
from fieldgrid.grids import OBSTACLE_ABOVE
from fieldgrid.lattice import TILE_CELLS, Bounds, Lattice, TileIndex, Window, tile_window
from fieldgrid.moments import SQUARES, WEIGHT, Moments
from fieldgrid.transfer import mean_density


class Change(IntEnum):
    """What became of a cell. An obstacle is what is above 100."""

    UNKNOWN = 0
    FREE = 1
    STAYED = 2
    APPEARED = 3
    VANISHED = 4
    NEW_OBSTACLE = 5
    NEW_FREE = 6
    NOT_SEEN_AGAIN = 7


MEANING = {
    Change.UNKNOWN: "never observed",
    Change.FREE: "no obstacle, before and after",
    Change.STAYED: "obstacle that stayed",
    Change.APPEARED: "obstacle that appeared",
    Change.VANISHED: "obstacle that vanished",
    Change.NEW_OBSTACLE: "obstacle where nothing was known",
    Change.NEW_FREE: "no obstacle where nothing was known",
    Change.NOT_SEEN_AGAIN: "known before, not observed since",
}

# [before][after], each 0 not observed, 1 no obstacle, 2 obstacle.
_OUTCOME = np.array(
    [
        [Change.UNKNOWN, Change.NEW_FREE, Change.NEW_OBSTACLE],
        [Change.NOT_SEEN_AGAIN, Change.FREE, Change.APPEARED],
        [Change.NOT_SEEN_AGAIN, Change.VANISHED, Change.STAYED],
    ],
    dtype=np.uint8,
)


@dataclass(frozen=True, slots=True)
class ChangeView:
    """The `Change` of each cell of a window, uint8 [rows north, columns east], row 0 in the south.

    `before` and `after` name the sessions that are compared.
    """

    lattice: Lattice
    window: Window
    change: UInt8
    datum: Datum
    before: tuple[str, ...]
    after: tuple[str, ...]

    @property
    def bounds(self) -> Bounds:
        """The outer edges in metres east and north of the datum."""
        return self.lattice.bounds(self.window)

    def area_m2(self, change: Change) -> float:
        """The ground that underwent a change."""
        return float((self.change == change).sum()) / self.lattice.cells_per_m**2


class ChangeTally:
    """The latest state of a tile's cells before and after a moment."""

    def __init__(self, view: ChangeView, after: Collection[str]) -> None:
        self._view = view
        self._after = after
        self._states = np.zeros((2, TILE_CELLS, TILE_CELLS), dtype=np.uint8)

    def add(self, session: str, moments: Moments) -> None:
        """Take up a session, later than all before it."""
        density, observed = mean_density(moments[..., WEIGHT:SQUARES])
        state = np.where(density > OBSTACLE_ABOVE, np.uint8(2), np.uint8(1))
        np.copyto(self._states[int(session in self._after)], state, where=observed)

    def write(self, tile: TileIndex) -> None:
        """Fill the tile's part of the view."""
        cells = tile_window(tile)
        part = cells.intersect(self._view.window)
        if part is not None:
            before, after = (state[cells.slices_of(part)] for state in self._states)
            self._view.change[self._view.window.slices_of(part)] = _OUTCOME[before, after]
