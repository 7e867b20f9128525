"""Coverage of random fields: what is covered, how short the way is, and whether all holds.

`python -m benchmarks.coverage [[FIRST:]LAST [[FEWEST:]EXACT]]` makes so many fields (default 200):
one or two blocks of rows, straight or bent, with stepped ends, gaps, things in lanes and on
headlands, and parts that were not seen; vehicles of all kinds, with reverse or without. It plans a
coverage of each and prints

* faults: by the check that every route passes, and by looking up points of the footprint in the
  view, pose by pose;
* the share of the lanes covered that can be by construction: a third of the fields have nothing but
  rows in them, lanes that are wide enough, and headlands in which the vehicle can turn about;
* for fields of up to `EXACT` lanes (default 4; ten take minutes, 0 is for none) the cost and the
  length beside those of the best order, found by planning the way between every two lanes;
* on the same ways, what the local search makes of them;
* processor time.

With `FEWEST:EXACT`, as in `0:200 5:10`, only fields with so many lanes are planned, all of them
beside the best order. A field is made of its number, so 10,000 of them may be planned in parts:
`0:500 0`, `500:1000 0`...

`python -m benchmarks.coverage layouts [NUMBER...]` covers layouts of real vineyards (all 40 without
numbers), whose rows are found in made evidence without noise, with a vehicle 0.7 m wide that cannot
reverse, and prints the share of the lanes that are covered; `noisy` in the place of `layouts` does
so with false obstacles and holes in what was seen, and lanes that were driven.

Parallel tracks over ground without rows have a script of their own: `python -m benchmarks.tracks`.
"""

from __future__ import annotations

import itertools
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
import shapely

from benchmarks.fields import layout
from benchmarks.planting import DATUM, Planting as Stand, Sight, seen_view
from fieldgrid.core import Float64, NoRouteError
from fieldgrid.field import Coverage, Lane, Planting, Vehicle
from fieldgrid.field.coverage.order import best_order
from fieldgrid.field.coverage.passes import Pass, drive_lane
from fieldgrid.field.coverage.plan import coverage_in_view
from fieldgrid.field.coverage.ways import LaneWays
from fieldgrid.field.route.plan import searcher_of
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import Lattice, Window, extended, part, resampled
from fieldgrid.maps import MapView, Mark, MarkKind
from fieldgrid.maps.views.driven import WIDTH_M

_CELL_M = 0.2


class Task(NamedTuple):
    """A field with its lanes, and a vehicle; whether all lanes can be covered by construction."""

    view: MapView
    planting: Planting
    vehicle: Vehicle
    is_open: bool


