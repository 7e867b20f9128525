"""The map around the vehicle while it drives: sums of frames over a window that moves along."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Self

import numpy as np

from fieldgrid.array_types import Float32, Int64, UInt64
from fieldgrid.geodesy import Datum
from fieldgrid.grids import LocalGrid
from fieldgrid.lattice import Lattice, Window
from fieldgrid.mapfile import MapView
from fieldgrid.trajectory import Pose, Status
from fieldgrid.transfer import MeanFold, Transfer, footprint, mean_density

UNSEEN_NS = -(1 << 62)

MOVES_M = 1.0
"""The window moves when the vehicle is farther than this from its middle."""


class PlacedGrid(NamedTuple):
    """A local grid at its pose; `sigma_m` is how far off its far end may be."""

    grid: LocalGrid
    pose: Pose
    time_ns: int
    sigma_m: float


class _Cells(NamedTuple):
    """What is known of the cells of a window [rows, columns]: the sums of the mean [2, ...], when
    each was last seen, and how sure the place of that frame was."""

    sums: UInt64
    seen_ns: Int64
    sigma_m: Float32

    @classmethod
    def empty(cls, window: Window) -> Self:
        return cls(
            np.zeros((2, *window.shape), dtype=np.uint64),
            np.full(window.shape, UNSEEN_NS, dtype=np.int64),
            np.full(window.shape, np.nan, dtype=np.float32),
        )

    def copy(self) -> Self:
        return type(self)(self.sums.copy(), self.seen_ns.copy(), self.sigma_m.copy())


class RollingWindow:
    """A square of `side_m` around the vehicle, in cells of the map, or more where grids reach
    farther: what a frame sees must lie in it while it is new, or is not in it later either."""

    def __init__(self, cell_m: float, transfer: Transfer, side_m: float, reach_m: float) -> None:
        self.lattice, self._transfer = Lattice(cell_m), transfer
        self._side = round(max(side_m, 2.0 * (reach_m + 2.0 * MOVES_M)) / cell_m)
        self._window = Window(-self._side // 2, -self._side // 2, self._side, self._side)
        self._cells = _Cells.empty(self._window)
        self._moving: tuple[list[PlacedGrid], _Cells] = [], self._cells
        self.frames = 0
        """Frames that were placed for good."""

    def follow(self, pose: Pose, within_m: float = MOVES_M) -> None:
        """Move along with the vehicle, where it is farther than this from the middle; what is left
        behind is forgotten here. By a pose that is rejected it does not move."""
        if pose.status is Status.REJECTED:
            return
        i, j = (int(value) for value in self.lattice.index(pose.east_m, pose.north_m))
        old, half = self._window, self._side // 2
        away = max(abs(i - old.i0 - half), abs(j - old.j0 - half))
        if away <= within_m * self.lattice.cells_per_m:
            return
        self._window = Window(i - half, j - half, self._side, self._side)
        kept, self._cells = self._cells, _Cells.empty(self._window)
        common = old.intersect(self._window)
        if common is not None:
            to, from_ = self._window.slices_of(common), old.slices_of(common)
            self._cells.sums[(..., *to)] = kept.sums[(..., *from_)]
            self._cells.seen_ns[to] = kept.seen_ns[from_]
            self._cells.sigma_m[to] = kept.sigma_m[from_]
        self._moving = [], self._cells

    def settle(self, frames: Iterable[PlacedGrid]) -> None:
        """Place frames for good."""
        before = self.frames
        for frame in frames:
            self._add(self._cells, frame)
            self.frames += 1
        if self.frames != before:
            self._moving = [], self._cells

    def place(self, frames: Sequence[PlacedGrid]) -> None:
        """Place frames that are not settled yet, in place of those of before. Those that are where
        they were cost nothing, if others only follow them."""
        placed, cells = self._moving
        count = len(placed)
        if len(frames) < count or any(map(_differs, placed, frames)):
            count, cells = 0, self._cells
        if cells is self._cells or len(frames) > count:
            cells = cells.copy()  # what was given out of them stays
        for frame in frames[count:]:
            self._add(cells, frame)
        self._moving = list(frames), cells

    def view(
        self, frames: Sequence[PlacedGrid], datum: Datum, now_ns: int
    ) -> tuple[MapView, Float32, Float32]:
        """What is known with further frames that are not settled yet; the age of each cell in
        seconds at `now_ns`, and its sigma in metres, NaN where nothing was seen."""
        self.place(frames)
        cells = self._moving[1]
        density, observed = mean_density(*cells.sums)
        age_s = np.full(self._window.shape, np.nan, dtype=np.float32)
        age_s[observed] = (now_ns - cells.seen_ns[observed]) / 1e9
        view = MapView(self.lattice, self._window, density, observed, datum, is_base=True)
        return view, age_s, cells.sigma_m

    def _add(self, cells: _Cells, frame: PlacedGrid) -> None:
        reached = footprint(frame.grid.spec, frame.pose, self.lattice).intersect(self._window)
        if reached is None:
            return
        fold = MeanFold(self.lattice, reached, self._transfer)
        fold.add(frame.grid, frame.pose)
        sums, place = fold.sums, self._window.slices_of(reached)
        cells.sums[(..., *place)] += sums
        newer = (sums[0] > 0) & (cells.seen_ns[place] <= frame.time_ns)
        cells.seen_ns[place][newer] = frame.time_ns
        cells.sigma_m[place][newer] = frame.sigma_m


def _differs(one: PlacedGrid, other: PlacedGrid) -> bool:
    return one.grid is not other.grid or one[1:] != other[1:]
