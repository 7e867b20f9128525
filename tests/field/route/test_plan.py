"""Routes over fields of which everything is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy import ndimage

from benchmarks.planting import DATUM
from benchmarks.routes import Task, random_task
from fieldgrid.core import ConfigError, NoRouteError
from fieldgrid.field import Route, Vehicle
from fieldgrid.field.route.ground import Ground
from fieldgrid.field.route.plan import remedy, route_in_view, searcher_of
from fieldgrid.field.route.verify import find_fault
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import CostCurve, MapView, Mark, MarkKind

CELL_M = 0.2
SMALL = Vehicle(
    front_m=0.8, rear_m=0.4, width_m=0.6, turning_radius_m=1.0, clearance_m=0.1, reverse=True
)


def field(
    size_m: tuple[float, float] = (20.0, 10.0),
    obstacles: Sequence[tuple[float, float, float, float]] = (),
    unseen: Sequence[tuple[float, float, float, float]] = (),
) -> MapView:
    """Free ground from (100, -50) on, with boxes (west, south, east, north from there)."""
    width, height = (round(v / CELL_M) for v in size_m)
    density = np.zeros((height, width), dtype=np.uint8)
    observed = np.ones((height, width), dtype=np.bool_)

    def cells(box: tuple[float, float, float, float]) -> tuple[slice, slice]:
        west, south, east, north = (round(v / CELL_M) for v in box)
        return slice(south, north), slice(west, east)

    for box in obstacles:
        density[cells(box)] = 200
    for box in unseen:
        observed[cells(box)] = False
    window = Window(round(100 / CELL_M), round(-50 / CELL_M), width, height)
    return MapView(Lattice(CELL_M), window, density, observed, DATUM, is_base=True)


def at(east_m: float, north_m: float, *heading_deg: float) -> tuple[float, ...]:
    """A place in such a field."""
    return (100.0 + east_m, -50.0 + north_m, *heading_deg)


def footprints(route: Route) -> shapely.Geometry:
    """What the vehicle covers in every pose, by the compass and not by the planner's yaw."""
    v, phi = route.vehicle, np.radians(route.heading_deg)
    wide = max(v.width_m, v.implement_width_m)
    corners = [(v.front_m, 0.5 * v.width_m), (v.front_m, -0.5 * v.width_m)]
    corners += [(0.0, -0.5 * wide), (-v.rear_m, -0.5 * wide), (-v.rear_m, 0.5 * wide)]
    corners += [(0.0, 0.5 * wide)]
    ahead, right = np.array(corners).T
    x = route.east_m[:, None] + ahead * np.sin(phi)[:, None] + right * np.cos(phi)[:, None]
    y = route.north_m[:, None] + ahead * np.cos(phi)[:, None] - right * np.sin(phi)[:, None]
    return shapely.convex_hull(shapely.polygons(np.stack([x, y], axis=2)))


def assert_holds(route: Route, view: MapView, *, allow_unknown: bool = False) -> None:
    """What every route promises, from its columns and the view alone."""
    shapes = footprints(route)
    barred = view.observed & (view.density > 100)
    if not allow_unknown:
        depth_m = ndimage.distance_transform_edt(~view.observed) * view.lattice.cell_m
        barred |= depth_m > route.vehicle.clearance_m + 1e-6
        bounds = view.bounds
        window = shapely.box(bounds.west_m, bounds.south_m, bounds.east_m, bounds.north_m)
        assert shapely.covers(window.buffer(1e-6), shapes).all()
    cell_m = view.lattice.cell_m
    j, i = np.nonzero(barred)
    west, south = (i + view.window.i0) * cell_m, (j + view.window.j0) * cell_m
    tree = shapely.STRtree(shapely.box(west, south, west + cell_m, south + cell_m))
    touched = tree.query(shapes, "dwithin", max(route.vehicle.clearance_m - 1e-6, 0.0))
    if route.vehicle.clearance_m == 0.0:
        touched = tree.query(shapely.buffer(shapes, -1e-6), "intersects")
    assert touched.shape[1] == 0
    # Curvature from three points of one gear; a chord of an arc is a little shorter.
    limit = 1.0 / route.vehicle.turning_radius_m
    assert np.abs(route.curvature_1pm).max() <= limit * (1.0 + 1e-9)
    east, north, gear = np.diff(route.east_m), np.diff(route.north_m), route.gear
    step = np.hypot(east, north)
    turn = np.radians((np.diff(route.heading_deg) + 180.0) % 360.0 - 180.0)
    assert (np.abs(2.0 * np.sin(0.5 * turn)) <= limit * step * (1.0 + 1e-6) + 1e-9).all()
    assert step.max() <= 0.1 + 1e-9
    # It moves along its nose, backwards where the gear says so, and stands where that changes.
    middle = np.radians(route.heading_deg[:-1]) + 0.5 * turn
    along = east * np.sin(middle) + north * np.cos(middle)
    moving = step > 1e-7
    assert np.allclose(along[moving], (gear[:-1] * step)[moving], atol=1e-6)
    assert set(np.unique(gear).tolist()) <= ({-1, 1} if route.vehicle.reverse else {1})
    assert not moving[np.diff(gear) != 0].any()
    # On an arc to the left the heading falls.
    bent = route.curvature_1pm[:-1] * gear[:-1] * step
    assert np.allclose(-2.0 * np.sin(0.5 * turn), bent, atol=1e-6)


