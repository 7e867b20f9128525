from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from fieldgrid.core import ConfigError, MapError
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, MapView, Patience, open_map
from fieldgrid.maps.views import blocks
from tests.maps.file.maps import drive, one_cell, write_map


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    """Two drives that overlap, and a cell far away from them, over 9 x 9 tiles."""
    path = tmp_path_factory.mktemp("map") / "m.gpkg"
    far = [one_cell(-100.35, 120.05, 200), one_cell(110.05, -96.75, 0)]
    return open_map(write_map(path, [drive(9), [*drive(5, heading_deg=201.7, start=3), *far]]))


def together(views: list[MapView], whole: MapView) -> MapView:
    """What the pieces say, in one view; what none of them covers was not observed."""
    found = {name: np.zeros_like(array) for name, array in whole.layers.items()}
    for array in found.values():
        if array.dtype.kind == "f":
            array.fill(np.nan)
    density = np.zeros_like(whole.density)
    covered = np.zeros(whole.window.shape, dtype=np.int64)
    observed = np.zeros_like(whole.observed)
    for view in views:
        place = whole.window.slices_of(view.window)
        density[place], observed[place] = view.density, view.observed
        covered[place] += 1
        for name, array in found.items():
            array[place] = view.layer(name)
    assert covered.max() <= 1
    return MapView(whole.lattice, whole.window, density, observed, whole.datum, found)


bounds = st.tuples(
    st.floats(-120.0, 100.0), st.floats(-110.0, 110.0), st.floats(0.05, 60.0), st.floats(0.05, 60.0)
).map(lambda b: Bounds(b[0], b[1], b[0] + b[2], b[1] + b[3]))


@given(
    st.one_of(st.none(), bounds),
    st.sampled_from([None, 0.2, 0.4, 0.13, 1.7]),
    st.sampled_from([(), ("count",), ("variance", "max", "height")]),
    st.sampled_from([None, "0", "1"]),
)
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_the_blocks_are_the_view(
    universal: MapFile,
    monkeypatch: pytest.MonkeyPatch,
    part: Bounds | None,
    cell_m: float | None,
    layers: tuple[str, ...],
    at: str | None,
) -> None:
    monkeypatch.setattr(blocks, "_ROWS", 256)
    monkeypatch.setattr(blocks, "_COLUMNS", 512)
    whole = universal.read(part, cell_m, layers=layers, at=at)
    with universal.read_blocks(part, cell_m, layers=layers, at=at) as cut:
        assert (cut.lattice, cut.window) == (whole.lattice, whole.window)
        views = list(cut.views)
    found = together(views, whole)
    np.testing.assert_array_equal(found.density, whole.density)
    np.testing.assert_array_equal(found.observed, whole.observed)
    for name in layers:
        np.testing.assert_array_equal(found.layer(name), whole.layer(name))


def test_they_come_from_the_north_and_where_something_is(universal: MapFile) -> None:
    with universal.read_blocks() as cut:
        windows = [view.window for view in cut.views]
        assert cut.window.height > 2000
    tops = [window.j0 + window.height for window in windows]
    assert tops == sorted(tops, reverse=True)
    assert all(window.j0 % 1024 == 0 or window.j0 == cut.window.j0 for window in windows)


def test_nobody_changes_the_map_meanwhile(tmp_path: Path) -> None:
    path = write_map(tmp_path / "m.gpkg", [drive(2), drive(2, heading_deg=90.0)])
    with open_map(path) as reader:
        with (
            reader.read_blocks() as cut,
            open_map(path, writable=True, patience=Patience(0.05)) as writer,
        ):
            with pytest.raises(MapError, match="in use by another program"):
                writer.remove_session("0")
            seen = sum(int(view.observed.sum()) for view in cut.views)
            assert seen == reader.read().observed.sum()
        with open_map(path, writable=True) as writer:
            writer.remove_session("0")


def test_a_map_of_no_bounds_is_refused(universal: MapFile) -> None:
    with (
        pytest.raises(ConfigError, match="over 10 thousand million"),
        universal.read_blocks(Bounds(0.0, 0.0, 20000.0, 20000.0)),
    ):
        pass


def test_a_damaged_picture_is_one_sentence(tmp_path: Path) -> None:
    path = write_map(tmp_path / "m.gpkg", [drive(3)])
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE density SET tile_data = substr(tile_data, 1, 300)")
    with (
        open_map(path) as universal,
        pytest.raises(MapError, match=r"picture of tile .* is damaged"),
        universal.read_blocks() as cut,
    ):
        list(cut.views)
