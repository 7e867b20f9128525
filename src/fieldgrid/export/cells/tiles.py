"""A part of a map that is too large for one message or picture, cut into tiles.

Tiles begin where the lattice's multiples of their side do, so those of two exports coincide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

from fieldgrid.geometry import Bounds, Lattice, Window
from fieldgrid.maps import Readable, Selection

MESSAGE_CELLS = 25_000_000
"""Cells of a nav_msgs/OccupancyGrid, which Nav2's map server makes of a map, too."""

_LOOK_CELLS = 2048
"""Cells along a side of the view that tells which tiles hold anything."""


class Tile(NamedTuple):
    """A tile: its number north and east, 0 for the first ones of the part, and what it holds."""

    row: int
    column: int
    selection: Selection
    window: Window

    @property
    def name(self) -> str:
        """As files and topics have it: its numbers, north first."""
        return f"{self.row:03d}_{self.column:03d}"

    def about(self, lattice: Lattice) -> dict[str, Any]:
        """Its size and place, as JSON and YAML can hold them."""
        bounds = map(float, lattice.bounds(self.window))
        return {
            "width": self.window.width,
            "height": self.window.height,
            "bounds_m": dict(zip(("west", "south", "east", "north"), bounds, strict=True)),
        }


class Whole(NamedTuple):
    """The part of a map that is asked for."""

    lattice: Lattice
    window: Window

    @property
    def is_large(self) -> bool:
        """Whether it has more cells than one message takes."""
        return self.window.width * self.window.height > MESSAGE_CELLS


def cut(universal: Readable, selection: Selection, whole: Whole, side: int) -> Iterator[Tile]:
    """The tiles, `side` cells wide, in which anything was observed or marked, from the south."""
    lattice, window = whole
    area = lattice.bounds(window)
    cell_m = universal.cell_m
    while max(area.east_m - area.west_m, area.north_m - area.south_m) / cell_m > _LOOK_CELLS:
        cell_m *= 2.0
    seen = universal.read(area, cell_m, at=selection.at)
    south, west = window.j0 // side, window.i0 // side
    for row in range(south, (window.j0 + window.height - 1) // side + 1):
        for column in range(west, (window.i0 + window.width - 1) // side + 1):
            part = window.intersect(Window(column * side, row * side, side, side))
            assert part is not None
            bounds = lattice.bounds(part)
            looked = seen.lattice.window(bounds).intersect(seen.window)
            observed = looked and seen.observed[seen.window.slices_of(looked)].any()
            if observed or any(mark.lies_in(bounds) for mark in seen.marks):
                # Bounds of the same cells, which no rounding widens by one.
                edge_m = lattice.cell_m / 4.0
                inside = Bounds(
                    bounds.west_m + edge_m,
                    bounds.south_m + edge_m,
                    bounds.east_m - edge_m,
                    bounds.north_m - edge_m,
                )
                yield Tile(row - south, column - west, replace(selection, bounds=inside), part)
