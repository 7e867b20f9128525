"""`plan_coverage`: one way along all lanes of a map, or some, or along tracks that are laid."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from fieldgrid.core import ConfigError, Float64, NoRouteError, quoted
from fieldgrid.field.coverage.area import Tracks
from fieldgrid.field.coverage.passes import Pass, drive_lane
from fieldgrid.field.coverage.tracks import TrackLayout, lay_tracks
from fieldgrid.field.coverage.ways import LaneWays
from fieldgrid.field.route.ground import OUTSIDE
from fieldgrid.field.route.path import joined
from fieldgrid.field.route.plan import (
    Route,
    check_place,
    checked_route,
    find_way,
    free_poses,
    planning_view,
    remedy,
    searcher_of,
    weak_cells,
)
from fieldgrid.field.route.search import Searcher, SearchPose
from fieldgrid.field.route.vehicle import Vehicle
from fieldgrid.field.rows.crops import Crop
from fieldgrid.field.rows.find import find_rows
from fieldgrid.field.rows.result import Lane, Planting
from fieldgrid.geometry import OBSTACLE_ABOVE, Bounds
from fieldgrid.maps import CostCurve, MapFile, MapView, open_map

Progress = Callable[[int, int], None]
"""Told how many lanes and ways between them are planned, and of how many, as far as is known."""

_HALF_DIAGONAL = math.sqrt(0.5)
_WORTH = 1000.0
"""Metres of way that a metre of lane is worth: nothing is left out to save way."""


class WorkedLane(NamedTuple):
    """A lane that a route works: whether against the direction of its line, and from where to where
    along the line the reference point goes, in metres."""

    lane: str
    against: bool
    from_m: float
    to_m: float


class OmittedLane(NamedTuple):
    """A lane that no route works, why, and where that is (metres east and north)."""

    lane: str
    reason: str
    east_m: float
    north_m: float


class Swaths(NamedTuple):
    """What tracks work: their width; the ground that it reaches anywhere, and what of it is worked
    (m²); metres of the ways between tracks that lead over the ground inside the headland."""

    wide_m: float
    reachable_m2: float
    worked_m2: float
    crossing_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """A route along lanes: the lanes in the order of driving, and those that are left out.

    `remedy` is what may help those, '' where there are none. `planting` has the lanes; those of
    parallel tracks are tracks and passes around them, and `swaths` says what they work. `cost_m` is
    what the order was chosen by: metres of way, those in reverse and changes of gear counted for
    more.
    """

    route: Route
    lanes: tuple[WorkedLane, ...]
    left_out: tuple[OmittedLane, ...]
    remedy: str
    planting: Planting
    cost_m: float
    swaths: Swaths | None = None

    @property
    def worked_m(self) -> float:
        """Metres that are driven in lanes while they are worked."""
        return float(self.route.path.steps_m[self.route.lane[:-1] != ""].sum())

    @property
    def turning_share(self) -> float:
        """The share of the length that is driven from lane to lane, 0..1."""
        return 1.0 - self.worked_m / self.route.length_m


def plan_coverage(
    universal: MapFile | str | FilePath,
    vehicle: Vehicle | None = None,
    *,
    lanes: Sequence[str] | None = None,
    start: tuple[float, ...] | None = None,
    goal: tuple[float, ...] | None = None,
    crop: str | Crop = "vineyard",
    planting: Planting | None = None,
    tracks: Tracks | None = None,
    allow_unknown: bool = False,
    cell_m: float | None = None,
    bounds: Bounds | None = None,
    curve: CostCurve | None = None,
    at: str | int | None = None,
    progress: Progress | None = None,
) -> Coverage:
    """A route along all lanes of a map, or those named, over seen free ground; with `tracks` along
    parallel tracks that are laid over that ground, and passes around it and its obstacles.

    Each lane is driven from end to end once, in an order and a direction that make turning short,
    by local search. `start` and `goal` are places as
    `plan_route` takes them; without them the route begins and ends at a lane. The
    lanes are those of `planting`, or of what `find_rows` finds of `crop`. The rest
    is as in `plan_route`, to which the ways between lanes keep.

    A lane that cannot be driven, or not reached beside the others, is in `left_out` with the
    reason. Raises NoRouteError when that is so of all, ConfigError for what cannot be asked.
    """
    if not isinstance(universal, MapFile):
        with open_map(universal) as opened:
            return plan_coverage(
                opened, vehicle, lanes=lanes, start=start, goal=goal, crop=crop, planting=planting,
                tracks=tracks, allow_unknown=allow_unknown, cell_m=cell_m, bounds=bounds,
                curve=curve, at=at, progress=progress,
            )  # fmt: skip
    work: Planting | Tracks | None = tracks or planting
    if work is None:
        above = OBSTACLE_ABOVE if curve is None else curve.obstacle_above
        work = find_rows(universal, crop=crop, bounds=bounds, obstacle_above=above, at=at)
    vehicle = vehicle or Vehicle()
    view = planning_view(universal, cell_m, bounds, at)
    return coverage_in_view(
        view, work, vehicle, lanes=lanes, start=start, goal=goal,
        allow_unknown=allow_unknown, curve=curve, progress=progress, universal=universal,
    )  # fmt: skip


def coverage_in_view(
    view: MapView,
    work: Planting | Tracks,
    vehicle: Vehicle | None = None,
    *,
    lanes: Sequence[str] | None = None,
    start: tuple[float, ...] | None = None,
    goal: tuple[float, ...] | None = None,
    allow_unknown: bool = False,
    curve: CostCurve | None = None,
    progress: Progress | None = None,
    universal: MapFile | None = None,
) -> Coverage:
    """Plan a coverage as :func:`plan_coverage` does, in a view that was read already, as
    `route_in_view` takes it, and the map."""
    for name, place in (("start", start), ("goal", goal)):
        if place is not None:
            check_place(name, place)
    said = progress or (lambda done, total: None)
    searcher = searcher_of(view, vehicle or Vehicle(), allow_unknown=allow_unknown, curve=curve)
    laid = None
    if isinstance(work, Planting):
        planting = work
    else:
        if work.boundary is not None:
            # A cell whose middle is inside may reach beyond by half a diagonal.
            inside = work.boundary.buffer(-_HALF_DIAGONAL * searcher.ground.cell_m)
            searcher = Searcher(searcher.ground.confined(inside, OUTSIDE), searcher.vehicle)
        fill_unseen = allow_unknown and work.boundary is not None
        laid = lay_tracks(searcher, work, view.datum, view.bounds, fill_unseen=fill_unseen)
        planting = laid.planting
    asked = _asked(planting, lanes)
    starts = [] if start is None else free_poses(searcher, start, "start", view.bounds)
    goals = [] if goal is None else free_poses(searcher, goal, "goal", view.bounds)
    driven: list[tuple[Lane, list[Pass | None]]] = []
    left_out = []
    for count, lane in enumerate(asked):
        said(count, len(asked))
        passes, none = _both_ways(searcher, lane)
        if none is None:
            driven.append((lane, passes))
        else:
            left_out.append(OmittedLane(lane.id, none.reason, none.east_m, none.north_m))
    nodes: list[int] = []
    cost_m, headland = 0.0, None
    if laid is not None:  # turns belong there
        around = shapely.box(*searcher.ground.bounds_m).difference(_core(laid, searcher.vehicle))
        headland = Searcher(searcher.ground.confined(around), searcher.vehicle)
    ways = LaneWays(
        searcher, [p for _, passes in driven for p in passes], starts, goals,
        lambda done, total: said(len(asked) + done, len(asked) + total),
        headland,
    )  # fmt: skip
    if driven:
        worth = np.array([_WORTH * lane.length_m for lane, _ in driven])
        order = ways.order(worth)
        missed = order.left_out(len(driven))
        nodes, cost_m = order.nodes, order.cost - sum(float(worth[k]) for k in missed)
        left_out += [_unreached(ways, nodes, k, driven[k][0]) for k in missed]
    left_out.sort(key=lambda entry: [lane.id for lane in asked].index(entry.lane))
    helps = ""
    if left_out:
        omitted = left_out[0]
        first = next(lane for lane in asked if lane.id == omitted.lane)
        helps = weak_cells(
            searcher, lambda on: drive_lane(on, first, backwards=False).samples, universal
        ) or remedy(searcher, [(lane.east_m, lane.north_m) for lane in left_out])
    if not nodes:
        no_lane = f"None of {len(asked)} lanes" if len(asked) > 1 else "No lane"
        raise NoRouteError(
            f"{no_lane} can be covered; of {omitted.lane}: {omitted.reason}",
            omitted.east_m, omitted.north_m, helps,
        )  # fmt: skip
    samples = _assembled(ways, nodes)
    names = np.array(["", *(lane.id for lane, _ in driven)])
    route = checked_route(
        searcher, samples[:, :5], names[samples[:, 5].astype(np.int64)], view.datum
    )
    worked = []
    for node in nodes:
        lane, passes = driven[node // 2]
        way = passes[node % 2]
        assert way is not None
        ends = way.from_m, way.to_m
        from_m, to_m = (lane.length_m - end for end in ends[::-1]) if node % 2 else ends
        worked.append(WorkedLane(lane.id, bool(node % 2), max(from_m, 0.0), to_m))
    swaths = None if laid is None else _swaths(laid, route)
    return Coverage(route, tuple(worked), tuple(left_out), helps, planting, cost_m, swaths)


def _core(laid: TrackLayout, vehicle: Vehicle) -> shapely.Geometry:
    """The ground that tracks alone lead over: a vehicle at the end of one stays out of it."""
    return laid.inner.buffer(-(vehicle.reach_m + vehicle.clearance_m + 0.5 * laid.wide_m))


def _swaths(laid: TrackLayout, route: Route) -> Swaths:
    """What of the ground is worked, by the poses in which a lane is."""
    places = np.column_stack([route.east_m, route.north_m])
    edges = np.flatnonzero(np.r_[True, route.lane[1:] != route.lane[:-1], True])
    worked = [
        shapely.LineString(places[first : min(last + 1, len(places))])
        for first, last in itertools.pairwise(edges.tolist())
        if route.lane[first]
    ]
    strips = shapely.buffer(worked, 0.5 * laid.wide_m, cap_style="flat")
    area = shapely.intersection(shapely.union_all(strips), laid.reachable)
    core = _core(laid, route.vehicle)
    steps = shapely.linestrings(np.stack([places[:-1], places[1:]], axis=1)[route.lane[:-1] == ""])
    shapely.prepare(core)
    crossing = shapely.length(steps[shapely.intersects(core, steps)]).sum()
    return Swaths(laid.wide_m, float(laid.reachable.area), float(area.area), float(crossing))


def _asked(planting: Planting, lanes: Sequence[str] | None) -> list[Lane]:
    """The lanes that were asked for."""
    if not planting.lanes:
        raise ConfigError(
            "No lanes were found in the map; --crop and --spacing say which rows to look for, "
            "`fieldgrid rows` shows what is found, and --tracks works ground without rows."
        )
    if lanes is None:
        return list(planting.lanes)
    names = [lane.id for lane in planting.lanes]
    for name in lanes:
        if name not in names:
            raise ConfigError(f"There is no lane {quoted(name)}; there are {', '.join(names)}.")
    if not lanes:
        raise ConfigError("No lane is named; name some, or none to cover all of them.")
    return [lane for lane in planting.lanes if lane.id in lanes]


def _both_ways(searcher: Searcher, lane: Lane) -> tuple[list[Pass | None], NoRouteError | None]:
    """The pass along a lane and the one against it; the reason when there is neither."""
    passes: list[Pass | None] = []
    why = None
    for backwards in (False, True):
        try:
            passes.append(drive_lane(searcher, lane, backwards=backwards))
        except NoRouteError as none:
            passes.append(None)
            why = why or none
    return passes, why if passes == [None, None] else None


def _unreached(ways: LaneWays, nodes: list[int], k: int, lane: Lane) -> OmittedLane:
    """Why a lane that could be driven is left out."""
    searcher = ways.searcher
    entries = [p.start for p in ways.passes[2 * k : 2 * k + 2] if p is not None]
    exits = [p.stop for p in (ways.passes[node] for node in nodes) if p is not None]
    origins: list[SearchPose] = ways.starts[:1] or exits
    place = (entries[0].x + searcher.ground.west_m, entries[0].y + searcher.ground.south_m)
    if not any(
        np.isfinite(searcher.distance_left(entry)[searcher.coarse_place(origin)])
        for origin in origins
        for entry in entries
    ):
        try:
            find_way(searcher, origins[:1], entries[:1], "to the lane", 1)
        except NoRouteError as none:
            return OmittedLane(lane.id, none.reason, none.east_m, none.north_m)
    reason = (
        "no way was found that leads to it from the other lanes and on, with a turning radius of "
        f"{searcher.vehicle.turning_radius_m:g} m"
        f"{'' if searcher.vehicle.reverse else ' and no reverse'}"
    )
    return OmittedLane(lane.id, reason, *place)


def _assembled(ways: LaneWays, nodes: list[int]) -> Float64:
    """Rows of x, y, yaw, gear, curvature and the number of the lane that is worked, from 1; 0 where
    none is."""
    end = len(ways.passes)
    parts: list[tuple[npt.NDArray[np.float64], int]] = []
    for a, b in zip([end, *nodes], [*nodes, end], strict=True):
        if (a, b) in ways.ways:
            parts.append((ways.ways[a, b], 0))
        passed = ways.passes[b] if b < end else None
        if passed is not None:
            parts.append((passed.samples, b // 2 + 1))
    return joined([np.column_stack([p, np.full(len(p), lane)]) for p, lane in parts])
