"""The map so far: what windows around the vehicle have shown, as an occupancy that grows."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from fieldgrid.export import occupancy_grid
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import UNKNOWN_OCCUPANCY
from fieldgrid.recordings import MAP, ros_messages

GROWS_CELLS = 512
"""The edges of the whole lie at multiples of so many cells, so that it seldom grows."""


class OccupancyPart(NamedTuple):
    """Occupancy int8 [rows north, columns east] of a window of a lattice."""

    lattice: Lattice
    window: Window
    cells: npt.NDArray[np.int8]

    def with_(self, newer: Self) -> tuple[Self, Self | None]:
        """The whole with what a newer part knows, in place where it lies inside; and the part that
        changed, None for nothing."""
        whole = self.around(newer.window)
        old = whole.cells[whole.window.slices_of(newer.window)]
        changed = (newer.cells != UNKNOWN_OCCUPANCY) & (newer.cells != old)
        if not changed.any():
            return whole, None
        old[changed] = newer.cells[changed]
        rows, columns = (np.flatnonzero(changed.any(axis=axis)) for axis in (1, 0))
        i0, j0 = newer.window.i0 + int(columns[0]), newer.window.j0 + int(rows[0])
        part = Window(i0, j0, int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1)
        cells = whole.cells[whole.window.slices_of(part)]
        return whole, self._replace(window=part, cells=cells)

    def around(self, window: Window) -> Self:
        """It, larger where a window goes beyond it."""
        if self.window.union(window) == self.window and self.cells.size:
            return self
        needed = self.window.union(window) if self.cells.size else window
        i0, j0 = (value // GROWS_CELLS * GROWS_CELLS for value in needed[:2])
        width = -(-(needed.i0 + needed.width - i0) // GROWS_CELLS) * GROWS_CELLS
        height = -(-(needed.j0 + needed.height - j0) // GROWS_CELLS) * GROWS_CELLS
        larger = Window(i0, j0, width, height)
        cells = np.full(larger.shape, UNKNOWN_OCCUPANCY, dtype=np.int8)
        if self.cells.size:
            cells[larger.slices_of(self.window)] = self.cells
        return self._replace(window=larger, cells=cells)

    def grid(self, time_ns: int) -> Any:
        """It as a nav_msgs/OccupancyGrid."""
        return occupancy_grid(self.lattice, self.window, self.cells, time_ns)

    def update(self, whole: Window, time_ns: int) -> Any:
        """It as a map_msgs/OccupancyGridUpdate of a grid over the window `whole`."""
        return ros_messages.new(
            "map_msgs/OccupancyGridUpdate",
            header=ros_messages.header_of(time_ns, MAP),
            x=self.window.i0 - whole.i0,
            y=self.window.j0 - whole.j0,
            width=self.window.width,
            height=self.window.height,
            data=np.ascontiguousarray(self.cells).reshape(-1),
        )
