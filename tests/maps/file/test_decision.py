"""What cells count as with marks, decided on the map's own cells at any size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st

from fieldgrid.geometry import Bounds, Lattice, LocalGrid, Window
from fieldgrid.maps import Mark, MarkKind, open_map
from fieldgrid.maps.file.geometry import Ring
from fieldgrid.maps.views.decision import DRIVEN, FREE, KEEPOUT, OBSTACLE, marked_cells
from tests.maps.file.maps import CELL_M, SPEC, drive, pose_at, write_map
from tests.maps.file.test_marks import add, square

METRES = st.floats(-3.0, 3.0).map(lambda value: round(value, 3))
"""Whole millimetres: shapely does not see a slit that is thinner than a number can tell."""

COORDINATES = st.tuples(METRES, METRES)


@given(st.lists(COORDINATES, min_size=3, max_size=7, unique=True))
def test_outlines_touch_the_cells_that_their_insides_touch(
    corners: list[tuple[float, float]],
) -> None:
    shape = shapely.Polygon(corners)
    if not shape.is_valid or shape.area < 1e-6:
        return
    check_cells(tuple(corners), ())


@given(st.lists(COORDINATES, min_size=3, max_size=7, unique=True))
def test_holes_are_left_out_but_for_the_cells_that_they_cut(
    corners: list[tuple[float, float]],
) -> None:
    hole = shapely.Polygon(corners)
    if not hole.is_valid or hole.area < 1e-6:
        return
    check_cells(square(-3.5, -3.5, 7.0), (tuple(corners),))


def check_cells(corners: Ring, holes: tuple[Ring, ...]) -> None:
    """Compare the cells of a polygon with what shapely says of each of them."""
    shape = shapely.Polygon(corners, holes)
    lattice, window = Lattice(0.5), Window(-5, -4, 9, 10)
    marks = [Mark(kind, corners, holes=holes) for kind in (MarkKind.KEEPOUT, MarkKind.FREE)]
    flags = marked_cells(marks, lattice, window)
    for j, i in np.ndindex(*window.shape):
        west, south = 0.5 * (window.i0 + i), 0.5 * (window.j0 + j)
        cell = shapely.box(west, south, west + 0.5, south + 0.5)
        inner, outer = cell.buffer(-1e-4), cell.buffer(1e-4)
        if shape.intersects(inner):
            assert flags[j, i] & KEEPOUT
        if not shape.intersects(outer):
            assert not flags[j, i]
        if shape.contains(outer):
            assert flags[j, i] & FREE
        if not shape.contains(inner):
            assert not flags[j, i] & FREE


def test_outlines_along_the_sides_of_cells_touch_no_more_than_they_enclose() -> None:
    flags = marked_cells(
        [
            Mark(MarkKind.OBSTACLE, square(0.3, -0.2, 0.3)),
            Mark(MarkKind.FREE, square(0.7, 0.1, 0.2)),
        ],
        Lattice(0.1),
        Window(0, -5, 12, 12),
    )
    assert [set(axis.tolist()) for axis in np.nonzero(flags & OBSTACLE)] == [{3, 4, 5}, {3, 4, 5}]
    assert [set(axis.tolist()) for axis in np.nonzero(flags & FREE)] == [{6, 7}, {7, 8}]


def test_a_point_is_its_cell_and_a_place_is_nothing() -> None:
    marks = [Mark(MarkKind.OBSTACLE, ((0.45, 0.17),)), Mark(MarkKind.PLACE, square(0, 0), "yard")]
    flags = marked_cells(marks, Lattice(0.1), Window(0, 0, 10, 10))
    assert np.argwhere(flags).tolist() == [[1, 4]]


def test_an_area_far_larger_than_the_window_costs_no_more() -> None:
    huge = Mark(MarkKind.FREE, square(-40_000.0, -40_000.0, 80_000.0))
    assert (marked_cells([huge], Lattice(0.05), Window(100, 200, 64, 32)) == FREE).all()


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random cells of which a third is unseen, with marks over seen and unseen ones."""
    path = write_map(tmp_path_factory.mktemp("marks") / "map.gpkg", [drive(4)])
    add(
        path,
        Mark(MarkKind.OBSTACLE, square(-6.03, 5.02, 0.31)),
        Mark(MarkKind.FREE, square(-6.33, 4.9, 2.17, 3.3)),
        Mark(MarkKind.FREE, ((-2.0, 7.0), (1.0, 8.05), (-1.5, 9.3))),
        Mark(MarkKind.FREE, ((-3.03, 9.04),)),
        Mark(MarkKind.KEEPOUT, square(-4.0, 10.0, 2.0)),
        Mark(MarkKind.PLACE, square(-6.0, 4.0, 9.0), "yard"),
    )
    return path


