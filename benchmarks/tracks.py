"""Parallel tracks over random fields: what is worked, and whether all holds.

`python -m benchmarks.tracks [[FIRST:]LAST]` makes so many fields (default 100): ground of any
outline, with obstacles, parts that were not seen and lone cells; vehicles of all kinds, with
reverse or without; a direction, the best one, an edge or a curve; half of them with a boundary that
was drawn. It plans a coverage of each and prints

* faults, by looking up points of the footprint in the view, pose by pose, by its corners against
  the boundary, and by curvature and gears read off the poses;
* the share of the reachable ground that is worked, on the middles of cells: what the working width
  covers in some pose, of 24 headings in each cell, in which the vehicle stands free;
* how much of the ways between tracks leads over ground inside the headland passes;
* processor time.
"""

from __future__ import annotations

import math
import sys
import time
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import shapely
import shapely.affinity

from benchmarks.coverage import points_on_barred, random_vehicle
from benchmarks.planting import DATUM
from fieldgrid.core import NoRouteError
from fieldgrid.field import Coverage, Tracks, Vehicle
from fieldgrid.field.coverage.plan import coverage_in_view
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import MapView

_CELL_M = 0.2


class Task(NamedTuple):
    """A field, the tracks that are asked for, and a vehicle."""

    view: MapView
    tracks: Tracks
    vehicle: Vehicle


