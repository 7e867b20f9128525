"""Coverage of fields of which everything is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely

from benchmarks.coverage import (
    best_of,
    driven,
    layout_view,
    least,
    points_on_barred,
    random_field,
)
from fieldgrid.core import ConfigError, Float64, NoRouteError
from fieldgrid.field import Coverage, Lane, Planting, Vehicle
from fieldgrid.field.coverage.passes import drive_lane
from fieldgrid.field.coverage.plan import coverage_in_view
from fieldgrid.field.route.plan import searcher_of
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import project
from fieldgrid.maps import MapView, Mark, MarkKind
from fieldgrid.maps.views.decision import marked_cells
from tests.field.route.test_plan import DATUM, SMALL, assert_holds, at, field, footprints

FORWARD = Vehicle(0.8, 0.4, 0.6, turning_radius_m=1.0, reverse=False, clearance_m=0.1)


def planted(
    rows: int = 4,
    *,
    obstacles: Sequence[tuple[float, float, float, float]] = (),
    unseen: Sequence[tuple[float, float, float, float]] = (),
) -> tuple[MapView, Planting]:
    """Rows of 12 m to the north, 2 m apart from 6 m east on, with 5 m of ground around them."""
    stand = [(5.8 + 2.0 * k, 5.0, 6.0 + 2.0 * k, 17.0) for k in range(rows)]
    view = field((2.0 * rows + 9.0, 22.0), [*stand, *obstacles], unseen)
    lanes = tuple(
        straight_lane(f"B1-L{k + 1}", at(6.9 + 2.0 * k, 5.5), at(6.9 + 2.0 * k, 16.5))
        for k in range(rows - 1)
    )
    return view, Planting(DATUM, view.bounds, 0.2, (), lanes, (), (), (), ())


def straight_lane(name: str, start: tuple[float, ...], stop: tuple[float, ...]) -> Lane:
    line = shapely.LineString([start, stop])
    area = line.buffer(1.0, cap_style="square")
    rows = (f"{name}-left", f"{name}-right")
    return Lane(name, "B1", rows, line, area, line.length, math.nan, np.zeros(0), 1.0, False)


def assert_covers(coverage: Coverage, view: MapView, planting: Planting) -> None:
    """Each lane is driven once, from where to where and in the direction that is said, between
    other lanes' poses none."""
    route = coverage.route
    assert_holds(route, view)
    assert points_on_barred(coverage, view) == 0
    places = np.column_stack([route.east_m, route.north_m])
    named = [name for name in route.lane.tolist() if name]
    assert list(dict.fromkeys(named)) == [lane.lane for lane in coverage.lanes]
    for worked in coverage.lanes:
        lane = planting.lane(worked.lane)
        assert lane is not None
        mine = np.flatnonzero(route.lane == worked.lane)
        assert (np.diff(mine) == 1).all()
        along, aside = project(places[mine[0] : mine[-1] + 2], np.asarray(lane.line.coords))
        assert np.abs(aside).max() < 0.7
        ends = along[[0, -1]] if not worked.against else along[[-1, 0]]
        assert ends == pytest.approx((worked.from_m, worked.to_m), abs=0.15)
        assert ends[0] < 1.2
        assert ends[1] > lane.length_m - 1.2
    said = {lane.lane for lane in coverage.lanes} | {lane.lane for lane in coverage.left_out}
    assert said == {lane.id for lane in planting.lanes}


@pytest.mark.parametrize("vehicle", [SMALL, FORWARD])
def test_all_lanes_once(vehicle: Vehicle) -> None:
    view, planting = planted()
    coverage = coverage_in_view(view, planting, vehicle)
    assert_covers(coverage, view, planting)
    assert not coverage.left_out
    assert not coverage.remedy
    assert len(coverage.lanes) == 3
    assert coverage.worked_m == pytest.approx(33.0, abs=0.1)
    # Half circles lead from lane to lane, whose distance is two radii.
    assert coverage.route.length_m == pytest.approx(33.0 + 2.0 * (math.pi + 1.0), rel=0.05)
    assert coverage.turning_share == pytest.approx(1.0 - 33.0 / coverage.route.length_m, abs=0.01)
    assert coverage.cost_m == pytest.approx(coverage.route.length_m, abs=1e-6)