def random_field(seed: int) -> Task:
    """A field of up to 14 lanes a block."""
    rng = np.random.default_rng(seed)
    is_open = seed % 3 == 0
    vehicle = random_vehicle(rng)
    spacing = float(rng.uniform(2.4, 4.0))
    half = float(rng.uniform(0.15, 0.4))
    # Rows are drawn up to three cells too wide.
    need = vehicle.work_width_m + 2.0 * (vehicle.clearance_m + half + 3.0 * _CELL_M)
    # Room for an omega turn: two radii and three quarters, and the vehicle beyond them.
    room = 2.8 * vehicle.turning_radius_m + vehicle.reach_m + vehicle.clearance_m + 1.0
    headland = float(rng.uniform(2.0, 10.0))
    if is_open:
        spacing, headland = max(spacing, need), room
    rows: list[list[Float64]] = []
    at = 0.0
    for _ in range(rng.integers(1, 3)):
        count = int(rng.integers(2, 8 if rng.random() < 0.8 else 16))
        rows.append(_block(rng, count, spacing, at))
        at += count * spacing + headland
    turn = rng.uniform(0.0, 2.0 * math.pi)
    spin = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    corner = rng.uniform(-2000.0, 2000.0, 2)
    rows = [[row @ spin + corner for row in block] for block in rows]
    every = np.concatenate([row for block in rows for row in block])
    margin = headland + 1.0
    low, high = every.min(axis=0) - margin, every.max(axis=0) + margin
    i0, j0 = (math.floor(v / _CELL_M) for v in low)
    width, height = (math.ceil((b - a) / _CELL_M) for a, b in zip(low, high, strict=True))
    origin = np.array([i0, j0]) * _CELL_M
    density, observed = np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8)

    def cells(points: Float64) -> Float64:
        return np.round((points - origin) / _CELL_M - 0.5).astype(np.int32)

    hull = shapely.MultiPoint(every).convex_hull.buffer(headland)
    cv2.fillPoly(observed, [cells(np.array(hull.exterior.coords))], 1)
    for row in (row for block in rows for row in block):
        for stretch in _stretches(rng, row):
            cv2.polylines(density, [cells(stretch)], False, 180, max(1, round(2 * half / _CELL_M)))
    if not is_open:
        _spoil(rng, density, observed, rows, cells)
    view = MapView(
        Lattice(_CELL_M), Window(i0, j0, width, height), density, observed > 0, DATUM, is_base=True
    )
    lanes = [
        lane for name, block in enumerate(rows, 1) for lane in _lanes(f"B{name}", block, spacing)
    ]
    planting = Planting(DATUM, view.bounds, _CELL_M, (), tuple(lanes), (), (), (), ())
    return Task(view, planting, vehicle, is_open)


def random_vehicle(rng: np.random.Generator) -> Vehicle:
    """Of any kind, up to 1.3 m wide."""
    wide = float(rng.uniform(0.5, 1.3))
    return Vehicle(
        front_m=float(rng.uniform(0.3, 2.2)),
        rear_m=float(rng.uniform(0.2, 1.2)),
        width_m=wide,
        implement_width_m=float(rng.choice([0.0, wide * 1.2])),
        turning_radius_m=float(rng.uniform(0.6, 3.5)),
        reverse=bool(rng.random() < 0.5),
        clearance_m=float(rng.choice([0.0, 0.1, 0.2])),
    )


def _block(rng: np.random.Generator, count: int, spacing: float, at: float) -> list[Float64]:
    """Rows to the north, from left to right; bent ones are arcs about one centre."""
    length, slope = rng.uniform(12.0, 35.0), rng.uniform(-0.4, 0.4)
    bend = rng.choice([0.0, 0.0, 1.0]) * rng.uniform(-1.0, 1.0) / (80.0 + count * spacing)
    steps = rng.uniform(0.0, rng.choice([0.3, 3.0]), (count, 2))
    rows = []
    for k in range(count):
        s = np.arange(slope * k * spacing + steps[k, 0], length + slope * k * spacing - steps[k, 1])
        x = np.full(len(s), k * spacing)
        if bend:
            radius = 1.0 / bend - k * spacing
            x, s = 1.0 / bend - radius * np.cos(s * bend), radius * np.sin(s * bend)
        rows.append(np.column_stack([x + at, s]))
    return rows


def _stretches(rng: np.random.Generator, row: Float64) -> list[Float64]:
    """What of a row stands: all of it, or two parts with a gap between them."""
    length = len(row) - 1.0
    if rng.random() < 0.7:
        return [row]
    start = rng.uniform(0.1, 0.7) * length
    return [part(row, 0.0, start), part(row, start + rng.uniform(0.1, 0.3) * length, length)]


def _spoil(rng, density, observed, rows, cells) -> None:  # type: ignore[no-untyped-def]
    """Things in lanes and on headlands, and parts that were not seen."""
    height, width = density.shape
    for _ in range(rng.integers(0, 5)):
        middle = rng.integers(0, (width, height)).tolist()
        cv2.circle(density, middle, int(rng.integers(0, 4)), 220, -1)
    for _ in range(rng.integers(0, 3)):
        middle = rng.integers(0, (width, height)).tolist()
        axes = rng.integers(1, 20, 2).tolist()
        cv2.ellipse(observed, middle, axes, rng.uniform(0.0, 180.0), 0, 360, 0, -1)
    for block in rows:
        if rng.random() < 0.5:
            row = block[rng.integers(len(block))]
            place = cells(row[rng.integers(len(row))] + rng.uniform(-1.5, 1.5, 2))
            cv2.circle(density, place.tolist(), int(rng.integers(0, 3)), 220, -1)
    specks = rng.random(density.shape) < rng.choice([0.0, 0.0, 0.0003])
    density[specks] = 150


