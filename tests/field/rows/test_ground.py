"""Outlines of areas of cells."""

from __future__ import annotations

import dataclasses
import math
import types

import numpy as np
import pytest
import shapely

from fieldgrid.field.rows import ground, segments
from fieldgrid.field.rows.blocks import LaneLine
from fieldgrid.field.rows.ground import (
    canopies,
    find_headlands,
    find_things,
    measure_lane,
    polygons_of,
)
from fieldgrid.field.rows.measuring.extent import Extent
from fieldgrid.field.rows.segments import thinned
from fieldgrid.maps import FREE, OBSTACLE, Evidence, evidence, fill_pinholes
from tests.field.rows.fields import QUIET, straight, view_of


def test_cells_that_meet_in_a_corner_are_two_valid_areas() -> None:
    seen = Evidence.of(view_of(straight(2, 10.0)), 100)
    mask = np.zeros(seen.cells.shape, dtype=np.uint8)
    mask[10:20, 10:20] = mask[20:30, 20:30] = 1
    mask[10:20, 50:60] = mask[20:30, 40:50] = 1
    found = polygons_of(seen, mask, 0.01)
    assert len(found) == 4
    assert all(shape.is_valid for shape in found)
    assert [shape.area for shape in found] == pytest.approx([1.0] * 4, abs=0.2)


def test_a_hole_that_meets_the_outside_in_a_corner_is_open() -> None:
    seen = Evidence.of(view_of(straight(2, 10.0)), 100)
    mask = np.zeros(seen.cells.shape, dtype=np.uint8)
    mask[10:40, 10:40] = 1
    mask[30:40, 30:40] = mask[20:30, 20:30] = 0
    (shape,) = polygons_of(seen, mask, 0.01)
    assert shape.is_valid
    assert not shape.interiors
    assert shape.area == pytest.approx(7.0, abs=0.4)


def test_bands_show_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is worked out some rows at a time is what all rows at once would say."""
    rows = straight(4, 20.0, heading_deg=20.0)
    view = view_of(rows, dataclasses.replace(QUIET, hole_share=0.1), cell_m=0.05)

    def worked() -> tuple[object, ...]:
        filled = fill_pinholes(Evidence.of(view, 100), 0.25)
        outlines = polygons_of(filled, (filled.cells == FREE).astype(np.uint8), 0.5)
        points = thinned(filled, 0.17)
        return filled.cells.tobytes(), [one.wkb for one in outlines], points.tobytes()

    whole = worked()
    for module in (evidence, ground, segments):
        monkeypatch.setattr(module, "_BAND_CELLS", 1)
    assert worked() == whole


def test_points_are_the_means_of_the_obstacle_cells_of_squares() -> None:
    seen = Evidence.of(view_of(straight(2, 10.0), cell_m=0.05), 100)
    j, i = np.nonzero(seen.cells == OBSTACLE)
    east_m, north_m = seen.lattice.centres(seen.window)
    squares: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for e, n in zip(east_m[i].tolist(), north_m[j].tolist(), strict=True):
        squares.setdefault((math.floor(e / 0.3), math.floor(n / 0.3)), []).append((e, n))
    expected = [np.mean(squares[key], axis=0) for key in sorted(squares)]
    np.testing.assert_allclose(thinned(seen, 0.3), expected, atol=1e-9)


@pytest.mark.parametrize(("aside", "things"), [(2, 0), (9, 1)])
def test_what_hangs_together_with_a_canopy_is_a_thing_where_it_sticks_out(
    aside: int, things: int
) -> None:
    view = view_of(straight(1, 10.0), cell_m=0.1)
    cells = Evidence.of(view, 100)
    row = types.SimpleNamespace(
        line=np.array([(0.0, 0.0), (0.0, 10.0)]), half_width_m=0.35,
        extent=Extent(0.0, 10.0, (), ()),
    )  # fmt: skip
    i0, j0 = cells.window.i0, cells.window.j0
    grid = np.full(cells.cells.shape, FREE, np.uint8)
    grid[-j0 : 100 - j0, -5 - i0 : 5 - i0] = OBSTACLE
    grid[40 - j0 : 50 - j0, 4 - i0 : 5 + aside - i0] = OBSTACLE
    found = find_things(cells._replace(cells=grid), canopies(cells, [row]))  # type: ignore[list-item]
    assert len(found) == things


def test_ground_inside_any_block_is_no_headland() -> None:
    cells = Evidence.of(view_of(straight(2, 30.0)), 100)
    free = cells._replace(cells=np.full_like(cells.cells, FREE))
    west_m, south_m, east_m, north_m = cells.lattice.bounds(cells.window)
    middle_m = (south_m + north_m) / 2.0
    blocks = [
        shapely.box(west_m - 1.0, south_m + 8.0, east_m + 1.0, middle_m),
        shapely.box(west_m - 1.0, middle_m, east_m + 1.0, north_m - 8.0),
    ]
    found = find_headlands(free, blocks, 20.0)
    assert len(found) == 2
    assert sum(one.area for one in found) == pytest.approx(16.0 * (east_m - west_m), rel=0.05)


def test_a_lane_between_rows_that_touch_has_no_width() -> None:
    seen = Evidence.of(view_of(straight(2, 10.0)), 100)
    line = np.array([[1.25, 1.0], [1.25, 9.0]])
    area = shapely.LineString(line).buffer(0.01)
    told = measure_lane(seen, seen, seen, seen, LaneLine(0, 1, line, area, 0.01), (0.3, 0.3))
    assert np.isnan(told.widths_m).all()
    assert math.isnan(told.clear_m)
    assert told.known == 0.0
