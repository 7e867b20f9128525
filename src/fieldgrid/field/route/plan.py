"""`plan_route`: a way that a vehicle can drive over what a map has seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
import numpy.typing as npt
import shapely

from fieldgrid.core import ConfigError, Float32, Float64, Int64, NoRouteError, counted, shortened
from fieldgrid.field.route.ground import SLOPE_LAYERS, Ground
from fieldgrid.field.route.path import Path
from fieldgrid.field.route.search import MAX_STATES, Searcher, SearchPose
from fieldgrid.field.route.vehicle import Vehicle
from fieldgrid.field.route.verify import Fault, find_fault, slope_fault, swept_hulls
from fieldgrid.geometry import Bounds, Datum, wrap_deg, yaw_from_heading_rad
from fieldgrid.maps import CostCurve, MapFile, MapView, open_map

USUAL_CELL_M = 0.1
"""Cells that a route is planned on, where the map's own are smaller: stereo leaves pinholes in the
smallest cells of ground that it has seen."""

NEAR_M = 1.0
"""Clearances are exact up to here, and at least this beyond."""

_HEADINGS = 24
_MOST_NAMED = 3
"""Cells that a refusal names, and frames that saw one."""


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A way in the plane of a datum, poses a decimetre apart or less, arrays [n].

    Metres east and north of the vehicle's reference point; heading of its nose in degrees
    clockwise from north; gear, 1 or -1, and curvature (1/m, positive to the left of the nose) of
    the stretch that begins at each pose; clearance from the footprint to the nearest obstacle or
    unseen cell in metres, exact up to 1 m and a lower bound above; the lane that is worked on the
    stretch that begins there, empty where none is. Where the gear changes, two poses are the same.
    """

    datum: Datum
    vehicle: Vehicle
    east_m: Float64
    north_m: Float64
    heading_deg: Float64
    gear: Int64
    curvature_1pm: Float64
    clearance_m: Float64
    lane: npt.NDArray[np.str_]

    @property
    def path(self) -> Path:
        """The poses alone."""
        return Path(self.east_m, self.north_m, self.heading_deg, self.gear, self.curvature_1pm)

    @property
    def geometry(self) -> shapely.LineString:
        """The way of the reference point, metres east and north."""
        return shapely.LineString(np.column_stack([self.east_m, self.north_m]))

    @property
    def length_m(self) -> float:
        """The distance driven, forward and in reverse."""
        return float(self.path.steps_m.sum())

    @property
    def turning_share(self) -> float:
        """The share of the length that is driven on arcs, 0..1."""
        return float(self.path.steps_m[self.curvature_1pm[:-1] != 0.0].sum()) / self.length_m

    @property
    def reverse_share(self) -> float:
        """The share of the length that is driven backwards, 0..1."""
        return float(self.path.steps_m[self.gear[:-1] < 0].sum()) / self.length_m

    @property
    def cusps(self) -> int:
        """How often the gear changes."""
        return int(np.count_nonzero(np.diff(self.gear)))

    @property
    def least_clearance_m(self) -> float:
        """The least of the clearances."""
        return float(self.clearance_m.min())


def plan_route(
    universal: MapFile | str | FilePath,
    start: tuple[float, ...],
    goal: tuple[float, ...],
    vehicle: Vehicle | None = None,
    *,
    allow_unknown: bool = False,
    cell_m: float | None = None,
    bounds: Bounds | None = None,
    curve: CostCurve | None = None,
    at: str | int | None = None,
) -> Route:
    """A way from `start` to `goal` that a vehicle can drive, over seen free ground.

    Places are (east_m, north_m) or (east_m, north_m, heading_deg), metres of the map and degrees
    clockwise from north; without a heading any will do. What the footprint sweeps keeps the
    vehicle's clearance to every obstacle and, but for `allow_unknown`, keeps off ground that was
    not seen, but for pinholes that are no wider than two clearances. Ground that is known to be
    steeper than the vehicle's limits for its heading is not driven. Cells are decided by the map's
    own cells in them, as `CostCurve` says; `cell_m` is their size, by default the smallest multiple
    of the map's own from 0.1 m up.
    `bounds` keeps the route in a part of the map; `at` is a session or a date.

    Raises NoRouteError, with the reason and the place, when there is no such way; ConfigError for
    what cannot be asked.
    """
    if not isinstance(universal, MapFile):
        with open_map(universal) as opened:
            return plan_route(
                opened, start, goal, vehicle, allow_unknown=allow_unknown, cell_m=cell_m,
                bounds=bounds, curve=curve, at=at,
            )  # fmt: skip
    vehicle = vehicle or Vehicle()
    view = planning_view(universal, cell_m, bounds, at)
    return route_in_view(
        view, start, goal, vehicle, allow_unknown=allow_unknown, curve=curve, universal=universal
    )


