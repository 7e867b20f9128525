"""From pose to pose: a curve of Dubins or of Reeds and Shepp where one is free, else a search.

The search is hybrid A* (Dolgov, D. et al. (2010), International Journal of Robotics Research 29,
485-501): states are poses, cells of a lattice of poses keep the best one that reached them, moves
are arcs that the vehicle can drive, and from time to time a curve to the goal is tried. The
estimate of what is left is the way that a disc inside the vehicle would have around what is
blocked. At last curves replace the stretches of the way that they shorten.
"""

from __future__ import annotations

import itertools
import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float32, Float64, Int64, UInt8
from fieldgrid.field.route.astar import (
    COUNT,
    CUSP_M,
    ESTIMATE,
    MOVES,
    NEAREST,
    PARENT,
    QUEUED,
    REVERSE_COST,
    TRIES,
    expand,
    first_free_word,
    spread,
)
from fieldgrid.field.route.footprint import CURVATURES, STANDING, Shape, gaps_m
from fieldgrid.field.route.ground import Ground
from fieldgrid.field.route.path import joined
from fieldgrid.field.route.vehicle import Vehicle
from fieldgrid.geometry import Word, words

MAX_STATES = 300_000
_MAX_SAMPLES = 50_000
_COARSE_M = 0.5
_COARSE_CELLS = 1_200_000
_EIGHT_WAYS = 2.0 * math.sqrt(2.0 - math.sqrt(2.0)) / math.sqrt(2.0)
_WORTH_M = 0.05
"""A shorter saving is no reason to change a way."""

_LONGEST_WORD = 30.0
"""Turning radii by which the length of a curve is at most above the distance of its ends: a few
whole circles."""

_BLOCKED_COST = 1000.0
"""What a metre through what is blocked is worth, where the question is what is in the way."""


class SearchPose(NamedTuple):
    """Metres from the window's corner, yaw in radians counter-clockwise from east."""

    x: float
    y: float
    yaw: float


class SearchResult(NamedTuple):
    """What a search found: rows of x, y, yaw, gear, curvature, none where there is no way.

    `nearest` is the pose that came nearest to the goal, `exhausted` says that every pose of the
    lattice was tried, and `tried_m` where they are [n, 2], of a search that found nothing."""

    samples: Float64
    nearest: SearchPose
    exhausted: bool
    tried_m: Float64


