"""Parallel tracks over ground of which everything is known."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from benchmarks.coverage import points_on_barred
from benchmarks.tracks import faults, random_field, worked_share
from fieldgrid.core import ConfigError, NoRouteError
from fieldgrid.field import Coverage, Lane, Tracks, Vehicle
from fieldgrid.field.coverage.plan import coverage_in_view
from fieldgrid.field.coverage.tracks import lay_tracks
from fieldgrid.field.route.plan import searcher_of
from fieldgrid.geometry import project
from fieldgrid.maps import MapView
from tests.field.route.test_plan import SMALL, assert_holds, at, field, footprints

WIDE = Tracks(width_m=2.0)
THING = (10.0, 6.0, 11.0, 7.0)


def laid(view: MapView, tracks: Tracks, vehicle: Vehicle = SMALL) -> tuple[Lane, ...]:
    searcher = searcher_of(view, vehicle, allow_unknown=False, curve=None)
    return lay_tracks(searcher, tracks, view.datum, view.bounds, fill_unseen=False).planting.lanes


def headings(lanes: tuple[Lane, ...], letter: str) -> list[float]:
    found = []
    for lane in lanes:
        if f"-{letter}" in lane.id:
            out = np.diff(np.asarray(lane.line.coords)[[0, -1]], axis=0)[0]
            found.append(math.degrees(math.atan2(*out)) % 360.0)
    return found


@pytest.fixture(scope="module")
def around_a_thing() -> tuple[MapView, Coverage]:
    view = field((20.0, 14.0), [THING], [(0.0, 10.0, 4.0, 14.0)])
    return view, coverage_in_view(view, Tracks(width_m=1.8, headland_passes=1), SMALL)


def test_all_that_can_be_reached_is_worked_and_nothing_is_touched(
    around_a_thing: tuple[MapView, Coverage],
) -> None:
    view, coverage = around_a_thing
    assert_holds(coverage.route, view)
    assert points_on_barred(coverage, view) == 0
    assert not coverage.left_out
    assert coverage.swaths is not None
    # By the places of the poses alone.
    route = coverage.route
    worked = shapely.union_all(
        [lane.line.buffer(0.9, cap_style="flat") for lane in coverage.planting.lanes]
    )
    free = shapely.box(*at(0.0, 0.0), *at(20.0, 14.0)).difference(
        shapely.union_all([shapely.box(*at(10.0, 6.0), *at(11.0, 7.0)),
                           shapely.box(*at(0.0, 10.0), *at(4.0, 14.0))])
    )  # fmt: skip
    assert worked.intersection(free).area > 0.95 * free.area
    assert coverage.swaths.worked_m2 > 0.95 * coverage.swaths.reachable_m2
    assert coverage.swaths.reachable_m2 <= free.area + 1e-6
    named = list(dict.fromkeys(name for name in route.lane.tolist() if name))
    assert named == [lane.lane for lane in coverage.lanes]


def test_passes_lead_around_the_ground_and_the_obstacle(
    around_a_thing: tuple[MapView, Coverage],
) -> None:
    """On all four sides of the thing, as near to it as the vehicle can be."""
    _, coverage = around_a_thing
    thing = shapely.box(*at(*THING[:2]), *at(*THING[2:]))
    sides = [lane.line for lane in coverage.planting.lanes if "-O" in lane.id]
    assert len(sides) == 4
    for side in sides:  # half the width away, to a cell
        assert 0.9 - 0.2 <= side.distance(thing) < 0.9 + 0.4
    away = [
        np.subtract(side.interpolate(0.5, normalized=True).coords[0], thing.centroid.coords[0])
        for side in sides
    ]
    assert {int(np.argmax(np.abs(d))) * 2 + int(d[np.argmax(np.abs(d))] > 0) for d in away} == {
        0, 1, 2, 3,
    }  # fmt: skip
    # The ring around the ground, against the unseen corner too.
    ring = [lane.line for lane in coverage.planting.lanes if "-H1" in lane.id]
    assert shapely.union_all(ring).distance(shapely.Point(at(4.0, 10.0))) < 1.8


def test_turns_stay_on_the_headland() -> None:
    """No way between tracks leads over the ground inside, but by the vehicle's own length."""
    view = field((24.0, 16.0))
    coverage = coverage_in_view(view, Tracks(width_m=1.5, direction_deg=90.0), SMALL)
    assert coverage.swaths is not None
    assert coverage.swaths.crossing_m == 0.0
    passes = {lane.id.split("-")[1].split(".")[0] for lane in coverage.planting.lanes}
    depth = 1.5 * len({name for name in passes if name.startswith("H")})
    assert depth >= SMALL.turning_radius_m + 0.5 * SMALL.width_m
    inside = shapely.box(*at(depth, depth), *at(24.0 - depth, 16.0 - depth))
    core = inside.buffer(-(SMALL.reach_m + SMALL.clearance_m + 0.75))
    turning = footprints(coverage.route)[coverage.route.lane == ""]
    centres = np.column_stack([coverage.route.east_m, coverage.route.north_m])
    assert not shapely.contains_xy(core, *centres[coverage.route.lane == ""].T).any()
    assert len(turning)


