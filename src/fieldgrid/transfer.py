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

import numpy as np
import numpy.typing as npt

from fieldgrid.array_types import Bool, Float32, Float64, UInt8, UInt64
from fieldgrid.errors import ConfigError
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.kernel import kernel
from fieldgrid.lattice import Lattice, Window
from fieldgrid.settings import Transfer as Transfer  # noqa: PLC0414 - users set it, and it is used here
from fieldgrid.trajectory import Pose

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


@dataclass(slots=True)
class MeanFold:
    """The order-independent mean over a window: (weight, weighted sum) a cell."""

    lattice: Lattice
    window: Window
    transfer: Transfer = Transfer.CENTRE
    sums: UInt64 = field(init=False)

    def __post_init__(self) -> None:
        # Side by side, because every touched cell needs both: one cache line instead of two.
        self.sums = np.zeros((*self.window.shape, 2), dtype=np.uint64)

    def add(self, grid: LocalGrid, pose: Pose) -> None:
        """Carry one local grid into the window; what falls outside is left out."""
        add_to_sums(self.sums, self.window, grid, pose, self.lattice, self.transfer)

    def density(self) -> tuple[UInt8, Bool]:
        """Mean 3D density rounded to uint8, and the observed mask, both [rows, columns]."""
        return mean_density(self.sums)


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
        rounded = np.floor(np.where(observed, self.value, 0.0) + 0.5)
        return rounded.astype(np.uint8), observed


def add_to_sums(
    sums: UInt64,
    window: Window,
    grid: LocalGrid,
    pose: Pose,
    lattice: Lattice,
    transfer: Transfer,
) -> None:
    """Carry one local grid into (weight, weighted sum) over a window, uint64 [rows, columns, 2].

    Raises ConfigError when universal cells are smaller than the grid's.
    """
    check_cell_sizes(lattice.cell_m, grid.spec.cell_m)
    shift = AREA_SHIFT if transfer is Transfer.AREA else 0
    axes = universal_axes(grid.spec, pose, lattice, shift)
    accumulate(grid.density, grid.observed, *axes, shift, window.i0, window.j0, sums)


def mean_density(
    sums: UInt64,
) -> tuple[UInt8, Bool]:
    """The mean of accumulated cells [..., (weight, weighted sum)], rounded half up in integers.

    Returns uint8 and the mask of the cells that have any weight, both [...].
    """
    weight, weighted_sum = sums[..., 0], sums[..., 1]
    divisor = np.maximum(weight, np.uint64(1))
    two = np.uint64(2)
    return ((two * weighted_sum + divisor) // (two * divisor)).astype(np.uint8), weight > 0


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
def accumulate(  # type: ignore[no-untyped-def]
    density, observed, column_i, column_j, row_i, row_j, shift, i0, j0, sums
):
    """Add every observed cell to (weight, weighted sum); see `accumulate_reference`.

    Two short loops a row, because the first then runs in vector registers.
    """
    height, width, columns = sums.shape[0], sums.shape[1], column_i.size
    flat = sums.reshape(-1)
    unit_shift = np.uint64(2 * (AREA_SHIFT - shift))
    unit = np.uint64(1) << unit_shift
    cell = np.empty(columns, dtype=np.int32)
    for fine_r in range(row_i.size):
        r, i_r, j_r = fine_r >> shift, row_i[fine_r], row_j[fine_r]
        for c in range(columns):
            # Floats until the end: whole numbers of 64 bits would not fit the vector units.
            u = np.floor(column_i[c] + i_r) - i0
            v = np.floor(column_j[c] + j_r) - j0
            inside = (u >= 0.0) & (v >= 0.0) & (u < width) & (v < height)
            cell[c] = np.int32(v) * np.int32(width) + np.int32(u) if inside else -1
        for c in range(columns):
            if cell[c] >= 0 and observed[r, c >> shift]:
                k = 2 * np.intp(cell[c])
                flat[k] += unit
                flat[k + 1] += np.uint64(density[r, c >> shift]) << unit_shift


def accumulate_reference(
    density: UInt8,
    observed: Bool,
    column_i: Float64,
    column_j: Float64,
    row_i: Float64,
    row_j: Float64,
    shift: int,
    i0: int,
    j0: int,
    sums: UInt64,
) -> None:
    """The same as `accumulate`, in NumPy: what the compiled kernel is held to."""
    unit = np.uint64(1 << (2 * (AREA_SHIFT - shift)))
    rows, columns = np.arange(row_i.size) >> shift, np.arange(column_i.size) >> shift
    i = np.floor(column_i[None, :] + row_i[:, None]) - i0
    j = np.floor(column_j[None, :] + row_j[:, None]) - j0
    height, width = sums.shape[:2]
    inside = observed[np.ix_(rows, columns)] & (i >= 0) & (j >= 0) & (i < width) & (j < height)
    cells = (j[inside].astype(np.intp), i[inside].astype(np.intp))
    values = density[np.ix_(rows, columns)][inside].astype(np.uint64)
    np.add.at(sums[..., 0], cells, unit)
    np.add.at(sums[..., 1], cells, values * unit)


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