class Searcher:
    """Searches on one ground for one vehicle; it keeps what they share."""

    def __init__(self, ground: Ground, vehicle: Vehicle) -> None:
        self.ground, self.vehicle, self.shape = ground, vehicle, Shape.of(vehicle)
        shape = self.shape
        limits = np.array([*vehicle.most_rises, vehicle.middle_m])
        self._ground = (ground.blocked, ground.to_blocked_m, ground.cell_m, ground.rises, limits)
        self._step = (shape.step_m, shape.hulls, shape.discs, shape.clearance_m, *self._ground)
        self._samples = np.zeros((_MAX_SAMPLES, 5))
        self._lattice = min(max(0.15 * vehicle.turning_radius_m, 0.15), 0.5)
        self._move_m = 1.6 * self._lattice

    def gaps_m(self, poses: Float64, reach_m: float) -> Float64:
        """From the footprint to the nearest blocked cell, in poses [n, 3]: lower bounds above
        `reach_m`, and negative beyond the window and where the ground is too steep."""
        gaps = np.empty(len(poses))
        hull, discs = self.shape.hulls[STANDING], self.shape.discs[STANDING]
        gaps_m(np.ascontiguousarray(poses), hull, discs, float(reach_m), *self._ground, gaps)
        return gaps

    def is_free(self, poses: Float64) -> Bool:
        """Whether the vehicle may stand in poses [n, 3]."""
        return np.asarray(self.gaps_m(poses, self.shape.clearance_m) >= self.shape.clearance_m)

    def curve(self, start: SearchPose, goal: SearchPose, longest_m: float = math.inf) -> Float64:
        """The cheapest free curve from pose to pose that costs less than `longest_m`, as rows of x,
        y, yaw, gear, curvature; no rows when none is free."""
        radius = self.vehicle.turning_radius_m
        cos, sin = math.cos(start.yaw), math.sin(start.yaw)
        dx, dy = (goal.x - start.x) / radius, (goal.y - start.y) / radius
        found = words(
            dx * cos + dy * sin, dy * cos - dx * sin, goal.yaw - start.yaw,
            reverse=self.vehicle.reverse,
        )  # fmt: skip
        costs = sorted((radius * _word_cost(word, CUSP_M / radius), word) for word in found)
        tried = [word for cost, word in costs if cost < longest_m]
        if not tried:
            return self._samples[:0]
        segments = np.zeros((len(tried), 5, 2))
        for row, word in zip(segments, tried, strict=True):
            row[: len(word)] = word
        count = first_free_word(
            segments[:, :, 0] / radius, segments[:, :, 1] * radius, *start, *self._step,
            self._samples,
        )  # fmt: skip
        samples = self._samples[:count].copy()
        if count:  # segments of less than a micrometre were left out
            samples[-1, :2] = goal[:2]
            samples[-1, 2] += math.remainder(goal.yaw - samples[-1, 2], 2.0 * math.pi)
        return samples

    def search(
        self,
        starts: list[SearchPose],
        goals: list[SearchPose],
        left_m: Float32,
        max_states: int = MAX_STATES,
    ) -> SearchResult:
        """A way from one of the starts to one of the goals, which are free and differ in their
        yaw only; `left_m` is `distance_left` of the goal."""
        bound_m = float(left_m[self.coarse_place(starts[0])])
        direct = self._samples[:0]
        if self._may_be_free(starts[0], goals[0], bound_m):
            direct = self._best_curve(starts, goals)
        if len(direct) and driven_cost(direct) <= 1.05 * bound_m:
            return SearchResult(direct, goals[0], False, direct[:0, :2])
        states, links = np.zeros((max_states, 5)), np.empty((max_states, 2), dtype=np.int64)
        heap, places = np.zeros(max_states), np.empty(max_states, dtype=np.int64)
        table = np.full((1 << (4 * max_states).bit_length(), 2), -1, dtype=np.int64)
        counters, tried_at = np.zeros(4, dtype=np.int64), np.array([np.inf])
        states[: len(starts), :3], states[: len(starts), ESTIMATE] = starts, bound_m
        links[: len(starts)] = -1
        places[: len(starts)] = np.arange(len(starts))
        counters[[QUEUED, COUNT]] = len(starts)
        here, found = -1, self._samples[:0]
        radius = float(self.vehicle.turning_radius_m)  # one type: compiled once
        while not len(found):
            here = expand(
                np.int64(here), goals[0].x, goals[0].y, np.array([goal.yaw for goal in goals]),
                radius, np.int64(MOVES if self.vehicle.reverse else 5),
                self._move_m, self._arcs, self._lattice, left_m, self._coarse_m,
                *self._step[1:], states, links, heap, places,
                table, counters, tried_at,
            )  # fmt: skip
            if here < 0:
                break
            pose = SearchPose(*states[here, :3].tolist())
            if not self._may_be_free(pose, goals[0], float(left_m[self.coarse_place(pose)])):
                continue
            # A way about is taken for one only when the search has gone on for long.
            longest_m = 1.2 * states[here, ESTIMATE] + radius * (2.0 + counters[TRIES] / 500)
            found = self._best_curve([pose], goals, longest_m)
        ways = [direct] if len(direct) else []
        if len(found):
            way = joined([*self._moves(states, links, here), found])
            ways.append(self._shortened(way, starts, goals, left_m))
        if ways:
            best = min(ways, key=driven_cost)
            return SearchResult(best, goals[0], False, best[:0, :2])
        nearest, tried = states[counters[NEAREST], :3], states[: counters[COUNT], :2].copy()
        return SearchResult(direct, SearchPose(*nearest.tolist()), here == -1, tried)

    def _moves(self, states: Float64, links: Int64, here: int) -> list[Float64]:
        """The moves from a start to a state, as rows of x, y, yaw, gear, curvature."""
        found = []
        while links[here, PARENT] >= 0:
            here, move = links[here].tolist()
            x, y, yaw = states[here, :3].tolist()
            cos, sin = math.cos(yaw), math.sin(yaw)
            way = self._arcs[move].copy()
            ahead, left = way[:, 0].copy(), way[:, 1].copy()
            way[:, 0] = x + ahead * cos - left * sin
            way[:, 1] = y + ahead * sin + left * cos
            way[:, 2] += yaw
            found.append(way)
        return found[::-1]

    @cached_property
    def _arcs(self) -> Float64:
        """Each move from a pose at the corner that faces east, as rows of x, y, yaw, gear,
        curvature [10, n, 5]: all moves are equally long."""
        length, arcs = self._move_m, []
        for move in range(MOVES):
            gear = 1.0 if move < MOVES // 2 else -1.0
            curvature = CURVATURES[move % len(CURVATURES)] * self.vehicle.curvature_1pm
            d = gear * np.linspace(0.0, length, math.ceil(length / self.shape.step_m) + 1)
            turned, same = curvature * d, np.ones(len(d))
            ahead, left = d, 0.0 * d
            if curvature:
                ahead, left = np.sin(turned) / curvature, (1.0 - np.cos(turned)) / curvature
            arcs.append(np.column_stack([ahead, left, turned, gear * same, curvature * same]))
        return np.stack(arcs)

    def _may_be_free(self, start: SearchPose, goal: SearchPose, left_m: float) -> bool:
        """Whether a curve may be free between poses that are `left_m` apart by `distance_left`:
        none is shorter than the way around what is blocked."""
        most_m = math.dist(start[:2], goal[:2]) + _LONGEST_WORD * self.vehicle.turning_radius_m
        return most_m >= self.least_m(left_m)

    def _best_curve(
        self, starts: list[SearchPose], goals: list[SearchPose], longest_m: float = math.inf
    ) -> Float64:
        """The cheapest free curve from one of the starts to one of the goals."""
        best = self._samples[:0]
        for start in starts:
            for goal in goals:
                curve = self.curve(start, goal, longest_m)
                if len(curve):
                    best, longest_m = curve, driven_cost(curve)
        return best

    def _shortened(
        self, samples: Float64, starts: list[SearchPose], goals: list[SearchPose], left_m: Float32
    ) -> Float64:
        """A way with curves in the place of its stretches where that is cheaper."""
        for _ in range(3):
            before, start = driven_cost(samples), 0
            while start < len(samples) - 2:
                start += _is_doubled(samples, start)
                stop = len(samples) - 1
                while stop - start > 4:
                    stop += _is_doubled(samples, stop)
                    ends = [[SearchPose(*samples[k, :3].tolist())] for k in (start, stop)]
                    shorter = self._replaced(
                        samples, start, stop,
                        starts if start == 0 else ends[0],
                        goals if stop == len(samples) - 1 else ends[1],
                        left_m,
                    )  # fmt: skip
                    if shorter is not None:
                        samples = shorter
                        break
                    stop = start + (stop - start) // 2
                start += max(10, (len(samples) - start) // 6)
            if driven_cost(samples) > before - _WORTH_M:
                break
        return samples

    def _replaced(
        self,
        samples: Float64,
        start: int,
        stop: int,
        starts: list[SearchPose],
        goals: list[SearchPose],
        left_m: Float32,
    ) -> Float64 | None:
        """The way with a curve between two of its poses, or others where its ends are free to
        choose; None where that saves nothing."""
        had_m = driven_cost(samples[start : stop + 1])
        if had_m < math.dist(samples[start, :2], samples[stop, :2]) + _WORTH_M:
            return None
        nearer_m = left_m[self.coarse_place(starts[0])] - left_m[self.coarse_place(goals[0])]
        if not self._may_be_free(starts[0], goals[0], float(nearer_m)):
            return None
        curve = self._best_curve(starts, goals, had_m + 2.0 * CUSP_M)
        if not len(curve):
            return None
        before = samples[: start + (not _is_doubled(samples, start - 1))].copy()
        if len(before) > 1:
            before[-1, 3:] = before[-2, 3:]
        if driven_cost(joined([before[-2:], curve, samples[stop : stop + 2]])) > (
            driven_cost(samples[max(start - 1, 0) : stop + 2]) - _WORTH_M
        ):
            return None
        return joined([before, curve, samples[stop:]])

    def distance_left(self, goal: SearchPose, through: float = math.inf) -> Float32:
        """How far it is from each coarse cell to the goal for a disc that fits into the vehicle,
        inf where there is no way; a metre through what is blocked counts `through`."""
        passable, size = self.passable, self._coarse_m
        left = np.full(passable.shape, np.inf, dtype=np.float32)
        j, i = int(goal.y / size), int(goal.x / size)
        spread(passable, np.int64(j), np.int64(i), size, through, left)
        return left

    def least_m(self, left_m: float) -> float:
        """The length that no way falls below of which `distance_left` says `left_m`: eight
        neighbours make a straight line up to 8.2 % longer, and a coarse cell stands for all of its
        points."""
        return max(left_m / _EIGHT_WAYS - 4.0 * self._coarse_m, 0.0)

    @cached_property
    def passable(self) -> UInt8:
        """1 for the coarse cells where the disc about the reference point fits somewhere."""
        ground, scale = self.ground, self._coarse_cells()
        corners = self.vehicle.footprint()
        inner = min(corners[:, 0].max(), -corners[:, 0].min(), 0.5 * self.vehicle.width_m)
        inner += self.vehicle.clearance_m
        # The field is half a diagonal short at either end.
        least = np.float32(inner - (math.sqrt(2.0) + 0.25) * ground.cell_m)
        fits = ((ground.to_blocked_m >= least) & (ground.blocked == 0)).view(np.uint8)
        height, width = (-(-n // scale) * scale for n in fits.shape)
        whole = np.zeros((height, width), dtype=np.uint8)
        whole[: fits.shape[0], : fits.shape[1]] = fits
        # North to south first, over whole rows: both at once takes ten times as long.
        strips = whole.reshape(height // scale, scale, width).max(axis=1)
        return np.asarray(strips.reshape(height // scale, width // scale, scale).max(axis=2))

    def coarse_place(self, pose: SearchPose) -> tuple[int, int]:
        """Row and column of the coarse cell that encloses a pose."""
        size = self._coarse_m
        return int(pose.y / size), int(pose.x / size)

    def bottleneck(self, start: SearchPose, goal: SearchPose) -> tuple[float, float]:
        """Metres from the corner: where the way that goes through least of what is blocked first
        does so, from a start that is cut off."""
        passable, left = self.passable, self.distance_left(goal, _BLOCKED_COST)
        height, width = passable.shape
        j, i = self.coarse_place(start)
        crossed: list[tuple[int, int]] = []
        while left[j, i] > 0.0:
            near = [
                (a, b)
                for a in range(max(j - 1, 0), min(j + 2, height))
                for b in range(max(i - 1, 0), min(i + 2, width))
            ]
            j, i = min(near, key=lambda place: float(left[place]))
            if not passable[j, i]:
                crossed.append((j, i))
            elif crossed:
                break
        j, i = crossed[len(crossed) // 2] if crossed else (j, i)
        size = self._coarse_m
        return (i + 0.5) * size, (j + 0.5) * size

    @property
    def _coarse_m(self) -> float:
        return self.ground.cell_m * self._coarse_cells()

    def _coarse_cells(self) -> int:
        """How many cells one of the field of distances is wide: half a metre, more on large
        maps."""
        size = _COARSE_M
        while self.ground.blocked.size * self.ground.cell_m**2 / size**2 > _COARSE_CELLS:
            size *= 2.0
        return max(1, round(size / self.ground.cell_m))


def _word_cost(word: Word, cusp: float) -> float:
    """The cost of a word, in turning radii: its length, with reverse counted for more, and `cusp`
    for each change of gear."""
    gears = [length > 0.0 for _, length in word if abs(length) > 1e-6]
    cusps = sum(a != b for a, b in itertools.pairwise(gears))
    return cusp * cusps + sum(
        length if length > 0.0 else -REVERSE_COST * length for _, length in word
    )


def _is_doubled(samples: Float64, k: int) -> bool:
    """Whether the pose after one is the same pose, in another gear."""
    return bool(0 <= k < len(samples) - 1 and (samples[k, :2] == samples[k + 1, :2]).all())


def driven_cost(samples: Float64) -> float:
    """Metres of a way, those in reverse and changes of gear counted for more."""
    step = np.hypot(np.diff(samples[:, 0]), np.diff(samples[:, 1]))
    gear = samples[:, 3]
    backwards = float(step[gear[:-1] < 0].sum())
    cusps = int(np.count_nonzero(np.diff(gear)))
    return float(step.sum()) + (REVERSE_COST - 1.0) * backwards + CUSP_M * cusps