def test_lanes_that_were_named_from_start_to_goal() -> None:
    view, planting = planted()
    start, goal = at(2.0, 3.0), at(14.0, 19.0, 90.0)
    coverage = coverage_in_view(
        view, planting, SMALL, lanes=["B1-L3", "B1-L1"], start=start, goal=goal
    )
    assert_covers(coverage, view, replace(planting, lanes=planting.lanes[::2]))
    route = coverage.route
    assert [lane.lane for lane in coverage.lanes] in (["B1-L1", "B1-L3"], ["B1-L3", "B1-L1"])
    assert math.dist((route.east_m[0], route.north_m[0]), start) < 1e-6
    assert math.dist((route.east_m[-1], route.north_m[-1]), goal[:2]) < 1e-6
    assert route.heading_deg[-1] == pytest.approx(90.0)


def test_a_lane_that_is_blocked_is_left_out_with_the_place() -> None:
    view, planting = planted(obstacles=[(8.0, 11.0, 9.8, 11.4)])
    coverage = coverage_in_view(view, planting, SMALL)
    assert_covers(coverage, view, planting)
    (left_out,) = coverage.left_out
    assert left_out.lane == "B1-L2"
    assert "stopped by an obstacle" in left_out.reason
    assert (left_out.east_m, left_out.north_m) == pytest.approx(at(8.9, 11.2), abs=1.1)
    with pytest.raises(NoRouteError, match="No lane can be covered; of B1-L2") as refused:
        coverage_in_view(view, planting, SMALL, lanes=["B1-L2"])
    assert "; give a smaller vehicle or --allow-unknown if " in str(refused.value)
    assert coverage.remedy.startswith("give a smaller vehicle or --allow-unknown if ")


def test_a_lane_with_a_keep_out_across_it_is_left_out_and_none_is_entered() -> None:
    view, planting = planted()
    corners = tuple(at(*place) for place in ((7.8, 10.0), (10.0, 10.0), (10.0, 11.0), (7.8, 11.0)))
    pond = Mark(MarkKind.KEEPOUT, corners)
    view = replace(view, marks=(pond,))
    coverage = coverage_in_view(view, planting, SMALL)
    (left,) = coverage.left_out
    assert left.lane == "B1-L2"
    assert "a keep-out mark" in left.reason
    assert coverage.remedy == "remove the mark with `fieldgrid mark --remove`"
    assert not shapely.intersects(footprints(coverage.route), pond.geometry).any()


def test_things_on_either_side_are_passed_inside_the_lane() -> None:
    """No straight line leads past both."""
    view, planting = planted(obstacles=[(6.0, 8.0, 6.8, 8.2), (7.2, 13.0, 8.0, 13.2)])
    coverage = coverage_in_view(view, planting, SMALL)
    assert_covers(coverage, view, planting)
    assert coverage.route.curvature_1pm[coverage.route.lane == "B1-L1"].any()
    assert not coverage.left_out


def test_an_end_that_was_not_seen() -> None:
    view, planting = planted(unseen=[(6.0, 14.0, 8.0, 22.0)])
    coverage = coverage_in_view(view, planting, SMALL)
    assert_covers(coverage, view, planting)
    (left_out,) = coverage.left_out
    assert left_out.lane == "B1-L1"
    assert "end of the lane" in left_out.reason
    assert "not seen" in left_out.reason
    everywhere = coverage_in_view(view, planting, SMALL, allow_unknown=True)
    assert not everywhere.left_out
    assert_holds(everywhere.route, view, allow_unknown=True)


def test_a_lane_behind_a_wall_cannot_be_reached() -> None:
    wall = [(9.8, 0.0, 10.0, 22.0)]
    view, planting = planted(obstacles=wall)
    coverage = coverage_in_view(view, planting, FORWARD)
    assert_covers(coverage, view, planting)
    assert [lane.lane for lane in coverage.left_out] == ["B1-L3"]
    assert "no path" in coverage.left_out[0].reason
    started = coverage_in_view(view, planting, SMALL, start=at(15.0, 3.0))
    assert [lane.lane for lane in started.lanes] == ["B1-L3"]
    assert {lane.lane for lane in started.left_out} == {"B1-L1", "B1-L2"}


