"""Rows, lanes, gaps, blocks, headlands and obstacles of plantings that are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import shapely

from benchmarks.planting import DATUM, Sight
from fieldgrid.core import ConfigError
from fieldgrid.field import Crop, crop_named, planting_features
from fieldgrid.field.rows.crops import CROPS
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import Bounds, Lattice, lengths, project
from fieldgrid.maps import MapView
from tests.field.rows.fields import QUIET, line_of, rms_m, straight, view_of


@pytest.mark.parametrize("heading_deg", [3.0, 48.0, 91.0, 137.0])
def test_straight_rows_are_found_with_their_ends_and_lanes(heading_deg: float) -> None:
    rows = straight(5, 30.0, 2.5, heading_deg, (-13.7, 8.2))
    found = rows_of_view(
        view_of(rows, dataclasses.replace(QUIET, hole_share=0.0, noise_per_m2=0.0))
    )
    assert len(found.rows) == 5
    assert len(found.lanes) == 4
    assert [b.rows for b in found.blocks] == [5]
    for row in rows:
        line = line_of(found, row)
        assert rms_m(line, row) < 0.04
        at, _ = project(line, row)
        # Half a canopy is taken off at either end, which these rows do not have.
        assert abs(at.min()) < 0.4
        assert abs(at.max() - 30.0) < 0.4
    for lane in found.lanes:
        assert lane.known > 0.95
        assert lane.free_width_m == pytest.approx(2.5 - 0.7, abs=0.35)
    turn = (found.blocks[0].heading_deg - heading_deg + 90.0) % 180.0 - 90.0
    assert abs(turn) < 0.3
    assert found.blocks[0].spacing_m == pytest.approx(2.5, abs=0.03)


def test_left_and_right_of_a_lane_are_meant_along_its_line() -> None:
    found = rows_of_view(view_of(straight(4, 25.0, 2.2, 20.0)))
    lines = {row.id: np.asarray(row.line.coords) for row in found.rows}
    for lane in found.lanes:
        middle = np.asarray(lane.line.coords)
        left, right = (project(lines[name], middle)[1].mean() for name in lane.rows)
        assert left > 0.9
        assert right < -0.9


def test_ids_follow_the_rows_from_left_to_right() -> None:
    found = rows_of_view(view_of(straight(4, 25.0, heading_deg=20.0)))
    along = np.subtract(*(found.rows[0].line.coords[k] for k in (-1, 0)))
    right = np.array([along[1], -along[0]])
    places = [np.asarray(row.line.coords).mean(axis=0) @ right for row in found.rows]
    assert places == sorted(places)
    assert [row.id for row in found.rows] == ["B1-R1", "B1-R2", "B1-R3", "B1-R4"]


def test_a_field_moved_by_whole_cells_is_the_same_field() -> None:
    view = view_of(straight(3, 20.0, heading_deg=33.0))
    window = view.window
    far = window._replace(i0=window.i0 + 12_345, j0=window.j0 - 6_789)
    here, there = (rows_of_view(v) for v in (view, dataclasses.replace(view, window=far)))
    assert len(here.rows) == len(there.rows) == 3
    for a, b in zip(here.rows, there.rows, strict=True):
        moved = np.asarray(b.line.coords) - (1234.5, -678.9)
        assert np.abs(project(moved, np.asarray(a.line.coords))[1]).max() < 0.02
        assert b.length_m == pytest.approx(a.length_m, abs=0.25)


def test_curved_rows_are_followed() -> None:
    angle = np.linspace(0.0, 0.7, 40)
    rows = [
        np.column_stack([r * np.sin(angle), r * np.cos(angle)]) for r in (60.0, 62.5, 65.0, 67.5)
    ]
    found = rows_of_view(view_of(rows))
    assert len(found.rows) == 4
    for row in rows:
        assert rms_m(line_of(found, row), row) < 0.06
    assert found.blocks[0].rows == 4


def test_blocks_of_two_directions_are_two() -> None:
    rows = straight(5, 26.0, 2.5, 10.0) + straight(4, 22.0, 3.0, 70.0, (22.0, 14.0))
    found = rows_of_view(view_of(rows))
    assert [b.rows for b in found.blocks] == [5, 4]
    headings = [b.heading_deg % 180.0 for b in found.blocks]
    assert headings == pytest.approx([10.0, 70.0], abs=0.5)
    assert [b.spacing_m for b in found.blocks] == pytest.approx([2.5, 3.0], abs=0.05)
    for row in rows:
        assert rms_m(line_of(found, row), row) < 0.06


def test_missing_plants_are_gaps_and_do_not_end_a_row() -> None:
    rows = straight(4, 40.0, heading_deg=15.0)
    missing = [(1, 12.0, 14.6), (2, 20.0, 28.0)]
    found = rows_of_view(view_of(rows, missing=missing))
    assert len(found.rows) == 4
    assert len(found.gaps) == 2
    for (row, start, stop), gap in zip(missing, found.gaps, strict=True):
        at, off = project(np.asarray(gap.line.coords), rows[row])
        assert np.abs(off).max() < 0.2
        assert [at.min(), at.max()] == pytest.approx([start, stop], abs=0.35)
        assert gap.length_m == pytest.approx(stop - start, abs=0.5)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_row_that_was_seen_from_one_side_is_not_drawn_to_it(seed: int) -> None:
    rows = straight(4, 40.0, heading_deg=70.0)
    sides = [(False, True), (True, True), (True, True), (True, False)]
    sight = dataclasses.replace(QUIET, sides=sides, depth_m=0.2, seed=seed)
    found = rows_of_view(view_of(rows, sight, cell_m=0.05))
    assert len(found.rows) == 4
    for row, (left, right) in zip(rows, sides, strict=True):
        line = line_of(found, row)
        own = next(r for r in found.rows if np.asarray(r.line.coords) is not None
                   and np.array_equal(np.asarray(r.line.coords), line))  # fmt: skip
        bias = float(project(line, row)[1].mean())
        assert abs(bias) < 0.07
        assert abs(bias) < 3.0 * own.sigma_m
        if not (left and right):
            assert own.sides < 1.3
            # What the far face may be is added to what the fit says.
            assert own.sigma_m > 0.03


def test_an_unseen_lane_says_so_and_has_no_width() -> None:
    rows = straight(3, 30.0)
    sides = [(True, True), (True, False), (False, True)]
    found = rows_of_view(view_of(rows, dataclasses.replace(QUIET, sides=sides)))
    lanes = {lane.rows: lane for lane in found.lanes}
    seen, unseen = lanes["B1-R1", "B1-R2"], lanes["B1-R2", "B1-R3"]
    assert seen.known > 0.95
    assert unseen.known < 0.3
    assert np.isnan(unseen.free_width_m)
    assert np.isfinite(seen.free_width_m)
    assert not unseen.driven


def test_a_stretch_of_a_row_that_was_not_seen_is_no_gap() -> None:
    rows = straight(3, 40.0)
    sight = dataclasses.replace(QUIET, unseen=[Bounds(-3.0, 15.0, 1.0, 20.0)])
    found = rows_of_view(view_of(rows, sight))
    assert len(found.rows) == 3
    assert not found.gaps
    first = min(found.rows, key=lambda r: r.line.coords[0][0])
    assert first.known == pytest.approx(1.0 - 5.0 / 40.0, abs=0.04)


def test_things_in_lanes_belong_to_them_and_narrow_them() -> None:
    rows = straight(3, 30.0)
    found = rows_of_view(view_of(rows, things=[(3.75, 12.0, 0.3)], cell_m=0.05))
    place = shapely.Point(3.75, 12.0)
    (thing,) = [o for o in found.obstacles if o.area.distance(place) < 0.2]
    lane = found.lane(thing.lane)
    assert lane is not None
    assert lane.area.contains(place)
    assert lane.free_width_m < 1.1
    assert thing.area_m2 == pytest.approx(np.pi * 0.3**2, rel=0.3)
    assert not thing.row


@pytest.mark.parametrize("heading_deg", [0.0, 31.0, 45.0])
def test_one_obstacle_cell_narrows_its_metre_of_a_lane(heading_deg: float) -> None:
    """A stake is not listed, and a tractor that trusts the width drives into it."""
    rows = straight(3, 30.0, heading_deg=heading_deg)
    view = view_of(rows, dataclasses.replace(QUIET, hole_share=0.0, noise_per_m2=0.0), cell_m=0.05)
    before = rows_of_view(view).lanes[0]
    i, j = view.lattice.index(*np.atleast_2d(before.line.interpolate(12.4).coords[0]).T)
    density = view.density.copy()
    density[j - view.window.j0, i - view.window.i0] = 255
    found = rows_of_view(dataclasses.replace(view, density=density))
    after = found.lanes[0]
    assert before.free_width_m > 1.5
    assert before.free_width_m == np.nanmin(before.widths_m)
    assert 0.7 < after.free_width_m < 1.1
    narrowed = np.flatnonzero(~np.isclose(after.widths_m, before.widths_m, atol=0.08))
    assert narrowed.tolist() == [12]


@pytest.mark.parametrize("cell_m", [0.05, 0.1])
def test_a_lone_cell_and_unseen_ground_narrow_the_free_width_and_not_the_clear_one(
    cell_m: float,
) -> None:
    rows = straight(3, 30.0)
    quiet = dataclasses.replace(QUIET, hole_share=0.0, noise_per_m2=0.0)
    before = rows_of_view(view_of(rows, quiet, cell_m=cell_m)).lanes[0]
    assert before.clear_width_m == pytest.approx(before.free_width_m - 0.07, abs=0.04)
    wedge = dataclasses.replace(quiet, unseen=[Bounds(1.9, 20.0, 2.1, 20.4)])
    view = view_of(rows, wedge, cell_m=cell_m)
    i, j = view.lattice.index(*np.atleast_2d(before.line.interpolate(12.4).coords[0]).T)
    view.density[j - view.window.j0, i - view.window.i0] = 255
    lane = rows_of_view(view, hole_m=0.0).lanes[0]
    assert lane.free_width_m < 1.1
    assert lane.clear_width_m == pytest.approx(before.clear_width_m, abs=0.06)
    assert 0.1 < lane.clear_sigma_m < 0.15


def test_a_lone_cell_that_is_large_is_noise_or_a_thing_and_the_clear_width_says_so() -> None:
    rows = straight(3, 30.0)
    quiet = dataclasses.replace(QUIET, hole_share=0.0, noise_per_m2=0.0)
    view = view_of(rows, quiet, cell_m=0.2)
    before = rows_of_view(view).lanes[0]
    i, j = view.lattice.index(*np.atleast_2d(before.line.interpolate(12.4).coords[0]).T)
    view.density[j - view.window.j0, i - view.window.i0] = 255
    lane = rows_of_view(view).lanes[0]
    assert lane.clear_width_m < before.clear_width_m - 0.4
    assert 0.1 < before.clear_sigma_m < 0.2
    assert before.clear_width_m - lane.clear_width_m < 2.0 * lane.clear_sigma_m


def test_a_thing_in_a_metre_that_was_hardly_seen_narrows_the_clear_width() -> None:
    rows = straight(3, 30.0)
    sight = dataclasses.replace(
        QUIET, hole_share=0.0, noise_per_m2=0.0, unseen=[Bounds(1.9, 11.5, 2.1, 13.5)]
    )
    view = view_of(rows, sight, things=[(1.35, 12.4, 0.2)], cell_m=0.05)
    lane = rows_of_view(view, hole_m=0.0).lanes[0]
    assert lane.clear_width_m < 1.2


def test_a_lane_of_which_a_side_was_not_seen_has_no_clear_width() -> None:
    rows = straight(3, 30.0)
    sight = dataclasses.replace(QUIET, unseen=[Bounds(0.5, -5.0, 0.7, 35.0)])
    found = rows_of_view(view_of(rows, sight, cell_m=0.05), hole_m=0.0)
    lane = next(lane for lane in found.lanes if lane.rows == ("B1-R1", "B1-R2"))
    assert lane.free_width_m > 0.6
    assert np.isnan(lane.clear_width_m)
    assert np.isnan(lane.clear_sigma_m)


def test_a_width_is_told_of_the_metres_that_were_seen() -> None:
    rows = straight(3, 30.0)
    sight = dataclasses.replace(
        QUIET, hole_share=0.0, noise_per_m2=0.0, unseen=[Bounds(0.5, 10.0, 2.0, 14.0)]
    )
    found = rows_of_view(view_of(rows, sight), hole_m=0.0)
    lane = next(lane for lane in found.lanes if lane.rows == ("B1-R1", "B1-R2"))
    at = 0.5 + np.arange(len(lane.widths_m)) + lane.line.coords[0][1]
    unseen = (at > 10.6) & (at < 13.4)
    assert unseen.sum() >= 2
    assert np.isnan(lane.widths_m[unseen]).all()
    assert np.isfinite(lane.widths_m[(at < 9.4) | (at > 14.6)]).all()
    assert lane.free_width_m > 1.4
    assert lane.known == pytest.approx(1.0 - 4.0 * 1.5 / 1.8 / lane.length_m, abs=0.06)


def test_pinholes_count_as_free_but_not_as_seen() -> None:
    sight = dataclasses.replace(QUIET, hole_share=0.0, noise_per_m2=0.0)
    view = view_of(straight(3, 30.0), sight)
    seen = np.random.default_rng(2).random(view.observed.shape) > 0.05
    observed = view.observed & (seen | (view.density > 0))
    found = rows_of_view(dataclasses.replace(view, observed=observed))
    for lane in found.lanes:
        assert lane.known == pytest.approx(0.95, abs=0.02)
        assert lane.free_width_m > 1.4


def test_a_piece_of_a_row_beside_the_last_is_a_row_and_a_trailer_is_none() -> None:
    """Of the row beyond a neighbour of a driven lane some metres are seen, through the canopy."""
    whole = straight(4, 30.0, heading_deg=25.0)
    first, last = whole[3]
    piece = np.array([first, first + 3.8 / 30.0 * (last - first)])
    found = rows_of_view(view_of([*whole[:3], piece]))
    assert len(found.rows) == 4
    assert rms_m(line_of(found, piece), piece) < 0.15
    assert not found.obstacles
    east_m, north_m = 0.5 * (first + last)
    found = rows_of_view(view_of(whole[:3], things=[(east_m, north_m, 1.0)]))
    assert len(found.rows) == 3
    assert len(found.obstacles) == 1


def test_headlands_lie_before_and_behind_the_rows() -> None:
    rows = straight(5, 30.0)
    found = rows_of_view(view_of(rows))
    ends = {h.end for h in found.headlands}
    assert ends <= {"start", "stop", "both"}
    ground = shapely.union_all([h.area for h in found.headlands])
    for before in (shapely.box(0.0, -4.0, 10.0, -1.0), shapely.box(0.0, 31.0, 10.0, 34.0)):
        assert ground.intersection(before).area > 0.9 * before.area
    for lane in found.lanes:
        assert ground.intersection(lane.area).area < 0.1 * lane.area.area


def test_noise_alone_has_no_rows() -> None:
    rng = np.random.default_rng(4)
    lattice = Lattice(0.1)
    window = lattice.window(Bounds(0.0, 0.0, 40.0, 40.0))
    density = np.where(rng.random(window.shape) < 0.01, 200, 0).astype(np.uint8)
    view = MapView(
        lattice, window, density, np.ones(window.shape, dtype=np.bool_), DATUM, is_base=True
    )
    assert not rows_of_view(view).rows


@pytest.mark.parametrize("observed", [False, True])
def test_a_map_without_obstacles_is_an_empty_planting(observed: bool) -> None:
    lattice = Lattice(0.1)
    window = lattice.window(Bounds(0.0, 0.0, 10.0, 10.0))
    mask = np.full(window.shape, observed)
    found = rows_of_view(
        MapView(lattice, window, np.zeros(window.shape, np.uint8), mask, DATUM, is_base=True)
    )
    assert found.rows == found.lanes == found.gaps == found.blocks == found.headlands == ()


def test_a_trailer_in_line_with_a_row_does_not_lengthen_it() -> None:
    rows = straight(4, 30.0)
    found = rows_of_view(view_of(rows, things=[(5.0, 36.0, 1.0)]))
    at, _ = project(line_of(found, rows[2]), rows[2])
    assert at.max() < 30.5


def test_trunks_of_an_orchard_are_rows_by_its_parameters() -> None:
    rows = straight(4, 48.0, 5.0, 30.0)
    missing = [(k, 4.0 * n + 0.2, 4.0 * n + 3.8) for k in range(4) for n in range(12)]
    view = view_of(rows, dataclasses.replace(QUIET, fill=0.95), half_width_m=0.2, missing=missing)
    found = rows_of_view(view, crop="orchard")
    assert len(found.rows) == 4
    for row in rows:
        assert rms_m(line_of(found, row), row) < 0.1
    assert not found.gaps


@pytest.mark.parametrize(("spacing_m", "apart_m", "half_m"), [(6.0, 5.0, 0.3), (6.0, 5.0, 0.8)])
def test_trees_as_far_from_each_other_as_rows_stand_in_rows_one_way(
    spacing_m: float, apart_m: float, half_m: float
) -> None:
    rows = straight(8, 60.0, spacing_m, 10.0)
    missing = [
        (k, apart_m * n + half_m, apart_m * (n + 1) - half_m) for k in range(8) for n in range(12)
    ]
    view = view_of(rows, half_width_m=half_m, missing=missing)
    found = rows_of_view(view, crop="orchard")
    assert len(found.rows) == 8
    for row in rows:
        assert rms_m(line_of(found, row), row) < 0.1
    assert len(found.lanes) == 7


@pytest.mark.parametrize("far_m", [0.0, 9.0])
def test_a_tree_beyond_a_bare_place_is_the_end_of_its_row(far_m: float) -> None:
    """One that is missing does not end a row of trees; specks before and behind them do not
    lengthen it."""
    rows = straight(4, 48.0, 5.0)
    stands = [n for n in range(12) if n not in (9, 10)]
    edges = [0.0, *(4.0 * n + side for n in stands for side in (1.8, 2.2)), 48.0]
    holes = list(zip(edges[::2], edges[1::2], strict=True))
    every = [(4.0 * n - 1.8, 4.0 * n + 1.8) for n in range(13)]
    missing = [(0, *hole) for hole in holes]
    missing += [(k, max(a, 0.0), min(b, 48.0)) for k in (1, 2, 3) for a, b in every]
    specks = [(0.0, 46.2 + far_m, 0.08)] if far_m else []
    view = view_of(
        rows,
        dataclasses.replace(QUIET, fill=0.95),
        half_width_m=0.2,
        missing=missing,
        things=specks,
    )
    found = rows_of_view(view, crop="orchard")
    at, _ = project(line_of(found, rows[0]), rows[0])
    assert abs(at.min() - 2.0) < 0.3
    assert abs(at.max() - 46.0) < 0.3


def test_an_end_post_apart_from_the_plants_ends_its_row_on_its_inner_side() -> None:
    rows = straight(4, 30.0)
    brace = [(0.0, -0.55 + 0.1 * n, 0.08) for n in range(7)]
    missing = [(0, -1.0, 1.2)]
    found = rows_of_view(view_of(rows, missing=missing, things=brace, cell_m=0.05))
    start = project(line_of(found, rows[0]), rows[0])[0].min()
    assert abs(start - 0.1) < 0.15


def test_a_row_says_which_of_its_ends_were_seen() -> None:
    rows = straight(4, 30.0)
    hidden = Bounds(-10.0, 30.0, 20.0, 40.0)
    found = rows_of_view(view_of(rows, dataclasses.replace(QUIET, unseen=[hidden])))
    assert {row.ends_seen for row in found.rows} == {(True, False)}
    kinds = {f.properties["ends_seen"] for f in planting_features(found) if f.kind == "row"}
    assert kinds == {"start"}


@pytest.mark.parametrize("half_width_m", [0.25, 0.5])
def test_the_headland_is_no_second_side_of_a_row(half_width_m: float) -> None:
    """It is seen to both sides, and would tell a width that nobody saw."""
    rows = straight(6, 25.0, 2.2)
    sight = dataclasses.replace(QUIET, sides=[(True, False)] * 6, headland_m=8.0)
    found = rows_of_view(view_of(rows, sight, half_width_m=half_width_m), crop="bushes")
    for row in found.rows:
        assert row.sides < 1.1
        assert row.half_width_m == CROPS["bushes"].half_width_m
        off = min(abs(project(np.asarray(row.line.coords), true)[1].mean()) for true in rows)
        assert off < 3.0 * row.sigma_m


def test_a_speck_in_a_hole_does_not_end_a_row() -> None:
    rows = straight(4, 50.0)
    view = view_of(rows, missing=[(1, 30.0, 36.0)], things=[(2.5, 33.0, 0.12)])
    found = rows_of_view(view)
    at, _ = project(line_of(found, rows[1]), rows[1])
    assert at.min() < 1.0
    assert at.max() > 49.0


def test_plants_that_are_missing_one_by_one_do_not_end_a_row() -> None:
    """Beyond a hole of two plants stands one, and another one beyond the next: each alone is short
    for its hole."""
    rows = straight(4, 50.0)
    missing = [(1, 20.0, 24.2), (1, 25.5, 29.0), (1, 30.3, 33.8), (1, 35.1, 39.0)]
    found = rows_of_view(view_of(rows, missing=missing))
    at, _ = project(line_of(found, rows[1]), rows[1])
    assert at.min() < 1.0
    assert at.max() > 49.0
    told = [project(np.asarray(gap.line.coords), rows[1])[0] for gap in found.gaps]
    assert [(a.min(), a.max()) for a in told] == [
        (pytest.approx(start, abs=0.35), pytest.approx(stop, abs=0.35))
        for _, start, stop in missing
    ]


def test_a_plant_that_stands_apart_beside_a_gap_is_no_thing_in_it() -> None:
    rows = straight(3, 30.0)
    missing = [(k, n - 0.25, n + 0.1) for k in range(3) for n in range(1, 30) if (k, n) != (1, 15)]
    found = rows_of_view(view_of(rows, missing=[*missing, (1, 14.75, 16.3)], cell_m=0.05))
    (gap,) = found.gaps
    at, _ = project(np.asarray(gap.line.coords), rows[1])
    assert [at.min(), at.max()] == pytest.approx([14.75, 16.3], abs=0.25)


def test_the_seen_part_of_a_hole_is_a_gap() -> None:
    """So that few cells of a row beside a gap, which make its hole longer, do not hide it."""
    rows = straight(3, 40.0)
    sight = dataclasses.replace(QUIET, unseen=[Bounds(1.5, 16.0, 3.5, 20.0)])
    found = rows_of_view(view_of(rows, sight, missing=[(1, 20.0, 22.0)]))
    (gap,) = found.gaps
    at, _ = project(np.asarray(gap.line.coords), rows[1])
    assert [at.min(), at.max()] == pytest.approx([20.0, 22.0], abs=0.3)
    row = next(row for row in found.rows if row.id == gap.row)
    assert row.known == pytest.approx(1.0 - 4.0 / 40.0, abs=0.03)


@pytest.mark.parametrize(("oblique_deg", "wide_m"), [(0.0, 5.0), (30.0, 3.5)])
def test_a_road_across_all_rows_parts_two_blocks(oblique_deg: float, wide_m: float) -> None:
    rows = straight(6, 60.0)
    half = 0.5 * wide_m / np.cos(np.radians(oblique_deg))
    middle = [30.0 + 2.5 * k * np.tan(np.radians(oblique_deg)) for k in range(6)]
    missing = [(k, at - half, at + half) for k, at in enumerate(middle)]
    found = rows_of_view(view_of(rows, missing=missing))
    assert [(block.rows, block.lanes) for block in found.blocks] == [(6, 5), (6, 5)]
    assert not found.gaps
    for row in found.rows:
        ends = np.asarray(row.line.coords)[[0, -1]]
        k = round(float(ends[0, 0]) / 2.5)
        stops = np.array([0.0, middle[k] - half, middle[k] + half, 60.0])
        assert np.abs(stops[:, None] - ends[:, 1]).min(axis=0).max() < 0.5


def test_a_clearing_that_ends_at_rows_parts_nothing() -> None:
    rows = straight(7, 60.0)
    found = rows_of_view(view_of(rows, missing=[(k, 27.0, 33.0) for k in range(1, 6)]))
    assert [(block.rows, block.lanes) for block in found.blocks] == [(7, 6)]
    assert len(found.gaps) == 5


def test_sown_rows_are_found_by_their_parameters() -> None:
    rows = straight(8, 15.0, 0.6, 12.0)
    sight = Sight(noise_per_m2=0.05, hole_share=0.02, margin_m=2.0, headland_m=2.0)
    found = rows_of_view(view_of(rows, sight, cell_m=0.05, half_width_m=0.1), crop="arable")
    assert len(found.rows) == 8
    for row in rows:
        assert rms_m(line_of(found, row), row) < 0.03


def test_a_sparse_canopy_is_still_a_row() -> None:
    rows = straight(4, 40.0, heading_deg=5.0)
    found = rows_of_view(view_of(rows, dataclasses.replace(QUIET, fill=0.15)))
    assert len(found.rows) == 4
    for row in rows:
        assert rms_m(line_of(found, row), row) < 0.08


def test_lengths_along_rows_are_those_of_their_lines() -> None:
    found = rows_of_view(view_of(straight(3, 20.0, heading_deg=12.0)))
    for row in found.rows:
        assert row.length_m == pytest.approx(lengths(np.asarray(row.line.coords))[-1], abs=0.05)
        assert row.cells > 100
        assert row.sigma_m > 0.0


@pytest.mark.parametrize("change", [{"min_spacing_m": -1.0}, {"half_width_m": float("nan")},
                                    {"min_spacing_m": 5.0}])  # fmt: skip
def test_a_crop_that_cannot_be_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        crop_named("vineyard").changed(**change)


def test_an_unknown_crop_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"'hops' is no crop; known are vineyard"):
        crop_named("hops")
    assert crop_named("vineyard") == Crop()
