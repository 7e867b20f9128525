"""Routes over random fields: how many are found, in what time, how long, and whether all hold.

`python -m benchmarks.routes [FIELDS]` plans in so many fields (default 1000) of rows, things and
unseen parts with vehicles of all kinds, checks each route by what shares nothing with the planner,
and prints the share that was found, times, and lengths beside a lower bound; then routes over 1 km²
of cells of 0.25 m.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.planting import DATUM
from fieldgrid.core import NoRouteError
from fieldgrid.field import Route, Vehicle
from fieldgrid.field.route.ground import Ground
from fieldgrid.field.route.plan import route_in_view
from fieldgrid.field.route.search import Searcher, SearchPose
from fieldgrid.field.route.verify import find_fault
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import CostCurve, MapView


class Task(NamedTuple):
    """A field, a vehicle, and where it is to go."""

    view: MapView
    vehicle: Vehicle
    start: tuple[float, ...]
    goal: tuple[float, ...]


def random_task(seed: int, size_m: tuple[float, float] = (20.0, 45.0)) -> Task:
    """Rows with gaps, round things, specks and unseen parts on fields of such a side; a vehicle of
    0.4 to 2.4 m in width, with reverse or without; ends that are free for its middle."""
    rng = np.random.default_rng(seed)
    cell_m = float(rng.choice([0.1, 0.2, 0.25]))
    width, height = (int(v / cell_m) for v in rng.uniform(*size_m, 2))
    i0, j0 = (int(v) for v in rng.integers(-4000, 4000, 2))
    density = np.zeros((height, width), dtype=np.uint8)
    observed = np.ones((height, width), dtype=np.uint8)

    def at(*metres: float) -> tuple[int, ...]:
        return tuple(int(value / cell_m) for value in metres)

    size = width * cell_m, height * cell_m
    if rng.random() < 0.7:
        spacing, angle = rng.uniform(2.2, 5.0), rng.uniform(-0.5, 0.5)
        for x in np.arange(4.0, size[0] - 4.0, spacing):
            y, stop = rng.uniform(4.0, 8.0), size[1] - rng.uniform(4.0, 8.0)
            while y < stop:
                end = min(y + rng.uniform(2.0, 20.0), stop)
                shift = np.tan(angle) * (np.array([y, end]) - 0.5 * size[1])
                ends = at(x + shift[0], y), at(x + shift[1], end)
                cv2.line(density, *ends, 180, max(1, *at(rng.uniform(0.2, 0.7))))
                y = end + (rng.uniform(1.0, 5.0) if rng.random() < 0.4 else 0.0)
    for _ in range(rng.integers(0, 12)):
        middle = at(rng.uniform(0.0, size[0]), rng.uniform(0.0, size[1]))
        cv2.circle(density, middle, *at(rng.uniform(0.1, 1.5)), 220, -1)
    for _ in range(rng.integers(0, 5)):
        middle = at(rng.uniform(0.0, size[0]), rng.uniform(0.0, size[1]))
        axes = at(rng.uniform(0.5, 5.0), rng.uniform(0.5, 5.0))
        cv2.ellipse(observed, middle, axes, rng.uniform(0.0, 180.0), 0, 360, 0, -1)
    specks = rng.random(density.shape) < rng.choice([0.0, 0.0005])
    density[specks] = 150
    view = MapView(
        Lattice(cell_m), Window(i0, j0, width, height), density, observed > 0, DATUM, is_base=True
    )
    wide = float(rng.uniform(0.4, 1.8))
    vehicle = Vehicle(
        front_m=float(rng.uniform(0.3, 3.0)),
        rear_m=float(rng.uniform(0.2, 1.5)),
        width_m=wide,
        implement_width_m=float(rng.choice([0.0, wide * 1.3])),
        turning_radius_m=float(rng.uniform(0.5, 5.0)),
        reverse=bool(rng.random() < 0.5),
        clearance_m=float(rng.choice([0.0, 0.1, 0.3])),
    )
    free = observed & (density == 0).astype(np.uint8)
    clear = cv2.distanceTransform(
        cv2.copyMakeBorder(free, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0), cv2.DIST_L2, 5
    )[1:-1, 1:-1]
    rows, columns = np.nonzero(clear * cell_m > 0.5 * wide + vehicle.clearance_m + cell_m)
    places = []
    for _ in range(2):
        k = int(rng.integers(len(rows))) if len(rows) else 0
        j, i = (int(rows[k]), int(columns[k])) if len(rows) else (height // 2, width // 2)
        place = (float((i0 + i + 0.5) * cell_m), float((j0 + j + 0.5) * cell_m))
        places.append((*place, float(rng.uniform(-180.0, 180.0))) if rng.random() < 0.6 else place)
    return Task(view, vehicle, *places)


def faults(route: Route, view: MapView, *, allow_unknown: bool = False) -> str:
    """What is wrong with a route, '' for nothing, by the check that shares nothing with its
    making."""
    margin_m = 60.0 if allow_unknown else 5.0
    ground = Ground.of(
        view, CostCurve(), route.vehicle, allow_unknown=allow_unknown, margin_m=margin_m
    )
    fault = find_fault(route.path, ground, route.vehicle)
    return "" if fault is None else fault.reason


def driven_task(seed: int) -> Task | None:
    """The same field, with a goal to which a random drive of free arcs of any curvature leads from
    the start, so that a route exists; None where the vehicle can hardly move."""
    task = random_task(seed)
    vehicle, rng = task.vehicle, np.random.default_rng(seed)
    ground = Ground.of(task.view, CostCurve(), task.vehicle, allow_unknown=False, margin_m=8.0)
    searcher = Searcher(ground, vehicle)
    x, y = task.start[0] - ground.west_m, task.start[1] - ground.south_m
    here = np.array([x, y, math.radians(90.0 - rng.uniform(-180.0, 180.0))])
    start, driven_m = here, 0.0
    for _ in range(200):
        gear = -1.0 if vehicle.reverse and rng.random() < 0.3 else 1.0
        curvature = rng.choice([0.0, *rng.uniform(-1.0, 1.0, 3)]) * vehicle.curvature_1pm
        d = gear * np.arange(0.0, rng.uniform(1.0, 4.0), 0.02)
        yaw = here[2] + curvature * d
        east, north = d * np.cos(here[2]), d * np.sin(here[2])
        if curvature:
            east = (np.sin(yaw) - np.sin(here[2])) / curvature
            north = (np.cos(here[2]) - np.cos(yaw)) / curvature
        poses = np.column_stack([here[0] + east, here[1] + north, yaw])
        if (searcher.gaps_m(poses, 1.0) >= vehicle.clearance_m + 0.02).all():
            here, driven_m = poses[-1], driven_m + abs(float(d[-1]))
    if driven_m < 10.0 or math.dist(start[:2], here[:2]) < 1.0:
        return None
    ends = [
        (float(p[0] + ground.west_m), float(p[1] + ground.south_m), 90.0 - math.degrees(p[2]))
        for p in (start, here)
    ]
    return Task(task.view, vehicle, *ends)


def least_length_m(task: Task) -> float:
    """No route is shorter: the straight line, and the way of a disc inside the vehicle around what
    is blocked, on eight neighbours, of which a straight line is up to 8.2 % shorter."""
    ground = Ground.of(task.view, CostCurve(), task.vehicle, allow_unknown=False, margin_m=5.0)
    searcher = Searcher(ground, task.vehicle)
    start, goal = (
        SearchPose(place[0] - ground.west_m, place[1] - ground.south_m, 0.0)
        for place in (task.start, task.goal)
    )
    around = float(searcher.distance_left(goal)[searcher.coarse_place(start)])
    # A coarse cell stands for all of its points.
    around = around / (2.0 * math.sqrt(2.0 - math.sqrt(2.0)) / math.sqrt(2.0)) - 2.0
    return max(math.dist(start[:2], goal[:2]), around, 1.0)


def over_fields(what: str, tasks: list[Task]) -> None:
    """Print what came of some tasks."""
    outcome: Counter[str] = Counter()
    wrong, found_s, none_s, ratios = [], [], [], []
    for task in tasks:
        began = time.process_time()
        try:
            route = route_in_view(task.view, task.start, task.goal, task.vehicle)
        except NoRouteError as none:
            outcome[next(what for what, words in _REASONS.items() if words in none.reason)] += 1
            none_s.append(time.process_time() - began)
            if "fails its check" in none.reason:
                wrong.append(str(none))
            continue
        found_s.append(time.process_time() - began)
        outcome["found"] += 1
        ratios.append(route.length_m / least_length_m(task))
        if fault := faults(route, task.view):
            wrong.append(fault)
    tried = outcome["found"] + outcome["none on the lattice"] + outcome["none within the limit"]
    print(f"{len(tasks)} {what}: " + ", ".join(f"{n} {why}" for why, n in outcome.items()))
    print(f"  found of those whose ends are free and connected  {outcome['found'] / tried:.1%}")
    print(f"  routes with a fault                               {len(wrong)} {wrong or ''}")
    for kind, times in (("found", found_s), ("not found", none_s)):
        print(f"  processor time in s, {kind:<10} {_spread(times)}")
    print(f"  length to a lower bound          {_spread(ratios)}")


def _spread(values: list[float]) -> str:
    if not values:
        return "     -"
    middle, late, worst = np.percentile(values, [50, 95, 100])
    return f"{middle:6.2f} median {late:6.2f} p95 {worst:6.2f} worst"


_REASONS = {
    "with an end that is not free": "not free",
    "cut off": "stopped by",
    "none on the lattice": "ended without one",
    "none within the limit": "none was found",
    "faulty": "",
}
"""What came of a field, and the words by which a refusal says so."""


def square_kilometre() -> MapView:
    """1 km² of cells of 0.25 m: rows of 110 m, 3 m apart, with headlands, things and unseen
    parts."""
    rng, side = np.random.default_rng(0), 4000
    density = np.zeros((side, side), dtype=np.uint8)
    observed = np.ones((side, side), dtype=np.uint8)
    for x in range(40, side - 40, 12):
        for y in range(60, side - 60, 480):
            cv2.line(density, (x, y), (x, y + 440), 180, 3)
    for _ in range(300):
        cv2.circle(density, rng.integers(0, side, 2).tolist(), int(rng.integers(1, 8)), 200, -1)
    for _ in range(40):
        axes = rng.integers(5, 80, 2).tolist()
        cv2.ellipse(observed, rng.integers(0, side, 2).tolist(), axes, 0, 0, 360, 0, -1)
    window = Window(0, 0, side, side)
    return MapView(Lattice(0.25), window, density, observed > 0, DATUM, is_base=True)


def over_a_square_kilometre() -> None:
    """Print the time of routes from corner to corner."""
    view = square_kilometre()
    places = ((5.0, 5.0, 0.0), (990.0, 990.0, 90.0)), ((5.0, 5.0), (990.0, 990.0))
    for start, goal in (*places, ((5.0, 990.0), (990.0, 5.0))):
        began, at = time.process_time(), time.perf_counter()
        route = route_in_view(view, start, goal)
        took, waited = time.process_time() - began, time.perf_counter() - at
        print(
            f"1 km² of 0.25 m cells, {route.length_m:6.0f} m: {took:5.2f} s of processor time, "
            f"{waited:5.2f} s"
        )


if __name__ == "__main__":
    fields = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    over_fields("random ends", [random_task(seed) for seed in range(fields)])
    driven = [task for task in map(driven_task, range(fields)) if task is not None]
    over_fields("ends of a random drive, to which a route exists", driven)
    over_a_square_kilometre()