def planning_view(
    universal: MapFile, cell_m: float | None, bounds: Bounds | None, at: str | int | None
) -> MapView:
    """What :func:`plan_route` reads of a map."""
    own = universal.cell_m
    size = own * max(1, math.ceil(USUAL_CELL_M / own - 1e-9)) if cell_m is None else cell_m
    return universal.read(bounds, size, layers=SLOPE_LAYERS, at=at, decide="density")


class _TooSteepError(NoRouteError):
    """There would be a way, were all ground level."""


def route_in_view(
    view: MapView,
    start: tuple[float, ...],
    goal: tuple[float, ...],
    vehicle: Vehicle | None = None,
    *,
    allow_unknown: bool = False,
    curve: CostCurve | None = None,
    max_poses: int = MAX_STATES,
    universal: MapFile | None = None,
) -> Route:
    """Plan a route as :func:`plan_route` does, in a view that was read to decide. `max_poses` is
    the largest number of poses that are searched. With the map of the view, a refusal names the
    weak cells that block."""
    for name, place in (("start", start), ("goal", goal)):
        check_place(name, place)
    if math.dist(start[:2], goal[:2]) < 1e-3 and (
        min(len(start), len(goal)) == 2 or wrap_deg(start[2] - goal[2]) == 0.0
    ):
        raise ConfigError(
            f"The start and the goal are both {start[0]:g},{start[1]:g}; give two places."
        )
    searcher = searcher_of(view, vehicle or Vehicle(), allow_unknown=allow_unknown, curve=curve)

    def way(on: Searcher) -> Float64:
        starts = free_poses(on, start, "start", view.bounds)
        goals = free_poses(on, goal, "goal", view.bounds)
        return find_way(on, starts, goals, "from the start to the goal", max_poses)

    try:
        samples = way(searcher)
    except _TooSteepError:
        raise
    except NoRouteError as none:
        helps = weak_cells(searcher, way, universal)
        if not helps:
            raise
        raise NoRouteError(none.reason, none.east_m, none.north_m, helps) from none
    return checked_route(searcher, samples, np.full(len(samples), ""), view.datum)


def weak_cells(
    searcher: Searcher, way: Callable[[Searcher], Float64], universal: MapFile | None
) -> str:
    """The weak obstacle cells that stand alone on a way that would be free without them, the frames
    that saw them and the marks that free them; '' where that does not help, or the shortest such
    way is too steep."""
    ground, vehicle = searcher.ground, searcher.vehicle
    without = ground.without_weak()
    j, i = np.nonzero(ground.blocked != without.blocked)
    if universal is None or not len(j):
        return ""
    try:
        samples = way(Searcher(without.level, vehicle))
    except NoRouteError:
        return ""
    path = Path.of_samples(samples, ground.west_m, ground.south_m)
    if slope_fault(path, ground, vehicle) is not None:
        return ""
    hulls, bulge_m = swept_hulls(path, vehicle)
    west, south = ground.west_m + i * ground.cell_m, ground.south_m + j * ground.cell_m
    boxes = shapely.box(west, south, west + ground.cell_m, south + ground.cell_m)
    _, met = shapely.STRtree(boxes).query(hulls, "dwithin", vehicle.clearance_m + bulge_m)
    cells, marks = [], []
    for box in boxes[np.unique(met)[:_MOST_NAMED]]:
        # Of the map's own cells in it, the one that decided.
        view = universal.read(Bounds(*box.bounds))
        row, column = np.unravel_index(int(view.density.argmax()), view.density.shape)
        east_m, north_m = view.lattice.centres(view.window)
        found = universal.query(float(east_m[column]), float(north_m[row]))
        seen = [one for one in found.contributions if one.density > ground.obstacle_above]
        frames = ", ".join(f"{one.session} {one.frame_id}" for one in seen[:_MOST_NAMED])
        cells.append(
            f"{found.east_m:.2f},{found.north_m:.2f} (density {found.density}, seen by "
            f"{len(seen)} of {counted(len(found.contributions), 'frame')}: {frames})"
        )
        # A mark frees what lies in it with all of itself.
        corners = shapely.get_coordinates(shapely.box(*box.buffer(0.01).bounds))[:-1]
        marks.append(
            f"`fieldgrid mark {universal.path.name} --kind free --polygon "
            f'"{";".join(f"{east:.2f},{north:.2f}" for east, north in corners)}"`'
        )
    if not cells:
        return ""
    return (
        f"there is a way if nothing stands at {' and '.join(cells)}; "
        f"where that is so, run {' and '.join(marks)}"
    )


