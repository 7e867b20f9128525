"""Where a vehicle may be: seen free ground, and how far it is to what is not."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import shapely

from fieldgrid.core import ConfigError, Float32, Float64, UInt8
from fieldgrid.field.route.vehicle import Vehicle
from fieldgrid.maps import LETHAL, UNKNOWN_COST, CostCurve, MapView, decision

FREE, OBSTACLE, UNSEEN, BEYOND, KEEPOUT, OUTSIDE, STEEP = 0, 1, 2, 3, 4, 5, 6
"""Classes of cells; `BEYOND` is outside the lane that a vehicle is confined to, `OUTSIDE` outside
the boundary of a field, `STEEP` too steep whichever way the vehicle heads."""

SLOPE_LAYERS = ("slope", "aspect")
"""What tells how the ground leans under a vehicle."""

_LEVEL = math.tan(math.radians(0.4))
"""What all slopes under a vehicle are off together: their error on the rendered drives where the
slopes are alike. They are off alone by what they scatter, one for each patch of `_PATCH_M` in which
frames follow the ground."""

_PATCH_M = 0.5
_LEAST_KNOWN = 0.5
"""Below this share of the ground under a vehicle with a slope nothing is told."""

MAX_CELLS = 100_000_000
MAX_SIDE = 40_000
"""Cells along a side, for whose squares the distance transform has room."""

_FEW_CELLS = 4
"""Obstacle cells that touch each other and are no more than these stand alone."""

_NAMES = {
    OBSTACLE: "an obstacle",
    UNSEEN: "ground that was not seen",
    BEYOND: "the side of the lane",
    KEEPOUT: "a keep-out mark",
    OUTSIDE: "the boundary",
}
"""What blocks a cell, in words."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Classes of the cells of a window [rows north, columns east], row 0 in the south, with their
    south-west corner and side in metres.

    `blocked` is 1 where a vehicle must not be. `to_blocked_m` is at most the distance from any
    point of a cell to the nearest blocked cell. `density` is the highest of the map's own cells in
    each, 255 where a mark says that there is an obstacle; above `obstacle_above` it is one.
    `rises` [rows, columns, 2] are metres a metre to east and north of the ground that a vehicle
    covers with its middle in a cell, less their sigma, 0 where not known; empty where no slope
    matters.
    """

    west_m: float
    south_m: float
    cell_m: float
    cells: UInt8
    blocked: UInt8
    to_blocked_m: Float32
    density: UInt8
    obstacle_above: int
    rises: Float32

    @classmethod
    def of(
        cls,
        view: MapView,
        curve: CostCurve,
        vehicle: Vehicle,
        *,
        allow_unknown: bool,
        margin_m: float,
    ) -> Ground:
        """The ground of a view for a vehicle, decided as a costmap decides, with `margin_m` of
        unseen cells around it, but for what is marked there. Drops that the vehicle does not take
        are obstacles. Unseen cells are blocked but for `allow_unknown`, and but for those within
        the clearance of what was seen: a footprint that keeps so far from the others keeps off
        unseen ground, but for its pinholes. The view has `SLOPE_LAYERS`, or no slope matters.
        Raises ConfigError for more than 100 million cells, or 40000 along a side."""
        cell_m = 1.0 / view.lattice.cells_per_m
        margin = math.ceil(margin_m / cell_m)
        height, width = view.density.shape
        rows, columns = height + 2 * margin, width + 2 * margin
        if rows * columns > MAX_CELLS or max(rows, columns) > MAX_SIDE:
            raise ConfigError(
                f"A route over {columns} x {rows} cells of {cell_m:g} m is over "
                f"{MAX_CELLS / 1e6:.0f} million cells or {MAX_SIDE} along a side; give smaller "
                "--bounds or a larger --cell."
            )
        cells = np.full((rows, columns), UNSEEN, dtype=np.uint8)
        density = np.zeros_like(cells)
        inside = np.s_[margin : margin + height, margin : margin + width]
        inner = cells[inside]
        classes = np.full(256, FREE, dtype=np.uint8)
        classes[LETHAL], classes[UNKNOWN_COST] = OBSTACLE, UNSEEN
        worst, share, keepout = view.decision(vehicle.step_m)
        inner[:] = classes[curve.cost(worst, share)]
        density[inside] = worst
        if view.marks:
            said = decision.marked_cells(view.marks, view.lattice, view.window.grown(margin))
            marked = (said & decision.OBSTACLE) > 0
            cells[marked], density[marked] = OBSTACLE, 255
            cells[(said & decision.KEEPOUT) > 0] = KEEPOUT
        if keepout is not None:
            inner[keepout] = KEEPOUT
        rises = _rises(view, vehicle, margin)
        if rises.size:
            too_steep = np.hypot(*rises.transpose(2, 0, 1)) > math.hypot(*vehicle.most_rises)
            cells[too_steep & (cells != OBSTACLE) & (cells != KEEPOUT)] = STEEP
        blocked = cells != FREE
        unseen = (cells == UNSEEN).astype(np.uint8)
        if allow_unknown:
            blocked &= unseen == 0
        elif not unseen.all():
            depth = cv2.distanceTransform(unseen, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            blocked[(unseen > 0) & (depth * cell_m <= vehicle.clearance_m + 1e-6)] = False
        bounds = view.bounds
        return cls(
            bounds.west_m - margin * cell_m, bounds.south_m - margin * cell_m, cell_m, cells,
            blocked.view(np.uint8), _to_blocked_m(blocked.view(np.uint8), cell_m),
            density, curve.obstacle_above, rises,
        )  # fmt: skip

    def confined(self, area: shapely.Geometry, beyond: int = BEYOND) -> Ground:
        """The part of it whose cells have their middles inside an area (metres east and north);
        all else is blocked, and of the class `beyond` where it was free."""
        west, south, east, north = shapely.bounds(area)
        height, width = self.blocked.shape
        (j0, i0), (j1, i1) = self._cell(west, south), self._cell(east, north)
        j0, i0 = min(max(j0 - 1, 0), height - 1), min(max(i0 - 1, 0), width - 1)
        part = np.s_[j0 : max(j1 + 2, j0 + 1), i0 : max(i1 + 2, i0 + 1)]
        cells = self.cells[part].copy()
        corner_e, corner_n = self.west_m + i0 * self.cell_m, self.south_m + j0 * self.cell_m
        rows, columns = cells.shape
        inside = shapely.contains_xy(
            area,
            (corner_e + (np.arange(columns) + 0.5) * self.cell_m)[None, :],
            (corner_n + (np.arange(rows) + 0.5) * self.cell_m)[:, None],
        )
        cells[~inside & (self.blocked[part] == 0)] = beyond
        blocked = (~inside).view(np.uint8) | self.blocked[part]
        to_blocked = _to_blocked_m(blocked, self.cell_m)
        return Ground(
            corner_e, corner_n, self.cell_m, cells, blocked, to_blocked,
            self.density[part], self.obstacle_above, np.ascontiguousarray(self.rises[part]),
        )  # fmt: skip

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """West, south, east, north of the window."""
        height, width = self.blocked.shape
        return (
            self.west_m, self.south_m,
            self.west_m + width * self.cell_m, self.south_m + height * self.cell_m,
        )  # fmt: skip

    def blocked_boxes(
        self, west_m: float, south_m: float, east_m: float, north_m: float
    ) -> Float64:
        """West, south, east, north [n, 4] in metres of the blocked cells that meet a box."""
        j0, i0 = self._cell(west_m, south_m)
        j1, i1 = self._cell(east_m, north_m)
        j0, i0 = max(j0, 0), max(i0, 0)
        j, i = np.nonzero(self.blocked[j0 : max(j1 + 1, 0), i0 : max(i1 + 1, 0)])
        x, y = self.west_m + (i + i0) * self.cell_m, self.south_m + (j + j0) * self.cell_m
        return np.column_stack([x, y, x + self.cell_m, y + self.cell_m])

    def nearest_blocked(self, east_m: float, north_m: float) -> tuple[float, float]:
        """The middle of the blocked cell that is nearest to a point, metres east and north; the
        point itself where none is."""
        j, i = np.nonzero(self.blocked)
        if not len(j):
            return east_m, north_m
        x, y = self.west_m + (i + 0.5) * self.cell_m, self.south_m + (j + 0.5) * self.cell_m
        k = int(np.argmin((x - east_m) ** 2 + (y - north_m) ** 2))
        return float(x[k]), float(y[k])

    def without_weak(self) -> Ground:
        """The ground as if nothing stood in its weak obstacle cells that stand alone, few
        together."""
        obstacle = (self.cells == OBSTACLE).view(np.uint8)
        _, label, found, _ = cv2.connectedComponentsWithStats(obstacle, connectivity=8)
        alone = found[label, cv2.CC_STAT_AREA] <= _FEW_CELLS
        weak = (obstacle > 0) & alone & (self.density <= (self.obstacle_above + 255) // 2)
        blocked = np.where(weak, np.uint8(0), self.blocked)
        return replace(self, blocked=blocked, to_blocked_m=_to_blocked_m(blocked, self.cell_m))

    @property
    def level(self) -> Ground:
        """It as if no slope mattered."""
        return replace(self, rises=self.rises[:0, :0])

    @property
    def is_unseen_blocked(self) -> bool:
        """Whether ground that was not seen is in the way."""
        return bool(((self.cells == UNSEEN) & (self.blocked > 0)).any())

    def what_is_at(self, east_m: float, north_m: float) -> str:
        """What blocks the blocked cell that encloses a point, in words."""
        place = self._cell(east_m, north_m)
        if self.cells[place] == STEEP:
            return f"a slope of {math.degrees(math.atan(math.hypot(*self.rises[place]))):.1f}°"
        return _NAMES[int(self.cells[place])]

    def is_marked(self, east_m: float, north_m: float) -> bool:
        """Whether a keep-out mark blocks the cell that encloses a point, which may be anywhere."""
        row, column = self._cell(east_m, north_m)
        inside = 0 <= row < self.cells.shape[0] and 0 <= column < self.cells.shape[1]
        return inside and bool(self.cells[row, column] == KEEPOUT)

    def _cell(self, east_m: float, north_m: float) -> tuple[int, int]:
        return (
            math.floor((north_m - self.south_m) / self.cell_m),
            math.floor((east_m - self.west_m) / self.cell_m),
        )


def _rises(view: MapView, vehicle: Vehicle, margin: int) -> Float32:
    """`Ground.rises` of a view, with some cells around it: means over a disc as large as what the
    vehicle covers, less their sigma, so that neither noise nor doubt makes level ground steep."""
    slope_deg = view.layers.get("slope", np.zeros((0, 0), dtype=np.float32))
    most_deg = min(vehicle.slope_along_deg, vehicle.slope_across_deg)
    if not np.fmax.reduce(slope_deg, axis=None, initial=0.0) > most_deg:
        return np.zeros((0, 0, 2), dtype=np.float32)
    rise, falls = np.tan(np.radians(slope_deg)), np.radians(view.layer("aspect"))
    known = np.isfinite(rise).astype(np.float32)
    to = np.nan_to_num(np.stack([-rise * np.sin(falls), -rise * np.cos(falls)]))
    area_m2 = float(shapely.Polygon(vehicle.footprint()).area)
    reach = math.sqrt(area_m2 / math.pi) * view.lattice.cells_per_m
    side = np.arange(-math.floor(reach), math.floor(reach) + 1)
    disc = (np.hypot(side, side[:, None]) <= reach).astype(np.float32)
    disc /= disc.sum()

    def over_disc(values: Float32) -> Float32:
        return np.asarray(cv2.filter2D(values, cv2.CV_32F, disc, borderType=cv2.BORDER_CONSTANT))

    share = over_disc(known)
    mean = np.stack([over_disc(one) for one in to]) / np.maximum(share, 1e-6)
    squares = over_disc(np.square(to).sum(axis=0)) / np.maximum(share, 1e-6)
    scatter = 0.5 * np.maximum(squares - np.square(mean).sum(axis=0), 0.0)
    patches = np.maximum(share * area_m2 / _PATCH_M**2, 1.0)
    size, sigma = np.hypot(*mean), np.sqrt(_LEVEL**2 + scatter / patches)
    sure = np.maximum(1.0 - sigma / np.maximum(size, 1e-6), 0.0)
    sure[share < _LEAST_KNOWN] = 0.0
    rises = np.moveaxis(mean * sure, 0, 2).astype(np.float32)
    return np.pad(rises, ((margin, margin), (margin, margin), (0, 0)))


def _to_blocked_m(blocked: UInt8, cell_m: float) -> Float32:
    """From anywhere in a cell to the nearest blocked one, never too far, metres."""
    if not blocked.any():
        return np.full(blocked.shape, 1e6, dtype=np.float32)
    metres: Float32 = cv2.distanceTransform(1 - blocked, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # From middle to middle; either point may be half a diagonal nearer.
    metres -= np.float32(math.sqrt(2.0))
    np.maximum(metres, 0.0, out=metres)
    metres *= np.float32(cell_m)
    return metres