def random_field(seed: int) -> Task:
    """A field of 15 to 40 m, at least nine turning radii, without reverse twelve."""
    rng = np.random.default_rng(seed)
    vehicle = random_vehicle(rng)
    wide = vehicle.work_width_m * float(rng.uniform(1.0, 3.0))
    radii = 9.0 if vehicle.reverse else 12.0
    size = max(float(rng.uniform(15.0, 40.0)), radii * vehicle.turning_radius_m)
    # An outline about a middle: nearly convex, or with bays.
    count = int(rng.integers(4, 9))
    angles = 2.0 * math.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    reach = 0.5 * size * rng.uniform(rng.choice([0.5, 0.8]), 1.0, count)
    corner = rng.uniform(-2000.0, 2000.0, 2)
    i0, j0 = (math.floor(v / _CELL_M) for v in corner)
    cells = math.ceil(size / _CELL_M)
    origin, middle = np.array([i0, j0]) * _CELL_M, 0.5 * size
    outline = middle + reach[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    density, seen = np.zeros((cells, cells), np.uint8), np.zeros((cells, cells), np.uint8)
    if rng.random() < 0.3:
        seen[:] = 1
    cv2.fillPoly(seen, [np.round(outline / _CELL_M).astype(np.int32)], 1)
    for _ in range(rng.integers(0, 5)):
        place = rng.integers(0, cells, 2).tolist()
        cv2.circle(density, place, int(rng.integers(0, 6)), 220, -1)
    for _ in range(rng.integers(0, 3)):
        place, axes = rng.integers(0, cells, 2).tolist(), rng.integers(1, 20, 2).tolist()
        cv2.ellipse(seen, place, axes, rng.uniform(0.0, 180.0), 0, 360, 0, -1)
    density[rng.random(density.shape) < rng.choice([0.0, 0.0, 0.0002])] = 150
    view = MapView(
        Lattice(_CELL_M), Window(i0, j0, cells, cells), density, seen > 0, DATUM, is_base=True
    )
    inner = shapely.Polygon(outline + origin).buffer(-0.5)
    is_drawn = rng.random() < 0.5 and isinstance(inner, shapely.Polygon) and inner.area > 50.0
    bend, way = rng.uniform(-0.3, 0.3), np.linspace(-0.5, 0.5, 20)[:, None]
    turn = rng.uniform(0.0, 2.0 * math.pi)
    ahead, left = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    curve = origin + middle + size * (way * ahead + bend * way**2 * left)
    kind = rng.integers(0, 5)
    tracks = Tracks(
        width_m=wide,
        overlap_m=float(rng.choice([0.0, 0.1 * wide])),
        direction_deg=float(rng.uniform(0.0, 360.0)) if kind == 0 else None,
        along="edge" if kind == 1 else shapely.LineString(curve) if kind == 2 else None,
        boundary=inner if is_drawn else None,
        headland_passes=None if rng.random() < 0.8 else int(rng.integers(0, 4)),
    )
    return Task(view, tracks, vehicle)


def faults(coverage: Coverage, task: Task) -> list[str]:
    """What is wrong with a route, by its columns, the view and the boundary alone."""
    route, vehicle, found = coverage.route, task.vehicle, []
    if bad := points_on_barred(coverage, task.view):
        found.append(f"{bad} poses on what is barred")
    phi = np.radians(route.heading_deg)
    east, north = np.diff(route.east_m), np.diff(route.north_m)
    step, turn = np.hypot(east, north), np.diff(np.unwrap(phi))
    if step.max() > 0.1 + 1e-6:
        found.append("a hole")
    if (np.abs(2.0 * np.sin(0.5 * turn)) > step / vehicle.turning_radius_m * 1.000001 + 1e-9).any():
        found.append("a turn that is too sharp")
    along = east * np.sin(phi[:-1] + 0.5 * turn) + north * np.cos(phi[:-1] + 0.5 * turn)
    if not np.allclose(along, route.gear[:-1] * step, atol=1e-6):
        found.append("a step against its gear")
    if not vehicle.reverse and (route.gear < 0).any():
        found.append("reverse")
    if task.tracks.boundary is not None:
        ahead, left = vehicle.footprint().T
        x = route.east_m[:, None] + ahead * np.sin(phi)[:, None] - left * np.cos(phi)[:, None]
        y = route.north_m[:, None] + ahead * np.cos(phi)[:, None] + left * np.sin(phi)[:, None]
        shapely.prepare(task.tracks.boundary)
        if not shapely.contains_xy(task.tracks.boundary, x, y).all():
            found.append("a corner beyond the boundary")
    return found


def worked_share(coverage: Coverage, task: Task) -> float:
    """The share of the reachable ground that is worked, on the middles of cells."""
    view, vehicle, route = task.view, task.vehicle, coverage.route
    free = (view.observed & (view.density <= 100)).astype(np.uint8)
    east_m, north_m = view.lattice.centres(view.window)
    if task.tracks.boundary is not None:
        inside = shapely.contains_xy(task.tracks.boundary, east_m[None, :], north_m[:, None])
        free &= inside.astype(np.uint8)
    wide = task.tracks.width_m or 0.0
    shape = shapely.Polygon(vehicle.footprint()).buffer(vehicle.clearance_m)
    reachable = np.zeros(free.shape, dtype=np.uint8)
    for turn in np.arange(24) * 15.0:
        stands = _kernel(shapely.affinity.rotate(shape, turn, origin=(0.0, 0.0)))
        across = shapely.LineString([(0.0, -0.5 * wide), (0.0, 0.5 * wide)])
        works = _kernel(shapely.affinity.rotate(across, turn, origin=(0.0, 0.0)))
        standing = cv2.erode(free, stands, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        reachable |= cv2.dilate(standing, works, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    reachable &= free
    j, i = np.nonzero(reachable)
    points = np.column_stack([east_m[i], north_m[j]])
    done = np.zeros(len(points), dtype=bool)
    for name in dict.fromkeys(route.lane[route.lane != ""].tolist()):
        k = np.flatnonzero(route.lane == name)
        way = shapely.LineString(np.column_stack([route.east_m, route.north_m])[k[0] : k[-1] + 2])
        strip = way.buffer(0.5 * wide, cap_style="flat")
        shapely.prepare(strip)
        done |= shapely.contains_xy(strip, points)
    return float(done.mean()) if len(done) else 1.0


def _kernel(shape: shapely.Geometry) -> npt.NDArray[np.uint8]:
    """The cells that meet a shape about the middle of a cell."""
    size = math.ceil(max(map(abs, shape.bounds)) / _CELL_M + 1.0)
    at = _CELL_M * (np.arange(-size, size + 1) - 0.5)
    x, y = np.meshgrid(at, at)
    meets = shapely.intersects(shape, shapely.box(x, y, x + _CELL_M, y + _CELL_M))
    found: npt.NDArray[np.uint8] = meets.astype(np.uint8)
    return found


class Outcome(NamedTuple):
    """What came of a field: what is wrong, the share that is worked, the share of the ways between
    tracks that leads over the ground inside, tracks, those left out, seconds; why there is none."""

    faults: list[str]
    share: float
    crossing: float
    lanes: int
    left_out: list[str]
    took_s: float
    none: str = ""


def outcome(seed: int) -> Outcome:
    """Plan on one field and check what comes of it."""
    task = random_field(seed)
    began = time.process_time()
    try:
        coverage = coverage_in_view(task.view, task.tracks, task.vehicle)
    except NoRouteError as none:
        took = time.process_time() - began
        wrong = [none.reason] if "fails its check" in none.reason else []
        return Outcome(wrong, 0.0, 0.0, 0, [], took, none.reason)
    took = time.process_time() - began
    assert coverage.swaths is not None
    between = coverage.route.length_m - coverage.worked_m
    return Outcome(
        faults(coverage, task), worked_share(coverage, task),
        coverage.swaths.crossing_m / max(between, 1e-9), len(coverage.lanes),
        [f"{lane.lane}: {lane.reason}" for lane in coverage.left_out], took,
    )  # fmt: skip


def report(found: dict[int, Outcome]) -> None:
    """Print what came of some fields."""
    with_route = {seed: one for seed, one in found.items() if not one.none}
    wrong = [f"{seed}: {fault}" for seed, one in found.items() for fault in one.faults]
    print(f"{len(found)} fields, {len(with_route)} with a route")
    print(f"  routes with a fault                        {len(wrong)} {wrong or ''}")
    shares = np.array([one.share for one in with_route.values()])
    worst = min(with_route, key=lambda seed: with_route[seed].share)
    print(
        f"  share of the reachable ground that is worked {np.median(shares):6.1%} median "
        f"{np.percentile(shares, 5):6.1%} p5 {shares.min():6.1%} worst (field {worst})"
    )
    crossing = np.array([one.crossing for one in with_route.values()])
    print(
        f"  of the ways between tracks inside the headland {np.median(crossing):6.1%} median "
        f"{np.percentile(crossing, 95):6.1%} p95 {crossing.max():6.1%} worst"
    )
    lanes = sum(one.lanes for one in with_route.values())
    out = sum(len(one.left_out) for one in with_route.values())
    print(f"  tracks driven {lanes}, left out {out}")
    took = np.array([one.took_s / max(one.lanes, 1) for one in with_route.values()])
    print(f"  processor time a track, s  {np.median(took):6.2f} median {took.max():6.2f} worst")
    for seed, one in found.items():
        if one.none:
            print(f"    {seed}: {one.none}")
    sys.stdout.flush()


def main(seeds: range) -> None:
    """Print what came of some fields, each time ten more are done."""
    found = {}
    for seed in seeds:
        found[seed] = outcome(seed)
        if "-v" in sys.argv:
            print(seed, found[seed], flush=True)
        if len(found) % 10 == 0 or seed == seeds[-1]:
            report(found)


if __name__ == "__main__":
    first, _, last = (sys.argv[1:] or ["100"])[0].rpartition(":")
    main(range(int(first or 0), int(last)))