def _lanes(block: str, rows: list[Float64], spacing: float) -> list[Lane]:
    found = []
    for k, (left, right) in enumerate(itertools.pairwise(rows), 1):
        # From where both rows have begun to where one ends.
        count = min(len(left), len(right))
        middle = resampled(0.5 * (left[:count] + right[:count]), 1.0)
        line = part(extended(middle, 0.0, 0.0), 0.25 * spacing, count - 1.0 - 0.25 * spacing)
        area = shapely.Polygon(np.concatenate([left[:count], right[:count][::-1]]))
        shape = shapely.LineString(line)
        found.append(
            Lane(f"{block}-L{k}", block, (f"{block}-R{k}", f"{block}-R{k + 1}"), shape, area,
                 float(shape.length), math.nan, np.zeros(0), 1.0, False)
        )  # fmt: skip
    return found


def points_on_barred(coverage: Coverage, view: MapView) -> int:
    """Poses in which a point of the footprint lies on an obstacle, on a cell that was not seen, or
    off the map."""
    route, cell_m = coverage.route, view.lattice.cell_m
    outline = shapely.Polygon(route.vehicle.footprint()).buffer(-1e-6)
    west, south, east, north = outline.bounds
    x, y = (
        v.ravel() for v in np.meshgrid(np.arange(west, east, 0.1), np.arange(south, north, 0.1))
    )
    inside = shapely.contains_xy(outline, x, y)
    ahead, left = (
        np.concatenate([v[inside], shapely.get_coordinates(outline)[:, k]])
        for k, v in enumerate((x, y))
    )
    phi = np.radians(route.heading_deg)[:, None]
    i = (route.east_m[:, None] + ahead * np.sin(phi) - left * np.cos(phi)) / cell_m
    j = (route.north_m[:, None] + ahead * np.cos(phi) + left * np.sin(phi)) / cell_m
    i, j = np.floor(i).astype(int) - view.window.i0, np.floor(j).astype(int) - view.window.j0
    height, width = view.density.shape
    off = (i < 0) | (j < 0) | (i >= width) | (j >= height)
    barred = (view.density > 100) | ~view.observed
    bad = off | barred[np.clip(j, 0, height - 1), np.clip(i, 0, width - 1)]
    return int(bad.any(axis=1).sum())


class Best(NamedTuple):
    """Of a field all of whose ways were planned: the least cost and the least length of an order
    that covers as much as any, and the cost of what the local search finds."""

    cost_m: float
    length_m: float
    searched_m: float


