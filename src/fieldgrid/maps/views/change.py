"""What changed in a field between two moments: cells that appeared, vanished or stayed.

What the drives up to the first moment knew of a cell, the latest of them that observed it, is
compared with what the drives after it and up to the second found there, again the latest.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fieldgrid.core import UInt8
from fieldgrid.geometry import OBSTACLE_ABOVE, Bounds, Datum, Lattice, Window
from fieldgrid.maps.layers.declaration import Cells


class Change(IntEnum):
    """What became of a cell. An obstacle is a cell of the map's own above 100, and a larger cell
    that holds one."""

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


def latest_states(
    shape: tuple[int, int], sessions: Iterable[tuple[str, Cells]], after: Collection[str]
) -> UInt8:
    """The latest state of cells before and after a moment, uint8 [2, *shape]: 0 not observed,
    1 no obstacle, 2 obstacle. The sessions come in the order of their drives."""
    states = np.zeros((2, *shape), dtype=np.uint8)
    for name, cells in sessions:
        state = np.where(cells["peak"] > OBSTACLE_ABOVE, np.uint8(2), np.uint8(1))
        np.copyto(states[int(name in after)], state, where=cells["seen"] > 0)
    return states


def unseen(states: UInt8) -> UInt8:
    """Obstacles that were not observed after the moment, uint8 [rows, columns] of 0 and 1."""
    return np.asarray((states[0] == 2) & (states[1] == 0), dtype=np.uint8)


def outcome(states: UInt8) -> UInt8:
    """The `Change` of cells, from their states before and after."""
    return np.asarray(_OUTCOME[states[0], states[1]])
