"""What changed in a field between two moments: cells that appeared, vanished or stayed.

What the drives up to the first moment knew of a cell, the latest of them that observed it, is
compared with what the drives after it and up to the second found there, again the latest.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np

from fieldgrid.core import ConfigError, Threads, UInt8
from fieldgrid.geometry import OBSTACLE_ABOVE, Bounds, Datum, Lattice, Window
from fieldgrid.maps.file.history import until
from fieldgrid.maps.layers.registry import GROUPS
from fieldgrid.maps.transfer import check_cell_sizes
from fieldgrid.maps.views.base_cells import enlarged
from fieldgrid.maps.views.content import MapContent
from fieldgrid.maps.views.read import Request, chunks
from fieldgrid.maps.views.view import check_size


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


def read_change(
    content: MapContent,
    request: Request,
    between: tuple[str | int, str | int],
    path: Path,
) -> ChangeView:
    """What changed between two moments; ConfigError when no drive is up to or after the first.

    In cells of any size an obstacle is what holds one of the map's own cells that is one, and it
    is gone only where each of those was seen again.
    """
    check_size(request.lattice, request.window)
    header, sessions = content.header, content.evidence.sessions()
    early, late = ([info.name for info in until(at, sessions, path)] for at in between)
    late = [name for name in late if name not in early]
    if not early or not late:
        gap = f"after {between[0]} and up to {between[1]}" if early else f"up to {between[0]}"
        raise ConfigError(
            f"{path} has no session {gap}, so there is nothing to compare; `fieldgrid sessions` "
            "lists the dates of its drives."
        )
    for info in sessions:
        if info.grid is not None and info.name in (*early, *late):
            check_cell_sizes(request.lattice.cell_m, info.grid.cell_m)
    change = np.zeros(request.window.shape, dtype=np.uint8)
    groups = (GROUPS["density"],)
    by = enlarged(groups, header.lattice, request.lattice)
    own = request._replace(
        lattice=header.lattice,
        window=by.under(request.window),
        sessions=(*early, *late),
    )
    source = content.session_source(own, groups)

    def fill(chunk: Window) -> None:
        under = by.under(chunk)
        states = np.zeros((2, *under.shape), dtype=np.uint8)
        for name, cells in source.by_session(under):
            state = np.where(cells["peak"] > OBSTACLE_ABOVE, np.uint8(2), np.uint8(1))
            np.copyto(states[int(name in late)], state, where=cells["seen"] > 0)
        unseen = ((states[0] == 2) & (states[1] == 0)).astype(np.uint8)
        before, after, lost = (by.highest(values, chunk) for values in (*states, unseen))
        after[(lost > 0) & (after == 1)] = 0
        change[request.window.slices_of(chunk)] = _OUTCOME[before, after]

    for _ in Threads().in_order(fill, chunks(request.window, by.factor)):
        pass
    names = tuple(early), tuple(late)
    return ChangeView(request.lattice, request.window, change, header.datum, *names)
