"""Slopes and steps that a vehicle takes, and those that it does not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from fieldgrid.core import Float64, NoRouteError
from fieldgrid.field import Route, plan_route
from fieldgrid.field.coverage.plan import coverage_in_view
from fieldgrid.field.route.plan import route_in_view, searcher_of
from fieldgrid.field.route.verify import find_fault
from fieldgrid.geometry import GROUND_CHANNEL, Pose
from fieldgrid.maps import MapView, open_map
from tests.field.coverage.test_plan import planted
from tests.field.route.test_plan import SMALL, at, field
from tests.field.rows.fields import write_map
from tests.maps.file.maps import DATUM
from tests.maps.layers.test_ground import grid, hillside


def leaning(view: MapView, east: Float64, north: Float64) -> MapView:
    """A view of ground that rises to east and north by so much a metre, NaN where not known."""
    slope = np.degrees(np.arctan(np.hypot(east, north))).astype(np.float32)
    aspect = np.degrees(np.arctan2(-east, -north)).astype(np.float32)
    return replace(view, layers={**view.layers, "slope": slope, "aspect": aspect})


def tilted(view: MapView, slope_deg: float, falls_deg: float, part: object = ...) -> MapView:
    """A view of level ground, of which a part falls toward a direction."""
    fall, toward = math.tan(math.radians(slope_deg)), math.radians(falls_deg)
    rises = np.zeros((2, *view.window.shape))
    rises[:, *(part if isinstance(part, tuple) else (part,))] = -fall * np.array(
        [math.sin(toward), math.cos(toward)]
    ).reshape(2, 1, 1)
    return leaning(view, rises[0], rises[1])


@pytest.mark.parametrize("falls_deg", [90.0, -90.0, 0.0, 180.0, 37.0])
def test_a_slope_is_driven_up_and_down_and_not_across(falls_deg: float) -> None:
    """18° are below the limit along the way, 20°, and above that across it, 15°."""
    view = tilted(field((20.0, 20.0)), 18.0, falls_deg)
    fall = np.array([math.sin(math.radians(falls_deg)), math.cos(math.radians(falls_deg))])
    for way, heading_deg in ((fall, falls_deg), (-fall, falls_deg + 180.0)):
        ends = (at(*(10.0 + s * 7.0 * way), heading_deg) for s in (-1, 1))
        route = route_in_view(view, *ends, SMALL)
        assert route.length_m == pytest.approx(14.0, abs=1e-6)
    for sign in (1, -1):
        across = sign * fall[::-1] * (1, -1)
        heading_deg = math.degrees(math.atan2(*across))
        start, goal = (at(*(10.0 + s * 5.0 * across), heading_deg) for s in (-1, 1))
        with pytest.raises(NoRouteError, match=r"not free: a slope of 17\.\d° across the way"):
            route_in_view(view, start, goal, SMALL)
        with pytest.raises(
            NoRouteError, match=r"No way was found .* across the way is over .* 15°"
        ):
            route_in_view(view, start[:2], goal[:2], SMALL, max_poses=5000)


def test_ground_that_is_too_steep_across_is_driven_around_or_aslant() -> None:
    view = tilted(field(), 18.0, 0.0, np.s_[:30, 40:60])
    route = route_in_view(view, at(2, 3, 90), at(18, 3, 90), SMALL)
    assert route.length_m > 16.2
    inside = (np.abs(route.east_m - 110.0) < 1.4) & (route.north_m < -50.0 + 5.3)
    across = math.tan(math.radians(18.0)) * np.abs(np.sin(np.radians(route.heading_deg[inside])))
    assert np.degrees(np.arctan(across)).max(initial=0.0) < 15.0 + 0.5
    free = route_in_view(view, at(2, 3, 90), at(18, 3, 90), replace(SMALL, slope_across_deg=25.0))
    assert free.length_m == pytest.approx(16.0, abs=1e-6)


def test_ground_that_is_too_steep_for_any_heading_blocks_like_an_obstacle() -> None:
    """No part of the vehicle enters it; it stops where it crosses the whole field."""
    bank = tilted(field(), 35.0, 90.0, np.s_[:30, 40:60])
    route = route_in_view(bank, at(2, 3, 90), at(18, 3, 90), SMALL)
    on_slope = (route.east_m > 108.8) & (route.east_m < 111.2)
    assert (route.north_m[on_slope] > -50.0 + 6.2).all()
    across = tilted(field(), 35.0, 90.0, np.s_[:, 40:60])
    with pytest.raises(NoRouteError, match=r"stopped by a slope of 3\d\.\d°") as refused:
        route_in_view(across, at(2, 3, 90), at(18, 3, 90), SMALL)
    assert 107.0 < refused.value.east_m < 113.0


def assert_within(route: Route, view: MapView, slack_deg: float) -> None:
    """No pose of a route is steeper than the limits, by the layers of the view."""
    corner_m, cell_m = np.array([view.bounds.south_m, view.bounds.west_m]), view.lattice.cell_m
    axes = [
        start + (np.arange(n) + 0.5) * cell_m
        for start, n in zip(corner_m, view.window.shape, strict=True)
    ]
    phi, v = np.radians(route.heading_deg), route.vehicle
    ahead = 0.5 * (v.front_m - v.rear_m)
    places = np.column_stack(
        [route.north_m + ahead * np.cos(phi), route.east_m + ahead * np.sin(phi)]
    )
    fall = np.tan(np.radians(view.layer("slope")))
    aspect = np.radians(view.layer("aspect"))
    to_east, to_north = (
        RegularGridInterpolator(axes, -fall * part)(places)
        for part in (np.sin(aspect), np.cos(aspect))
    )
    along = to_east * np.sin(phi) + to_north * np.cos(phi)
    across = to_east * np.cos(phi) - to_north * np.sin(phi)
    for rise, most_deg in ((along, v.slope_along_deg), (across, v.slope_across_deg)):
        assert np.degrees(np.arctan(np.abs(rise))).max() < most_deg + slack_deg


@pytest.mark.parametrize("seed", range(6))
def test_no_pose_is_steeper_than_the_limits_on_random_hills(seed: int) -> None:
    """Waves of several lengths; a route may be steeper by the sigma of a slope, and by what a
    wave is steeper in its middle than on average under the vehicle."""
    random = np.random.default_rng(seed)
    plain = field((24.0, 24.0))
    east_m, north_m = plain.lattice.centres(plain.window)
    to_east, to_north = np.zeros((2, *plain.window.shape))
    for length_m in (11.0, 17.0, 29.0):
        toward, phase = random.uniform(0.0, 2.0 * np.pi, 2)
        x, y = math.sin(toward), math.cos(toward)
        rise = 0.16 * np.cos((x * east_m + y * north_m[:, None]) * 2.0 * np.pi / length_m + phase)
        to_east, to_north = to_east + x * rise, to_north + y * rise
    view = leaning(plain, to_east, to_north)
    vehicle = replace(SMALL, slope_along_deg=12.0, slope_across_deg=8.0, reverse=bool(seed % 2))
    found = 0
    for _ in range(12):
        ends = random.uniform(2.0, 22.0, (2, 2))
        try:
            route = route_in_view(view, at(*ends[0]), at(*ends[1]), vehicle, max_poses=8000)
        except NoRouteError as none:
            if "fails its check" in none.reason:
                raise
            continue
        found += 1
        assert_within(route, view, 1.2)
    assert found >= 2


def test_the_check_finds_a_slope_that_the_planner_did_not_know_of() -> None:
    level = field()
    route = route_in_view(level, at(2, 5, 90), at(18, 5, 90), SMALL)
    for slope_deg, falls_deg, words in (
        (18.0, 0.0, "across the way"),
        (24.0, 90.0, "along the way"),
        (18.0, 90.0, ""),
        (18.0, 37.0, ""),
        (22.0, 37.0, "across the way"),
    ):
        hill = tilted(level, slope_deg, falls_deg, np.s_[:, 40:60])
        ground = searcher_of(hill, SMALL, allow_unknown=False, curve=None).ground
        fault = find_fault(route.path, ground, SMALL)
        assert (fault is not None) == bool(words)
        if fault is not None:
            assert words in fault.reason
            assert 107.0 < fault.east_m < 112.0


def test_noise_and_what_is_not_known_block_nothing() -> None:
    level = field(obstacles=[(9, 0, 10, 7)])
    ends = at(2, 3, 90), at(17, 3, 90)
    plain = route_in_view(level, *ends, SMALL)
    random = np.random.default_rng(3)
    noise = random.normal(0.0, 0.35, (2, *level.window.shape))  # 19°, as no map has it
    steep = np.full_like(noise, 1.0)
    steep[:, random.random(level.window.shape) > 0.1] = np.nan  # known of a tenth of the cells
    for rises in (noise, steep, np.full_like(noise, np.nan)):
        route = route_in_view(leaning(level, *rises), *ends, SMALL)
        np.testing.assert_array_equal(np.column_stack(route.path), np.column_stack(plain.path))


def test_lanes_across_a_slope_are_left_out_with_the_slope() -> None:
    """Lanes to the north; those along the slope are driven, and turns on level headlands."""
    view, planting = planted()
    rows = np.s_[25:85, :]
    assert not coverage_in_view(tilted(view, 18.0, 0.0, rows), planting, SMALL).left_out
    with pytest.raises(NoRouteError, match=r"None of 3 lanes .* a slope of 17\.\d° across the way"):
        coverage_in_view(tilted(view, 18.0, 90.0, rows), planting, SMALL)


@pytest.mark.parametrize("heading_deg", [0.0, 60.0])
def test_slopes_are_read_from_a_map(tmp_path: Path, heading_deg: float) -> None:
    """Frames that look up a hillside of 18°: along it there is a way, across it none."""
    fall, phi = math.tan(math.radians(18.0)), math.radians(heading_deg)
    up, right = np.array([math.sin(phi), math.cos(phi)]), np.array([math.cos(phi), -math.sin(phi)])
    path, base = tmp_path / "map.gpkg", np.array([0.0, 2.0])
    with open_map(path, datum=DATUM, cell_m=0.2) as universal, universal.add_session("a") as drive:
        for k in range(4):
            east_m, north_m = base + 0.5 * k * up
            up_m = float(fall * up @ (east_m, north_m))
            pose = Pose(10**9 * (k + 1), east_m, north_m, up_m, heading_deg, 0.02, 0.3, 1.0)
            heights = {GROUND_CHANNEL: hillside(pose, *(fall * up))}
            drive.add(grid(), pose, frame_id=str(k), channels=heights)
    start, goal, left, away = (
        tuple(base + ahead * up + aside * right)
        for ahead, aside in ((3.0, 0.0), (6.0, 0.0), (4.5, -1.0), (4.5, 1.0))
    )
    assert plan_route(path, start, goal, SMALL).length_m == pytest.approx(3.0, abs=0.3)
    with pytest.raises(NoRouteError, match=r"a slope of 17\.\d° across the way"):
        plan_route(path, (*left, heading_deg + 90.0), away, SMALL)
    with pytest.raises(NoRouteError, match=r"too near to a slope of 17\.\d°"):
        plan_route(path, start, goal, replace(SMALL, slope_along_deg=10.0, slope_across_deg=10.0))


def test_a_drop_is_an_obstacle_to_a_vehicle_that_does_not_take_it() -> None:
    drop = np.zeros(field().window.shape, np.float32)
    drop[:, 50] = 0.3
    view = replace(field(), layers={"drop": drop, "sure_share": np.ones_like(drop)})
    ends = at(2, 5, 90), at(17, 5, 90)
    with pytest.raises(NoRouteError, match="stopped by an obstacle"):
        route_in_view(view, *ends, SMALL)
    assert route_in_view(view, *ends, replace(SMALL, step_m=0.31)).length_m < 15.1


@pytest.mark.parametrize("steep", [False, True])
def test_weak_cells_are_named_where_their_ground_is_not_too_steep(
    tmp_path: Path, steep: bool
) -> None:
    view = field(obstacles=[(10.0, 0.0, 10.2, 4.0), (10.0, 6.0, 10.2, 10.0)])
    view.density[25, 50] = 130
    with open_map(write_map(tmp_path / "gap.gpkg", view)) as universal:
        hill = tilted(view, 18.0, 0.0, np.s_[:, 70:80] if steep else np.s_[:5, 70:80])
        with pytest.raises(NoRouteError) as refused:
            route_in_view(
                hill, at(5, 5, 90), at(17, 5, 90), replace(SMALL, width_m=1.2), universal=universal
            )
    assert ("fieldgrid mark" in str(refused.value)) == (not steep)
