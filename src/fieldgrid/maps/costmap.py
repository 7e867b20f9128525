"""A map as a planner asks it: what does it cost to be here, and how far is the next obstacle.

Whole arrays of points are answered at once. Unknown is kept apart from all that is known: it is a
cost of its own, and how far it is can be asked for itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Bool, ConfigError, Float32, Float64, Index, UInt8, quoted
from fieldgrid.geometry import Bounds, Datum, Lattice, Window
from fieldgrid.maps.cost import DENSITIES, INSCRIBED, LETHAL, UNKNOWN_COST, CostCurve
from fieldgrid.maps.views.blocks import MapBlocks
from fieldgrid.maps.views.readable import Readable
from fieldgrid.maps.views.view import MapView

MAX_CELLS = 100_000_000
"""Cells of a costmap: it holds 9 bytes of each, and 10 while it is made, beside what a block of the
map takes."""

MAX_SIDE = 40_000
"""Cells along a side, for whose squares the distance transform has room."""

_BLOCK_CELLS = 1_000_000
_ROUNDING = 1.0 + 1e-6
"""A distance that equals a radius up to rounding is within it."""


class Answer(NamedTuple):
    """What a costmap says of points; arrays of their shape, as of the functions of these names."""

    cost: UInt8
    clearance_m: Float64
    unknown_m: Float64
    known: Bool


@dataclass(frozen=True, slots=True)
class Inflation:
    """The robot's share in a cost, as Nav2's inflation layer has it.

    Within `robot_radius_m` of an obstacle the cost is 253. From there to `inflation_m` it is at
    least 252·exp(-`decay_per_m`·(distance - robot_radius_m)), and beyond it is that of the cell.
    """

    robot_radius_m: float = 0.0
    inflation_m: float = 0.0
    decay_per_m: float = 3.0

    def __post_init__(self) -> None:
        for name, value, most in (
            ("robot's radius", self.robot_radius_m, 50.0),
            ("inflation", self.inflation_m, 200.0),
        ):
            if not (math.isfinite(value) and 0.0 <= value <= most):
                raise ConfigError(f"A {name} of {value} m is outside 0..{most:g} m.")
        if not (math.isfinite(self.decay_per_m) and 0.0 < self.decay_per_m <= 1000.0):
            raise ConfigError(f"A decay of {self.decay_per_m} per metre is outside 0..1000.")


class _Distances:
    """How far cells are from others, worked out of their costs when it is first asked for."""

    def __init__(self, costs: UInt8) -> None:
        self._costs = costs
        self._to: dict[int, Float32] = {}

    def to(self, cost: int) -> Float32:
        """Of each cell to the nearest one of this cost, in cells; inf when there is none. Of
        obstacles NaN in the border, beyond which they are not known of."""
        found = self._to.get(cost)
        if found is None:
            found = _distance_cells(self._costs != cost)
            if cost == LETHAL:
                for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
                    found[edge] = np.nan
            self._to[cost] = found
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Costmap:
    """Costs and distances of a part of a map, with a border of what lies outside.

    Points are metres east and north of the datum, floats or arrays of any shapes that broadcast;
    a point belongs to the cell that encloses it, and gets that cell's answer. Distances are from
    the centre of its cell to the centre of the nearest one of the kind, so the true distance of
    the point to the edge of that cell is at most the answer and at least the answer less √2 cells.
    Points outside, and those that are NaN, are unknown.

    Obstacles beyond the edge of the part are not known of: within `unknown_m` of a point there is
    no other obstacle than those that `clearance_m` speaks of.
    """

    lattice: Lattice
    window: Window
    datum: Datum
    _costs: UInt8 = field(repr=False)
    _distances: _Distances = field(repr=False)

    @classmethod
    def from_map(
        cls,
        universal: Readable,
        bounds: Bounds | None = None,
        cell_m: float | None = None,
        *,
        layer: str = "density",
        at: str | int | None = None,
        curve: CostCurve | None = None,
        robot_radius_m: float = 0.0,
        inflation_m: float = 0.0,
        decay_per_m: float = 3.0,
    ) -> Self:
        """The costs of a part of a map, or of a `Farm`; `bounds`, `cell_m` and `at` as in
        `MapFile.read`. `layer` is the density; `lasting`, without what stood in half of the drives
        or fewer; or `max`.

        Raises ConfigError for settings that cannot be and for a part of more than 100 million
        cells or 40000 along a side.
        """
        settings = Inflation(robot_radius_m, inflation_m, decay_per_m)
        if layer not in DENSITIES:
            raise ConfigError(
                f"The layer {quoted(layer)} holds no density, so it has no cost; choose one of "
                f"{', '.join(DENSITIES)}."
            )
        with universal.read_blocks(bounds, cell_m, at=at, decide=layer) as blocks:
            costmap = cls._of(blocks, universal.datum, settings, curve)
        for cost in (LETHAL, UNKNOWN_COST):  # so that the first question takes no longer
            costmap._distances.to(cost)
        return costmap

    @classmethod
    def from_view(
        cls,
        view: MapView,
        *,
        curve: CostCurve | None = None,
        robot_radius_m: float = 0.0,
        inflation_m: float = 0.0,
        decay_per_m: float = 3.0,
    ) -> Self:
        """The costs of a view that was read already, to decide. Its distances are worked out when
        they are first asked for."""
        settings = Inflation(robot_radius_m, inflation_m, decay_per_m)
        whole = MapBlocks(view.lattice, view.window, iter((view,)))
        return cls._of(whole, view.datum, settings, curve)

    @classmethod
    def _of(
        cls,
        blocks: MapBlocks,
        datum: Datum,
        inflation: Inflation,
        curve: CostCurve | None,
    ) -> Self:
        costs = _costs_of(blocks, curve or CostCurve())
        distances = _Distances(costs)
        # It changes no cell that is an obstacle or unknown.
        _inflate(costs, distances, inflation, blocks.lattice)
        return cls(blocks.lattice, blocks.window, datum, costs, distances)

    @property
    def bounds(self) -> Bounds:
        """The outer edges in metres east and north of the datum."""
        return self.lattice.bounds(self.window)

    @property
    def costs(self) -> UInt8:
        """The cost of every cell, uint8 [rows north, columns east], row 0 in the south."""
        return self._costs[1:-1, 1:-1]

    def cost(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> UInt8:
        """The costs of Nav2, uint8: 0 free, to 252 dearer, 253 too near an obstacle for the
        robot, 254 an obstacle, 255 unknown or outside, however near an obstacle is."""
        return self._costs.take(self._places(east_m, north_m))

    def clearance_m(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> Float64:
        """Metres to the nearest obstacle: 0 in one, inf where there is none, NaN outside."""
        return self._metres(self._distances.to(LETHAL), self._places(east_m, north_m))

    def unknown_m(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> Float64:
        """Metres to the nearest cell that is unknown or outside: 0 in one."""
        return self._metres(self._distances.to(UNKNOWN_COST), self._places(east_m, north_m))

    def is_known(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> Bool:
        """Whether a point lies in a cell that was observed."""
        return np.asarray(self.cost(east_m, north_m) != UNKNOWN_COST)

    def at(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> Answer:
        """All answers at once."""
        places = self._places(east_m, north_m)
        costs = self._costs.take(places)
        return Answer(
            costs,
            self._metres(self._distances.to(LETHAL), places),
            self._metres(self._distances.to(UNKNOWN_COST), places),
            costs != UNKNOWN_COST,
        )

    def at_latlon(
        self,
        lat_deg: npt.ArrayLike,
        lon_deg: npt.ArrayLike,
        height_m: npt.ArrayLike | None = None,
    ) -> Answer:
        """All answers at WGS84 positions, at the datum's ellipsoidal height when not given.

        A height that is 10 m off moves a point 1 km from the datum by 2 mm.
        """
        height = self.datum.height_m if height_m is None else height_m
        east, north, _ = self.datum.to_enu(lat_deg, lon_deg, height)
        return self.at(east, north)

    def _places(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> Index:
        """Where the cells of points are in the flat arrays; in the border for those outside."""
        per_m, (i0, j0, width, height) = self.lattice.cells_per_m, self.window
        column = _within(east_m, per_m, i0, width)
        row = _within(north_m, per_m, j0, height)
        return np.asarray(row * (width + 2) + column)

    def _metres(self, cells: Float32, places: Index) -> Float64:
        return cells.take(places) * np.float64(self.lattice.cell_m)


def _within(coordinate_m: npt.ArrayLike, per_m: float, first: int, count: int) -> Index:
    """1..count for the cells of a side, 0 or count + 1 beyond it, 0 for NaN."""
    place = np.array(coordinate_m, dtype=np.float64)  # a copy, that is worked on in place
    place *= per_m
    np.floor(place, out=place)
    place -= first - 1
    np.fmax(place, 0.0, out=place)
    np.fmin(place, count + 1.0, out=place)
    return place.astype(np.intp)


def _distance_cells(other: Bool) -> Float32:
    """Of each cell to the nearest one that is False, in cells; inf when there is none."""
    import cv2  # exact, and fifteen times as fast as SciPy's

    if other.all():
        return np.full(other.shape, np.inf, dtype=np.float32)
    found: Any = cv2.distanceTransform(other.view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(found, dtype=np.float32)


def _costs_of(blocks: MapBlocks, curve: CostCurve) -> UInt8:
    """The costs of the cells with a border, block by block: what decides them takes more bytes than
    they do."""
    window = blocks.window
    width, height = blocks.window.width, blocks.window.height
    if width * height > MAX_CELLS or max(width, height) > MAX_SIDE:
        raise ConfigError(
            f"A costmap of {width} x {height} cells of {blocks.lattice.cell_m} m is over "
            f"{MAX_CELLS / 1e6:.0f} million cells or {MAX_SIDE} along a side; give smaller bounds "
            "or a larger cell."
        )
    costs = np.full((window.height + 2, window.width + 2), UNKNOWN_COST, np.uint8)
    inside = costs[1:-1, 1:-1]
    for view in blocks.views:
        decided = view.decision(curve.least_drop_m)
        inside[window.slices_of(view.window)] = curve.cost(*decided)
    return costs


def _inflate(costs: UInt8, distances: _Distances, inflation: Inflation, lattice: Lattice) -> None:
    """Raise the costs of known cells near obstacles, in place, some rows at a time."""
    radius_m = inflation.robot_radius_m
    inscribed = radius_m * lattice.cells_per_m * _ROUNDING
    reach = max(inflation.inflation_m * lattice.cells_per_m * _ROUNDING, inscribed)
    if reach < 1.0:
        return
    to_obstacle = distances.to(LETHAL)
    count = max(1, _BLOCK_CELLS // costs.shape[1])
    for first in range(0, costs.shape[0], count):
        rows = slice(first, first + count)
        cost, distance = costs[rows], to_obstacle[rows]
        near = (distance <= reach) & (cost < LETHAL)
        cells = distance[near].astype(np.float64)
        beyond_m = np.maximum(cells * lattice.cell_m - radius_m, 0.0)
        inflated = ((INSCRIBED - 1) * np.exp(-inflation.decay_per_m * beyond_m)).astype(np.uint8)
        inflated[cells <= inscribed] = INSCRIBED
        cost[near] = np.maximum(cost[near], inflated)
