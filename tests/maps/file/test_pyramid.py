"""Tiles and overviews against a fold of everything at once."""

from __future__ import annotations

import io
import sqlite3
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from fieldgrid.geometry import TILE_CELLS, Lattice, Window
from fieldgrid.maps import LAYERS, MapFile, mean_density, open_map
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.transfer import MeanFold
from fieldgrid.maps.writing import placing
from tests.maps.file.content import content
from tests.maps.file.maps import CELL_M, DATUM, Frame, drive, write_map, write_session

LATTICE = Lattice(CELL_M)
SIDE = 16 * TILE_CELLS
AROUND_DATUM = Window(-SIDE // 2, -SIDE // 2, SIDE, SIDE)


def expected_sums(frames: list[Frame]) -> npt.NDArray[np.uint64]:
    fold = MeanFold(LATTICE, AROUND_DATUM)
    for grid, pose in frames:
        fold.add(grid, pose)
    return fold.sums


def picture(path: Path, zoom: int) -> npt.NDArray[np.uint8]:
    """The whole window as the tiles of a zoom level show it, [rows north, columns, LA]."""
    matrices = TileMatrixSet(LATTICE)
    shrink = 1 << (matrices.base_zoom - zoom)
    size = SIDE // shrink
    first = (1 << (zoom - 1)) - size // 2 // TILE_CELLS
    pixels = np.zeros((max(size, 2 * TILE_CELLS), max(size, 2 * TILE_CELLS), 2), dtype=np.uint8)
    first = (1 << (zoom - 1)) - pixels.shape[0] // 2 // TILE_CELLS
    with sqlite3.connect(path) as database:
        rows = database.execute(
            "SELECT tile_column, tile_row, tile_data FROM density WHERE zoom_level = ?", (zoom,)
        ).fetchall()
    database.close()
    for column, row, data in rows:
        y, x = (row - first) * TILE_CELLS, (column - first) * TILE_CELLS
        pixels[y : y + TILE_CELLS, x : x + TILE_CELLS] = np.asarray(Image.open(io.BytesIO(data)))
    margin = (pixels.shape[0] - size) // 2
    return pixels[margin : margin + size, margin : margin + size][::-1]


def assert_levels_show(path: Path, frames: list[Frame]) -> None:
    sums = expected_sums(frames)
    assert sums[0].any()
    with sqlite3.connect(path) as database:
        zooms = [
            row[0]
            for row in database.execute("SELECT DISTINCT zoom_level FROM density ORDER BY 1 DESC")
        ]
        listed = {row[0] for row in database.execute("SELECT zoom_level FROM gpkg_tile_matrix")}
    database.close()
    base = TileMatrixSet(LATTICE).base_zoom
    assert zooms == list(range(base, base - len(zooms), -1))
    assert set(zooms) <= listed
    for zoom in zooms:
        density, observed = mean_density(*sums)
        shown = picture(path, zoom)
        np.testing.assert_array_equal(shown[..., 0], density)
        np.testing.assert_array_equal(shown[..., 1], observed * 255)
        size = sums.shape[1] // 2
        sums = sums.reshape(2, size, 2, size, 2).sum(axis=(2, 4))
    # The uppermost level is small enough to be looked at whole.
    rows, columns = np.nonzero(observed)
    assert max(np.ptp(rows), np.ptp(columns)) < 2 * TILE_CELLS


def test_every_level_is_the_mean_over_all_that_fell_into_its_cells(tmp_path: Path) -> None:
    frames = drive(30)
    assert_levels_show(write_map(tmp_path / "map.gpkg", [frames]), frames)


def test_a_map_that_grows_gets_the_levels_that_it_would_have_had_at_once(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    frames = drive(1)
    for name, more in (
        ("b", drive(3, start=9)),
        ("c", drive(12, heading_deg=-110.0)),
        ("d", drive(25)),
    ):
        with open_map(path, datum=DATUM) as universal:
            write_session(universal, name, more)
        frames += more
        assert_levels_show(path, frames)


def test_a_drive_longer_than_the_memory_gives_the_same_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = drive(20)
    frames = [*there, *drive(20, heading_deg=37.3)[::-1], *drive(10, heading_deg=140.0)]
    monkeypatch.setattr(placing, "BLOCK_TILES", 1)
    monkeypatch.setattr(placing, "ALONE_TILES", 1)
    monkeypatch.setattr(placing, "RECENT_FRAMES", 1)
    monkeypatch.setattr(placing, "RECENT_TILES", 0)
    path = write_map(tmp_path / "map.gpkg", [frames])
    assert_levels_show(path, frames)


def test_rows_that_a_change_leaves_as_they_are_are_not_written(tmp_path: Path) -> None:
    """Frames without a ground have no terrain, in one session or in two."""
    path = write_map(tmp_path / "map.gpkg", [drive(3)])
    with open_map(path, datum=DATUM, cell_m=CELL_M) as universal:
        own = universal._connection
        own.execute("CREATE TEMP TABLE written (channels TEXT)")
        for event, row in (("INSERT", "new"), ("DELETE", "old"), ("UPDATE", "new")):
            own.execute(
                f"CREATE TEMP TRIGGER on_{event} AFTER {event} ON main.fieldgrid_tile "
                f"WHEN {row}.zoom = (SELECT max(zoom) FROM fieldgrid_tile) "
                f"BEGIN INSERT INTO written VALUES ({row}.channels); END"
            )
        write_session(universal, "again", drive(3))
        written = {name for (name,) in own.execute("SELECT channels FROM written")}
    assert {"density", "count"} <= written
    assert not written & {"terrain", "surface", "standing"}


def test_what_a_killed_writer_left_for_later_is_read_all_the_same_and_filled_in_by_the_next(
    tmp_path: Path,
) -> None:
    sessions = [drive(4), drive(30, start=3)]
    whole = write_map(tmp_path / "whole.gpkg", sessions)
    left = write_map(tmp_path / "left.gpkg", sessions[:1])
    universal = open_map(left, datum=DATUM)
    write_session(universal, "1", sessions[1])
    universal.discard()  # it gives up after its commit, as a kill does
    assert len(content(left, "tiles")["tiles"]) < len(content(whole, "tiles")["tiles"])
    with open_map(whole) as one, open_map(left) as other:
        for cell_m in (CELL_M, 2.0 * CELL_M, 4.0 * CELL_M, 8.0 * CELL_M):
            views = [
                universal.read(cell_m=cell_m, layers=tuple(LAYERS)) for universal in (one, other)
            ]
            for name in LAYERS:
                np.testing.assert_array_equal(views[0].layer(name), views[1].layer(name), name)
    assert content(left) != content(whole)  # a reader changes nothing
    open_map(left, writable=True).close()
    assert content(left) == content(whole)
    with open_map(left) as universal:
        assert universal.verify(deep=True).problems == ()
    before = left.read_bytes()
    open_map(left, writable=True).close()
    assert left.read_bytes() == before


@pytest.mark.parametrize("change", ["remove", "repose", "shift"])
def test_levels_follow_whatever_leaves(tmp_path: Path, change: str) -> None:
    """Also where the map becomes smaller, and where it is read before it is closed."""
    sessions = [drive(4), drive(24, step_m=12.0, heading_deg=37.3), drive(3, start=2)]
    path = write_map(tmp_path / "map.gpkg", sessions)
    with open_map(path, writable=True) as universal:
        if change == "remove":
            universal.remove_session("1")
        elif change == "shift":
            universal.set_transform("1", 30.0, -40.0, 20.0)
        else:
            poses = [pose for _, pose in drive(24, step_m=2.0)]
            universal.repose("1", {f"{k:06d}": pose for k, pose in enumerate(poses)})
        assert universal.verify().problems == ()
        assert universal.verify(deep=True).problems == ()
        for cell_m in (2.0 * CELL_M, 8.0 * CELL_M):
            assert_as_folded(universal, cell_m)
    with open_map(path) as universal:
        assert universal.verify(deep=True).problems == ()
        for cell_m in (2.0 * CELL_M, 8.0 * CELL_M):
            assert_as_folded(universal, cell_m)


def assert_as_folded(universal: MapFile, cell_m: float) -> None:
    stored = universal.read(cell_m=cell_m, layers=LAYERS)
    anew = universal.read(cell_m=cell_m, layers=LAYERS, frame_filter=lambda _: True)
    for name in LAYERS:
        np.testing.assert_array_equal(stored.layer(name), anew.layer(name), name)
