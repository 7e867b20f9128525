"""Tracks side by side over ground without rows, and passes around it and around obstacles.

All of them are lanes, so that they are driven, ordered and checked as lanes between rows are. Lines
come from polygons; which parts of them are kept is decided by the footprint, pose by pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import shapely
from shapely import affinity

from fieldgrid.core import ConfigError, Float64, NoRouteError
from fieldgrid.field.coverage.area import MOST_PASSES, Tracks, work_area
from fieldgrid.field.coverage.lines import (
    CURVE_MARGIN_M,
    MOST_TURN,
    STEP_M,
    STRAIGHT_M,
    DrivableLines,
    turns,
)
from fieldgrid.field.route.search import Searcher
from fieldgrid.field.rows.measuring.extent import runs
from fieldgrid.field.rows.result import Block, Headland, Lane, Obstacle, Planting
from fieldgrid.geometry import Bounds, Datum, extended, lengths, normals, project, resampled

_CORNER = 0.5
"""Radians in a turning radius of way: an outline is cut at a corner that turns more, where the
vehicle may reverse out of it."""

_SHIFTS_M = (-0.1, 0.0, 0.1, 0.2, 0.3, 0.4)
"""Away from what is blocked, of a straight pass beside it: the first that is free nearly all along
is taken, since an outline follows cells."""

_ENOUGH = 0.97
_EVERY_DEG = 10.0
_MOST_LINES = 2000


class TrackLayout(NamedTuple):
    """Tracks as the lanes of a planting; the ground inside the headland passes; all ground that the
    working width reaches; the width."""

    planting: Planting
    inner: shapely.Geometry
    reachable: shapely.Geometry
    wide_m: float


def lay_tracks(
    searcher: Searcher, asked: Tracks, datum: Datum, bounds: Bounds, *, fill_unseen: bool
) -> TrackLayout:
    """Tracks over the ground of a searcher. Raises NoRouteError where there is no room for one,
    ConfigError for too many."""
    vehicle = searcher.vehicle
    wide_m, step_m = asked.widths_m(vehicle.work_width_m)
    places, reachable = work_area(searcher, wide_m, fill_unseen=fill_unseen)
    lanes: list[Lane] = []
    blocks: list[Block] = []
    headlands: list[Headland] = []
    things: list[Obstacle] = []
    inners = []
    for standing in places:
        name = f"F{len(blocks) + 1}"
        field = _TrackField(searcher, asked, wide_m, step_m, name, standing)
        mine = field.lanes()
        if not mine:
            continue
        ground = reachable.intersection(standing.buffer(0.5 * wide_m + searcher.ground.cell_m))
        lanes += mine
        things += field.obstacles()
        inners.append(field.inner)
        blocks.append(Block(name, ground, 0, len(mine), field.heading_deg, step_m))
        around = ground.difference(field.inner)
        headlands.append(Headland(f"{name}-H", name, "both", around, float(around.area)))
    if not lanes:
        bounds_m = searcher.ground.bounds_m
        raise NoRouteError(
            f"There is no room for a track {wide_m:g} m wide that a vehicle "
            f"{vehicle.work_width_m:g} m wide and {vehicle.front_m + vehicle.rear_m:g} m long can "
            "drive",
            0.5 * (bounds_m[0] + bounds_m[2]), 0.5 * (bounds_m[1] + bounds_m[3]),
            "give another boundary or a smaller vehicle, or where the ground is known to be free, "
            "--allow-unknown",
        )  # fmt: skip
    planting = Planting(
        datum, bounds, searcher.ground.cell_m, (), tuple(lanes), (), tuple(headlands),
        tuple(blocks), tuple(things),
    )  # fmt: skip
    return TrackLayout(planting, shapely.union_all(inners), reachable, wide_m)


class _TrackField:
    """One piece of ground, where the reference point may be."""

    def __init__(
        self,
        searcher: Searcher,
        asked: Tracks,
        wide_m: float,
        step_m: float,
        name: str,
        standing: shapely.Polygon,
    ) -> None:
        self.searcher, self.asked, self.name = searcher, asked, name
        self.wide_m, self.step_m = wide_m, step_m
        self._drivable = DrivableLines(searcher, wide_m)
        vehicle = searcher.vehicle
        # Where the width reaches farther than the vehicle, its edge keeps to the ground.
        self._inset = max(0.5 * (wide_m - vehicle.work_width_m) - vehicle.clearance_m, 0.0)
        self._shell = shapely.Polygon(standing.exterior).buffer(-self._inset)
        self._holes = [shapely.Polygon(ring).buffer(self._inset) for ring in standing.interiors]
        passes = asked.headland_passes
        if passes is None:
            turn = math.hypot(vehicle.turning_radius_m + 0.5 * vehicle.work_width_m,
                              vehicle.front_m) + vehicle.clearance_m  # fmt: skip
            passes = min(math.ceil(turn / step_m), MOST_PASSES)
            while passes > 1 and self._inside(passes).is_empty:
                passes -= 1
        self.passes = passes
        self.inner = self._inside(passes)
        self.heading_deg = math.nan

    def obstacles(self) -> list[Obstacle]:
        """What stands in the ground, or was not seen, to a cell outside of its edge."""
        vehicle, cell_m = self.searcher.vehicle, self.searcher.ground.cell_m
        back_m = 0.5 * vehicle.work_width_m + vehicle.clearance_m + self._inset - cell_m
        shapes = [hole.buffer(-max(back_m, 0.0)) for hole in self._holes]
        return [
            Obstacle(f"{self.name}-O{k}", "", "", shape, float(shape.area))
            for k, shape in enumerate(shapes, 1)
        ]

    def _inside(self, passes: int) -> shapely.Geometry:
        """The ground that remains inside this number of headland passes."""
        if not passes:
            grown = 0.5 * self.wide_m
            holes = shapely.union_all([hole.buffer(-grown) for hole in self._holes])
            return self._shell.buffer(grown).difference(holes)
        left = self._shell.buffer(0.5 * self.wide_m - passes * self.step_m)
        around = [hole.buffer(self.step_m - 0.5 * self.wide_m) for hole in self._holes]
        return left.difference(shapely.union_all(around))

    def lanes(self) -> list[Lane]:
        """Passes around the ground, passes around obstacles, tracks; from the outside in."""
        found = [
            lane
            for number in range(self.passes)
            for lane in self._sides(
                f"H{number + 1}",
                self._shell.buffer(-number * self.step_m),
                # Counter-clockwise, the ground lies to the left.
                _SHIFTS_M if number == 0 else (0.0,),
            )
        ]
        if self.passes:
            for number, hole in enumerate(self._holes, 1):
                box = hole.minimum_rotated_rectangle
                is_small = hole.area < 4.0 * self.wide_m**2 or box.area < 1.5 * hole.area
                found += self._sides(
                    f"O{number}",
                    box if is_small else hole.simplify(0.25 * self.wide_m),
                    tuple(-shift for shift in _SHIFTS_M),
                )
        return found + list(self._tracks())

    def _sides(self, name: str, shape: shapely.Geometry, shifts: tuple[float, ...]) -> list[Lane]:
        """Passes along the outline of a shape, a side each; counter-clockwise."""
        vehicle, radius = self.searcher.vehicle, self.searcher.vehicle.turning_radius_m
        pieces: list[Float64] = []
        for part in shapely.get_parts(shape):
            if shifts[0] <= 0.0 and not vehicle.reverse:
                # From a corner a vehicle without reverse finds no way out: it drives a curve.
                part = part.buffer(-1.1 * radius).buffer(1.1 * radius)
            for one in shapely.get_parts(shapely.orient_polygons(part)):
                ring = shapely.get_coordinates(one.exterior.simplify(0.5 * STEP_M))
                if len(ring) > 3:
                    pieces += self._around(ring, shifts)
        return [self._lane(f"{name}.{k}", piece) for k, piece in enumerate(pieces, 1)]

    def _around(self, ring: Float64, shifts: tuple[float, ...]) -> list[Float64]:
        """The sides of a closed ring that can be driven."""
        line = resampled(ring, STEP_M)[:-1]
        radius = self.searcher.vehicle.turning_radius_m
        turn = np.abs(turns(np.concatenate([line] * 3), radius)[len(line) : -len(line)])
        cut = int(np.argmax(turn))
        sharp = _CORNER if self.searcher.vehicle.reverse else MOST_TURN
        line, is_gentle = np.roll(line, -cut, axis=0), np.roll(turn, -cut) <= sharp
        found: list[Float64] = []
        for first, last in runs(is_gentle):
            side = line[first:last]
            # A curve that ends where it began would be two things at once.
            half, gap = len(side) // 2, round(self._drivable.gap_m / STEP_M)
            is_ring = len(side) > 0.7 * len(line)
            for piece in (side[gap:half], side[half + gap :]) if is_ring else (side,):
                if len(piece) > 2:
                    found += self._driven(piece, shifts)
        return found

    def _driven(self, side: Float64, shifts: tuple[float, ...]) -> list[Float64]:
        """What of a side is free, by the first of some shifts to its left that leaves nearly all of
        it."""
        line, margin_m = resampled(side, 0.5), CURVE_MARGIN_M
        if np.abs(project(side, side[[0, -1]])[1]).max() <= STRAIGHT_M:
            reach_m = 0.5 * (self.wide_m + self.searcher.vehicle.turning_radius_m)
            line, margin_m = extended(side[[0, -1]], reach_m, reach_m)[[0, -1]], 0.0
        best: list[Float64] = []
        most = 0.0
        for shift in shifts:
            parts = self._drivable.free_parts(line + shift * normals(line), margin_m)
            size = sum(float(lengths(part)[-1]) for part in parts)
            if size * _ENOUGH > most:
                best, most = parts, size
        return best

    def _tracks(self) -> Iterator[Lane]:
        """Tracks over the ground inside the headland passes, from left to right."""
        number = 0
        for part in shapely.get_parts(self.inner):
            if part.area < 0.1 * self.wide_m**2:
                continue
            shapely.prepare(part)
            for line in self._lines(part):
                margin_m = 0.0 if len(line) == 2 else CURVE_MARGIN_M
                pieces = self._drivable.free_parts(line, margin_m, part)
                number += bool(pieces)
                for k, piece in enumerate(pieces, 1):
                    yield self._lane(f"T{number}" + (f".{k}" if len(pieces) > 1 else ""), piece)

    def _lines(self, part: shapely.Polygon) -> Iterator[Float64]:
        """Lines beside each other that cover a part, and reach beyond it."""
        corners = shapely.get_coordinates(part)
        reach_m = float(np.hypot(*np.ptp(corners, axis=0))) + self.wide_m
        base = self._guide()
        if base is None:
            if math.isnan(self.heading_deg):
                asked = self.asked.direction_deg
                self.heading_deg = self._best_heading() if asked is None else asked % 360.0
            along = np.array(
                [math.sin(math.radians(self.heading_deg)), math.cos(math.radians(self.heading_deg))]
            )
            middle = corners.mean(axis=0)
            base = np.array([middle - reach_m * along, middle + reach_m * along])
        else:
            out = base[-1] - base[0]
            self.heading_deg = math.degrees(math.atan2(out[0], out[1])) % 360.0
            base = extended(base, reach_m, reach_m)
        line = shapely.LineString(base)
        if len(base) > 2:
            # Tracks beside a curve keep their distance from it, wherever the ground begins.
            left = project(corners, base)[1]
            first, last = (math.ceil(v / self.step_m - 0.5) for v in (left.max(), left.min()))
            shifts = self.step_m * np.arange(first, last - 1, -1)
        else:
            shifts = _spaced(project(corners, base)[1], self.wide_m, self.step_m)
        if len(shifts) > _MOST_LINES:
            raise ConfigError(
                f"The ground takes {len(shifts)} tracks, more than {_MOST_LINES}; give a larger "
                "working width or smaller --bounds."
            )
        for shift in shifts.tolist():
            beside = shapely.offset_curve(line, shift, quad_segs=16) if shift else line
            for one in shapely.get_parts(beside):
                found = shapely.get_coordinates(one)
                if len(found) > 1:
                    yield found

    def _guide(self) -> Float64 | None:
        """The line beside which tracks run, straight where it hardly bends."""
        along = self.asked.along
        if along is None:
            return None
        if isinstance(along, shapely.LineString):
            line = shapely.get_coordinates(along)
        else:
            sides = self._sides("", self._shell, (0.0,))
            if not sides:
                return None
            line = shapely.get_coordinates(max(sides, key=lambda side: side.length_m).line)
        is_straight = np.abs(project(line, line[[0, -1]])[1]).max() <= STRAIGHT_M
        return line[[0, -1]] if is_straight else resampled(line, 0.5)

    def _best_heading(self) -> float:
        """The heading of straight tracks that take the least driving, half a circle of turn for
        each of them included."""
        shape = self.inner.simplify(0.5 * self.step_m)
        corners = shapely.get_coordinates(shape.convex_hull)
        edges = np.degrees(np.arctan2(*np.diff(corners, axis=0).T))
        turn_m = math.pi * self.searcher.vehicle.turning_radius_m + self.wide_m
        best, least = 0.0, math.inf
        for heading in [*edges.tolist(), *np.arange(0.0, 180.0, _EVERY_DEG).tolist()]:
            # Turned so that tracks with this heading run north.
            turned = affinity.rotate(shape, heading, origin=(0.0, 0.0))
            west, south, east, north = turned.bounds
            east_m = 0.5 * (west + east) - _spaced(
                np.array([west, east]) - 0.5 * (west + east), self.wide_m, self.step_m
            )
            ends = np.array([[[x, south - 1.0], [x, north + 1.0]] for x in east_m])
            parts = shapely.get_parts(shapely.intersection(turned, shapely.linestrings(ends)))
            cost = float(shapely.length(parts).sum()) + turn_m * len(parts)
            if cost < least - 1e-6:
                best, least = heading, cost
        return best % 180.0

    def _lane(self, name: str, line: Float64) -> Lane:
        shape = shapely.LineString(line)
        area = shape.buffer(0.5 * self.wide_m, cap_style="flat", join_style="mitre")
        return Lane(
            f"{self.name}-{name}", self.name, ("", ""), shape, area, float(shape.length),
            math.nan, np.zeros(0), 1.0, False,
        )  # fmt: skip


def _spaced(left_m: Float64, wide_m: float, step_m: float) -> Float64:
    """How far to the left tracks lie that cover all between the least and the largest of some
    distances, the largest first; as far from each other as can be, up to a step."""
    low, high = float(left_m.min()), float(left_m.max())
    if high - low <= wide_m:
        return np.array([0.5 * (low + high)])
    count = math.ceil((high - low - wide_m) / step_m - 1e-9) + 1
    return np.linspace(high - 0.5 * wide_m, low + 0.5 * wide_m, count)
