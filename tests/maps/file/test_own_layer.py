"""A channel group and layers of one's own, in one file: read, shown, exported, verified, repaired
and undone like the built-in ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.cli import app
from fieldgrid.core import ConfigError
from fieldgrid.export import Selection, export_map, figures
from fieldgrid.geometry import Lattice
from fieldgrid.maps import (
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    FrameInPlace,
    Layer,
    MapView,
    OverviewChannel,
    create_map,
    open_map,
    register_group,
    register_layer,
    unregister,
)
from fieldgrid.view import layers as tiles
from tests.maps.file.content import content
from tests.maps.file.maps import CELL_M, DATUM, drive, write_map, write_session

LAST, CERTAIN, NEAREST = "last", "certain", "nearest"


class LastSeen:
    """The time of the last frame that saw a cell, and how near the nearest one was."""

    def __init__(self, cells: int, _: Lattice) -> None:
        self._values = np.zeros((3, cells), dtype=np.uint64)

    def add(self, frame: FrameInPlace) -> None:
        seen = np.uint64(frame.pose.time_ns // 1_000_000_000 + 1)
        last, total, near = self._values
        last[frame.touched] = np.maximum(last[frame.touched], seen)
        total[frame.touched] += seen
        cells, values = frame.landing.cell, frame.cells.grid.density
        inside = cells >= 0
        np.maximum.at(near, cells[inside], 255 - values[inside].astype(np.uint64))

    def channels(self) -> np.ndarray:
        return self._values


GROUP = ChannelGroup(
    "last_seen",
    (
        Channel("last_s", Combine.MAX, Combine.MAX),
        Channel("total_s"),
        Channel("lowest", Combine.MAX, Combine.MAX),
    ),
    fold=LastSeen,
    overview=(OverviewChannel("oldest_s", Combine.MAX, lambda cells: cells["last_s"]),),
)

LAYERS = (
    Layer(
        "last_seen", "uint32", "s", "when it was seen last", ("density", "last_seen"),
        lambda cells: cells["last_s"], 0, Colours(("#000000", "#ffffff")),
    ),
    Layer(
        "mean_seen", "float32", "s", "mean time", ("density", "last_seen"),
        lambda cells: cells["total_s"] / np.maximum(cells["weight"], 1), float("nan"),
        Colours(("#000000", "#ffffff")),
    ),
    Layer(
        "lowest", "uint8", "", "lowest density that any frame gave", ("density", "last_seen"),
        lambda cells: 255 - cells["lowest"], None, Colours(("#000000", "#ffffff")),
    ),
)  # fmt: skip
NAMES = tuple(layer.name for layer in LAYERS)


def register() -> None:
    register_group(GROUP)
    for layer in LAYERS:
        register_layer(layer)


def forget() -> None:
    for name in (*NAMES, GROUP.name):
        unregister(name)


@pytest.fixture
def registered() -> Iterator[None]:
    register()
    yield
    forget()


FIELD = [drive(6), drive(5, heading_deg=-60.0), drive(6, step_m=0.7, start=3)]


def views(path: Path) -> list[MapView]:
    with open_map(path) as universal:
        return [universal.read(cell_m=cell_m, layers=NAMES) for cell_m in (CELL_M, 0.2, 0.3)]


def assert_same(ours: list[MapView], theirs: list[MapView]) -> None:
    for a, b in zip(ours, theirs, strict=True):
        for name in ("density", "observed", *NAMES):
            np.testing.assert_array_equal(a.layer(name), b.layer(name), name)


@pytest.mark.usefixtures("registered")
def test_it_is_read_at_every_size_as_the_frames_say(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", FIELD)
    with open_map(path) as universal:
        for sessions in (None, ["0", "2"]):
            for cell_m in (CELL_M, 0.2, 0.3):
                view = universal.read(cell_m=cell_m, layers=NAMES, sessions=sessions)
                anew = universal.read(
                    cell_m=cell_m, layers=NAMES, sessions=sessions, frame_filter=lambda _: True
                )
                assert_same([view], [anew])
        view = universal.read(layers=["last_seen", "lowest"])
        row, column = np.argwhere(view.observed)[1234]
        east, north = (axis[k] for axis, k in zip(
            view.lattice.centres(view.window), (column, row), strict=True
        ))  # fmt: skip
        found = universal.query(float(east), float(north)).contributions
        last_s = max(one.pose.time_ns // 1_000_000_000 + 1 for one in found)
        assert view.layer("last_seen")[row, column] == last_s
        assert universal.verify(deep=True).problems == ()


@pytest.mark.usefixtures("registered")
def test_a_session_leaves_and_comes_back_without_a_trace(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", FIELD, layers=NAMES)
    whole, before = content(path), views(path)
    with open_map(path, writable=True) as universal:
        universal.remove_session("1")
        assert universal.verify(deep=True).problems == ()
    never = tmp_path / "never.gpkg"
    with create_map(never, DATUM, cell_m=CELL_M, layers=NAMES) as universal:
        for name in ("0", "2"):
            write_session(universal, name, FIELD[int(name)])
    assert content(path, "tiles") == content(never, "tiles")
    with open_map(path, writable=True) as universal:
        universal.restore_session("1")
    assert content(path) == whole
    assert_same(views(path), before)


@pytest.mark.usefixtures("registered")
def test_it_is_exported(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    path = write_map(tmp_path / "map.gpkg", FIELD)
    with open_map(path) as universal:
        for name in NAMES:
            export_map(universal, tmp_path / f"{name}.tif", Selection(layer=name))
            expected = universal.read(layers=[name])
            with rasterio.open(tmp_path / f"{name}.tif") as opened:
                found = opened.read(1)[::-1]
            seen = expected.observed
            np.testing.assert_array_equal(found[seen], expected.layer(name)[seen])


@pytest.mark.usefixtures("registered")
def test_it_is_shown(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", FIELD)
    with open_map(path) as universal:
        view = universal.read(layers=NAMES)
        tile = tiles.draw_layer(view, "lowest", tiles.scale_of(universal, "lowest"))
    assert tile is not None
    for name in NAMES:
        (image,) = figures.universal_grid(view, layer=name).axes[0].images
        shown = image.get_array()
        assert isinstance(shown, np.ma.MaskedArray)
        np.testing.assert_array_equal(~np.ma.getmaskarray(shown), view.observed)
        np.testing.assert_array_equal(shown.compressed(), view.layer(name)[view.observed])
        words = ["show", str(path), "-o", str(tmp_path / f"{name}.png"), "--layer", name]
        app(words, standalone_mode=False)
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_a_map_of_before_is_read_and_repair_adds_it(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", FIELD)
    register()
    try:
        before = views(path)
        with open_map(path, writable=True) as universal:
            assert universal.verify(deep=True).problems == ()
            universal.repair(layers=NAMES)
            assert universal.verify(deep=True).problems == ()
        fresh = write_map(tmp_path / "fresh.gpkg", FIELD, layers=NAMES)
        assert content(path) == content(fresh)
        assert_same(views(path), before)
    finally:
        forget()


def test_a_map_with_channels_that_nobody_knows_is_read_and_says_what_to_do(tmp_path: Path) -> None:
    plain = write_map(tmp_path / "plain.gpkg", FIELD)
    register()
    try:
        path = write_map(tmp_path / "map.gpkg", FIELD, layers=NAMES)
    finally:
        forget()
    with open_map(path) as universal, open_map(plain) as other:
        np.testing.assert_array_equal(universal.read().density, other.read().density)
        layers = ["count", "height"]
        ours, theirs = (m.read(cell_m=0.2, layers=layers) for m in (universal, other))
        np.testing.assert_array_equal(ours.layer("count"), theirs.layer("count"))
        health = universal.verify(deep=True)
        assert health.sound
        assert "last_seen" in health.notes[0]
    before = path.read_bytes()
    with open_map(path, writable=True) as universal:
        for change in (
            lambda: universal.remove_session("0"),
            lambda: universal.set_transform("0", 1.0, 0.0),
            lambda: universal.add_session("more"),
        ):
            with pytest.raises(ConfigError, match=r"'last_seen', which no imported module knows"):
                change()
        assert path.read_bytes() == before
        universal.repair()
        assert universal.verify(deep=True).problems == ()
    assert content(path) == content(plain)