def searcher_of(
    view: MapView, vehicle: Vehicle, *, allow_unknown: bool, curve: CostCurve | None
) -> Searcher:
    """What plans on a view for a vehicle."""
    # Beyond what was read nothing was seen; where that may be driven, there is room for a turn.
    around = 2.0 * (vehicle.turning_radius_m + vehicle.reach_m) if allow_unknown else 0.0
    margin = NEAR_M + vehicle.clearance_m + vehicle.reach_m + around
    ground = Ground.of(
        view, curve or CostCurve(), vehicle, allow_unknown=allow_unknown, margin_m=margin
    )
    return Searcher(ground, vehicle)


def find_way(
    searcher: Searcher, starts: list[SearchPose], goals: list[SearchPose], what: str, max_poses: int
) -> Float64:
    """A way from one of the starts to one of the goals, as rows of x, y, yaw, gear, curvature;
    `what` says in words from where to where. Raises NoRouteError where there is none."""
    ground, vehicle = searcher.ground, searcher.vehicle
    left_m = searcher.distance_left(goals[0])
    if not math.isfinite(left_m[searcher.coarse_place(starts[0])]):
        x, y = searcher.bottleneck(starts[0], goals[0])
        east, north = ground.nearest_blocked(x + ground.west_m, y + ground.south_m)
        raise NoRouteError(
            f"There is no path {what} for a vehicle {vehicle.width_m:g} m wide, "
            f"which is stopped by {ground.what_is_at(east, north)}",
            east, north, remedy(searcher, [(east, north)], _OTHER_PLACES),
        )  # fmt: skip
    found = searcher.search(starts, goals, left_m, max_poses)
    if not len(found.samples):
        fault = _slope_in_the_way(searcher, starts, goals, left_m, max_poses)
        if fault is not None:
            place = fault.east_m, fault.north_m
            helps = remedy(searcher, [place], "a vehicle that takes steeper ground")
            raise _TooSteepError(
                f"No way was found {what} but one on which {fault.reason}", *place, helps
            )
        searched = "no path exists" if found.exhausted else "no path was found in time"
        east, north = found.nearest.x + ground.west_m, found.nearest.y + ground.south_m
        raise NoRouteError(
            f"A disc inside the vehicle could pass {what}, but {searched} that the whole vehicle "
            f"of {vehicle.front_m + vehicle.rear_m:g} m by {vehicle.width_m:g} m can drive, with a "
            f"clearance of {vehicle.clearance_m:g} m and a turning radius of "
            f"{vehicle.turning_radius_m:g} m{'' if vehicle.reverse else ', and no reverse'}; the "
            "search came nearest",
            east, north, remedy(searcher, [(east, north)], _OTHER_PLACES),
        )  # fmt: skip
    return found.samples


def _slope_in_the_way(
    searcher: Searcher,
    starts: list[SearchPose],
    goals: list[SearchPose],
    left_m: Float32,
    max_poses: int,
) -> Fault | None:
    """What is too steep on a way that there would be, were all ground level."""
    ground, vehicle = searcher.ground, searcher.vehicle
    if not ground.rises.size:
        return None
    samples = Searcher(ground.level, vehicle).search(starts, goals, left_m, max_poses).samples
    if not len(samples):
        return None
    return slope_fault(Path.of_samples(samples, ground.west_m, ground.south_m), ground, vehicle)


