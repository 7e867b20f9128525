"""The one lattice: square cells of the Local Tangent Plane, anchored at E = N = 0.

Cell (i, j) covers [i·L, (i+1)·L) east and [j·L, (j+1)·L) north; so maps of one datum and cell
size share their cells, whatever their extent. Arrays over a window are indexed [j, i] with
row 0 in the south; pictures and GIS rasters flip that at their own door.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import ConfigError, Float64, Int64

TILE_CELLS = 256
"""Cells along the side of a tile, the unit in which maps are stored."""

MIN_CELL_M, MAX_CELL_M = 0.005, 100.0


class Bounds(NamedTuple):
    """A rectangle of the LTP, metres: west < east, south < north."""

    west_m: float
    south_m: float
    east_m: float
    north_m: float

    def union(self, other: Bounds) -> Bounds:
        """The smallest rectangle that holds both."""
        return Bounds(
            min(self.west_m, other.west_m),
            min(self.south_m, other.south_m),
            max(self.east_m, other.east_m),
            max(self.north_m, other.north_m),
        )

    def overlaps(self, other: Bounds) -> bool:
        """Whether the two share an area."""
        return (
            self.west_m < other.east_m
            and other.west_m < self.east_m
            and self.south_m < other.north_m
            and other.south_m < self.north_m
        )


class TileIndex(NamedTuple):
    """Tile (tx, ty) covers cells [256·tx, 256·(tx+1)) east and likewise north."""

    ty: int
    tx: int


class Window(NamedTuple):
    """A rectangle of cells: its south-west cell (i0, j0), its width and height in cells."""

    i0: int
    j0: int
    width: int
    height: int

    @property
    def shape(self) -> tuple[int, int]:
        """Shape [rows north, columns east] of an array over this window."""
        return self.height, self.width

    def tiles(self) -> Iterator[TileIndex]:
        """The tiles that this window touches, south to north, west to east."""
        for ty in range(self.j0 // TILE_CELLS, (self.j0 + self.height - 1) // TILE_CELLS + 1):
            for tx in range(self.i0 // TILE_CELLS, (self.i0 + self.width - 1) // TILE_CELLS + 1):
                yield TileIndex(ty, tx)

    def intersect(self, other: Window) -> Window | None:
        """The common cells of two windows, or None."""
        i0, j0 = max(self.i0, other.i0), max(self.j0, other.j0)
        width = min(self.i0 + self.width, other.i0 + other.width) - i0
        height = min(self.j0 + self.height, other.j0 + other.height) - j0
        return Window(i0, j0, width, height) if width > 0 and height > 0 else None

    def union(self, other: Window) -> Window:
        """The smallest window that holds both."""
        i0, j0 = min(self.i0, other.i0), min(self.j0, other.j0)
        i1 = max(self.i0 + self.width, other.i0 + other.width)
        j1 = max(self.j0 + self.height, other.j0 + other.height)
        return Window(i0, j0, i1 - i0, j1 - j0)

    def grown(self, cells: int) -> Window:
        """The window with a number of cells more on each side."""
        return Window(
            self.i0 - cells, self.j0 - cells, self.width + 2 * cells, self.height + 2 * cells
        )

    def slices_of(self, part: Window) -> tuple[slice, slice]:
        """Slices [rows, columns] of `part`, which lies inside, in an array over this window."""
        j, i = part.j0 - self.j0, part.i0 - self.i0
        return slice(j, j + part.height), slice(i, i + part.width)


def tile_window(tile: TileIndex) -> Window:
    """The cells of a tile."""
    return Window(tile.tx * TILE_CELLS, tile.ty * TILE_CELLS, TILE_CELLS, TILE_CELLS)


def squares(window: Window, side: int) -> Iterator[Window]:
    """The window cut into squares of at most `side` cells, from its south-west corner on."""
    return _cut(window, window.j0, window.i0, side, side)


def aligned_parts(window: Window, height: int, width: int) -> Iterator[Window]:
    """The window cut at all rows and columns that are multiples of a height and a width."""
    j0, i0 = window.j0 // height * height, window.i0 // width * width
    return _cut(window, j0, i0, height, width)


def _cut(window: Window, first_j: int, first_i: int, height: int, width: int) -> Iterator[Window]:
    """The parts of a window in rectangles of one size, south to north, west to east."""
    for j0 in range(first_j, window.j0 + window.height, height):
        for i0 in range(first_i, window.i0 + window.width, width):
            part = window.intersect(Window(i0, j0, width, height))
            assert part is not None
            yield part


@dataclass(frozen=True, slots=True)
class Lattice:
    """Square cells of side `cell_m` (L_U in the paper), anchored at the datum."""

    cell_m: float

    def __post_init__(self) -> None:
        if not MIN_CELL_M <= self.cell_m <= MAX_CELL_M:
            raise ConfigError(
                f"A cell of {self.cell_m} m is outside {MIN_CELL_M}..{MAX_CELL_M} m; "
                "0.05 and 0.25 are usual."
            )

    @property
    def cells_per_m(self) -> float:
        """1/L. Positions are always scaled by this, never divided by L: 0.15/0.05 < 3."""
        return 1.0 / self.cell_m

    def index(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> tuple[Int64, Int64]:
        """Cell (i, j) that encloses each position in metres."""
        i = np.floor(np.asarray(east_m, dtype=np.float64) * self.cells_per_m)
        j = np.floor(np.asarray(north_m, dtype=np.float64) * self.cells_per_m)
        return i.astype(np.int64), j.astype(np.int64)

    def centres(self, window: Window) -> tuple[Float64, Float64]:
        """East of each column's and north of each row's centre, metres."""
        east = (np.arange(window.width, dtype=np.float64) + (window.i0 + 0.5)) / self.cells_per_m
        north = (np.arange(window.height, dtype=np.float64) + (window.j0 + 0.5)) / self.cells_per_m
        return east, north

    def bounds(self, window: Window) -> Bounds:
        """The window's outer edges in metres."""
        return Bounds(
            window.i0 / self.cells_per_m,
            window.j0 / self.cells_per_m,
            (window.i0 + window.width) / self.cells_per_m,
            (window.j0 + window.height) / self.cells_per_m,
        )

    def window(self, bounds: Bounds) -> Window:
        """The smallest window that covers `bounds` (Eq. 1's counts, rounded up)."""
        if not all(math.isfinite(v) for v in bounds) or not (
            bounds.west_m < bounds.east_m and bounds.south_m < bounds.north_m
        ):
            raise ConfigError(
                f"Bounds {tuple(bounds)} are empty; give west south east north in metres."
            )
        scale = self.cells_per_m
        # A bound that sits on a cell edge up to rounding must not open one more cell.
        i0 = math.floor(bounds.west_m * scale + 1e-6)
        j0 = math.floor(bounds.south_m * scale + 1e-6)
        i1 = math.ceil(bounds.east_m * scale - 1e-6)
        j1 = math.ceil(bounds.north_m * scale - 1e-6)
        return Window(i0, j0, max(i1 - i0, 1), max(j1 - j0, 1))


def check_inside(crop: Bounds, extent: Bounds) -> None:
    """Raise ConfigError for a crop that is empty, or shares nothing with the map."""
    Lattice(1.0).window(crop)
    if not crop.overlaps(extent):
        raise ConfigError(
            f"The bounds {crop.west_m:g} {crop.south_m:g} {crop.east_m:g} {crop.north_m:g} hold "
            f"nothing of the map, which lies between {extent.west_m:g} {extent.south_m:g} "
            f"{extent.east_m:g} {extent.north_m:g} (west south east north, metres)."
        )
