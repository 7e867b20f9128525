from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError, DatumError
from fieldgrid.geometry import Bounds, Datum, GridSpec, Status
from fieldgrid.maps import MapView, create_map, open_map
from tests.maps.file.maps import (
    CELL_M,
    DATUM,
    SPEC,
    Frame,
    drive,
    grid_of,
    pose_at,
    track,
    write_map,
    write_session,
)


def assert_same(a: MapView, b: MapView) -> None:
    assert a.window == b.window
    np.testing.assert_array_equal(a.density, b.density)
    np.testing.assert_array_equal(a.observed, b.observed)


def test_what_was_added_is_what_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    grid = grid_of(1)
    rejected = pose_at(
        math.nan, 2.0, math.nan, time_ns=5, status=Status.REJECTED, reason="no fix for 3 s"
    )
    accepted = pose_at(1.0, 2.0, 3.0, time_ns=2**62)
    with (
        create_map(path, DATUM, cell_m=CELL_M) as universal,
        universal.add_session("June 3", config={"every": 2}, source="drive sha256:1") as session,
    ):
        session.add(grid, accepted, frame_id="b", images=("left/ä.png", "right/ä.png"))
        session.add(grid_of(2), rejected)
    with open_map(path) as universal:
        (info,) = universal.sessions()
        first, second = universal.frames("June 3", with_grid=True)
    assert (info.name, info.source, dict(info.config)) == ("June 3", "drive sha256:1", {"every": 2})
    assert (info.frames, info.accepted) == (2, 1)
    assert (info.first_time_ns, info.last_time_ns, info.grid) == (5, 2**62, SPEC)
    assert info.created.endswith("Z")
    assert second.pose == accepted
    assert (second.frame_id, second.images) == ("b", ("left/ä.png", "right/ä.png"))
    assert (second.session, second.status, second.reason) == ("June 3", Status.OK, "")
    np.testing.assert_array_equal(second.grid().density, grid.density)
    np.testing.assert_array_equal(second.grid().observed, grid.observed)
    assert (first.frame_id, first.status, first.reason) == (
        "000001",
        Status.REJECTED,
        "no fix for 3 s",
    )
    assert math.isnan(first.pose.east_m)
    assert not first.accepted


def test_rejected_frames_are_evidence_but_not_in_the_map(tmp_path: Path) -> None:
    frames = drive(4)
    kept = write_map(tmp_path / "kept.gpkg", [frames])
    held = [
        (grid, pose_at(pose.east_m, pose.north_m + 9, 12.0, status=status, reason="why not"))
        for (grid, pose), status in zip(frames, [Status.REJECTED, Status.HELD] * 2, strict=True)
    ]
    mixed = write_map(tmp_path / "mixed.gpkg", [frames + held])
    with open_map(mixed) as universal:
        assert len(list(universal.frames())) == 8
        assert_same(universal.read(), open_map(kept).read())
        assert_same(universal.read(frame_filter=lambda frame: True), open_map(kept).read())


def test_two_sessions_give_the_tiles_of_one(tmp_path: Path) -> None:
    frames = drive(20)
    once = write_map(tmp_path / "once.gpkg", [frames])
    twice = write_map(tmp_path / "twice.gpkg", [frames[7:], frames[:7]])
    appended = write_map(tmp_path / "appended.gpkg", [frames[:11]])
    with open_map(appended, datum=DATUM) as universal:
        write_session(universal, "later", frames[11:])
    assert tiles_of(once) == tiles_of(twice) == tiles_of(appended)
    assert_same(open_map(once).read(), open_map(appended).read())


def tiles_of(path: Path) -> list[tuple[object, ...]]:
    database = sqlite3.connect(path)
    rows = [
        *database.execute(
            "SELECT zoom, ty, tx, channels, data FROM fieldgrid_tile "
            "WHERE channels NOT IN ('sessions', 'lasting', 'moved', "
            "'terrain', 'surface', 'vehicle_height') "  # each session has one voice
            "ORDER BY 1, 2, 3, 4"
        ),
        *database.execute(
            "SELECT zoom_level, tile_column, tile_row, tile_data FROM density ORDER BY 1, 2, 3"
        ),
        *database.execute("SELECT min_x, min_y, max_x, max_y FROM gpkg_contents ORDER BY 1"),
    ]
    database.close()
    assert len(rows) > 8
    return rows


def breaking(frames: list[Frame]) -> Iterator[Frame]:
    yield from frames
    raise RuntimeError("the camera fell off")


def test_an_error_in_a_session_leaves_the_map_as_it_was(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(5)])
    before = path.read_bytes()
    with pytest.raises(RuntimeError, match="camera"), open_map(path, datum=DATUM) as universal:
        write_session(universal, "broken", breaking(drive(5, heading_deg=100.0)), track())
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["map.gpkg"]


def test_after_an_error_the_next_session_is_complete(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(5)])
    with open_map(path, datum=DATUM) as universal:
        with pytest.raises(RuntimeError, match="camera"):
            write_session(universal, "broken", breaking(drive(1, heading_deg=100.0)))
        write_session(universal, "broken", drive(4, start=5))
    once = write_map(tmp_path / "once.gpkg", [drive(9)])
    assert_same(open_map(path).read(), open_map(once).read())


