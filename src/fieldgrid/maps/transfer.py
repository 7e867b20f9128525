"""From vehicle-fixed local grids to the universal grid: Eq. 3, and what happens in a cell.

Two rules say where a value goes. *Centre* (the paper): to the universal cell that encloses
the transformed centre of the local cell. *Area*: to all universal cells that the local cell
covers, in proportion; it leaves no holes at any heading. Both count in sixteenths of a
local cell, in integers, so that sums do not depend on the order of their terms.

Two rules say how values meet. *Mean* folds with (weight, weighted sum) and is independent of
order. *Paper* averages old and new pairwise, (old + new)/2, in the order of the frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import (
    Bool,
    ConfigError,
    Float32,
    Float64,
    Int32,
    Transfer as Transfer,  # noqa: PLC0414 - users set it, and it is used here
    UInt8,
    UInt32,
    UInt64,
    kernel,
)
from fieldgrid.geometry import GridSpec, Lattice, LocalGrid, Pose, Window

AREA_SHIFT = 2
"""The area rule splits a local cell into 4 x 4 parts, each sent to where its centre is."""

CELL_WEIGHT = 1 << (2 * AREA_SHIFT)
"""Weight of one whole local cell; a part has weight 1."""


class Averaging(StrEnum):
    """How values that meet in a universal cell are combined."""

    MEAN = "mean"
    PAPER = "paper"


def check_cell_sizes(universal_m: float, local_m: float) -> None:
    """Raise ConfigError unless L_U >= L_L: a finer universal cell would invent resolution."""
    if universal_m < local_m * (1.0 - 1e-9):
        raise ConfigError(
            f"Universal cells of {universal_m} m are smaller than the local cells of {local_m} m "
            f"that were recorded; choose {local_m} m or more."
        )


def footprint(spec: GridSpec, pose: Pose, lattice: Lattice) -> Window:
    """The smallest window that holds a local grid at its pose, with a cell to spare."""
    half = spec.width_m / 2.0
    corners_x = np.array([-half, half, -half, half])
    corners_y = np.array([0.0, 0.0, spec.length_m, spec.length_m])
    east, north = to_universal(corners_x, corners_y, pose)
    i, j = lattice.index(east, north)
    i0, j0 = int(i.min()) - 1, int(j.min()) - 1
    return Window(i0, j0, int(i.max()) + 2 - i0, int(j.max()) + 2 - j0)


def to_universal(x_m: npt.ArrayLike, y_m: npt.ArrayLike, pose: Pose) -> tuple[Float64, Float64]:
    """Eq. 3: (E, N) in metres of local coordinates (x right, y forward) at a pose."""
    x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
    phi = math.radians(pose.heading_deg)
    east = pose.east_m + x * math.cos(phi) + y * math.sin(phi)
    north = pose.north_m - x * math.sin(phi) + y * math.cos(phi)
    return east, north


def to_local(east_m: npt.ArrayLike, north_m: npt.ArrayLike, pose: Pose) -> tuple[Float64, Float64]:
    """Eq. 3 turned round: (x right, y forward) at a pose of places (E, N), metres."""
    east = np.asarray(east_m, dtype=np.float64) - pose.east_m
    north = np.asarray(north_m, dtype=np.float64) - pose.north_m
    phi = math.radians(pose.heading_deg)
    x_m = east * math.cos(phi) - north * math.sin(phi)
    y_m = east * math.sin(phi) + north * math.cos(phi)
    return x_m, y_m


class Landing(NamedTuple):
    """Where the cells of one local grid land in a window of universal cells.

    `cell` is int32 [n_y << shift, n_x << shift]: the flat index in the window of each local cell
    (of each of its 2^shift x 2^shift parts), -1 where it was not observed or lies outside. `spans`
    is uint32 [n_y << shift, 2]: in each row all that is not -1 lies from the first of its columns
    to before the second. Columns that a kernel counts by them are unsigned, and need no look
    whether they are negative.
    """

    cell: Int32
    shift: int
    spans: UInt32

    @property
    def unit(self) -> int:
        """The weight of one entry of `cell`, in sixteenths of a local cell."""
        return 1 << 2 * (AREA_SHIFT - self.shift)


def land(
    grid: LocalGrid, pose: Pose, lattice: Lattice, window: Window, transfer: Transfer
) -> Landing:
    """Carry the observed cells of a local grid into a window (Eq. 3).

    Raises ConfigError when universal cells are smaller than the grid's.
    """
    check_cell_sizes(lattice.cell_m, grid.spec.cell_m)
    shift = AREA_SHIFT if transfer is Transfer.AREA else 0
    axes = universal_axes(grid.spec, pose, lattice, shift)
    cell = np.empty((grid.spec.n_y << shift, grid.spec.n_x << shift), dtype=np.int32)
    spans = np.empty((len(cell), 2), dtype=np.uint32)
    locate(grid.observed, *axes, shift, *window, cell, spans)
    return Landing(cell, shift, spans)


_SUM_BITS = 36
"""Low bits of a packed word that hold the weighted sum; the weight has the other 28. A sum is at
most 255 times its weight, so it never reaches into the weight before that is full."""

_VALUES = np.arange(256, dtype=np.uint64)


class WeightedSums:
    """Weight and weighted sum of the density of each cell of a window.

    While frames are added both are in one word, so that a cell is fetched from memory once. They
    are moved into words of their own before a weight could become too large.
    """

    def __init__(self, cells: int) -> None:
        self._packed = np.zeros(cells, dtype=np.uint64)
        self._full: UInt64 | None = None
        self._room = 1 << (64 - _SUM_BITS)

    def add(self, grid: LocalGrid, landing: Landing, lattice: Lattice) -> None:
        """Add one local grid."""
        across = math.ceil(1.5 * lattice.cell_m / grid.spec.cell_m) + 2
        most = min(across * across, grid.density.size) * CELL_WEIGHT
        if most > self._room:
            self._full = self.channels()
            self._packed[:] = 0
            self._room = 1 << (64 - _SUM_BITS)
        self._room -= most
        unit = np.uint64(landing.unit)
        table = (unit << np.uint64(_SUM_BITS)) + _VALUES * unit
        add_values(grid.density, *landing, table, self._packed)

    def channels(self) -> UInt64:
        """(weight, weighted sum) of each cell, uint64 [2, cells]."""
        both = np.empty((2, self._packed.size), dtype=np.uint64)
        np.right_shift(self._packed, np.uint64(_SUM_BITS), out=both[0])
        np.bitwise_and(self._packed, np.uint64((1 << _SUM_BITS) - 1), out=both[1])
        return both if self._full is None else self._full + both


class MeanFold:
    """The order-independent mean over a window."""

    def __init__(
        self, lattice: Lattice, window: Window, transfer: Transfer = Transfer.CENTRE
    ) -> None:
        self.lattice, self.window, self.transfer = lattice, window, transfer
        self._sums = WeightedSums(window.width * window.height)

    def add(self, grid: LocalGrid, pose: Pose) -> None:
        """Carry one local grid into the window; what falls outside is left out."""
        landing = land(grid, pose, self.lattice, self.window, self.transfer)
        self._sums.add(grid, landing, self.lattice)

    @property
    def sums(self) -> UInt64:
        """(weight, weighted sum) of each cell, uint64 [2, rows, columns]."""
        return self._sums.channels().reshape(2, *self.window.shape)

    def density(self) -> tuple[UInt8, Bool]:
        """Mean 3D density rounded to uint8, and the observed mask, both [rows, columns]."""
        return mean_density(*self.sums)


@dataclass(slots=True)
class PaperFold:
    """The paper's pairwise average over a window; the order of `add` matters."""

    lattice: Lattice
    window: Window
    value: Float32 = field(init=False)

    def __post_init__(self) -> None:
        self.value = np.full(self.window.shape, np.nan, dtype=np.float32)

    def add(self, grid: LocalGrid, pose: Pose) -> None:
        """Carry one local grid into the window by cell centres, row by row."""
        check_cell_sizes(self.lattice.cell_m, grid.spec.cell_m)
        axes = universal_axes(grid.spec, pose, self.lattice)
        i0, j0 = self.window.i0, self.window.j0
        average_pairwise(grid.density, grid.observed, *axes, i0, j0, self.value)

    def density(self) -> tuple[UInt8, Bool]:
        """Averaged 3D density rounded to uint8, and the observed mask."""
        observed = ~np.isnan(self.value)
        return np.floor(np.where(observed, self.value, 0.0) + 0.5).astype(np.uint8), observed


