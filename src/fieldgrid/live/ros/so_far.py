"""The map so far: what windows around the vehicle have shown, as an occupancy that grows."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.export import occupancy_grid
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import UNKNOWN_OCCUPANCY
from fieldgrid.recordings import MAP, ros_messages

GROWS_CELLS = 512
"""Where it is to grow, it gets so many cells more on each side."""

Occupancy = npt.NDArray[np.int8]


class MapSoFar:
    """Occupancy [rows north, columns east] over `window`, of windows that move along: what one
    shows holds while it is there, and what it knew last when it has moved on."""

    def __init__(self, lattice: Lattice, window: Window, cells: Occupancy) -> None:
        self._lattice, self.window = lattice, window
        self._kept, self._cells = cells, cells.copy()
        """What is kept of where windows were, and that with what the last one shows."""
        self._last: tuple[Window, Occupancy] | None = None

    def take(self, window: Window, cells: Occupancy) -> Window | None:
        """Take what a window shows; where that changed something, None for nowhere."""
        self._grow(window)
        area = window
        if self._last is not None and self._last[0] != window:
            last, left = self._last
            area = window.union(last)
            if common := window.intersect(last):  # of which the window still tells
                left[last.slices_of(common)] = UNKNOWN_OCCUPANCY
            _lay(self._kept[self.window.slices_of(last)], left)
        self._last = window, cells.copy()
        place = self.window.slices_of(area)
        now = self._kept[place].copy()
        _lay(now[area.slices_of(window)], cells)
        changed = now != self._cells[place]
        self._cells[place] = now
        if not changed.any():
            return None
        rows, columns = (np.flatnonzero(changed.any(axis=axis)) for axis in (1, 0))
        i0, j0 = area.i0 + int(columns[0]), area.j0 + int(rows[0])
        return Window(i0, j0, int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1)

    def _grow(self, window: Window) -> None:
        whole = self.window.union(window)
        if whole != self.window:
            whole = whole.grown(GROWS_CELLS)
            inside = zip(whole.slices_of(self.window), whole.shape, strict=True)
            pads = [(part.start, size - part.stop) for part, size in inside]
            self._kept, self._cells = (
                np.pad(one, pads, constant_values=UNKNOWN_OCCUPANCY)
                for one in (self._kept, self._cells)
            )
            self.window = whole

    def grid(self, time_ns: int) -> Any:
        """All of it as a nav_msgs/OccupancyGrid."""
        return occupancy_grid(self._lattice, self.window, self._cells, time_ns)

    def update(self, part: Window, time_ns: int) -> Any:
        """A part of it as a map_msgs/OccupancyGridUpdate."""
        return ros_messages.new(
            "map_msgs/OccupancyGridUpdate",
            header=ros_messages.header_of(time_ns, MAP),
            x=part.i0 - self.window.i0,
            y=part.j0 - self.window.j0,
            width=part.width,
            height=part.height,
            data=self._cells[self.window.slices_of(part)].reshape(-1),
        )


def _lay(below: Occupancy, above: Occupancy) -> None:
    """Change what is below to what is known above."""
    np.copyto(below, above, where=above != UNKNOWN_OCCUPANCY)
