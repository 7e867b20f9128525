"""A map in which any cell of any table holds what it must not: a sentence, never a traceback."""

from __future__ import annotations

import json
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from fieldgrid.core import ConfigError, DatumError, FieldgridError, MapError
from fieldgrid.geometry import GridSpec, Status
from fieldgrid.maps import GEOMETRIES, MapFile, Mark, MarkKind, create_map, open_map
from fieldgrid.maps.file.schema import COUNTED_TABLES, OWN_TABLES
from fieldgrid.maps.health.row_sums import SUMMED_TABLES
from tests.maps.file.content import content
from tests.maps.file.maps import DATUM, drive, grid_of, pose_at, track, write_map
from tests.maps.file.terrain import write_drives

VALUES = ("NULL", "1e300", "'x'", "x'00ff'", "4611686018427387904")
FREE = {
    ("fieldgrid_session", "removed", "NULL"),
    ("fieldgrid_session", "transform", "NULL"),
    *(("density", "id", value) for value in VALUES),
    *(
        (layer, "fid", value)
        for layer in ("trajectory", "frame_position", "footprint")
        for value in VALUES
    ),
    *(("layer_styles", "id", value) for value in VALUES),
    *(("sqlite_sequence", "name", value) for value in VALUES),
    *(("layer_styles", "update_time", value) for value in VALUES),
}
"""What may hold such a value: numbers of rows, and what is left to other programs."""


TABLES = (
    "sqlite_sequence",
    *("gpkg_spatial_ref_sys", "gpkg_contents", "gpkg_tile_matrix", "gpkg_geometry_columns"),
    *("gpkg_tile_matrix_set", "density", "layer_styles", *GEOMETRIES, *OWN_TABLES),
)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("damage") / "map.gpkg"
    grid = grid_of(1, GridSpec(width_m=1.0, length_m=1.5, cell_m=0.1))
    with create_map(path, DATUM, cell_m=0.1) as universal:
        for k, name in enumerate("ab"):
            fixes = {"fix": track(3).east_m}
            with universal.add_session(name, trajectory=track(3), inputs=fixes) as session:
                session.add(grid, pose_at(2.043 + 0.3 * k, 3.017, 37.3, time_ns=k))
    return path


def spoil(path: Path, table: str, column: str, value: str) -> bool:
    """Put a value into the last row of a table, past its constraints; whether that changed it."""
    row = f"{table} WHERE rowid = (SELECT max(rowid) FROM {table})"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA synchronous = OFF")
        before = database.execute(f"SELECT {column} FROM {table}").fetchall()
        (sql,) = database.execute(
            "SELECT sql FROM sqlite_schema WHERE name = ?", (table,)
        ).fetchone()
        database.execute("PRAGMA writable_schema = ON")
        rewrite = "UPDATE sqlite_schema SET sql = ? WHERE name = ?"
        if table != "sqlite_sequence":
            database.execute(rewrite, (sql.replace(" NOT NULL", ""), table))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA synchronous = OFF")
        with suppress(sqlite3.IntegrityError):  # of the number of a row
            database.execute(f"UPDATE {row.replace(' WHERE', f' SET {column} = {value} WHERE')}")
        database.execute("PRAGMA writable_schema = ON")
        if table != "sqlite_sequence":
            database.execute(rewrite, (sql, table))
    with closing(sqlite3.connect(path)) as database:
        return database.execute(f"SELECT {column} FROM {table}").fetchall() != before


def use(universal: MapFile) -> None:
    """What `sessions`, `query`, `show` and `export` read."""
    for action in (
        lambda: universal.sessions(),
        lambda: universal._repr_html_(),
        lambda: universal.query(2.1, 3.5),
        lambda: universal.read(),
        lambda: universal.read(cell_m=0.25, layers=["max", "ground", "height", "persistence"]),
        lambda: universal.diff("a", "b"),
        lambda: list(universal.frames()),
        lambda: [universal.trajectory(info.name) for info in universal.sessions()],
        lambda: universal.root_sha256,
    ):
        with suppress(FieldgridError):
            action()


