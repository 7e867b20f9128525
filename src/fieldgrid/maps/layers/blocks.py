"""Blocks: squares of cells that share one value, for what changes slowly from place to place.

Ground is followed in patches of half a metre, and frames keep its heights in blocks of 20 cm. A
value for each cell of 5 cm would be the same 16 times. Blocks have a power of 2 of cells along
their side, so that tiles consist of whole blocks, and larger cells of the pyramid do, too. They lie
at multiples of their side on the lattice.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, Float64, Int32, Int64, kernel
from fieldgrid.geometry import TILE_CELLS, GridSpec, Lattice, Pose, Window
from fieldgrid.maps.transfer import footprint

LARGEST_M = 0.25
"""A block is no larger, unless a single cell is."""

_APART_M = 0.2
"""Distance between the points of a block at which a frame is looked up: most blocks have one."""

COLUMN_BITS = 16
"""Low bits of a local cell's number that are its column; the others are its row."""


@lru_cache(maxsize=64)
def block_side(lattice: Lattice) -> int:
    """Cells along the side of a block."""
    cells = max(math.floor(math.log2(LARGEST_M * lattice.cells_per_m * (1.0 + 1e-9))), 0)
    return min(1 << cells, TILE_CELLS)


def blocks_under(window: Window, side: int) -> Window:
    """The blocks that a window touches, counted in blocks."""
    i0, j0 = window.i0 // side, window.j0 // side
    i1, j1 = ((v - 1) // side + 1 for v in (window.i0 + window.width, window.j0 + window.height))
    return Window(i0, j0, i1 - i0, j1 - j0)


def whole_blocks(window: Window, lattice: Lattice) -> Window:
    """The cells of all blocks that a window touches: what they hold depends on no others."""
    side = block_side(lattice)
    return Window(*(value * side for value in blocks_under(window, side)))


class BlockPoints(NamedTuple):
    """Where a frame is looked up for the blocks under a window.

    `block` [n] are flat indices of blocks that the frame may have seen; `cell` [n, points] the
    local cells in [n_y, n_x] at the points of each, their row above `COLUMN_BITS` of the column, -1
    outside of the grid.
    """

    block: Int32
    cell: Int32


def block_points(spec: GridSpec, pose: Pose, lattice: Lattice, window: Window) -> BlockPoints:
    """The points of the blocks under a window in a frame's local grid: Eq. 3 turned round."""
    side = block_side(lattice)
    under, side_m = blocks_under(window, side), side * lattice.cell_m
    near = blocks_under(footprint(spec, pose, lattice), side).intersect(under)
    if near is None:
        near = Window(under.i0, under.j0, 0, 0)
    east, north = np.arange(near.width) + near.i0, np.arange(near.height) + near.j0
    points = max(1, round(side_m / _APART_M))
    part = (np.arange(points) + 0.5) / points
    phi = math.radians(pose.heading_deg)
    block = np.empty(near.width * near.height, np.int32)
    cell = np.empty((block.size, points * points), np.int32)
    count = look_up(
        _apart(east, part, side_m, pose.east_m) / spec.cell_m,
        _apart(north, part, side_m, pose.north_m) / spec.cell_m,
        east - under.i0,
        (north - under.j0) * under.width,
        math.cos(phi),
        math.sin(phi),
        *(spec.n_x, spec.n_y, spec.width_m / (2.0 * spec.cell_m)),
        block,
        cell,
    )
    return BlockPoints(block[:count], cell[:count])


def _apart(blocks: Int64, part: Float64, side_m: float, from_m: float) -> Float64:
    """How far the points of blocks lie from a place along an axis, metres [blocks, points]: the
    same whatever window they are looked up for."""
    return (blocks[:, None] + part) * side_m - from_m


@kernel
def look_up(east, north, column, row, cos, sin, n_x, n_y, half, block, cell):  # type: ignore[no-untyped-def]
    """Fill `block` and `cell` with the blocks of which a point lies in the grid; returns how many.

    `east`, `north` [blocks, points] and `half` the grid's width are in local cells; `column` and
    `row` are what each block adds to its flat index.
    """
    count = 0
    points = east.shape[1]
    for b in range(north.shape[0]):
        for a in range(east.shape[0]):
            inside = False
            for q in range(points):
                for p in range(points):
                    x = east[a, p] * cos - north[b, q] * sin + half
                    y = east[a, p] * sin + north[b, q] * cos
                    if 0.0 <= x < n_x and 0.0 <= y < n_y:
                        inside = True
                        cell[count, q * points + p] = (np.int32(y) << COLUMN_BITS) | np.int32(x)
                    else:
                        cell[count, q * points + p] = -1
            if inside:
                block[count] = row[b] + column[a]
                count += 1
    return count


def blocks_of(cells: Int32, lattice: Lattice, window: Window) -> Int32:
    """The flat indices of the blocks under a window that hold some of its cells, flat indices, in
    no order."""
    side = block_side(lattice)
    under = blocks_under(window, side)
    held = np.zeros(under.width * under.height, np.bool_)
    blocks = np.empty(min(cells.size, held.size), np.int32)
    # How far the window begins behind the corner of its first block.
    j0, i0 = window.j0 - side * under.j0, window.i0 - side * under.i0
    return blocks[: find_blocks(cells, window.width, j0, i0, side, under.width, held, blocks)]


@kernel
def find_blocks(cells, width, j0, i0, side, across, held, blocks):  # type: ignore[no-untyped-def]
    """Fill `blocks` with each block that holds a cell once; returns how many there are. `held` is
    false before."""
    count, last, block = 0, -1, 0
    for k in cells:
        row, column = np.uint32(k) // np.uint32(width), np.uint32(k) % np.uint32(width)
        block = ((row + j0) // side) * across + (column + i0) // side
        if block != last and not held[np.uint32(block)]:
            held[np.uint32(block)] = True
            blocks[count] = block
            count += 1
        last = block
    return count


def session_means(total: AnyArray, count: AnyArray) -> Int64:
    """Whole means of whole sums, rounded half up; 0 where there is nothing."""
    parts = np.maximum(count, 1)
    return np.where(count > 0, (2 * total + parts) // (2 * parts), 0)
