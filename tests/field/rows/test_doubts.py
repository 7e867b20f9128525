"""Fields that are hard: rows are right, or a doubt says what speaks against them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.missing_plants import outcome
from benchmarks.planting import Planting as Stand, Sight, seen_view
from benchmarks.rows import match
from fieldgrid.field import Planting, crop_named
from fieldgrid.field.rows.find import rows_of_view
from tests.field.rows.fields import QUIET, Array, straight, view_of


def arcs(radius_m: float, length_m: float, count: int = 4, spacing_m: float = 2.5) -> list[Array]:
    turn = np.linspace(0.0, length_m / radius_m, 40)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    return [(radius_m + k * spacing_m) * circle for k in range(count)]


def faults(found: Planting, rows: list[Array]) -> tuple[int, int]:
    """How many found rows are none, and how many true ones were missed."""
    lines = [np.asarray(row.line.coords) for row in found.rows]
    matched = match(lines, rows, [True] * len(rows))
    return matched.false, matched.missed


def kinds(found: Planting) -> list[str]:
    return [doubt.kind for doubt in found.doubts]


@pytest.mark.parametrize("seed", [0, 1])
def test_a_wide_canopy_of_sown_plants_is_one_row(seed: int) -> None:
    """Either face leads to its middle."""
    rows = straight(8, 20.0, 0.75, 15.0)
    view = seen_view(Stand(rows, 0.2), replace(QUIET, fill=0.4, seed=seed), 0.1)
    found = rows_of_view(view, crop="arable")
    assert faults(found, rows) == (0, 0)
    assert kinds(found) == []


@pytest.mark.parametrize("radius_m", [35.0, 50.0, 70.0, 90.0])
def test_rows_that_bend_are_whole(radius_m: float) -> None:
    rows = arcs(radius_m, 60.0)
    found = rows_of_view(view_of(rows, replace(QUIET, fill=0.6)))
    assert faults(found, rows) == (0, 0)
    assert kinds(found) == []


def test_trees_nearer_to_each_other_across_the_rows_are_told_with_what_to_do() -> None:
    rows = straight(8, 46.0, 3.5)
    edges = [0.0, *(4.6 * n + side for n in range(10) for side in (0.9, 1.9)), 46.0]
    holes = list(zip(edges[::2], edges[1::2], strict=True))
    view = view_of(rows, half_width_m=0.5, missing=[(k, a, b) for k in range(8) for a, b in holes])
    crop = crop_named("orchard")
    found = rows_of_view(view, crop=crop)
    assert faults(found, rows) == (0, 0)
    assert kinds(found) == ["across"]
    assert "--spacing 3.9:5.3 --plant-spacing 4.0" in found.doubts[0].text
    hedges = rows_of_view(view_of(rows), crop=crop)
    assert "across" not in kinds(hedges)


def test_tight_bends_are_told() -> None:
    rows = arcs(20.0, 36.0)
    found = rows_of_view(view_of(rows, replace(QUIET, fill=0.6)))
    assert faults(found, rows) == (0, 0)
    assert "bend" in kinds(found)


@pytest.mark.parametrize("spacing_m", [2.4, 3.0])
def test_a_row_does_not_run_on_between_those_of_the_next_block(spacing_m: float) -> None:
    rows = straight(6, 16.0, spacing_m)
    rows += straight(6, 16.0, spacing_m, at=(0.5 * spacing_m, 17.5))
    found = rows_of_view(view_of(rows, half_width_m=0.4))
    assert faults(found, rows) == (0, 0)
    assert max(row.length_m for row in found.rows) < 17.0


def test_a_row_in_two_pieces_is_told() -> None:
    rows = straight(4, 60.0)
    found = rows_of_view(view_of(rows, missing=[(1, 20.0, 42.0)]))
    assert len(found.rows) == 5
    assert kinds(found) == ["pieces"]
    lines = {row.id: np.asarray(row.line.coords) for row in found.rows}
    assert sorted(found.doubts[0].rows) == sorted(
        name for name, line in lines.items() if len(line) < 40
    )
    assert "2 of 5 rows" in found.doubts[0].text


def test_a_lane_that_is_unlike_the_others_is_told() -> None:
    rows = straight(6, 30.0)
    rows[3] = rows[3] + (0.9, 0.0)
    found = rows_of_view(view_of(rows))
    assert kinds(found) == ["uneven"]
    assert found.doubts[0].rows == ("B1-R3", "B1-R4", "B1-R5")
    assert "2 of 5 lanes of B1" in found.doubts[0].text


def test_noise_is_told() -> None:
    view = view_of(straight(5, 30.0), Sight(noise_per_m2=1.0, fill=0.3), cell_m=0.2)
    assert kinds(rows_of_view(view)) == ["stray"]


def test_a_road_and_gaps_are_no_doubt() -> None:
    rows = straight(5, 20.0) + straight(5, 20.0, at=(0.0, 25.0))
    found = rows_of_view(view_of(rows, missing=[(1, 5.0, 9.0), (6, 10.0, 12.0)]))
    assert len(found.rows) == 10
    assert kinds(found) == []


def test_plants_that_four_rows_lack_side_by_side_are_told() -> None:
    """Their edges are ragged, as those of a road are not."""
    rows = straight(4, 40.0)
    missing = [(0, 15.0, 19.0), (1, 16.6, 22.0), (2, 14.2, 18.4), (3, 16.4, 21.0)]
    found = rows_of_view(view_of(rows, missing=missing))
    assert kinds(found) == ["road"]
    assert sorted(found.doubts[0].rows) == sorted(row.id for row in found.rows)
    assert len(found.rows) == 8
    assert "4 holes lie side by side near " in found.doubts[0].text
    assert "taken for a road" in found.doubts[0].text


def test_a_road_with_straight_edges_is_no_doubt_in_four_rows() -> None:
    rows = straight(4, 40.0)
    missing = [(k, 15.0 + k, 19.0 + k) for k in range(4)]
    found = rows_of_view(view_of(rows, missing=missing))
    assert len(found.rows) == 8
    assert kinds(found) == []


def test_holes_side_by_side_by_chance_are_no_road() -> None:
    """Where 40 % of the plants are missing, some are in all of a few rows."""
    found = outcome(0.4, 46)
    assert found.rows == (8, 0, 0)
    assert found.told == ("road",)


def test_holes_that_may_be_a_road_are_told_where_rows_go_on() -> None:
    rows = straight(4, 60.0)
    holes = [(15.0, 6.0), (21.5, 24.0, 33.0), (12.0, 36.0), (9.0, 45.0)]
    missing = [(k, at, at + 3.0) for k, starts in enumerate(holes) for at in starts]
    missing += [(0, 26.0, 30.0), (1, 26.4, 31.4), (2, 28.6, 31.8), (3, 26.6, 30.6)]
    found = rows_of_view(view_of(rows, missing=sorted(missing)))
    assert len(found.rows) == 4
    assert kinds(found) == ["road"]
    assert len(found.doubts[0].rows) == 4
    assert "may be a road" in found.doubts[0].text