def assert_ends(route: Route, task: Task) -> None:
    """It begins and ends where it was asked to."""
    for k, place in ((0, task.start), (-1, task.goal)):
        assert math.dist((route.east_m[k], route.north_m[k]), place[:2]) < 1e-6
        for heading in place[2:]:
            assert abs((route.heading_deg[k] - heading + 180.0) % 360.0 - 180.0) < 1e-6


def route_or_none(task: Task) -> Route | None:
    """A route, where there is one; none is refused by its own check."""
    try:
        return route_in_view(task.view, task.start, task.goal, task.vehicle, max_poses=8000)
    except NoRouteError as none:
        if "fails its check" in none.reason:
            raise
        return None


@pytest.mark.parametrize(
    "block", [0, 3, 6, *(pytest.param(n, marks=pytest.mark.long) for n in (1, 2, 4, 5, 7))]
)
def test_random_fields_are_never_touched(block: int) -> None:
    """Vehicles of all kinds, with and without reverse."""
    found = 0
    for seed in range(30 * block, 30 * block + 30):
        task = random_task(seed, size_m=(12.0, 25.0))
        route = route_or_none(task)
        if route is None:
            continue
        found += 1
        assert_holds(route, task.view)
        assert_ends(route, task)
        ground = Ground.of(task.view, CostCurve(), task.vehicle, allow_unknown=False, margin_m=10.0)
        assert find_fault(route.path, ground, task.vehicle) is None
    assert found >= 5


def test_the_field_that_once_broke_the_queue_of_distances() -> None:
    """Sums that were rounded after they were compared were queued without end."""
    task = random_task(61)
    route = route_in_view(task.view, task.start, task.goal, task.vehicle)
    assert_holds(route, task.view)


def test_straight_on_is_a_straight_line() -> None:
    view = field()
    route = route_in_view(view, at(2, 5, 90), at(17, 5, 90), SMALL)
    assert route.length_m == pytest.approx(15.0, abs=1e-6)
    assert route.turning_share == 0.0
    assert route.cusps == 0
    assert route.heading_deg == pytest.approx(90.0)
    # Metres to what was not seen: the border of the map, 5 m to either side, is farther than that.
    assert route.least_clearance_m >= 1.0
    assert route.geometry.length == pytest.approx(15.0)


def test_around_an_obstacle() -> None:
    view = field(obstacles=[(9, 0, 10, 7)])
    route = route_in_view(view, at(2, 3, 90), at(17, 3, 90), SMALL)
    assert_holds(route, view)
    assert 15.5 < route.length_m < 20.0
    assert 0.1 <= route.least_clearance_m < 0.6
    shapes = footprints(route)
    gaps = shapely.distance(shapes, shapely.box(109, -50, 110, -43))
    near = gaps < 0.9
    assert np.allclose(route.clearance_m[near], gaps[near], atol=1e-6)
    assert (route.clearance_m <= gaps + 1e-6).all()


