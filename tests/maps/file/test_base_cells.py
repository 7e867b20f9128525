"""Cells that are no whole multiple of the map's own: what must come from those that they touch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as arrays

from fieldgrid.core import ConfigError
from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import GROUPS, Cells, Change, MapFile, MapView, Selection, Transfer, open_map
from fieldgrid.maps.layers.window import with_overviews
from fieldgrid.maps.views.base_cells import PARTS, Resampling
from tests.maps.file.maps import CELL_M, drive, one_cell, pose_at, write_map

BASE = Lattice(0.05)
SIZES_M = st.sampled_from([0.03, 0.05, 0.06, 0.075, 0.08, 0.1, 0.12, 0.13, 0.26, 0.4])
DENSITY = (GROUPS["density"],)
HIGHEST = ("peak", "max", "count", "sessions")
"""The layers that say the highest of something."""


@settings(max_examples=40)
@given(
    density=arrays.arrays(np.uint8, (24, 31), elements=st.sampled_from([0, 0, 0, 60, 200])),
    observed=arrays.arrays(np.bool_, (24, 31)),
    cell_m=SIZES_M,
    corner=st.tuples(st.integers(-40, 9), st.integers(-40, 9)),
)
def test_each_cell_has_the_worst_of_the_base_cells_that_it_touches(
    density: np.ndarray, observed: np.ndarray, cell_m: float, corner: tuple[int, int]
) -> None:
    """By comparing every cell with every base cell, in exact units of a tenth of a millimetre."""
    i0, j0 = corner
    lattice = Lattice(cell_m)
    window = lattice.window(BASE.bounds(Window(i0, j0, 31, 24)))
    touching = Resampling(DENSITY, BASE, lattice)
    under = touching.under(window)
    shift = j0 - under.j0, i0 - under.i0
    sums = np.zeros((2, *under.shape), dtype=np.uint64)
    place = sums[:, shift[0] : shift[0] + 24, shift[1] : shift[1] + 31]
    place[:] = observed, observed * density
    found = touching.larger(
        with_overviews(DENSITY, Cells({"weight": sums[0], "sum": sums[1]})), window
    )
    assert set(found) == {"peak", "seen"}  # sums of evidence do not follow from them
    large, small = round(cell_m * 10_000), 500
    for row in range(window.height):
        for column in range(window.width):
            south, west = (window.j0 + row) * large, (window.i0 + column) * large
            highest, area = 0, 0
            for j in range(24):
                high = min(south + large, (j0 + j + 1) * small) - max(south, (j0 + j) * small)
                if high <= 0:
                    continue
                for i in range(31):
                    wide = min(west + large, (i0 + i + 1) * small) - max(west, (i0 + i) * small)
                    if wide > 0 and observed[j, i]:
                        highest = max(highest, int(density[j, i]))
                        area += wide * high
            assert found["peak"][row, column] == highest
            share = int(found["seen"][row, column]) / found.base_cells
            assert abs(share - area / large**2) < 4 / PARTS
            assert (share > 0) == (area > 0)
            if area == large**2:
                assert share == 1.0


FIELD = [drive(4, step_m=0.7), drive(4, step_m=0.9, heading_deg=-61.0, start=2), drive(2, start=7)]


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_map(tmp_path_factory.mktemp("map") / "map.gpkg", FIELD))


def highest_touched(own: MapView, coarse: MapView, name: str) -> np.ndarray:
    """By comparing every cell with every one of the map's own."""
    found = np.zeros(coarse.window.shape, dtype=np.float64)
    values = np.where(own.observed, own.layer("density" if name == "peak" else name), 0)
    unit = 10_000
    large, small = round(coarse.lattice.cell_m * unit), round(own.lattice.cell_m * unit)
    for row in range(coarse.window.height):
        south = (coarse.window.j0 + row) * large
        j0, j1 = south // small - own.window.j0, -(-(south + large) // small) - own.window.j0
        for column in range(coarse.window.width):
            west = (coarse.window.i0 + column) * large
            i0, i1 = west // small - own.window.i0, -(-(west + large) // small) - own.window.i0
            inside = values[max(j0, 0) : max(j1, 0), max(i0, 0) : max(i1, 0)]
            found[row, column] = inside.max(initial=0)
    return found


@pytest.mark.parametrize(
    "cell_m", [0.25, 0.37, *(pytest.param(one, marks=pytest.mark.long) for one in (0.13, 1.05))]
)
@pytest.mark.parametrize("choice", ["all", "sessions", "filter", "area"])
def test_maxima_are_those_of_the_maps_own_cells(
    universal: MapFile, cell_m: float, choice: str
) -> None:
    asked = {
        "all": {},
        "sessions": {"sessions": ["0", "2"]},
        "filter": {"frame_filter": lambda frame: int(frame.frame_id) % 2 == 0},
        "area": {"transfer": Transfer.AREA},
    }[choice]
    coarse = universal.read(cell_m=cell_m, layers=(*HIGHEST, "seen_share"), **asked)
    own = universal.read(layers=HIGHEST, **asked)
    assert (coarse.peak > 100).sum() > (coarse.density > 100).sum()
    for name in HIGHEST:
        np.testing.assert_array_equal(coarse.layer(name), highest_touched(own, coarse, name), name)
    seen = np.nan_to_num(coarse.seen_share)
    np.testing.assert_array_equal(seen > 0, highest_touched(own, coarse, "observed") > 0)
    # The mean is that of the frames, folded anew.
    plain = universal.read(cell_m=cell_m, **asked)
    np.testing.assert_array_equal(coarse.density, plain.density)
    np.testing.assert_array_equal(coarse.observed, plain.observed)