def remedy(searcher: Searcher, places_m: Sequence[tuple[float, float]], first: str = "") -> str:
    """What may help against what blocks a vehicle near some places, metres east and north; `first`
    is what else does."""
    ground = searcher.ground
    unmarked = [place for place in places_m if not ground.is_marked(*place)]
    helps = [first] if first else []
    if unmarked:
        helps.append("a smaller vehicle")
        if ground.is_unseen_blocked:
            helps.append("--allow-unknown if the unseen ground is known to be free")
    listed = " or ".join([", ".join(helps[:-1]), helps[-1]] if helps[:-1] else helps)
    ways = [f"give {listed}"] if helps else []
    if len(unmarked) < len(places_m):
        ways.append("remove the mark with `fieldgrid mark --remove`")
    return ", or ".join(ways)


_OTHER_PLACES = "another start or goal"


def checked_route(
    searcher: Searcher, samples: Float64, lane: npt.NDArray[np.str_], datum: Datum
) -> Route:
    """The route of a way, when it passes the check that shares nothing with its making; `lane` [n]
    is the lane that is worked from each pose on. Raises NoRouteError when it fails."""
    ground, vehicle = searcher.ground, searcher.vehicle
    path = Path.of_samples(samples, ground.west_m, ground.south_m)
    fault = find_fault(path, ground, vehicle)
    if fault is not None:
        raise NoRouteError(
            f"The planned route fails its check: {fault.reason}",
            fault.east_m, fault.north_m, "report this with the map",
        )  # fmt: skip
    return Route(datum, vehicle, *path, searcher.gaps_m(samples[:, :3], NEAR_M), lane)


def standing_fault(searcher: Searcher, pose: Float64) -> Fault:
    """Why a vehicle cannot stand in a pose [3] that is not free."""
    ground = searcher.ground
    path = Path.of_samples(np.array([[*pose, 1.0, 0.0]]), ground.west_m, ground.south_m)
    fault = find_fault(path, ground, searcher.vehicle)
    return fault or Fault("something is too near", float(path.east_m[0]), float(path.north_m[0]))


def check_place(name: str, place: tuple[float, ...]) -> None:
    """Raise ConfigError for numbers that are no place; `name` says what it is for."""
    if len(place) not in (2, 3) or not all(math.isfinite(value) for value in place):
        raise ConfigError(
            f"A {name} of {shortened(repr(place), 60)} is not a position; give metres east and "
            "north, and a heading in degrees if it matters."
        )


def free_poses(
    searcher: Searcher, place: tuple[float, ...], name: str, seen: Bounds
) -> list[SearchPose]:
    """The poses at a place in which the vehicle may stand: one, or those of all headings. Raises
    NoRouteError where there is none."""
    ground = searcher.ground
    headings = place[2:] or tuple(np.arange(_HEADINGS) * 360.0 / _HEADINGS)
    yaws = yaw_from_heading_rad(np.array(headings))
    x, y = place[0] - ground.west_m, place[1] - ground.south_m
    poses = np.column_stack([np.full((len(yaws), 2), (x, y)), yaws])
    free = searcher.is_free(poses)
    if free.any():
        return [SearchPose(*pose) for pose in poses[free].tolist()]
    west, south, east, north = ground.bounds_m
    what = f"The {name}{'' if len(place) == 3 else ', with any heading,'}"
    if not (west < place[0] < east and south < place[1] < north):
        raise NoRouteError(
            f"{what} is off the map, which spans {seen.west_m:.1f}..{seen.east_m:.1f} m east and "
            f"{seen.south_m:.1f}..{seen.north_m:.1f} m north,",
            place[0], place[1], "give another position",
        )  # fmt: skip
    fault = standing_fault(searcher, poses[0])
    raise NoRouteError(
        f"{what} is not free: {fault.reason}", fault.east_m, fault.north_m,
        remedy(searcher, [(fault.east_m, fault.north_m)], "another position or heading"),
    )  # fmt: skip
