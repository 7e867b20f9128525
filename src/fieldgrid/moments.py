"""What a drive leaves in a cell: sums that add up, and so can be taken out again.

For each universal cell over the accepted frames of one session: the weight and the weighted sum
of the density (as :mod:`fieldgrid.transfer` counts them, in sixteenths of a local cell), the
weighted sum of its squares, how many frames observed the cell, and the highest density. All are
unsigned integers, and none depends on the order of the frames.

The frames are folded straight into tiles: a frame sees a part of its footprint, and only the
cells it sees are touched.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Bool, Float64, Int32, UInt8, UInt64
from fieldgrid.grids import LocalGrid
from fieldgrid.kernel import kernel
from fieldgrid.lattice import TILE_CELLS, Lattice, Window
from fieldgrid.trajectory import Pose
from fieldgrid.transfer import AREA_SHIFT, Transfer, check_cell_sizes, universal_axes

WEIGHT, SUM, SQUARES, FRAMES, HIGHEST = range(5)
"""The last axis of moments: uint64 [rows north, columns east, 5]."""

PLANES = 5

HIGHEST_BITS = 8
"""Above these bits of HIGHEST a fold in progress keeps the number of the last frame."""

Moments = UInt64


def merge_moments(a: Moments, b: Moments) -> Moments:
    """The moments of two disjoint sets of frames together."""
    merged = a + b
    merged[..., HIGHEST] = np.maximum(a[..., HIGHEST], b[..., HIGHEST])
    return merged


def finished(pooled: Moments) -> Moments:
    """A copy of the moments of a fold in progress, without its numbers of frames."""
    moments = pooled.copy()
    moments[..., HIGHEST] &= np.uint64((1 << HIGHEST_BITS) - 1)
    return moments


def add_to_tiles(
    pool: Moments,
    slots: Int32,
    window: Window,
    grid: LocalGrid,
    pose: Pose,
    lattice: Lattice,
    transfer: Transfer,
    number: int,
) -> None:
    """Carry one local grid into tiles that lie side by side.

    `pool` is uint64 [tiles, 256, 256, 5]. `window` covers whole tiles; `slots` [rows, columns]
    says where in the pool each is. `number`, from 1, is the frame's own in this fold.
    Raises ConfigError when universal cells are smaller than the grid's.
    """
    check_cell_sizes(lattice.cell_m, grid.spec.cell_m)
    shift = AREA_SHIFT if transfer is Transfer.AREA else 0
    axes = universal_axes(grid.spec, pose, lattice, shift)
    accumulate_moments(
        grid.density, grid.observed, *axes, shift, window.i0, window.j0, slots, number, pool
    )


@kernel
def accumulate_moments(  # type: ignore[no-untyped-def]
    density, observed, column_i, column_j, row_i, row_j, shift, i0, j0, slots, number, pool
):
    """Add every observed cell to the moments of its tile; see `accumulate_moments_reference`.

    Two short loops a row, because the first then runs in vector registers.
    """
    height, width, columns = TILE_CELLS * slots.shape[0], TILE_CELLS * slots.shape[1], column_i.size
    flat = pool.reshape(-1)
    unit_shift = np.uint64(2 * (AREA_SHIFT - shift))
    unit, stamp = np.uint64(1) << unit_shift, np.uint64(number) << np.uint64(HIGHEST_BITS)
    value_mask, stamp_mask = np.uint64(0xFF), ~np.uint64(0xFF)
    cell = np.empty(columns, dtype=np.int32)
    for fine_r in range(row_i.size):
        r, i_r, j_r = fine_r >> shift, row_i[fine_r], row_j[fine_r]
        for c in range(columns):
            u = np.floor(column_i[c] + i_r) - i0
            v = np.floor(column_j[c] + j_r) - j0
            inside = (u >= 0.0) & (v >= 0.0) & (u < width) & (v < height)
            cell[c] = np.int32(v) * np.int32(width) + np.int32(u) if inside else -1
        for c in range(columns):
            if cell[c] >= 0 and observed[r, c >> shift]:
                v, u = cell[c] // width, cell[c] % width
                slot = slots[v // TILE_CELLS, u // TILE_CELLS]
                in_tile = (v % TILE_CELLS) * TILE_CELLS + u % TILE_CELLS
                k = PLANES * ((np.intp(slot) * TILE_CELLS) * TILE_CELLS + np.intp(in_tile))
                value = np.uint64(density[r, c >> shift])
                flat[k + WEIGHT] += unit
                flat[k + SUM] += value << unit_shift
                flat[k + SQUARES] += (value * value) << unit_shift
                before = flat[k + HIGHEST]
                if (before & stamp_mask) != stamp:
                    flat[k + FRAMES] += np.uint64(1)
                flat[k + HIGHEST] = stamp | max(before & value_mask, value)


def accumulate_moments_reference(
    density: UInt8,
    observed: Bool,
    column_i: Float64,
    column_j: Float64,
    row_i: Float64,
    row_j: Float64,
    shift: int,
    i0: int,
    j0: int,
    slots: Int32,
    number: int,
    pool: Moments,
) -> None:
    """The same as `accumulate_moments`, in NumPy: what the compiled kernel is held to."""
    unit = np.uint64(1 << (2 * (AREA_SHIFT - shift)))
    rows, columns = np.arange(row_i.size) >> shift, np.arange(column_i.size) >> shift
    i = np.floor(column_i[None, :] + row_i[:, None]) - i0
    j = np.floor(column_j[None, :] + row_j[:, None]) - j0
    height, width = TILE_CELLS * slots.shape[0], TILE_CELLS * slots.shape[1]
    inside = observed[np.ix_(rows, columns)] & (i >= 0) & (j >= 0) & (i < width) & (j < height)
    v, u = j[inside].astype(np.intp), i[inside].astype(np.intp)
    values = density[np.ix_(rows, columns)][inside].astype(np.uint64)
    slot = slots[v // TILE_CELLS, u // TILE_CELLS]
    place = (slot, v % TILE_CELLS, u % TILE_CELLS)
    np.add.at(pool[..., WEIGHT], place, unit)
    np.add.at(pool[..., SUM], place, values * unit)
    np.add.at(pool[..., SQUARES], place, values * values * unit)
    touched = tuple(np.unique(np.stack(place), axis=1))
    pool[..., FRAMES][touched] += np.uint64(1)
    highest = pool[..., HIGHEST] & np.uint64((1 << HIGHEST_BITS) - 1)
    np.maximum.at(highest, place, values)
    stamp = np.uint64(number << HIGHEST_BITS)
    pool[..., HIGHEST][touched] = highest[touched] | stamp