def test_base_cells_count_as_marked(field: Path) -> None:
    with open_map(field) as universal:
        view = universal.read(decide="density")
        flags = marked_cells(universal.marks(), view.lattice, view.window)
    worst, seen, keepout = view.decision()
    obstacle = (flags & OBSTACLE) > 0
    free = ((flags & FREE) > 0) & ~obstacle
    assert obstacle.sum() == 16
    assert free.sum() > 500
    assert (worst[obstacle] == 255).all()
    assert (worst[free] == 0).all()
    assert (seen[obstacle | free] == 1.0).all()
    assert view.decided is not None
    rest = view.decided.flags == 0
    assert (worst[(view.decided.flags & DRIVEN) > 0] == 0).any()
    np.testing.assert_array_equal(worst[rest], view.density[rest])
    np.testing.assert_array_equal(seen[rest], view.observed[rest])
    np.testing.assert_array_equal(keepout, (flags & KEEPOUT) > 0)


@pytest.mark.parametrize("times", [2, 3, 4, 7])
@pytest.mark.parametrize("layer", ["density", "lasting", "max"])
def test_larger_cells_are_decided_by_the_marked_base_cells(
    field: Path, times: int, layer: str
) -> None:
    """The highest of those in each, and the share of them that was seen or is marked."""
    with open_map(field) as universal:
        coarse = universal.read(cell_m=times * CELL_M, decide=layer)
        base = universal.read(coarse.bounds, decide=layer)
    worst, seen, keepout = base.decision()
    found = coarse.decision()
    blocks = (coarse.window.height, times, coarse.window.width, times)
    share = seen.reshape(blocks).mean(axis=(1, 3))
    said = marked_cells(base.marks, base.lattice, base.window) & OBSTACLE
    share[said.reshape(blocks).any(axis=(1, 3))] = 1.0
    np.testing.assert_allclose(found.seen, share, atol=1e-6)
    np.testing.assert_array_equal(found.keepout, keepout.reshape(blocks).any(axis=(1, 3)))
    np.testing.assert_array_equal(found.worst, worst.reshape(blocks).max(axis=(1, 3)))


def test_cells_of_no_whole_multiple_are_the_worst_of_all_that_they_touch(field: Path) -> None:
    with open_map(field) as universal:
        coarse = universal.read(cell_m=0.27, decide="density")
        base = universal.read(decide="density")
    found, fine = coarse.decision(), base.decision()
    north, east = np.nonzero(
        marked_cells(base.marks, base.lattice, base.window) & (OBSTACLE | KEEPOUT)
    )
    easts, norths = base.lattice.centres(base.window)
    i, j = coarse.lattice.index(easts[east], norths[north])
    at = j - coarse.window.j0, i - coarse.window.i0
    assert (found.worst[at] >= fine.worst[north, east]).all()
    assert (found.keepout[at] >= fine.keepout[north, east]).all()


def test_blocks_decide_like_the_whole_and_come_where_only_marks_are(tmp_path: Path) -> None:
    values = np.zeros(SPEC.shape, np.uint8)
    grid = LocalGrid(SPEC, values, np.ones(SPEC.shape, np.bool_))
    frames = [(grid, pose_at(east, 0.03, 90.0, time_ns=k)) for k, east in enumerate((0.03, 900.03))]
    path = write_map(tmp_path / "far.gpkg", [frames])
    add(path, Mark(MarkKind.OBSTACLE, square(900.0, 0.0)), Mark(MarkKind.FREE, square(400.0, 0.0)))
    with open_map(path) as universal:
        whole = universal.read(decide="density").decision()
        with universal.read_blocks(decide="density") as blocks:
            found = sum(int((view.decision().worst == 255).sum()) for view in blocks.views)
        with universal.read_blocks(Bounds(300.0, -1.0, 500.0, 2.0), decide="density") as blocks:
            middle = list(blocks.views)
    assert found == (whole.worst == 255).sum() == 100
    assert sum(int((view.decision().seen > 0).sum()) for view in middle) == 100