@pytest.mark.parametrize("cell_m", [0.25, 0.37])
def test_overviews_of_odd_cells_keep_the_highest(universal: MapFile, cell_m: float) -> None:
    asked = Selection(cell_m=cell_m, beside=HIGHEST)
    longest = max(universal.read(cell_m=cell_m).window.shape)
    with asked.blocks(universal, smallest_px=longest // 5) as blocks:
        found = list(blocks.views)
    assert {one.lattice for one in found} == {blocks.lattice, *blocks.levels}
    assert len(blocks.levels) == 3
    for one in found:
        if one.lattice == blocks.lattice:
            view = one  # its overviews follow
        side = round(one.lattice.cell_m / cell_m)
        for name in HIGHEST:
            squares = view.layer(name).reshape(one.window.height, side, -1, side)
            np.testing.assert_array_equal(one.layer(name), squares.max(axis=(1, 3)), name)


def test_a_large_odd_cell_needs_no_more_memory(
    universal: MapFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many of the map's own cells lie in one: they are looked into a piece at a time."""
    most = 0
    larger = Resampling.larger

    def spy(self: Resampling, cells: Cells, window: Window) -> Cells:
        nonlocal most
        most = max(most, cells["weight"].size)
        return larger(self, cells, window)

    monkeypatch.setattr(Resampling, "larger", spy)
    bounds = universal.bounds._replace(east_m=2000.0, north_m=2000.0)
    view = universal.read(bounds, 7.33, layers=["peak"])
    asked = Selection(bounds, 7.33, layer="peak")
    with asked.blocks(universal, smallest_px=100) as blocks:
        _, larger_view, *_ = blocks.views
        assert larger_view.peak.max() == view.peak.max() == 255
    assert 0 < most < 2_000_000


@pytest.mark.parametrize("cell_m", [0.2, 0.5, 0.25, 0.37])
def test_what_changed_is_decided_by_the_maps_own_cells(tmp_path: Path, cell_m: float) -> None:
    """A post of one cell among free ones, which a mean would hide, appears and vanishes."""
    free = [one_cell(2.05 + 0.1 * i, 3.05 + 0.1 * j, 0) for i in range(12) for j in range(12)]

    def on_day(day: int, *posts: tuple[float, float]) -> list:
        frames = [(grid, pose) for grid, pose in free] + [one_cell(*post, 255) for post in posts]
        return [
            (grid, pose_at(pose.east_m, pose.north_m, 90.0, time_ns=day * 86_400_000_000_000))
            for grid, pose in frames
        ]

    first, second = (2.35, 3.35), (2.85, 3.85)
    path = write_map(tmp_path / "map.gpkg", [on_day(1, first), on_day(2, second)])
    with open_map(path) as universal:
        view = universal.diff("0", "1", cell_m=cell_m)
        assert (universal.read(cell_m=cell_m).density <= 100).all() or cell_m < 0.25
        for (east_m, north_m), expected in ((first, Change.VANISHED), (second, Change.APPEARED)):
            i, j = view.lattice.index(east_m, north_m)
            assert view.change[j - view.window.j0, i - view.window.i0] == expected
        with pytest.raises(ConfigError, match="smaller than the local cells"):
            universal.diff("0", "1", cell_m=CELL_M / 2)


@pytest.mark.parametrize("cell_m", [0.1, 0.2, 0.25, 0.37])
def test_an_obstacle_that_was_not_seen_again_has_not_vanished(
    tmp_path: Path, cell_m: float
) -> None:
    """The later drive sees the ground beside it, in the same larger cell."""
    post = (2.35, 3.35)
    beside = [(2.05 + 0.1 * i, 3.05 + 0.1 * j) for i in range(12) for j in range(12)]
    later = [place for place in beside if place != pytest.approx(post)]
    assert len(later) == len(beside) - 1
    days = (
        [one_cell(*place, 0) for place in beside] + [one_cell(*post, 255)],
        [one_cell(*place, 0) for place in later],
    )
    path = write_map(
        tmp_path / "map.gpkg",
        [
            [
                (grid, pose_at(pose.east_m, pose.north_m, 90.0, time_ns=day * 86_400_000_000_000))
                for grid, pose in frames
            ]
            for day, frames in enumerate(days, start=1)
        ],
    )
    with open_map(path) as universal:
        view = universal.diff("0", "1", cell_m=cell_m)
    i, j = view.lattice.index(*post)
    assert view.change[j - view.window.j0, i - view.window.i0] == Change.NOT_SEEN_AGAIN
    assert Change.VANISHED not in view.change


def test_no_session_is_not_every_session(universal: MapFile) -> None:
    for cell_m in (None, 0.2, 0.25):
        for asked in ({}, {"layers": ["max"]}, {"frame_filter": lambda frame: True}):
            view = universal.read(cell_m=cell_m, sessions=[], **asked)
            assert not view.observed.any()
            assert not view.density.any()
