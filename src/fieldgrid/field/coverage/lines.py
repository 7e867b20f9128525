"""Which stretches of a line a vehicle can drive, before it does."""

from __future__ import annotations

import math

import numpy as np
import shapely

from fieldgrid.core import Float64
from fieldgrid.field.coverage.passes import followed
from fieldgrid.field.route.search import Searcher
from fieldgrid.field.rows.measuring.extent import runs
from fieldgrid.geometry import lengths, normals, project, resampled

STEP_M = 0.1
_LEAST_M = 1.0
"""A shorter track is not worth its turns."""

STRAIGHT_M = 0.15
"""What bends less is one straight track; `drive_lane` takes it for one, too."""

CURVE_MARGIN_M = 0.2
"""The largest distance of a vehicle from a curve that it follows."""

MOST_TURN = 0.95
"""Radians in a turning radius of way: a curve that turns more is cut there."""


class DrivableLines:
    """What of a line a vehicle can drive on its ground, that works a width."""

    def __init__(self, searcher: Searcher, wide_m: float) -> None:
        self._searcher, self._wide_m = searcher, wide_m

    @property
    def gap_m(self) -> float:
        """What two parts of a curve leave between them, so that one can be driven after the
        other."""
        return max(1.0, 0.5 * self._searcher.vehicle.turning_radius_m)

    def free_parts(
        self, line: Float64, margin_m: float, within: shapely.Polygon | None = None
    ) -> list[Float64]:
        """The stretches of a line along which the vehicle fits, forward or back, with a margin;
        of them those where the working width meets `within`."""
        searcher = self._searcher
        ground, least_m = searcher.ground, searcher.shape.clearance_m + margin_m
        points = resampled(line, STEP_M)
        left = normals(points)
        wanted = np.ones(len(points), dtype=np.bool_)
        if within is not None:
            across = (0.5 * self._wide_m - 0.02) * left
            ends = np.stack([points - across, points + across], axis=1)
            wanted = shapely.intersects(within, shapely.linestrings(ends))
        if len(line) > 2:
            wanted &= np.abs(turns(points, searcher.vehicle.turning_radius_m)) <= MOST_TURN
        places = np.flatnonzero(wanted)
        yaw = np.arctan2(-left[places, 0], left[places, 1])
        inner = points[places] - (ground.west_m, ground.south_m)
        free = np.zeros(len(places), dtype=np.bool_)
        for turned in (0.0, math.pi):
            free |= searcher.gaps_m(np.column_stack([inner, yaw + turned]), least_m) >= least_m
        wanted[places] = free
        found = []
        for first, last in runs(wanted):
            if not searcher.vehicle.reverse:
                first, last = self._with_ways_out(points, first, last)
            if (last - first - 1) * STEP_M < _LEAST_M:
                continue
            part = points[first:last]
            found += [part[[0, -1]]] if len(line) == 2 else self._followable(resampled(part, 0.5))
        return found

    def _with_ways_out(self, points: Float64, first: int, last: int) -> tuple[int, int]:
        """The stretch of a line, shortened to where a vehicle that cannot reverse may turn away at
        either end."""
        if last - first < 3:
            return first, first
        ends = []
        for stretch in (points[first:last], points[first:last][::-1]):
            left = normals(stretch)
            corner = (self._searcher.ground.west_m, self._searcher.ground.south_m)
            poses = np.column_stack([stretch - corner, np.arctan2(-left[:, 0], left[:, 1])])
            # From the end inwards; most have room at once.
            ends.append(next((k for k in range(len(poses)) if self._turns_away(poses[-1 - k])),
                             len(poses)))  # fmt: skip
        return (first + ends[1], last - ends[0]) if sum(ends) < last - first else (first, first)

    def _turns_away(self, pose: Float64) -> bool:
        """Whether a quarter of a circle to the left or to the right is free."""
        searcher = self._searcher
        radius, (x, y, yaw) = searcher.vehicle.turning_radius_m, pose.tolist()
        turn = np.arange(0.0, 0.5 * math.pi, searcher.shape.step_m / radius)
        for side in (1.0, -1.0):
            turned = yaw + side * turn
            east = x + side * radius * (np.sin(turned) - math.sin(yaw))
            north = y + side * radius * (math.cos(yaw) - np.cos(turned))
            if searcher.is_free(np.column_stack([east, north, turned])).all():
                return True
        return False

    def _followable(self, curve: Float64) -> list[Float64]:
        """The parts of a free curve that a vehicle can keep to; straight ones at last."""
        corner = (self._searcher.ground.west_m, self._searcher.ground.south_m)
        if len(curve) < 2 or lengths(curve)[-1] < _LEAST_M:
            return []
        if np.abs(project(curve, curve[[0, -1]])[1]).max() <= STRAIGHT_M:
            return self.free_parts(curve[[0, -1]], 0.0)
        for way in (curve, curve[::-1]):
            samples = followed(self._searcher, way - corner)
            if len(samples):
                aside = project(samples[:, :2] + corner, way)[1]
                if np.abs(aside).max() <= CURVE_MARGIN_M:
                    return [curve]
        half, gap = len(curve) // 2, math.ceil(self.gap_m / 0.5)
        return self._followable(curve[: max(half + 1 - gap, 1)]) + self._followable(curve[half:])


def turns(line: Float64, radius_m: float) -> Float64:
    """By how much a line of equal steps turns around each of its points, within a radius of way,
    radians to the left."""
    half = max(1, round(0.5 * radius_m / STEP_M))
    chord = min(half, round(0.5 / STEP_M))
    heading = np.unwrap(np.arctan2(*(_shifted(line, chord) - _shifted(line, -chord)).T[::-1]))
    return _shifted(heading, half) - _shifted(heading, -half)


def _shifted(values: Float64, by: int) -> Float64:
    """The values `by` places later; the first or the last one where there is none."""
    places = np.clip(np.arange(len(values)) + by, 0, len(values) - 1)
    return np.asarray(values[places])
