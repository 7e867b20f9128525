"""The ways between passes: planned when the order needs them, bounded from below before."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from fieldgrid.core import Bool, Float32, Float64
from fieldgrid.field.coverage.order import VisitOrder, best_order
from fieldgrid.field.coverage.passes import Pass
from fieldgrid.field.route.astar import CUSP_M
from fieldgrid.field.route.path import joined
from fieldgrid.field.route.search import Searcher, SearchPose, driven_cost
from fieldgrid.geometry import Word, words

_MAX_POSES = 12_000
"""Of the search for one way: turns take some hundreds to thousands."""

_MORE_POSES = 60_000
_RETRIES = 40

_USUALLY = 1.5
"""The factor by which a way between tracks is taken to cost more than its lower bound before it is
planned: headlands leave hardly any way straight, and of many tracks few ways need planning."""

_ENOUGH = 4
"""Ways that are planned for each track before the order is made of those that are known: of a
hundred tracks, the best order would take thousands."""

_MOST_FAILED = 8
"""Ways from the end of a track, or to it, that are searched for in vain before it is taken to have
none but those that were found: where a vehicle hardly turns, others take minutes to fail, too."""

_DISTANCE_BYTES = 200_000_000
_CURVES_WITHIN = 12.0
"""Turning radii within which a curve says more of a way than its distance does."""


class LaneWays:
    """Passes along lanes, each in both directions, and what it costs to drive from one to another:
    metres, those in reverse and changes of gear counted for more, as in any route.

    Node 2k is lane k along its line, 2k + 1 against it; node 2n is the start or the end, at
    `starts` and `goals`, which are poses of one place, or anywhere where there are none. Ways are
    searched on the ground of `headland` first, where there is one: the same ground but for what is
    worked by tracks.
    """

    def __init__(
        self,
        searcher: Searcher,
        passes: Sequence[Pass | None],
        starts: list[SearchPose],
        goals: list[SearchPose],
        progress: Callable[[int, int], None],
        headland: Searcher | None = None,
    ) -> None:
        self.searcher, self.passes, self._headland = searcher, passes, headland
        self.starts, self._progress = starts, progress
        # The poses from which a way leaves each node, and in which one reaches it.
        self._starts = [*([] if one is None else [one.stop] for one in passes), starts]
        self._goals = [*([] if one is None else [one.start] for one in passes), goals]
        self.ways: dict[tuple[int, int], Float64] = {}
        self._doubtful: dict[tuple[int, int], None] = {}
        self._failed_from: Counter[int] = Counter()
        self._failed_to: Counter[int] = Counter()
        self._cut_off: dict[int, Float64] = {}
        self._left: dict[tuple[int, bool], Float32] = {}

    def bounds(self) -> tuple[Float64, Bool]:
        """Lower bounds of the costs from node to node, of tracks what they cost usually, the second
        pass included, and which of them are known."""
        count = len(self.passes)
        costs = np.full((count + 1, count + 1), np.inf)
        known = np.zeros(costs.shape, dtype=np.bool_)
        for b in range(count + 1):
            goals = self._goals[b]
            if b < count and not goals:
                continue
            after = self.passes[b] if b < count else None
            size = 0.0 if after is None else driven_cost(after.samples)
            left = self._distance(b) if goals else None
            for a in range(count + 1):
                starts = self._starts[a]
                is_same_lane = max(a, b) < count and a // 2 == b // 2
                if a == b or is_same_lane or (a < count and not starts):
                    continue
                if left is None or not starts:
                    costs[a, b], known[a, b] = size, True
                    continue
                way = self._bound(starts, goals, left, (a < count) + (b < count))
                costs[a, b] = size + (way if self._headland is None else _USUALLY * way)
        known |= ~np.isfinite(costs)
        return costs, known

    def costs(self, pairs: list[tuple[int, int]], max_poses: int = _MAX_POSES) -> list[float]:
        """The costs from node to node by ways that are planned; inf where none is found."""
        found = []
        for k, (a, b) in enumerate(pairs):
            self._progress(len(self.ways), len(self.ways) + len(pairs) - k)
            found.append(self._cost(a, b, max_poses))
        return found

    def order(self, worth: Float64) -> VisitOrder:
        """The best order of the lanes, each of which has a `worth`. Where lanes are left out, the
        nearest ways from and to them of which the search was cut short are searched for longer."""
        costs, known = self.bounds()
        bounds = costs.copy()
        enough = None if self._headland is None else _ENOUGH * len(worth)
        order = best_order(costs, known, worth, self.costs, enough=enough)
        missed = order.left_out(len(worth))
        pairs = [pair for pair in self._doubtful if missed & {node // 2 for node in pair}]
        most = _RETRIES if self._headland is None else _RETRIES // 4
        pairs = sorted(pairs, key=lambda pair: float(bounds[pair]))[:most]
        for pair, cost in zip(pairs, self.costs(pairs, _MORE_POSES), strict=True):
            costs[pair] = cost
        if pairs:
            order = best_order(costs, known, worth, self.costs, enough=enough)
        return order

    def _cost(self, a: int, b: int, max_poses: int) -> float:
        starts, goals = self._starts[a], self._goals[b]
        tried = self._cut_off.get(a)
        radius = self.searcher.vehicle.turning_radius_m
        if tried is not None and np.hypot(*(tried - goals[0][:2]).T).min() > 2.0 * radius:
            return math.inf
        samples = np.zeros((0, 5))
        if self._headland is not None:
            failed = max(self._failed_from[a], self._failed_to[b] if b < len(self.passes) else 0)
            if max_poses == _MAX_POSES and failed >= _MOST_FAILED:
                return math.inf
            left = self._distance(b, self._headland)
            if math.isfinite(left[self._headland.coarse_place(starts[0])]):
                few = max_poses // 4  # there is more ground to try
                samples = self._headland.search(starts, goals, left, few).samples
        if not len(samples):
            found = self.searcher.search(starts, goals, self._distance(b), max_poses)
            samples = found.samples
        self.ways[a, b] = samples
        if not len(samples):
            self._failed_from[a] += 1
            self._failed_to[b] += 1
            if found.exhausted:
                self._cut_off[a] = found.tried_m
            else:
                self._doubtful[a, b] = None
            return math.inf
        before, after = (self.passes[k] if k < len(self.passes) else None for k in (a, b))
        # The last step of the pass before tells whether the gear changes after it.
        parts = [] if before is None else [before.samples[-2:]]
        ways = [*parts, samples, *([] if after is None else [after.samples])]
        return driven_cost(joined(ways)) - sum(driven_cost(part) for part in parts)

    def _distance(self, node: int, searcher: Searcher | None = None) -> Float32:
        """`distance_left` of the place of a node; of the latest ones it is kept."""
        key = node, searcher is None
        left = self._left.get(key)
        if left is None:
            left = (searcher or self.searcher).distance_left(self._goals[node][0])
            while self._left and (len(self._left) + 1) * left.nbytes > _DISTANCE_BYTES:
                del self._left[next(iter(self._left))]
            self._left[key] = left
        return left

    def _bound(
        self, starts: list[SearchPose], goals: list[SearchPose], left_m: Float32, changes: int
    ) -> float:
        """A lower bound of the cost of a way between poses; inf where there is none. A way that
        reverses has at least `changes` changes of gear."""
        around = float(left_m[self.searcher.coarse_place(starts[0])])
        if not math.isfinite(around):
            return math.inf
        bound = self.searcher.least_m(around)
        radius = self.searcher.vehicle.turning_radius_m
        apart = math.dist(starts[0][:2], goals[0][:2])
        if len(starts) > 1 or len(goals) > 1 or apart > _CURVES_WITHIN * radius:
            return max(bound, apart)
        start, goal = starts[0], goals[0]
        cos, sin = math.cos(start.yaw), math.sin(start.yaw)
        dx, dy = (goal.x - start.x) / radius, (goal.y - start.y) / radius
        pose = dx * cos + dy * sin, dy * cos - dx * sin, goal.yaw - start.yaw
        shortest = radius * min(_length(word) for word in words(*pose, reverse=False))
        if self.searcher.vehicle.reverse:
            anyhow = radius * min(_length(word) for word in words(*pose, reverse=True))
            shortest = min(shortest, anyhow + changes * CUSP_M)
        return max(bound, shortest)


def _length(word: Word) -> float:
    return sum(abs(length) for _, length in word)