def mean_density(weight: UInt64, total: UInt64) -> tuple[UInt8, Bool]:
    """The mean of cells with a weight and a weighted sum, rounded half up in integers.

    Returns uint8, 0 where there is no weight, and the mask of the cells that have any.
    """
    density = np.empty(weight.shape, dtype=np.uint8)
    divide(weight.reshape(-1), total.reshape(-1), density.reshape(-1))
    return density, weight > 0


def universal_axes(
    spec: GridSpec, pose: Pose, lattice: Lattice, shift: int = 0
) -> tuple[Float64, Float64, Float64, Float64]:
    """Eq. 3 split into what a column and what a row contributes, in cells of the lattice.

    The centre of column c and row r lies in cell (floor(column_i[c] + row_i[r]),
    floor(column_j[c] + row_j[r])), whatever window is looked at: a centre on the very edge of
    a cell must not fall to one side in one window and to the other in another. With `shift` s
    there are 2^s columns and rows a local cell. Returns (column_i, column_j, row_i, row_j).
    """
    x, y = _part_centres_m(spec, shift)
    phi, scale = math.radians(pose.heading_deg), lattice.cells_per_m
    return (
        x * (math.cos(phi) * scale),
        -x * (math.sin(phi) * scale),
        pose.east_m * scale + y * (math.sin(phi) * scale),
        pose.north_m * scale + y * (math.cos(phi) * scale),
    )