@pytest.mark.parametrize("each_column", [1, pytest.param(len(VALUES), marks=pytest.mark.long)])
@pytest.mark.parametrize("table", TABLES)
def test_any_value_in_any_column_is_a_finding(
    sound: Path, tmp_path: Path, table: str, each_column: int
) -> None:
    """So many values in each column, not always the same."""
    with closing(sqlite3.connect(sound)) as database:
        columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
    assert columns
    ours = table in (*OWN_TABLES, "density", "sqlite_sequence")
    passed, path = [], tmp_path / "map.gpkg"
    for number, column in enumerate(columns):
        turned = (*VALUES[number % len(VALUES) :], *VALUES[: number % len(VALUES)])
        for value in turned[:each_column] if ours else ("NULL", "'x'"):
            shutil.copy(sound, path)
            if not spoil(path, table, column, value):
                continue
            with suppress(FieldgridError), open_map(path) as universal:
                found = universal.verify(1).problems
                assert all(problem.endswith(".") for problem in found), found
                assert found or table not in SUMMED_TABLES
                if all(problem.startswith("The rows of ") for problem in found):
                    passed.append((table, column, value))
                use(universal)
    assert set(passed) <= FREE


@pytest.mark.parametrize("table", [*COUNTED_TABLES, "gpkg_contents", "fieldgrid_tile"])
def test_what_is_not_evidence_is_made_again(sound: Path, tmp_path: Path, table: str) -> None:
    damage = [
        ("sqlite_sequence", "seq", f"name = '{table}'"),
        *(("layer_styles", name, "1") for name in ("styleQML", "styleName", "f_table_name")),
        *(("gpkg_contents", name, "1") for name in ("identifier", "description", "last_change")),
        *(("fieldgrid_tile", name, "1") for name in ("zoom", "ty", "data")),
    ]
    for where, column, rows in damage:
        if where not in (table, "sqlite_sequence"):
            continue
        path = tmp_path / "map.gpkg"
        shutil.copy(sound, path)
        with closing(sqlite3.connect(path, isolation_level=None)) as database:
            database.execute(f"UPDATE {where} SET {column} = 'x' || rowid WHERE {rows}")
        with open_map(path, writable=True) as universal:
            if table not in ("gpkg_contents", "fieldgrid_tile") or where == table:
                assert universal.verify(deep=True).problems
            universal.repair()
            assert universal.verify(deep=True).problems == ()
        assert content(path) == content(sound)