def test_without_room_to_turn_one_lane_is_left() -> None:
    """A headland of 0.8 m: nothing turns there without reverse, nor goes back in a lane."""
    view, planting = planted(unseen=[(0.0, 0.0, 17.0, 4.2), (0.0, 17.8, 17.0, 22.0)])
    coverage = coverage_in_view(view, planting, FORWARD)
    assert_covers(coverage, view, planting)
    assert len(coverage.lanes) == 1
    assert all("turning radius of 1 m and no reverse" in out.reason for out in coverage.left_out)


def test_bent_lanes_are_followed() -> None:
    """Arcs about one centre; nothing but the middle is driven."""
    task = next(
        task
        for task in map(random_field, range(0, 90, 3))
        if any(bend_m(lane) > 0.5 for lane in task.planting.lanes)
    )
    searcher = searcher_of(task.view, task.vehicle, allow_unknown=False, curve=None)
    corner = searcher.ground.west_m, searcher.ground.south_m
    for lane in task.planting.lanes[:2]:
        for backwards in (False, True):
            way = drive_lane(searcher, lane, backwards=backwards)
            places = way.samples[:, :2] + corner
            assert np.abs(project(places, np.asarray(lane.line.coords))[1]).max() < 0.25
            assert (way.samples[:, 3] == 1.0).all()
            assert 0.0 < np.abs(way.samples[:, 4]).max() <= task.vehicle.curvature_1pm


def bend_m(lane: Lane) -> float:
    line: Float64 = np.asarray(lane.line.coords)
    return float(np.abs(project(line, line[[0, -1]])[1]).max())


def test_random_fields() -> None:
    """The benchmark's fields, a few of them; `python -m benchmarks.coverage` has hundreds."""
    for seed in (2, 9, 15):
        task = random_field(seed)
        coverage = coverage_in_view(task.view, task.planting, task.vehicle)
        assert_holds(coverage.route, task.view)
        assert points_on_barred(coverage, task.view) == 0
        assert not (task.is_open and coverage.left_out)


def test_no_order_is_cheaper() -> None:
    """In this field of the benchmark it is 3.8 % longer than the shortest."""
    task = random_field(80)
    coverage, best = coverage_in_view(task.view, task.planting, task.vehicle), best_of(task)
    assert not coverage.left_out
    assert coverage.cost_m == pytest.approx(best.cost_m, rel=1e-3)
    assert 0.999 * best.length_m < coverage.route.length_m < 1.05 * best.length_m


def test_the_recursion_of_the_benchmark() -> None:
    """Two things: the start is free, and the second is cheapest against its direction."""
    costs = np.full((5, 5), 9.0)
    costs[4, :4], costs[:4, 4] = 1.0, 0.0
    costs[0, 3] = 2.0
    assert least(costs, np.array([100.0, 100.0])) == 3.0


@pytest.mark.parametrize(
    ("lanes", "words"),
    [(["B1-L9"], "no lane 'B1-L9'; there are B1-L1, B1-L2, B1-L3"), ([], "No lane is named")],
)
def test_lanes_that_are_none(lanes: list[str], words: str) -> None:
    view, planting = planted()
    with pytest.raises(ConfigError, match=words):
        coverage_in_view(view, planting, SMALL, lanes=lanes)


def test_a_map_without_lanes() -> None:
    view = field()
    planting = Planting(DATUM, view.bounds, 0.2, (), (), (), (), (), ())
    with pytest.raises(ConfigError, match="No lanes were found"):
        coverage_in_view(view, planting, SMALL)


def test_lanes_that_were_driven_are_covered_whatever_noise_says(
    shared_data: Callable[[str], Path],
) -> None:
    """A layout of a real vineyard, a false obstacle each 20 m² and 3 % of the ground unseen."""
    shared_data("row_layouts")
    view = layout_view(7, is_noisy=True)
    planting = rows_of_view(view)
    view = driven(view, planting)
    vehicle = Vehicle(width_m=0.7, turning_radius_m=2.0, reverse=False)
    coverage = coverage_in_view(view, planting, vehicle)
    assert len(planting.lanes) > 8
    assert len(coverage.lanes) >= 0.9 * len(planting.lanes)
    free = marked_cells(view.marks, view.lattice, view.window) > 0
    rest = np.where(free, 0, view.density).astype(np.uint8)
    observed = np.ones_like(view.observed)  # holes may be pinholes
    assert points_on_barred(coverage, replace(view, density=rest, observed=observed)) == 0