@lru_cache(maxsize=8)
def _part_centres_m(spec: GridSpec, shift: int) -> tuple[Float64, Float64]:
    """x of the columns' and y of the rows' centres, 2^shift of each a cell: the same for all
    frames of a drive."""
    parts = 1 << shift
    fine_m = spec.cell_m / parts
    x = (np.arange(spec.n_x * parts, dtype=np.float64) + 0.5) * fine_m - spec.width_m / 2.0
    y = (np.arange(spec.n_y * parts, dtype=np.float64) + 0.5) * fine_m
    x.setflags(write=False)
    y.setflags(write=False)
    return x, y


@kernel
def seen_span(observed):  # type: ignore[no-untyped-def]
    """The first column of a row that was observed, and the one behind the last."""
    first, last = 0, observed.size
    while first < last and not observed[first]:
        first += 1
    while last > first and not observed[last - 1]:
        last -= 1
    return first, last


@kernel
def locate(  # type: ignore[no-untyped-def]
    observed, column_i, column_j, row_i, row_j, shift, i0, j0, width, height, cell, spans
):
    """Fill the `cell` and `spans` of a `Landing`. Two loops a row, because the first then runs in
    vector registers: floats until the end, as whole numbers of 64 bits would not fit those."""
    for fine_r in range(cell.shape[0]):
        r, i_r, j_r = fine_r >> shift, row_i[fine_r], row_j[fine_r]
        first, last = seen_span(observed[r])
        start, end = first << shift, last << shift
        spans[fine_r, 0], spans[fine_r, 1] = start, end
        cell[fine_r, :start] = -1
        cell[fine_r, end:] = -1
        across_i, across_j, into = column_i[start:end], column_j[start:end], cell[fine_r, start:end]
        for c in range(into.size):
            u = np.floor(across_i[c] + i_r) - i0
            v = np.floor(across_j[c] + j_r) - j0
            inside = (u >= 0.0) & (v >= 0.0) & (u < width) & (v < height)
            into[c] = np.int32(v) * np.int32(width) + np.int32(u) if inside else -1
        for c in range(np.uint64(start), np.uint64(end)):
            if not observed[r, c >> shift]:
                cell[fine_r, c] = -1


@kernel
def add_values(values, cell, shift, spans, table, sums):  # type: ignore[no-untyped-def]
    """Add to each cell of a `Landing` what `table` has for the value of the local cell.

    Neighbours that land in one cell are added up before it is touched.
    """
    for r in range(cell.shape[0]):
        last, total = np.int32(-1), np.uint64(0)
        for c in range(spans[r, 0], spans[r, 1]):
            k = cell[r, c]
            if k != last:
                if last >= 0:
                    sums[np.uint32(last)] += total
                last, total = k, np.uint64(0)
            total += table[values[r >> shift, c >> shift]]
        if last >= 0:
            sums[np.uint32(last)] += total


@kernel
def divide(weight, total, mean):  # type: ignore[no-untyped-def]
    """Fill `mean` with total / weight, rounded half up; 0 where the weight is 0."""
    two = np.uint64(2)
    for k in range(weight.size):
        if weight[k] == 0 or total[k] == 0:
            mean[k] = 0
        else:
            mean[k] = np.uint8((two * total[k] + weight[k]) // (two * weight[k]))


@kernel
def average_pairwise(  # type: ignore[no-untyped-def]
    density, observed, column_i, column_j, row_i, row_j, i0, j0, value
):
    """The flow chart of the paper's Fig. 5: a new value, or the average of old and new."""
    height, width = value.shape
    for r in range(density.shape[0]):
        for c in range(density.shape[1]):
            if not observed[r, c]:
                continue
            i = math.floor(column_i[c] + row_i[r]) - i0
            j = math.floor(column_j[c] + row_j[r]) - j0
            if i >= 0 and j >= 0 and i < width and j < height:
                new = np.float32(density[r, c])
                old = value[j, i]
                value[j, i] = new if np.isnan(old) else np.float32(0.5) * (old + new)
