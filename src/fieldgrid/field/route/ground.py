"""Where a vehicle may be: seen free ground, and how far it is to what is not."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import shapely

from fieldgrid.core import ConfigError, Float32, Float64, UInt8
from fieldgrid.maps import LETHAL, UNKNOWN_COST, CostCurve, MapView, decision

FREE, OBSTACLE, UNSEEN, BEYOND, KEEPOUT, OUTSIDE = 0, 1, 2, 3, 4, 5
"""Classes of cells; `BEYOND` is outside the lane that a vehicle is confined to, `OUTSIDE` outside
the boundary of a field."""

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
    """

    west_m: float
    south_m: float
    cell_m: float
    cells: UInt8
    blocked: UInt8
    to_blocked_m: Float32
    density: UInt8
    obstacle_above: int

    @classmethod
    def of(
        cls,
        view: MapView,
        curve: CostCurve,
        *,
        allow_unknown: bool,
        margin_m: float,
        clearance_m: float = 0.0,
    ) -> Ground:
        """The ground of a view, decided as a costmap decides, with `margin_m` of unseen cells
        around it, but for what is marked there. Unseen cells are blocked but for `allow_unknown`,
        and but for those within `clearance_m` of what was seen: a footprint that keeps so far from
        the others keeps off unseen ground, but for its pinholes. Raises ConfigError for more than
        100 million cells, or 40000 along a side."""
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
        worst, share, keepout = view.decision(curve.least_drop_m)
        inner[:] = classes[curve.cost(worst, share)]
        density[inside] = worst
        if view.marks:
            said = decision.marked_cells(view.marks, view.lattice, view.window.grown(margin))
            marked = (said & decision.OBSTACLE) > 0
            cells[marked], density[marked] = OBSTACLE, 255
            cells[(said & decision.KEEPOUT) > 0] = KEEPOUT
        if keepout is not None:
            inner[keepout] = KEEPOUT
        blocked = cells != FREE
        unseen = (cells == UNSEEN).astype(np.uint8)
        if allow_unknown:
            blocked &= unseen == 0
        elif not unseen.all():
            depth = cv2.distanceTransform(unseen, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
            blocked[(unseen > 0) & (depth * cell_m <= clearance_m + 1e-6)] = False
        bounds = view.bounds
        return cls(
            bounds.west_m - margin * cell_m, bounds.south_m - margin * cell_m, cell_m, cells,
            blocked.view(np.uint8), _to_blocked_m(blocked.view(np.uint8), cell_m),
            density, curve.obstacle_above,
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
            self.density[part], self.obstacle_above,
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
    def is_unseen_blocked(self) -> bool:
        """Whether ground that was not seen is in the way."""
        return bool(((self.cells == UNSEEN) & (self.blocked > 0)).any())

    def what_is_at(self, east_m: float, north_m: float) -> str:
        """What blocks the blocked cell that encloses a point, in words."""
        return _NAMES[int(self.cells[self._cell(east_m, north_m)])]

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