def best_of(task: Task, *, allow_unknown: bool = False) -> Best:
    """The best order by trying all, on ways that are planned between every two lanes."""
    searcher = searcher_of(task.view, task.vehicle, allow_unknown=allow_unknown, curve=None)
    passes: list[Pass | None] = []
    sizes = []
    for lane in task.planting.lanes:
        both = []
        for backwards in (False, True):
            try:
                both.append(drive_lane(searcher, lane, backwards=backwards))
            except NoRouteError:
                both.append(None)
        if both != [None, None]:
            passes += both
            sizes.append(lane.length_m)
    network = LaneWays(searcher, passes, [], [], lambda done, total: None)
    costs, known = network.bounds()
    pairs = [(int(a), int(b)) for a, b in np.argwhere(~known)]
    for pair, cost in zip(pairs, network.costs(pairs, 60_000), strict=True):
        costs[pair] = cost
    lengths = np.full(costs.shape, math.inf)
    for a, b in np.argwhere(np.isfinite(costs)).tolist():
        after = passes[b] if b < len(passes) else None
        ways = [network.ways.get((a, b)), None if after is None else after.samples]
        lengths[a, b] = sum(driven_m(way) for way in ways if way is not None)
    worth = 1000.0 * np.array(sizes)
    order = best_order(costs, np.ones(costs.shape, np.bool_), worth, lambda _: [])
    lost = worth.sum() - sum(worth[node // 2] for node in order.nodes)
    return Best(least(costs, worth), least(lengths, worth), order.cost - lost)


def driven_m(samples: Float64) -> float:
    """Metres of a way, forward and in reverse."""
    return float(np.hypot(*np.diff(samples[:, :2], axis=0).T).sum())


def least(costs: Float64, worth: Float64) -> float:
    """The least cost of an order that visits the most worth, by recursion over what is left."""
    table, end = costs.tolist(), len(costs) - 1

    @cache
    def rest(left: frozenset[int], node: int) -> tuple[float, float]:
        """The worth that is left out from here on, and the cost."""
        found = [(float(sum(worth[k] for k in left)), 0.0)]
        for k in left:
            for after in (2 * k, 2 * k + 1):
                if table[node][after] < math.inf:
                    lost, cost = rest(left - {k}, after)
                    found.append((lost, cost + table[node][after]))
        return min(found)

    return rest(frozenset(range(len(worth))), end)[1]


class Outcome(NamedTuple):
    """What came of a field: lanes, those covered, what is wrong with the route, why lanes were left
    out, ratios to the best order, and seconds of processor time."""

    is_open: bool
    lanes: int
    covered: int
    faults: list[str]
    left_out: list[str]
    ratios: tuple[float, float, float] | None
    took_s: float


def outcome(seed: int, exact: int) -> Outcome:
    """Plan on one field and check what comes of it, beside the best order of up to `exact`
    lanes."""
    task = random_field(seed)
    lanes = len(task.planting.lanes)
    began = time.process_time()
    try:
        coverage = coverage_in_view(task.view, task.planting, task.vehicle)
    except NoRouteError as none:
        took, said = time.process_time() - began, [f"{seed}: {none.reason}"]
        wrong = said if "fails its check" in none.reason else []
        return Outcome(task.is_open, lanes, 0, wrong, said, None, took)
    took = time.process_time() - began
    bad, ratios = points_on_barred(coverage, task.view), None
    if lanes <= exact and len(coverage.lanes) > 1:
        best = best_of(task)
        ratios = (
            coverage.cost_m / best.cost_m,
            coverage.route.length_m / best.length_m,
            best.searched_m / best.cost_m,
        )
    return Outcome(
        task.is_open, lanes, len(coverage.lanes), [f"{seed}: {bad} poses"] if bad else [],
        [f"{seed} {out.lane}: {out.reason}" for out in coverage.left_out], ratios, took,
    )  # fmt: skip


def report(found: list[Outcome]) -> None:
    """Print what came of some fields."""
    asked, covered = sum(one.lanes for one in found), sum(one.covered for one in found)
    faults = [fault for one in found for fault in one.faults]
    none = sum(one.covered == 0 for one in found)
    print(f"{len(found)} fields, {asked} lanes: {covered} covered, {none} fields without a route")
    print(f"  routes with a fault                              {len(faults)} {faults or ''}")
    wide = [one for one in found if one.is_open]
    share = sum(one.covered for one in wide) / max(sum(one.lanes for one in wide), 1)
    count = sum(one.lanes for one in wide)
    print(f"  covered of {count} lanes that can be by construction  {share:.2%}")
    for reason in (reason for one in wide for reason in one.left_out):
        print(f"    {reason}")
    compared = [one.ratios for one in found if one.ratios is not None]
    for k, what in enumerate(
        (
            "cost to that of the best order                  ",
            "length to that of the shortest order            ",
            "cost of the local search to that of the best one",
        )
    ):
        print(f"  {what} {_spread([ratios[k] for ratios in compared])}")
    print(
        f"  processor time a lane, s                         "
        f"{_spread([one.took_s / one.lanes for one in found])}",
        flush=True,
    )


def main(seeds: Sequence[int], exact: int, fewest: int | None) -> None:
    """Print what came of some fields, each time twenty more are done; where `fewest` is given, of
    those alone that have so many lanes, and no more than `exact`."""
    if fewest is not None:
        seeds = [s for s in seeds if fewest <= len(random_field(s).planting.lanes) <= exact]
    found = []
    for seed in seeds:
        found.append(outcome(seed, exact))
        if len(found) % 20 == 0 or seed == seeds[-1]:
            print(f"{seeds[0]}:{seed + 1}:", end=" ")
            report(found)


def over_layouts(numbers: list[int], *, is_noisy: bool) -> None:
    """Print what of each layout is covered."""
    vehicle = Vehicle(width_m=0.7, turning_radius_m=2.0, reverse=False)
    covered = lanes = 0
    for number in numbers:
        view = layout_view(number, is_noisy=is_noisy)
        planting = rows_of_view(view)
        if is_noisy:
            view = driven(view, planting)
        began = time.process_time()
        coverage = coverage_in_view(view, planting, vehicle)
        covered, lanes = covered + len(coverage.lanes), lanes + len(planting.lanes)
        print(
            f"layout {number:2}: {len(coverage.lanes)} of {len(planting.lanes)} lanes covered, "
            f"{coverage.route.length_m:.0f} m, {coverage.turning_share:.1%} of it turning, "
            f"{time.process_time() - began:.0f} s",
            flush=True,
        )
        for out in coverage.left_out:
            print(f"    {out.lane}: {out.reason} at {out.east_m:.1f},{out.north_m:.1f}")
    print(f"{covered} of {lanes} lanes covered: {covered / lanes:.2%}", flush=True)


def layout_view(number: int, *, is_noisy: bool) -> MapView:
    """A layout as it is seen: in cells of 0.1 m with false obstacles and holes, or without in cells
    of 0.2 m."""
    known = layout(number)
    noise = (0.05, 0.03, 0.1) if is_noisy else (0.0, 0.0, _CELL_M)
    sight = Sight(noise_per_m2=noise[0], hole_share=noise[1], margin_m=12.0, headland_m=12.0)
    seen = seen_view(Stand(known.rows, 0.35, known.missing), sight, noise[2])
    return replace(seen, is_base=True)


def driven(view: MapView, planting: Planting) -> MapView:
    """The view when the vehicle that saw it went along the middle of each lane and 4 m beyond: the
    ground that it drove over is free, as free marks are."""
    ways = [
        shapely.LineString(extended(np.asarray(lane.line.coords)[:, :2], 4.0, 4.0)).buffer(
            0.5 * WIDTH_M, cap_style="flat"
        )
        for lane in planting.lanes
    ]
    free = tuple(Mark(MarkKind.FREE, tuple(way.exterior.coords[:-1])) for way in ways)
    return replace(view, marks=free)


def _spread(values: list[float]) -> str:
    if not values:
        return "     -"
    middle, late, worst = np.percentile(values, [50, 95, 100])
    return f"{middle:6.3f} median {late:6.3f} p95 {worst:6.3f} worst ({len(values)})"


if __name__ == "__main__":
    if sys.argv[1:2] in (["layouts"], ["noisy"]):
        wanted_ones = [int(number) for number in sys.argv[2:]] or list(range(1, 41))
        over_layouts(wanted_ones, is_noisy=sys.argv[1] == "noisy")
    else:
        first, _, last = (sys.argv[1:] or ["200"])[0].rpartition(":")
        fewest, _, exact = (sys.argv[2:] or ["4"])[0].rpartition(":")
        wanted = range(int(first or 0), int(last))
        main(wanted, int(exact), int(fewest) if fewest else None)