def test_sessions_are_told_apart_by_name(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    with open_map(path, datum=DATUM) as universal:
        with pytest.raises(ConfigError, match=r"has a session '0' already.*--name"):
            universal.add_session("0")
        for name in ("", "a\nb"):
            with pytest.raises(ConfigError, match="cannot be called"):
                universal.add_session(name)
        with universal.add_session("1"), pytest.raises(ConfigError, match="has not ended"):
            universal.add_session("2")
    with open_map(path) as universal, pytest.raises(ConfigError, match="opened for reading"):
        universal.add_session("2")
    with pytest.raises(ConfigError, match="is closed"):
        universal.add_session("2")


def test_a_name_that_another_program_took_meanwhile_is_refused(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    with open_map(path, datum=DATUM) as mine, open_map(path, datum=DATUM) as theirs:
        session = mine.add_session("1")
        session.add(*drive(1)[0])
        write_session(theirs, "1", drive(2))
        with pytest.raises(ConfigError, match="'1' already"), session:
            pass
        assert [(info.name, info.frames) for info in mine.sessions()] == [("0", 1), ("1", 2)]


def test_frames_that_do_not_fit_are_refused_and_the_rest_goes_in(tmp_path: Path) -> None:
    good = pose_at(0.0, 0.0, 10.0)
    with create_map(tmp_path / "map.gpkg", DATUM, cell_m=CELL_M) as universal:
        with universal.add_session("one") as session:
            session.add(grid_of(1), good, frame_id="7")
            with pytest.raises(ConfigError, match="'7' is in this session already"):
                session.add(grid_of(1), good, frame_id="7")
            with pytest.raises(ConfigError, match=r"local grids of 4\.0 x 6\.0 m"):
                session.add(grid_of(1, GridSpec(4.0, 4.0, 0.1)), good)
            with pytest.raises(ConfigError, match="is marked ok"):
                session.add(grid_of(1), pose_at(0.0, math.nan, 0.0))
            with pytest.raises(DatumError, match="50 km"):
                session.add(grid_of(1), pose_at(50_001.0, 0.0, 0.0))
            session.add(grid_of(1), pose_at(50_000.0, -50_000.0, -135.0))
        with pytest.raises(ConfigError, match="has ended"):
            session.add(grid_of(1), good)
        with universal.add_session("coarse") as session:
            with pytest.raises(ConfigError, match="smaller than the local cells"):
                session.add(grid_of(1, GridSpec(4.0, 4.0, 0.2)), good)
            session.add(grid_of(1, GridSpec(4.0, 4.0, 0.05)), good)
        assert [info.frames for info in universal.sessions()] == [2, 1]


def test_a_trajectory_of_another_datum_and_a_config_that_is_no_json_are_refused(
    tmp_path: Path,
) -> None:
    elsewhere = Datum(DATUM.lat_deg + 1e-6, DATUM.lon_deg, DATUM.height_m)
    with create_map(tmp_path / "map.gpkg", DATUM) as universal:
        with pytest.raises(DatumError, match=r"39\.407121234.*39\.407122234"):
            universal.add_session("one", trajectory=track(datum=elsewhere))
        for config in ({"a": object()}, {"a": math.nan}):
            with pytest.raises(ConfigError, match="JSON"):
                universal.add_session("one", config=config)
        with universal.add_session("one", config={"ä": [1, None]}):
            pass
        assert dict(universal.sessions()[0].config) == {"ä": [1, None]}


def test_the_settings_of_the_map_are_in_the_file(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    database = sqlite3.connect(path)
    meta = dict(database.execute("SELECT key, value FROM fieldgrid_meta"))
    database.close()
    assert meta["format_version"] == "4"
    assert float(meta["datum_lat_deg"]) == DATUM.lat_deg
    assert float(meta["cell_m"]) == CELL_M
    assert meta["transfer"] == "centre"
    assert len(json.loads(meta["data_window"])) == 4


def test_frames_near_a_place_are_read_alone(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(12, step_m=5.0)])
    with closing(sqlite3.connect(path)) as database, database:
        # The grid of the last frame is gone, which a reader of the first ones does not notice.
        database.execute(
            "DELETE FROM fieldgrid_grid WHERE frame = (SELECT max(id) FROM fieldgrid_frame)"
        )
    with open_map(path) as universal:
        every = list(universal.frames())
        first = every[0].pose
        near = Bounds(first.east_m - 1.0, first.north_m - 1.0, first.east_m, first.north_m)
        found = list(universal.frames(with_grid=True, near=near))
        assert [frame.frame_id for frame in found] == [
            frame.frame_id
            for frame in every
            if frame.pose.east_m - SPEC.reach_m <= near.east_m
            and frame.pose.north_m - SPEC.reach_m <= near.north_m
        ]
        assert 1 < len(found) < len(every)
        assert all(frame.grid().observed.any() for frame in found)
