"""The map around the vehicle while it drives: sums of frames over a window that moves along."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Self

import numpy as np

from fieldgrid.core import Float32, Int64, UInt64, kernel
from fieldgrid.geometry import Datum, Lattice, LocalGrid, Pose, Status, Window
from fieldgrid.maps import MapView, Transfer, land, mean_density

UNSEEN_NS = -(1 << 62)

Place = tuple[slice, slice]
ALL = slice(None), slice(None)

MOVES_M = 1.0
"""The window moves when the vehicle is farther than this from its middle."""


class PlacedGrid(NamedTuple):
    """A local grid at its pose; `sigma_m` is how far off its far end may be."""

    grid: LocalGrid
    pose: Pose
    time_ns: int
    sigma_m: float


class _WindowCells(NamedTuple):
    """What is known of the cells of a window [rows, columns]: the sums of the mean [2, ...], when
    each was last seen, and how sure the place of that frame was."""

    sums: UInt64
    seen_ns: Int64
    sigma_m: Float32

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> Self:
        made = cls(
            np.empty((2, *shape), dtype=np.uint64),
            np.empty(shape, dtype=np.int64),
            np.empty(shape, dtype=np.float32),
        )
        made.clear()
        return made

    def clear(self) -> None:
        """Know nothing."""
        self.sums.fill(0)
        self.seen_ns.fill(UNSEEN_NS)
        self.sigma_m.fill(np.nan)

    def take(self, other: Self, to: Place = ALL, from_: Place = ALL) -> None:
        """Know what another one knows, of a part."""
        self.sums[(..., *to)] = other.sums[(..., *from_)]
        self.seen_ns[to], self.sigma_m[to] = other.seen_ns[from_], other.sigma_m[from_]


class RollingWindow:
    """A square of `side_m` around the vehicle, in cells of the map, or more where grids reach
    farther: what a frame sees must lie in it while it is new, or is not in it later either."""

    def __init__(self, cell_m: float, transfer: Transfer, side_m: float, reach_m: float) -> None:
        self.lattice, self._transfer = Lattice(cell_m), transfer
        self._side = round(max(side_m, 2.0 * (reach_m + 2.0 * MOVES_M)) / cell_m)
        self._window = Window(-self._side // 2, -self._side // 2, self._side, self._side)
        shape = self._window.shape
        # What is there for good; and that with the frames that may still move, if there are any.
        self._cells, self._shown = _WindowCells.empty(shape), _WindowCells.empty(shape)
        self._moving: list[PlacedGrid] = []
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
        self._cells, self._shown, self._moving = self._shown, self._cells, []
        self._cells.clear()
        common = old.intersect(self._window)
        if common is not None:
            self._cells.take(self._shown, self._window.slices_of(common), old.slices_of(common))

    def settle(self, frames: Iterable[PlacedGrid]) -> None:
        """Place frames for good."""
        before = self.frames
        for frame in frames:
            self._add(self._cells, frame)
            self.frames += 1
        if self.frames != before:
            self._moving = []

    def place(self, frames: Sequence[PlacedGrid]) -> None:
        """Place frames that are not settled yet, in place of those of before. Those that are where
        they were cost nothing, if others only follow them."""
        count = len(self._moving)
        pairs = zip(self._moving, frames, strict=False)
        if len(frames) < count or any(a.grid is not b.grid or a[1:] != b[1:] for a, b in pairs):
            count = 0
        if not count and frames:
            self._shown.take(self._cells)
        for frame in frames[count:]:
            self._add(self._shown, frame)
        self._moving = list(frames)

    def view(
        self, frames: Sequence[PlacedGrid], datum: Datum, now_ns: int
    ) -> tuple[MapView, Float32, Float32]:
        """What is known with further frames that are not settled yet; the age of each cell in
        seconds at `now_ns`, and its sigma in metres, NaN where nothing was seen."""
        self.place(frames)
        cells = self._shown if self._moving else self._cells
        density, observed = mean_density(*cells.sums)
        age_s = np.full(self._window.shape, np.nan, dtype=np.float32)
        age_s[observed] = (now_ns - cells.seen_ns[observed]) / 1e9
        view = MapView(self.lattice, self._window, density, observed, datum, is_base=True)
        return view, age_s, cells.sigma_m.copy()

    def _add(self, cells: _WindowCells, frame: PlacedGrid) -> None:
        landing = land(frame.grid, frame.pose, self.lattice, self._window, self._transfer)
        lay(
            *(frame.grid.density, *landing, np.uint64(landing.unit), frame.time_ns),
            *(np.float32(frame.sigma_m), *cells.sums.reshape(2, -1)),
            *(cells.seen_ns.reshape(-1), cells.sigma_m.reshape(-1)),
        )


@kernel
def lay(  # type: ignore[no-untyped-def]
    values, cell, shift, spans, unit, time_ns, sigma_m, weights, totals, seen_ns, sigmas_m
):
    """Add to each cell of a `Landing` the `unit` of weight and that of the value of the local cell,
    and note the time and the sigma, unless a later frame has seen it."""
    for r in range(cell.shape[0]):
        for c in range(spans[r, 0], spans[r, 1]):
            if cell[r, c] >= 0:
                k = np.uint32(cell[r, c])
                weights[k] += unit
                totals[k] += unit * np.uint64(values[r >> shift, c >> shift])
                if seen_ns[k] <= time_ns:
                    seen_ns[k], sigmas_m[k] = time_ns, sigma_m