def test_the_same_question_has_the_same_answer() -> None:
    view = field(obstacles=[(9, 0, 10, 7)])
    one, other = (route_in_view(view, at(2, 3), at(17, 3), SMALL) for _ in range(2))
    assert np.array_equal(one.east_m, other.east_m)
    assert np.array_equal(one.heading_deg, other.heading_deg)


def test_a_turn_needs_reverse_where_ground_is_narrow() -> None:
    # Half a turn forward takes 2.83 m: two radii, half the width, and where the nose comes to.
    view = field((12.0, 2.8))
    route = route_in_view(view, at(6, 1.4, 90), at(6, 1.4, -90), SMALL)
    assert route.cusps > 0
    assert route.reverse_share > 0.0
    assert_holds(route, view)
    with pytest.raises(NoRouteError, match="no reverse"):
        route_in_view(
            view, at(6, 1.4, 90), at(6, 1.4, -90),
            Vehicle(0.8, 0.4, 0.6, turning_radius_m=1.0, reverse=False),
        )  # fmt: skip


def test_half_a_turn_is_found_where_there_is_hardly_room_for_it() -> None:
    view = field((12.0, 3.2))  # 2.83 m and the clearance on both sides
    vehicle = Vehicle(0.8, 0.4, 0.6, turning_radius_m=1.0, clearance_m=0.1, reverse=False)
    route = route_in_view(view, at(6, 1.6, 90), at(6, 1.6, -90), vehicle)
    assert route.cusps == 0
    assert_holds(route, view)


def test_unseen_ground_is_entered_only_when_that_is_allowed() -> None:
    view = field(unseen=[(8, 0, 12, 10)])
    with pytest.raises(NoRouteError, match="ground that was not seen") as refused:
        route_in_view(view, at(2, 5, 90), at(17, 5, 90), SMALL)
    assert 107.5 < refused.value.east_m < 112.5
    assert f"at {refused.value.east_m:.2f},{refused.value.north_m:.2f}" in str(refused.value)
    assert "--allow-unknown" in str(refused.value)
    route = route_in_view(view, at(2, 5, 90), at(17, 5, 90), SMALL, allow_unknown=True)
    assert_holds(route, view, allow_unknown=True)
    assert route.length_m == pytest.approx(15.0, abs=1e-6)


def test_a_wall_is_named_with_its_place() -> None:
    view = field(obstacles=[(9, 0, 10, 10)])
    with pytest.raises(NoRouteError, match="stopped by an obstacle") as refused:
        route_in_view(view, at(2, 5, 90), at(17, 5, 90), SMALL)
    assert 108.5 < refused.value.east_m < 110.5


def test_a_map_that_is_too_large_for_memory_is_refused() -> None:
    """Before anything of its size is made."""
    nothing = np.lib.stride_tricks.as_strided(np.zeros(1, dtype=np.uint8), (10, 40_001), (0, 0))
    view = MapView(
        Lattice(CELL_M), Window(0, 0, 40_001, 10), nothing, nothing == 0, DATUM, is_base=True
    )
    with pytest.raises(ConfigError, match=r"give smaller --bounds or a larger --cell"):
        route_in_view(view, (2.0, 1.0), (9.0, 1.0), SMALL)


def test_the_narrowest_place_counts_for_the_widest_vehicle() -> None:
    """A gap of 1 m: a vehicle of 0.6 m with 0.1 m of clearance passes, one of 0.9 m does not."""
    view = field(obstacles=[(9, 0, 10, 4.4), (9, 5.4, 10, 10)])
    passed = route_in_view(view, at(2, 5, 90), at(17, 5, 90), SMALL)
    assert passed.least_clearance_m == pytest.approx(0.2, abs=0.1)
    with pytest.raises(NoRouteError):
        route_in_view(view, at(2, 5, 90), at(17, 5, 90), Vehicle(0.8, 0.5, 0.9))


