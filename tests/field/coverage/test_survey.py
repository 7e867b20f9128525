"""Where to drive next, on fields of which it is known what was not seen."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import shapely

from benchmarks.planting import Sight
from benchmarks.survey import shortest_m
from fieldgrid.core import ConfigError
from fieldgrid.field import Vehicle
from fieldgrid.field.coverage.survey import SurveyPlan, need_features, survey_in_view
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import resampled
from fieldgrid.maps import MapView
from tests.field.rows.fields import Array, straight, view_of

SMALL = Vehicle(0.8, 0.4, 0.7, turning_radius_m=1.5)


def seen(rows: Sequence[Array], lanes: Sequence[bool], **more: object) -> MapView:
    """What a map has when these lanes were driven, each of which shows the faces beside it; the
    first one is to the left of the first row, the last one to the right of the last."""
    sides = [(lanes[k], lanes[k + 1]) for k in range(len(rows))]
    sight = Sight(sides=sides, noise_per_m2=0.0, hole_share=0.0, margin_m=6.0, headland_m=6.0)
    view = view_of(rows, sight, **more)  # type: ignore[arg-type]
    return replace(view, layers={"count": np.where(view.observed, 5, 0)})


def middles(rows: Sequence[Array], spacing_m: float) -> list[shapely.LineString]:
    """The middles of the lanes, and of the ground beside the outer rows."""
    lines = [shapely.offset_curve(shapely.LineString(rows[0]), 0.5 * spacing_m)]
    return lines + [shapely.offset_curve(shapely.LineString(row), -0.5 * spacing_m) for row in rows]


def driven(plan: SurveyPlan, lane: shapely.LineString) -> float:
    """The share of a lane along which the tour works one."""
    route = plan.coverage.route
    places = np.column_stack([route.east_m, route.north_m])[route.lane != ""]
    way = shapely.MultiPoint(places)
    points = shapely.points(resampled(np.asarray(lane.coords), 0.5))
    return float((shapely.distance(points, way) < 0.5).mean())


@pytest.fixture(scope="module")
def plan() -> SurveyPlan:
    """Of five lanes beside four rows, the second and the third were driven."""
    view = seen(straight(4, 25.0, 2.5, 30.0), (False, True, True, False, False))
    return survey_in_view(view, rows_of_view(view), SMALL)


def test_unseen_lanes_and_sides_are_driven(plan: SurveyPlan) -> None:
    """The row between two lanes that were not seen was not found; the side of the last one that
    was is driven, and so is the outer side of the first."""
    lanes = middles(straight(4, 25.0, 2.5, 30.0), 2.5)
    assert [driven(plan, lane) > 0.9 for lane in lanes] == [True, False, False, True, False]
    assert [lane.lane for lane in plan.coverage.lanes] in (
        ["B1-R1-left", "B1-R3-right"],
        ["B1-R3-right", "B1-R1-left"],
    )
    assert not plan.coverage.left_out
    assert plan.share > 0.9


def test_the_tour_keeps_off_rows_that_were_found(plan: SurveyPlan) -> None:
    route = plan.coverage.route
    for row in straight(4, 25.0, 2.5, 30.0)[:3]:
        assert shapely.LineString(row).distance(route.geometry) > 0.5 * SMALL.width_m


def test_needs_are_areas_with_a_figure_each(plan: SurveyPlan) -> None:
    by_kind = {kind: [n for n in plan.needs if n.kind == kind] for kind in ("unseen", "side")}
    lanes = {need.lane: need for need in by_kind["unseen"] if "headland" not in need.lane}
    for name in ("B1-R1-left", "B1-R3-right"):
        # As long as the row but for half a spacing, as wide as from its face to half a spacing on.
        assert lanes[name].area_m2 == pytest.approx(23.75 * (2.5 - 0.35), rel=0.1)
        assert lanes[name].share > 0.95
    for need in plan.needs:
        assert need.area_m2 == pytest.approx(need.area.area)
        assert 0.0 < need.share <= 1.0
    assert {(n.lane, n.why) for n in by_kind["side"]} == {
        ("B1-R1-left", "B1-R1 was seen from one side"),
        ("B1-R3-right", "B1-R3 was seen from one side"),
    }
    features = need_features(plan)
    assert [f.properties["area_m2"] for f in features] == [n.area_m2 for n in plan.needs]
    assert [f.properties["need"] for f in features] == [n.kind for n in plan.needs]


def test_ground_of_one_frame_doubtful_cells_and_old_drives() -> None:
    rows = straight(4, 20.0, 2.5)
    view = seen(rows, (True,) * 5)
    east, north = view.lattice.centres(view.window)
    once = (np.abs(east - 1.25)[None, :] < 0.4) & (np.abs(north - 10.0)[:, None] < 3.0)
    doubtful = (np.abs(east - 6.25)[None, :] < 0.3) & (np.abs(north - 5.0)[:, None] < 1.0)
    count = np.where(once, 1, view.layer("count"))
    density = np.where(doubtful, 80, view.density).astype(np.uint8)
    view = replace(view, density=density, layers={"count": count})
    planting = rows_of_view(replace(view, density=np.where(density > 100, density, 0)))
    lanes = tuple(
        lane._replace(sessions=("may", "june") if lane.id == "B1-L2" else ("may",))
        for lane in planting.lanes
    )
    plan = survey_in_view(view, replace(planting, lanes=lanes), SMALL, old_days={"may": 400.0})
    found = {(n.kind, n.lane): n for n in plan.needs if n.area_m2 > 0.8}
    assert found["once", "B1-L1"].area_m2 == pytest.approx(0.8 * 6.0, rel=0.1)
    assert found["doubtful", "B1-L3"].area_m2 == pytest.approx(0.6 * 2.0, rel=0.15)
    assert {lane for kind, lane in found if kind == "old"} == {"B1-L1", "B1-L3"}
    assert found["old", "B1-L1"].why == "the last drive here was 400 days ago"
    assert {lane.lane for lane in plan.coverage.lanes} == {"B1-L1", "B1-L3"}


def test_nothing_to_see_is_said() -> None:
    view = seen(straight(3, 20.0, 2.5), (True,) * 4)
    with pytest.raises(ConfigError, match="no further drive is needed"):
        survey_in_view(view, rows_of_view(view), SMALL)


def random_layout(seed: int) -> tuple[list[Array], float, list[bool]]:
    """Rows of which each was seen from one side at least, and which lanes were driven."""
    rng = np.random.default_rng(seed)
    count, spacing = int(rng.integers(3, 8)), float(rng.uniform(2.2, 3.0))
    rows = straight(count, float(rng.uniform(15.0, 30.0)), spacing, float(rng.uniform(0, 360)))
    while True:
        lanes = (rng.random(count + 1) < 0.6).tolist()
        unseen = lanes.count(False)
        if 2 <= unseen <= 4 and all(a or b for a, b in itertools.pairwise(lanes)):
            return rows, spacing, lanes


def test_the_tour_is_hardly_longer_than_the_shortest_that_sees_all() -> None:
    """All orders and directions of the lanes that were not seen, on ways planned between every two:
    1.000 of it on each of these."""
    ratios = []
    for seed in range(12):
        rows, spacing, lanes = random_layout(seed)
        view = seen(rows, lanes)
        planting = rows_of_view(view)
        plan = survey_in_view(view, planting, SMALL)
        for middle, was_seen in zip(middles(rows, spacing), lanes, strict=True):
            assert (driven(plan, middle) > 0.85) is not was_seen, (seed, lanes)
        least_m = shortest_m(view, planting, plan)
        worked_m = sum(lane.to_m - lane.from_m for lane in plan.coverage.lanes)
        assert plan.coverage.route.length_m > worked_m
        ratios.append(plan.coverage.route.length_m / least_m)
    assert max(ratios) <= 1.02
