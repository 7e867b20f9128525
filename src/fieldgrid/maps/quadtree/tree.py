"""The squares of a map, and which of them encloses a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt

from fieldgrid.core import AnyArray, ConfigError, Float64, Index, Int64, quoted
from fieldgrid.geometry import Bounds, Datum, Lattice, Window
from fieldgrid.maps.cost import DENSITIES, CostCurve
from fieldgrid.maps.quadtree.rule import LOSS, MAX_LEVEL, Near, Rule, checked_rule, whole_squares
from fieldgrid.maps.quadtree.split import Squares, joined, squares_of
from fieldgrid.maps.views.blocks import MapBlocks
from fieldgrid.maps.views.readable import Readable
from fieldgrid.maps.views.view import MapView

MAX_SQUARES = 20_000_000
"""Squares of a tree: 400 MB, and three times as much while it is made."""


@dataclass(frozen=True, slots=True, eq=False)
class Quadtree:
    """A part of a map in squares, sorted by side, then from the south, then from the west.

    `squares` are their columns. No observed cell differs in density from the mean of its square by
    more than `loss`, and all known cells of a square have its state. Unseen ground is in squares of
    state `UNSEEN` where some density is known, else in no square, but for what `least_seen` allows.
    `sides_m` are the sides that there may be; `window` are the cells that were looked at.
    """

    lattice: Lattice
    window: Window
    datum: Datum
    loss: float
    sides_m: tuple[float, ...]
    squares: Squares = field(repr=False)

    @classmethod
    def from_map(
        cls,
        universal: Readable,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        loss: float = LOSS,
        sides_m: Sequence[float] | None = None,
        least_seen: float = 1.0,
        near: Near | None = None,
        layer: str = "density",
        at: str | int | None = None,
        curve: CostCurve | None = None,
    ) -> Self:
        """The squares of a part of a map, or of a `Farm`, that cover `bounds`; `bounds`, `cell_m`
        and `at` as in `MapFile.read`, `layer` as in `Costmap.from_map`.

        `loss` (0..255) bounds by how much cells of `cell_m` differ from the mean of their square.
        `sides_m` are the sides that squares may have: first that of the cells, then some of 2, 4,
        ... 256 times that; all of these when not given. A square larger than a cell stays whole
        only where at least `least_seen` of it was seen: 1 takes no unseen ground for free, 0.5 is
        the rule for larger cells of a costmap. Squares that hold a cell `near` a line are as small
        as cells. `curve` says what is free and what is an obstacle.

        The map is read in blocks, so memory grows with the squares alone. Raises ConfigError for
        settings that cannot be and for more than 20 million squares.
        """
        lattice = Lattice(universal.cell_m if cell_m is None else cell_m)
        rule = checked_rule(lattice, loss, sides_m, least_seen, near, curve)
        if layer not in DENSITIES:
            raise ConfigError(
                f"The layer {quoted(layer)} holds no density, so it makes no squares; choose one "
                f"of {', '.join(DENSITIES)}."
            )
        window = whole_squares(lattice.window(bounds or universal.bounds), rule.levels[-1])
        area = lattice.bounds(window)
        with universal.read_blocks(area, cell_m, layers=[layer], at=at, decide=layer) as blocks:
            return cls._of(blocks, universal.datum, rule, layer)

    @classmethod
    def from_view(
        cls,
        view: MapView,
        *,
        loss: float = LOSS,
        sides_m: Sequence[float] | None = None,
        least_seen: float = 1.0,
        near: Near | None = None,
        curve: CostCurve | None = None,
    ) -> Self:
        """The squares of a view that was read already, to decide. What lies outside of it
        counts as unseen."""
        rule = checked_rule(view.lattice, loss, sides_m, least_seen, near, curve)
        whole = MapBlocks(view.lattice, view.window, iter((view,)))
        return cls._of(whole, view.datum, rule, "density")

    @classmethod
    def _of(cls, blocks: MapBlocks, datum: Datum, rule: Rule, layer: str) -> Self:
        parts, count = [], 0
        for part in (one for view in blocks.views for one in squares_of(view, rule, layer)):
            parts.append(part)
            count += len(part.level)
            if count > MAX_SQUARES:
                raise ConfigError(
                    f"There are more than {MAX_SQUARES / 1e6:.0f} million squares; give smaller "
                    "bounds, a larger cell or a larger loss."
                )
        found = joined(parts)
        order = np.lexsort((found.column, found.row, found.level))
        sides_m = tuple((1 << level) / blocks.lattice.cells_per_m for level in rule.levels)
        squares = Squares._make(column[order] for column in found)
        return cls(blocks.lattice, blocks.window, datum, rule.loss, sides_m, squares)

    def __len__(self) -> int:
        return len(self.squares.level)

    @property
    def side_m(self) -> Float64:
        """The side of each square in metres."""
        return (1 << self.squares.level.astype(np.int64)) / self.lattice.cells_per_m

    @property
    def west_m(self) -> Float64:
        """The western edge of each square, metres east of the datum."""
        return self.squares.column / self.lattice.cells_per_m

    @property
    def south_m(self) -> Float64:
        """The southern edge of each square, metres north of the datum."""
        return self.squares.row / self.lattice.cells_per_m

    @property
    def worst_loss(self) -> float:
        """The largest difference between a cell and the mean of its square; at most `loss`."""
        mean = self.squares.mean.astype(np.float64)
        away = np.maximum(self.squares.highest - mean, mean - self.squares.lowest)
        return float(np.nanmax(away, initial=0.0))

    def at(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> Index:
        """The square that encloses each point, as an index into the columns; -1 where none does.

        Points are metres east and north, floats or arrays of shapes that broadcast.
        """
        east, north = np.broadcast_arrays(
            np.asarray(east_m, dtype=np.float64), np.asarray(north_m, dtype=np.float64)
        )
        finite = np.isfinite(east) & np.isfinite(north)
        i, j = self.lattice.index(np.where(finite, east, 0.0), np.where(finite, north, 0.0))
        keys = _key(self.squares.row, self.squares.column)
        found = np.full(east.shape, -1, dtype=np.intp)
        for level in range(MAX_LEVEL + 1):
            first, last = np.searchsorted(self.squares.level, (level, level + 1))
            if first < last:
                wanted, some = _key(j >> level << level, i >> level << level), keys[first:last]
                place = np.minimum(np.searchsorted(some, wanted), last - first - 1)
                found = np.where((some[place] == wanted) & finite, first + place, found)
        return found


def _key(row: AnyArray, column: AnyArray) -> Int64:
    """A number a square that sorts those of one side by row, then by column."""
    return np.asarray(row, dtype=np.int64) * (1 << 32) + column