def test_cells_are_decided_by_the_map_s_own_cells_in_them() -> None:
    """One obstacle cell in a larger one bars it, and one that was half seen is free."""
    plain = field()
    shape = plain.density.shape
    peak, share = np.zeros(shape, dtype=np.uint8), np.ones(shape, dtype=np.float32)
    layers = {"peak": peak, "seen_share": share}
    view = MapView(plain.lattice, plain.window, plain.density, plain.observed, DATUM, layers)
    share[:, 50] = 0.5
    assert route_in_view(view, at(2, 5, 90), at(17, 5, 90), SMALL).length_m > 14.0
    strict = CostCurve(least_seen=0.6)
    with pytest.raises(NoRouteError, match="not seen"):
        route_in_view(view, at(2, 5, 90), at(17, 5, 90), SMALL, curve=strict)
    peak[:, 50] = 101
    with pytest.raises(NoRouteError, match="an obstacle"):
        route_in_view(view, at(2, 5, 90), at(17, 5, 90), SMALL)


def test_no_route_leads_through_a_keep_out() -> None:
    """Not over free ground, and not over unseen ground beside the map, where that may be driven."""
    box = tuple(at(*corner) for corner in ((9, -3), (10, -3), (10, 8), (9, 8)))
    pond = Mark(MarkKind.KEEPOUT, box)
    view = replace(field(), marks=(pond,))
    route = route_in_view(view, at(2, 4, 90), at(17, 4, 90), SMALL)
    assert not shapely.intersects(footprints(route), pond.geometry).any()
    assert route.length_m > 15.5
    high = replace(view, marks=(pond._replace(corners=(*box[:2], at(10, 10), at(9, 10))),))
    with pytest.raises(NoRouteError, match=r"stopped by a keep-out mark .*fieldgrid mark --remove"):
        route_in_view(high, at(2, 4, 90), at(17, 4, 90), SMALL)
    around = route_in_view(high, at(2, 4, 90), at(17, 4, 90), SMALL, allow_unknown=True)
    assert not shapely.intersects(footprints(around), high.marks[0].geometry).any()


def test_what_helps_against_marks_and_obstacles_and_off_the_map() -> None:
    pond = Mark(MarkKind.KEEPOUT, tuple(at(*one) for one in ((9, 2), (10, 2), (10, 3), (9, 3))))
    view = replace(field(obstacles=[(14.0, 0.0, 14.2, 4.0)]), marks=(pond,))
    searcher = searcher_of(view, SMALL, allow_unknown=True, curve=None)
    remove = "remove the mark with `fieldgrid mark --remove`"
    assert remedy(searcher, [at(9.5, 2.5)]) == remove
    assert remedy(searcher, [at(14.1, 2.0)]) == "give a smaller vehicle"
    both = [at(9.5, 2.5), at(14.1, 2.0)]
    assert remedy(searcher, both) == f"give a smaller vehicle, or {remove}"
    for beyond in (at(-50, 5), at(5, -50), at(900, 5), at(5, 900)):
        assert remedy(searcher, [beyond]) == "give a smaller vehicle"


@pytest.mark.parametrize(
    ("start", "goal", "words"),
    [
        (at(2, 0.2, 90), at(17, 5), "The start is not free: .* ground that was not seen"),
        (at(2, 5, 90), at(9.5, 5), "The goal, with any heading, is not free: .* an obstacle"),
        (at(2, 5, 90), at(900, 5), "The goal.* is off the map, which spans"),
    ],
)
def test_ends_that_are_not_free(
    start: tuple[float, ...], goal: tuple[float, ...], words: str
) -> None:
    with pytest.raises(NoRouteError, match=words):
        route_in_view(field(obstacles=[(9, 4, 10, 6)]), start, goal, SMALL)


@pytest.mark.parametrize(
    ("start", "goal", "words"),
    [
        ((1.0,), (2.0, 3.0), "not a position"),
        ((1.0, math.nan), (2.0, 3.0), "not a position"),
        ((1.0, 2.0, 3.0, 4.0), (2.0, 3.0), "not a position"),
        (at(2, 5), at(2, 5, 90), "give two places"),
        (at(2, 5, 90), at(2, 5, 450), "give two places"),
    ],
)
def test_places_that_cannot_be(
    start: tuple[float, ...], goal: tuple[float, ...], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        route_in_view(field(), start, goal, SMALL)