def test_the_header_of_the_file_is_checked(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA user_version = 10200")
    with open_map(path, writable=True) as universal:
        (problem,) = universal.verify(deep=True).problems
        assert "version 10200, and not 10300" in problem
        universal.repair()
        assert universal.verify(deep=True).sound


def test_no_height_can_overflow_the_sums(tmp_path: Path) -> None:
    with (
        create_map(tmp_path / "map.gpkg", DATUM, cell_m=0.1) as universal,
        universal.add_session("high") as session,
    ):
        for up_m in (1e300, -1e6, float("inf")):
            with pytest.raises(DatumError, match="m up is over 50 km"):
                session.add(grid_of(1), replace(pose_at(0.0, 0.0, 0.0), up_m=up_m))


def test_a_schema_that_is_no_text_is_a_sentence(sound: Path, tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    for spoilt in (b"CREATE TABLE traject\xffry", b"CREATE TABL\x9f trajectory"):
        whole = sound.read_bytes()
        path.write_bytes(whole.replace(b"CREATE TABLE trajectory", spoilt))
        said = []
        try:
            with open_map(path) as universal:
                said += universal.verify(1, deep=True).problems
        except MapError as error:
            said.append(str(error))
        assert said
        assert all(one.endswith(".") and one.isprintable() for one in said)


def test_what_sqlite_says_is_one_short_line(sound: Path, tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    path.write_bytes(sound.read_bytes().replace(b"<!DOCTYPE qgis", b"<!DOCTYPE \xffgis"))
    with open_map(path) as universal:
        problems = universal.verify(1, deep=True).problems
    assert problems
    assert all(one.endswith(".") and one.isprintable() and len(one) < 400 for one in problems)


def test_a_repair_that_would_not_verify_changes_nothing(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path)) as database:
        database.execute("ALTER TABLE fieldgrid_frame ADD COLUMN more TEXT")
    before, keep = path.read_bytes(), tmp_path / "kept.gpkg"
    with (
        open_map(path, writable=True) as universal,
        pytest.raises(MapError, match=r"cannot be repaired.*not laid out.*was changed"),
    ):
        universal.repair(keep=keep)
    assert path.read_bytes() == before
    assert not keep.exists()


def test_the_map_as_it_was_is_kept(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("DELETE FROM density")
    keep = tmp_path / "kept.gpkg"
    with open_map(path, writable=True) as universal:
        assert universal.repair(keep=keep) == ()
    assert content(path) == content(sound)
    assert content(keep)["pictures"] == []
    assert content(keep, "tiles", "fixes") == content(sound, "tiles", "fixes")


def test_the_list_of_marks_has_no_extent(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with open_map(path, writable=True) as universal:
        universal.add_marks([Mark(MarkKind.KEEPOUT, ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))])
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("UPDATE gpkg_contents SET max_x = 1e9 WHERE table_name = 'mark'")
    with open_map(path, writable=True) as universal:
        assert universal.verify(1, deep=True).problems == (
            "The layer mark is not listed as it should be; repair the map.",
        )
        universal.repair(jobs=1)
        assert universal.verify(1, deep=True).sound


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE fieldgrid_meta SET value = '[\"max\"]' WHERE key = 'channel_groups'",
        "UPDATE fieldgrid_session SET source = CAST(x'41ff0a' AS TEXT)",
    ],
)
def test_settings_and_texts_that_cannot_be_are_sentences(
    sound: Path, tmp_path: Path, statement: str
) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(statement)
    for action in (MapFile.verify, MapFile.sessions, MapFile.read, MapFile.repair):
        try:
            with open_map(path, writable=True) as universal:
                found = action(universal)
                said = list(getattr(found, "problems", ()))
        except MapError as error:
            said = [str(error)]
        assert all(one.endswith(".") and one.isprintable() for one in said)
        assert said or action is MapFile.read


DEEP = "printf('%.*c', 100000, '[')"
NO_NUMBERS = "'[1e999, 1e999, 1e999, 1e999]'"
RIGID = dict.fromkeys(
    ("shift_east_m", "shift_north_m", "turn_deg", "pivot_east_m", "pivot_north_m"), int("1" * 400)
)
HUGE = f"'{json.dumps({'rigid': RIGID})}'"


@pytest.mark.parametrize(
    ("table", "change"),
    [
        *(("fieldgrid_session", f"{name} = {DEEP}") for name in ("config", "transform")),
        ("fieldgrid_session", f"transform = {HUGE}"),
        *(("fieldgrid_frame", f"{name} = {DEEP}") for name in ("images", "images_sha256")),
        *(("fieldgrid_frame", f"{name} = {DEEP}") for name in ("frame_id", "status")),
        *(("fieldgrid_array", f"shape = {value}") for value in (DEEP, NO_NUMBERS)),
        *(
            ("fieldgrid_meta", f"value = {value} WHERE key = '{key}'")
            for key in ("channel_groups", "data_window")
            for value in (DEEP, NO_NUMBERS)
        ),
        ("fieldgrid_grid", "channel = x'00ff' WHERE channel = 'ground_cm'"),
    ],
)
def test_documents_that_cannot_be_are_short_sentences(
    sound: Path, tmp_path: Path, table: str, change: str
) -> None:
    """Nested deeply, with numbers that are none, or long."""
    path = tmp_path / "map.gpkg"
    if table == "fieldgrid_grid":
        write_drives(path, {"a": 10.0})
    else:
        shutil.copy(sound, path)
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        assert database.execute(f"UPDATE {table} SET {change}").rowcount
    for action in (MapFile.verify, MapFile.repair, use, _with_another_session):
        try:
            with open_map(path, writable=True) as universal:
                found = action(universal)
                said = list(getattr(found, "problems", ()))
                assert said or action is not MapFile.verify
        except FieldgridError as error:
            said = [str(error)]
        for one in said:
            assert one.endswith(".")
            assert one.isprintable()
            assert len(one) < 1500


def _with_another_session(universal: MapFile) -> None:
    with universal.add_session("z") as session:
        session.add(grid_of(1, GridSpec(width_m=1.0, length_m=1.5, cell_m=0.1)), pose_at(2, 3, 37))


def test_a_session_that_an_index_has_lost_is_read(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        (page,) = database.execute(
            "SELECT rootpage FROM sqlite_schema WHERE name = 'sqlite_autoindex_fieldgrid_session_1'"
        ).fetchone()
    data = bytearray(path.read_bytes())
    start = 4096 * (page - 1)
    data[start + 3 : start + 5] = b"\0\0"  # the index has no entry any more
    path.write_bytes(data)
    with open_map(path) as universal:
        assert universal.verify(1, deep=True).problems
        found = universal.trajectory("a")
    with open_map(sound) as universal:
        assert list(found.east_m) == list(universal.trajectory("a").east_m)


@pytest.mark.parametrize("missing", [4096, 40_000, 1])
def test_a_map_that_was_not_copied_to_the_end_is_told(tmp_path: Path, missing: int) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    data = path.read_bytes()
    path.write_bytes(data[:-missing])
    for writable in (False, True):
        with pytest.raises(MapError, match=rf"has \d+ of {len(data)} bytes: .* copy it again"):
            open_map(path, writable=writable)
    assert path.read_bytes() == data[:-missing]


def test_a_copy_that_never_began_is_told(tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    path.touch()
    for writable in (False, True):
        with pytest.raises(
            MapError, match=r"is not a fieldgrid map: it is empty, .* copy it again"
        ):
            open_map(path, writable=writable)
    assert path.read_bytes() == b""


def test_a_link_to_what_went_is_told(tmp_path: Path) -> None:
    path = tmp_path / "link.gpkg"
    path.symlink_to(tmp_path / "disk" / "map.gpkg")
    with pytest.raises(MapError, match=r"link.gpkg leads to .*disk.map.gpkg, which is not there"):
        open_map(path)


@pytest.mark.parametrize("letters", [5_000_000, pytest.param(40_000_000, marks=pytest.mark.long)])
def test_a_text_that_is_too_long_is_named(sound: Path, tmp_path: Path, letters: int) -> None:
    path = tmp_path / "map.gpkg"
    shutil.copy(sound, path)
    with closing(sqlite3.connect(path)) as database:
        columns = [
            (table, column)
            for table in ("gpkg_contents", "gpkg_spatial_ref_sys", *GEOMETRIES, *OWN_TABLES)
            for _, column, kind, *_ in database.execute(f"PRAGMA table_info({table})")
            if kind in ("TEXT", "DATETIME")
        ]
    assert len(columns) > 40
    for table, column in columns:
        shutil.copy(sound, path)
        with closing(sqlite3.connect(path, isolation_level=None)) as database:
            database.execute("PRAGMA synchronous = OFF")
            database.execute(
                f"UPDATE {table} SET {column} = printf('%.*c', {letters}, 'x') "
                f"WHERE rowid = (SELECT max(rowid) FROM {table})"
            )
        try:
            with open_map(path) as universal:
                said = list(universal.verify(1).problems)
                assert [one for one in said if table in one and column in one], (table, column)
                if table == "fieldgrid_session":
                    with pytest.raises(MapError) as refused:
                        universal.sessions()
                    said.append(str(refused.value))
        except MapError as error:
            assert table == "fieldgrid_meta"
            said = [str(error)]
        assert all(len(one) < 500 for one in said)


def test_a_text_that_is_too_long_is_not_written(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    before = path.read_bytes()
    with open_map(path, writable=True) as universal:
        for name, more in (
            ("x" * 256, {}),
            ("1", {"source": "x" * 1001}),
            ("1", {"config": {"x": "x" * 5_000_000}}),
        ):
            with pytest.raises(ConfigError, match="letters"):
                universal.add_session(name, **more)
        for frame_id, reason in (("x" * 256, ""), ("1", "x" * 1001)):
            pose = pose_at(1.0, 1.0, 0.0, status=Status.HELD if reason else Status.OK)
            with (
                pytest.raises(ConfigError, match="letters"),
                universal.add_session("1") as session,
            ):
                session.add(grid_of(1), replace(pose, reason=reason), frame_id=frame_id)
        with pytest.raises(ConfigError, match="letters"):
            universal.rename_session("0", "x" * 256)
    assert path.read_bytes() == before


def test_rows_that_gdal_counts_wrongly_are_told_and_put_right(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(
            "CREATE TABLE gpkg_ogr_contents "
            "(table_name TEXT NOT NULL PRIMARY KEY, feature_count INTEGER)"
        )
        database.execute("INSERT INTO gpkg_ogr_contents VALUES ('footprint', 2)")
        database.execute("INSERT INTO gpkg_ogr_contents VALUES ('trajectory', 5)")
    with open_map(path, writable=True) as universal:
        (problem,) = universal.verify(1, deep=True).problems
        assert problem == "The layer trajectory has 6 rows, and GDAL is told of 5."
        assert not universal.verify(1).sound
        universal.repair()
        assert universal.verify(1).sound
        assert universal.verify(1, deep=True).sound


def test_a_signal_is_heard_while_sqlite_checks_the_pages(sound: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("CREATE TABLE more (x)")
        database.execute("CREATE INDEX more_x ON more (x)")
        database.executemany("INSERT INTO more VALUES (?)", [(k,) for k in range(10_000)])
        database.execute("PRAGMA writable_schema = ON")
        slow = "x + 0 * length(hex(zeroblob(5000000 + x)))"  # for each row: minutes
        database.execute(
            f"UPDATE sqlite_schema SET sql = 'CREATE INDEX more_x ON more ({slow})' "
            "WHERE name = 'more_x'"
        )
    command = [sys.executable, "-m", "fieldgrid", "verify", str(path)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        time.sleep(3.0)
        assert process.poll() is None
        process.terminate()
        start = time.monotonic()
        assert process.wait(20.0) == 128 + signal.SIGTERM
        assert time.monotonic() - start < 2.0