@pytest.mark.parametrize("direction", [0.0, 30.0, 250.0])
def test_tracks_have_the_direction_and_the_distance_that_were_asked_for(direction: float) -> None:
    lanes = laid(field((20.0, 14.0)), Tracks(2.0, 0.4, direction, headland_passes=1))
    found = headings(lanes, "T")
    assert len(found) > 4
    assert found == pytest.approx([direction] * len(found))
    lines = [np.asarray(lane.line.coords) for lane in lanes if "-T" in lane.id]
    aside = [float(project(b[:1], a)[1][0]) for a, b in itertools.pairwise(lines)]
    # From left to right, never farther apart than width less overlap.
    assert all(-1.6 - 1e-6 <= by <= -1.0 for by in aside)


def test_without_a_direction_the_longest_tracks_are_taken() -> None:
    found = headings(laid(field((30.0, 9.0)), replace(WIDE, headland_passes=1)), "T")
    assert found
    assert all(abs(heading - 90.0) < 1.0 for heading in found)


def test_tracks_run_beside_a_curve() -> None:
    """An arc of 30 m about a point in the south; each track is as far from it all along."""
    turn = np.linspace(-0.4, 0.4, 30)
    arc = np.column_stack([110.0 + 30.0 * np.sin(turn), -76.0 + 30.0 * np.cos(turn)])
    view = field((20.0, 16.0))
    lanes = laid(view, Tracks(2.0, along=shapely.LineString(arc), headland_passes=1))
    tracks = [lane.line for lane in lanes if "-T" in lane.id]
    assert len(tracks) > 4
    for line in tracks:
        radii = np.hypot(*(shapely.get_coordinates(line) - (110.0, -76.0)).T)
        assert np.ptp(radii) < 0.12
    middle = [float(np.hypot(*(shapely.get_coordinates(t)[0] - (110.0, -76.0)))) for t in tracks]
    steps = np.round((np.array(middle) - 30.0) / 2.0, 1)
    assert np.allclose(steps, np.round(steps), atol=0.06)
    # Left of the arc, which runs east, is north.
    assert middle[0] > middle[-1]


def test_tracks_beside_the_longest_edge() -> None:
    view = field((20.0, 14.0), unseen=[(0.0, 0.0, 20.0, 2.0)])
    found = headings(laid(view, Tracks(2.0, along="edge", headland_passes=1)), "T")
    assert all(min(abs(h - 90.0), abs(h - 270.0)) < 1.0 for h in found)


def test_no_corner_leaves_the_boundary() -> None:
    boundary = shapely.Polygon([at(2.0, 2.0), at(17.0, 3.0), at(15.0, 12.0), at(4.0, 11.0)],
                               [[at(8.0, 6.0), at(10.0, 6.0), at(10.0, 8.0)]])  # fmt: skip
    view = field((20.0, 14.0))
    coverage = coverage_in_view(view, replace(WIDE, boundary=boundary, headland_passes=1), SMALL)
    assert shapely.covers(boundary, footprints(coverage.route)).all()
    assert coverage.swaths is not None
    assert coverage.swaths.worked_m2 > 0.8 * boundary.area


def test_unseen_ground_inside_a_boundary_is_worked_where_that_is_allowed() -> None:
    view = field((14.0, 10.0), unseen=[(5.0, 0.0, 14.0, 10.0)])
    boundary = shapely.box(*at(0.0, 0.0), *at(14.0, 10.0))
    tracks = Tracks(2.0, boundary=boundary, headland_passes=1)
    seen = coverage_in_view(view, tracks, SMALL)
    everywhere = coverage_in_view(view, tracks, SMALL, allow_unknown=True)
    assert seen.swaths is not None
    assert everywhere.swaths is not None
    assert seen.swaths.reachable_m2 < 51.0
    assert everywhere.swaths.worked_m2 > 120.0
    # Without a boundary it ends where the seen ground does.
    bare = coverage_in_view(view, replace(tracks, boundary=None), SMALL, allow_unknown=True)
    assert bare.swaths is not None
    assert bare.swaths.reachable_m2 < 51.0


@pytest.mark.parametrize("seed", [4, 8])
def test_random_fields(seed: int) -> None:
    task = random_field(seed)
    coverage = coverage_in_view(task.view, task.tracks, task.vehicle)
    assert faults(coverage, task) == []
    assert worked_share(coverage, task) > 0.5


def test_what_cannot_be_asked() -> None:
    view = field((10.0, 8.0))
    line = shapely.LineString([(0.0, 0.0), (1.0, 0.0)])
    bow = shapely.Polygon([(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)])
    for wrong, words in (
        ({"width_m": 0.0}, "width_m of tracks of 0"),
        ({"overlap_m": math.nan}, "overlap_m"),
        ({"headland_passes": -1}, "headland_passes"),
        ({"direction_deg": 10.0, "along": line}, "give one of the two"),
        ({"boundary": bow}, "boundary of the tracks is no boundary: Self-intersection"),
    ):
        with pytest.raises(ConfigError, match=words):
            Tracks(**wrong)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="over half of the working width"):
        coverage_in_view(view, Tracks(1.0, overlap_m=0.6), SMALL)
    with pytest.raises(NoRouteError, match="no room for a track"):
        coverage_in_view(view, Tracks(1.0, boundary=shapely.box(*at(1, 1), *at(2, 2))), SMALL)
