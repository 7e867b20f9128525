"""Which ground is worked by tracks, and how they are asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import shapely

from fieldgrid.core import ConfigError, UInt8
from fieldgrid.field.route import ground as cells
from fieldgrid.field.route.search import Searcher
from fieldgrid.field.rows.ground import polygons_of
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import Evidence

MOST_PASSES = 50


@dataclass(frozen=True, slots=True)
class Tracks:
    """Parallel tracks over ground without rows.

    `width_m` is the working width (None for the vehicle's with its implement), of which `overlap_m`
    is worked twice. Tracks are straight with the heading `direction_deg` (None for the one that
    takes the least driving), or run beside `along`: a line in metres of the map, or "edge", the
    longest side of the ground. `boundary` encloses the ground, which is else all that was seen.
    `headland_passes` are driven around it (None for as many as a turn takes).
    """

    width_m: float | None = None
    overlap_m: float = 0.0
    direction_deg: float | None = None
    along: shapely.LineString | Literal["edge"] | None = None
    boundary: shapely.Polygon | None = None
    headland_passes: int | None = None

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("width_m", self.width_m, 0.1, 60.0),
            ("overlap_m", self.overlap_m, 0.0, 30.0),
            ("direction_deg", self.direction_deg, -360.0, 360.0),
            ("headland_passes", self.headland_passes, 0, MOST_PASSES),
        ):
            if value is not None and not (math.isfinite(value) and low <= value <= high):
                raise ConfigError(f"A {name} of tracks of {value} is outside {low:g}..{high:g}.")
        if self.direction_deg is not None and self.along is not None:
            raise ConfigError("Tracks have a direction or run along a line; give one of the two.")
        for what, shape in (("line", self.along), ("boundary", self.boundary)):
            if isinstance(shape, shapely.Geometry) and (shape.is_empty or not shape.is_valid):
                why = "it is empty" if shape.is_empty else shapely.is_valid_reason(shape)
                raise ConfigError(f"The {what} of the tracks is no {what}: {why}; draw it anew.")

    def widths_m(self, work_width_m: float) -> tuple[float, float]:
        """The working width, and the distance between tracks. ConfigError for too much overlap."""
        wide = work_width_m if self.width_m is None else self.width_m
        if self.overlap_m > 0.5 * wide:
            raise ConfigError(
                f"An overlap of {self.overlap_m:g} m is over half of the working width of "
                f"{wide:g} m; give a smaller one."
            )
        return wide, wide - self.overlap_m


def work_area(
    searcher: Searcher, wide_m: float, *, fill_unseen: bool
) -> tuple[list[shapely.Polygon], shapely.Geometry]:
    """For a working width where the reference point may be on a straight way (polygons without
    narrow strips), and all ground that the width reaches from there; metres east and north.

    Ground that was not seen belongs to it only where the vehicle may drive there, and it lies
    inside the seen ground; with `fill_unseen`, wherever it is."""
    ground, vehicle = searcher.ground, searcher.vehicle
    free: UInt8 = 1 - ground.blocked
    if not fill_unseen:
        seen = (ground.cells != cells.UNSEEN).astype(np.uint8)
        outlines, _ = cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        free &= cv2.drawContours(np.zeros_like(seen), outlines, -1, 1, cv2.FILLED)
    half_m = 0.5 * vehicle.work_width_m + vehicle.clearance_m
    depth = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # From middle to middle of cells: half a cell is blocked ground.
    standing = (depth * ground.cell_m >= half_m + 0.5 * ground.cell_m).astype(np.uint8)
    if not standing.any():
        return [], shapely.Polygon()
    away = cv2.distanceTransform(1 - standing, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    reached = ((away * ground.cell_m <= 0.5 * wide_m) & (free > 0)).astype(np.uint8)
    thin_m = 0.25 * wide_m
    shapes = [
        part
        for shape in _polygons(searcher, standing)
        for part in shapely.get_parts(shape.buffer(-thin_m).buffer(thin_m))
        if part.area > 0.0
    ]
    shapes.sort(key=lambda shape: -shape.area)
    return shapes, shapely.union_all(_polygons(searcher, reached))


def _polygons(searcher: Searcher, mask: UInt8) -> list[shapely.Polygon]:
    """The areas of a mask of the ground."""
    ground = searcher.ground
    height, width = mask.shape
    corner = (round(ground.west_m / ground.cell_m), round(ground.south_m / ground.cell_m))
    evidence = Evidence(Lattice(ground.cell_m), Window(*corner, width, height), mask)
    return polygons_of(evidence, mask, ground.cell_m**2)
