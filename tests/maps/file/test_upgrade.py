"""A map of format 2, written by the last program that wrote that: three drives of
`tests.maps.file.maps`, of which "1" has new poses and "2" is removed."""

from __future__ import annotations

import re
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError, MapError
from fieldgrid.maps import LAYERS, MapFile, MapView, kept_groups, merge_maps, open_map, schema
from tests.maps.file.content import content
from tests.maps.file.maps import CELL_M, DATUM, drive, track, write_map, write_session

FORMAT_2 = Path(__file__).with_name("format2.gpkg")
FORMAT_3 = Path(__file__).with_name("format3.gpkg")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return Path(shutil.copy(FORMAT_2, tmp_path / "map.gpkg"))


@pytest.fixture(params=[FORMAT_2, FORMAT_3], ids=["2", "3"])
def old(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """The same drives in a map of each older format."""
    return Path(shutil.copy(request.param, tmp_path / "map.gpkg"))


@pytest.fixture
def today(tmp_path: Path) -> Path:
    """The same drives in a map of today."""
    sessions = [drive(6), drive(5, heading_deg=80.0), drive(4, heading_deg=150.0)]
    made = write_map(tmp_path / "today.gpkg", sessions, trajectory=track(6))
    with open_map(made, writable=True) as universal:
        poses = {f"{k:06d}": pose for k, (_, pose) in enumerate(sessions[1])}
        universal.repose("1", poses, track(9))
        universal.remove_session("2")
    return made


def assert_same(a: MapView, b: MapView) -> None:
    assert a.window == b.window
    for name in ("observed", *LAYERS):
        np.testing.assert_array_equal(a.layer(name), b.layer(name), name)


def version(path: Path) -> str:
    with closing(sqlite3.connect(path)) as database:
        query = "SELECT value FROM fieldgrid_meta WHERE key = 'format_version'"
        return str(database.execute(query).fetchone()[0])


def test_it_is_read_as_it_is(path: Path, today: Path) -> None:
    before = path.read_bytes()
    with open_map(path) as old, open_map(today) as new:
        for cell_m in (CELL_M, 0.2, 0.3):
            assert_same(
                old.read(cell_m=cell_m, layers=LAYERS), new.read(cell_m=cell_m, layers=LAYERS)
            )
        assert_same(
            old.read(layers=LAYERS, sessions=["1"]), new.read(layers=LAYERS, sessions=["1"])
        )
        assert [(i.name, i.active, i.frames, i.accepted) for i in old.sessions()] == [
            ("0", True, 6, 6), ("1", True, 5, 5), ("2", False, 4, 4),
        ]  # fmt: skip
        assert [f.pose for f in old.frames()] == [f.pose for f in new.frames()]
        assert (
            old.trajectory("1").heading_deg.tobytes() == new.trajectory("1").heading_deg.tobytes()
        )
        found, expected = old.query(-5.0, 6.0), new.query(-5.0, 6.0)
        assert found.density == expected.density
        assert len(found.contributions) == len(expected.contributions) > 0
        assert old.session_inputs("0")["fix.time_ns"].tolist() == [0, 1, 2, 3, 4]
        health = old.verify(deep=True)
        assert health.sound
        assert "repair --upgrade" in health.notes[0]
    assert path.read_bytes() == before
    merge_maps([path], path.with_name("merged.gpkg"))
    with open_map(path.with_name("merged.gpkg")) as merged:
        assert merged.verify(deep=True).problems == ()
        assert [info.name for info in merged.sessions()] == ["0", "1"]


def test_format_3_is_read_and_verified_as_it_is(tmp_path: Path, today: Path) -> None:
    path = Path(shutil.copy(FORMAT_3, tmp_path / "map.gpkg"))
    before = path.read_bytes()
    with open_map(path) as old, open_map(today) as new:
        for cell_m in (CELL_M, 0.2, 0.3):
            for sessions in (None, ["1"]):
                how = {"cell_m": cell_m, "layers": LAYERS, "sessions": sessions}
                assert_same(old.read(**how), new.read(**how))
        for deep in (False, True):
            found = old.verify(deep=deep)
            assert (found.problems, found.deep) == ((), deep)
            # The tiles of a layer that is no more are told of by whoever checks tiles.
            assert ["remaining" in note for note in found.notes] == [True] * deep
    assert path.read_bytes() == before
    with open_map(path, writable=True) as universal:
        universal.rename_session("0", "first")
        found = universal.verify()
        assert (found.problems, found.notes, found.deep) == ((), (), False)  # it keeps its sums
    with closing(sqlite3.connect(path)) as database:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_schema")}
        kept = {name for (name,) in database.execute("SELECT channels FROM fieldgrid_tile")}
    assert "fieldgrid_session_tile" not in tables
    assert kept == set(kept_groups())


def test_it_is_upgraded_in_place(old: Path, today: Path) -> None:
    with open_map(old, writable=True) as universal:
        assert universal.upgrade()
        assert not universal.upgrade()
        assert universal.verify(deep=True).problems == ()
        assert [(i.name, dict(i.config)) for i in universal.sessions()] == [
            (str(k), {"every": k}) for k in range(3)
        ]
    assert version(old) == str(schema.FORMAT_VERSION)
    kinds = set(content(today)) - {"digests"}
    assert content(old, *kinds) == content(today, *kinds)
    with open_map(old, writable=True) as universal:
        universal.restore_session("2")
        assert universal.verify(deep=True).problems == ()


@pytest.mark.parametrize("change", ["add", "remove", "shift", "repair"])
def test_the_first_change_upgrades_it(old: Path, change: str) -> None:
    with open_map(old, datum=DATUM) as universal:
        if change == "add":
            with universal.add_session("more") as session:
                session.add(*drive(1)[0])
        elif change == "remove":
            universal.remove_session("0")
        elif change == "shift":
            universal.set_transform("1", 1.0, 2.0)
        else:
            universal.repair()
        assert universal.verify(deep=True).problems == ()
    assert version(old) == str(schema.FORMAT_VERSION)


def test_an_upgrade_that_is_cut_short_changes_nothing(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fieldgrid.maps.file import upgrade

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    before = path.read_bytes()
    monkeypatch.setattr(upgrade, "rebuild", fail)
    with pytest.raises(KeyboardInterrupt), open_map(path, writable=True) as universal:
        universal.upgrade()
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE fieldgrid_frame SET east_m = east_m + 1 WHERE id = 13",
        "UPDATE fieldgrid_frame SET observed = zeroblob(3) WHERE id = 13",
        "UPDATE fieldgrid_session SET source = 'another' WHERE name = '2'",
        "DELETE FROM fieldgrid_array WHERE name = 'up_m' AND session_id = 3",
    ],
)
def test_damage_of_before_is_not_blessed(path: Path, statement: str) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        assert database.execute(statement).rowcount == 1
    with open_map(path, writable=True) as universal:
        universal.upgrade()
        (problem, *_) = universal.verify(deep=True).problems
    assert "'2'" in problem


def test_a_map_whose_frames_cannot_be_read_stays_as_it_is(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE fieldgrid_frame SET density = zeroblob(3) WHERE id = 2")
    before = path.read_bytes()
    told = "frame '000001' of session '0' is damaged.*sessions --remove"
    for change in (
        MapFile.upgrade,
        MapFile.repair,
        lambda universal: universal.remove_session("1"),
        lambda universal: universal.rename_session("0", "more"),
    ):
        with open_map(path, writable=True) as universal, pytest.raises(MapError, match=told):
            change(universal)
    with open_map(path) as universal:
        (problem,) = universal.verify().problems
    assert re.search(told, problem)
    assert path.read_bytes() == before


def test_a_session_whose_frames_cannot_be_read_can_be_removed(path: Path, tmp_path: Path) -> None:
    """The map is that of which it was removed when it was whole; the frames are kept."""
    whole = Path(shutil.copy(path, tmp_path / "whole.gpkg"))
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE fieldgrid_frame SET density = zeroblob(3) WHERE id = 2")
    for one in (path, whole):
        with open_map(one, writable=True) as universal:
            universal.remove_session("0")
            assert [info.name for info in universal.sessions() if not info.active] == ["0", "2"]
    queries = (
        "SELECT zoom, ty, tx, channels, data FROM fieldgrid_tile ORDER BY 1, 2, 3, 4",
        "SELECT zoom_level, tile_column, tile_row, tile_data FROM density ORDER BY 1, 2, 3",
        "SELECT frame_id, digest FROM fieldgrid_frame WHERE session_id = 1 AND id <> 2 ORDER BY 1",
    )
    for query in queries:
        found, expected = rows(path, query), rows(whole, query)
        assert found == expected != []
    with open_map(path, writable=True) as universal:
        damaged, *more = universal.repair()
    assert "000001" in damaged
    assert all("Session '0' is not as it was stored" in problem for problem in more)


def rows(path: Path, query: str) -> list[object]:
    with closing(sqlite3.connect(path)) as database:
        return database.execute(query).fetchall()


def test_a_handle_of_before_changes_what_another_one_upgraded(path: Path) -> None:
    with open_map(path, datum=DATUM) as first, open_map(path, writable=True) as second:
        assert second.upgrade()
        write_session(first, "more", drive(1))
        first.remove_session("0")
        assert not first.upgrade()
        assert first.verify(deep=True).problems == ()
    with open_map(path) as universal:
        assert [info.name for info in universal.sessions()] == ["0", "1", "2", "more"]


@pytest.mark.parametrize(
    "refused",
    [
        lambda universal: universal.rename_session("0", "1"),
        lambda universal: universal.rename_session("0", "\n"),
        lambda universal: universal.remove_session("none"),
        lambda universal: universal.restore_session("1"),
        lambda universal: universal.set_transform("0", 1e9, 0.0),
        lambda universal: universal.repose("1", {}),
        lambda universal: universal.add_session("0"),
        lambda universal: abandon(universal),
    ],
)
def test_a_change_that_is_refused_upgrades_nothing(
    old: Path, refused: Callable[[MapFile], object]
) -> None:
    before = old.read_bytes()
    with open_map(old, writable=True) as universal:
        expected = universal.read(layers=LAYERS)
        with pytest.raises((ConfigError, KeyboardInterrupt)):
            refused(universal)
        assert_same(universal.read(layers=LAYERS), expected)  # still as the old format has it
    assert old.read_bytes() == before
    with open_map(old, writable=True) as universal:
        with pytest.raises((ConfigError, KeyboardInterrupt)):
            refused(universal)
        universal.remove_session("0")
        assert universal.verify(deep=True).problems == ()
    assert version(old) == str(schema.FORMAT_VERSION)


def abandon(universal: MapFile) -> None:
    with universal.add_session("more") as session:
        session.add(*drive(1)[0])
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("statement", "told"),
    [
        ("UPDATE fieldgrid_frame SET east_m = east_m + 1 WHERE id = 13", "'000001' of session '2'"),
        ("UPDATE fieldgrid_frame SET density = zeroblob(3) WHERE id = 2", "is damaged"),
        ("UPDATE fieldgrid_frame SET east_m = 'x' WHERE id = 2", "is damaged"),
        ("UPDATE fieldgrid_frame SET digest = x'00' WHERE id = 13", "'000001' of session '2'"),
        ("UPDATE fieldgrid_session SET source = 'another' WHERE name = '2'", "Session '2' is not"),
        ("UPDATE fieldgrid_session SET grid_cell_m = 1e300 WHERE name = '2'", "'2' is damaged"),
        ("UPDATE density SET tile_data = (SELECT tile_data FROM density WHERE id = 1)", "picture"),
        ("DELETE FROM density WHERE id = 2", "lacks picture"),
        ("UPDATE fieldgrid_meta SET value = '-39.4' WHERE key = 'datum_lat_deg'", "of its plane"),
        (
            "UPDATE gpkg_spatial_ref_sys SET definition = replace(definition, '39.4', '-39.4') "
            "WHERE srs_id = 100001",
            "of its plane",
        ),
    ],
)
def test_what_is_damaged_is_found_before_the_upgrade(path: Path, statement: str, told: str) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        assert database.execute(statement).rowcount >= 1
    before = path.read_bytes()
    with open_map(path) as universal:
        problems = universal.verify(deep=True).problems
    assert any(told in problem for problem in problems), problems
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("datum_lat_deg", "-39.407121234"),
        ("datum_lon_deg", "1.219356789"),
        ("datum_lat_deg", "39.407121235"),
        ("datum_height_m", "-702.417"),
    ],
)
def test_another_datum_is_not_blessed(path: Path, key: str, value: str) -> None:
    """It was the drive's when the plane was written; nothing else would tell."""
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE fieldgrid_meta SET value = ? WHERE key = ?", (value, key))
    before = path.read_bytes()
    with open_map(path, writable=True) as universal:
        for change in (MapFile.upgrade, MapFile.repair, lambda u: u.remove_session("0")):
            with pytest.raises(MapError, match="not that of its plane"):
                change(universal)
    assert path.read_bytes() == before


def test_another_wording_of_the_plane_is_the_same_plane(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database, database:
        changed = database.execute(
            "UPDATE gpkg_spatial_ref_sys SET definition = replace(replace(definition, "
            "'GEOGCS[\"unknown\"', 'GEOGCS[\"WGS 84\"'), '39.407121234]', '39.4071212340]') "
            "WHERE srs_id = 100001 AND definition LIKE '%GEOGCS[\"unknown\"%'"
        )
        assert changed.rowcount == 1
    with open_map(path, writable=True) as universal:
        assert universal.upgrade()
        assert universal.verify(deep=True).sound
