"""The sums that a map keeps of its rows: in step with every change, and with nothing else."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from fieldgrid.core import MapError
from fieldgrid.geometry import GridSpec, Status
from fieldgrid.maps import MapFile, Mark, MarkKind, Transform, create_map, merge_maps, open_map
from fieldgrid.maps.health.row_sums import SUMMED_TABLES
from fieldgrid.maps.health.verification import HealthReport
from tests.maps.file.maps import DATUM, drive, grid_of, pose_at, track, write_map, write_session

POND = ((0.0, 0.0), (2.0, 0.0), (1.0, 1.0))
SUMS = "SELECT * FROM fieldgrid_sum ORDER BY 1"


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of two sessions, one that was removed, and a mark: no table is empty."""
    path = tmp_path_factory.mktemp("sums") / "map.gpkg"
    grid = grid_of(1, GridSpec(width_m=1.0, length_m=1.5, cell_m=0.1))
    with create_map(path, DATUM, cell_m=0.1) as universal:
        for k, name in enumerate("abc"):
            fixes = {"fix": track(3).east_m}
            with universal.add_session(name, trajectory=track(3), inputs=fixes) as session:
                session.add(grid, pose_at(2.043 + 0.3 * k, 3.017, 37.3, time_ns=k))
        universal.remove_session("c")
        universal.add_marks([Mark(MarkKind.PLACE, ((1.0, 2.0),), "gate")])
    return path


@pytest.fixture
def path(sound: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(sound, tmp_path / "map.gpkg"))


def health(path: Path, jobs: int | None = None) -> HealthReport:
    with open_map(path) as universal:
        return universal.verify(jobs)


def assert_fitting(path: Path) -> None:
    for jobs in (1, 2):
        found = health(path, jobs)
        assert (found.problems, found.notes, found.deep) == ((), (), False)


def sql(path: Path, statement: str) -> list[tuple[object, ...]]:
    """What a program does that knows of no sums."""
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        return database.execute(statement).fetchall()


def test_every_change_keeps_them(path: Path, tmp_path: Path) -> None:
    assert_fitting(path)  # a build
    before = sql(path, SUMS)
    with open_map(path, datum=DATUM) as universal:
        write_session(universal, "d", drive(3), track(4))
    assert_fitting(path)
    assert {row[0] for row in before} == {*SUMMED_TABLES, "root"}
    poses = {"0": pose_at(3.0, 3.1, 30.0), "1": pose_at(5.0, 9.1, 31.0, status=Status.HELD)}
    poses["2"] = pose_at(8.0, 12.1, 33.0)
    changes = {
        "remove": lambda m: m.remove_session("a"),
        "restore": lambda m: m.restore_session("a"),
        "restore another": lambda m: m.restore_session("c"),
        "shift": lambda m: m.set_transform("b", 0.25, -0.5, 3.0),
        "align": lambda m: m.set_transforms({"a": Transform(1.0, 2.0, 0.0, 0.0, 0.0)}),
        "rename": lambda m: m.rename_session("a", "e"),
        "repose": lambda m: m.repose(
            "d", {f.frame_id: pose for f, pose in zip(m.frames("d"), poses.values(), strict=True)}
        ),
        "mark": lambda m: m.add_marks([Mark(MarkKind.KEEPOUT, POND)]),
        "mark out": lambda m: m.remove_marks([1]),
        "mark in": lambda m: m.restore_marks([1]),
        "repair": lambda m: m.repair(),
    }  # fmt: skip
    seen = {tuple(sql(path, SUMS))}
    for what, change in changes.items():
        with open_map(path, writable=True) as universal:
            change(universal)
        assert_fitting(path)
        seen.add(tuple(sql(path, SUMS)))
        assert len(seen) > 1, what
    with open_map(path, writable=True) as universal:  # many by one connection
        universal.remove_session("e")
        universal.set_transform("b", 0.0, 0.0)
        assert universal.verify().deep is False
        universal.restore_session("e")
    assert_fitting(path)
    merged = tmp_path / "merged.gpkg"
    other = write_map(tmp_path / "other.gpkg", [drive(2)])
    merge_maps([path, other], merged)
    assert_fitting(merged)
    with open_map(path) as universal:
        assert universal.verify(deep=True).problems == ()
        assert universal.verify(deep=True).deep


def test_a_change_that_is_rolled_back_is_not_counted(path: Path) -> None:
    def fail(universal: MapFile) -> None:
        with universal._changing():
            universal._connection.execute("DELETE FROM fieldgrid_tile")
            raise MapError("No.")

    def stop(universal: MapFile) -> None:
        with universal.add_session("d") as session:
            session.add(*drive(1)[0])
            raise KeyboardInterrupt

    before = sql(path, SUMS)
    with open_map(path, datum=DATUM) as universal:
        with pytest.raises(KeyboardInterrupt):
            stop(universal)
        with pytest.raises(MapError):
            fail(universal)
        assert sql(path, SUMS) == before
        universal.remove_session("a")
    assert_fitting(path)


TILE = "zoom = (SELECT max(zoom) FROM fieldgrid_tile) AND channels = 'count'"


def test_what_another_program_changed_stays_visible(path: Path) -> None:
    """Of one byte, too, that makes no difference to what is read; until a repair."""
    ((data,),) = sql(path, f"SELECT hex(data) FROM fieldgrid_tile WHERE {TILE} LIMIT 1")
    sql(path, f"UPDATE fieldgrid_tile SET data = x'{data}00' WHERE {TILE}")
    assert health(path).problems
    with open_map(path, writable=True) as universal:
        universal.remove_session("b")
        universal.restore_session("b")
        assert universal.verify(deep=False).problems
        for _ in range(2):
            universal.set_transform("a", 0.5, 0.5)  # every tile is made again
            universal.set_transform("b", 0.5, 0.5)
        found = universal.verify()
        assert found.deep
        assert [one for one in found.problems if "fieldgrid_tile" in one]
        universal.repair()
    assert_fitting(path)


def test_after_a_program_that_knows_no_sums_everything_is_made_again(path: Path) -> None:
    sql(path, "UPDATE fieldgrid_sum SET sum = 'another' WHERE rows_of = 'root'")
    found = health(path)
    assert found.sound
    assert found.deep
    assert "keeps no sums of its rows, or those of another state" in found.notes[0]
    with open_map(path, writable=True) as universal:
        universal.rename_session("a", "d")
        assert universal.verify().deep
        universal.repair()
    assert_fitting(path)


def test_a_map_without_sums_is_made_again_and_gets_them_by_repair(path: Path) -> None:
    sql(path, "DROP TABLE fieldgrid_sum")
    with open_map(path, writable=True) as universal:
        universal.remove_session("a")
        found = universal.verify()
        assert (found.problems, found.deep, len(found.notes)) == ((), True, 1)
        universal.repair()
    assert_fitting(path)


@pytest.mark.parametrize("value", ["'x'", "x'00'", "7", "''"])
def test_a_sum_that_is_none_is_a_finding(path: Path, value: str) -> None:
    sql(path, f"UPDATE fieldgrid_sum SET sum = {value} WHERE rows_of = 'fieldgrid_frame'")
    for _ in range(2):
        assert "fieldgrid_" in health(path).problems[0]
        with open_map(path, writable=True) as universal:
            universal.set_transform("a", 0.5, 0.5)
    with open_map(path, writable=True) as universal:
        universal.repair()
    assert_fitting(path)


@pytest.mark.parametrize("table", SUMMED_TABLES)
def test_a_bit_of_any_table_is_found(path: Path, table: str) -> None:
    with closing(sqlite3.connect(path)) as database:
        columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
        assert columns, table
        values = database.execute(f"SELECT {', '.join(columns)} FROM {table}").fetchone()
    assert values is not None, f"{table} is empty"
    whole, found = path.read_bytes(), 0
    for value in values:
        raw = (
            value if isinstance(value, bytes) else value.encode() if isinstance(value, str) else b""
        )
        data = bytearray(whole)
        at = data.find(raw[:200]) if len(raw) > 20 else -1  # blobs go on on other pages
        if at < 0:
            continue
        data[at + len(raw[:200]) // 2] ^= 0x10
        path.write_bytes(data)
        assert not health(path).sound
        found += 1
    if not found:  # numbers, and short texts
        path.write_bytes(whole)
        column = columns[-1]
        sql(path, f"UPDATE {table} SET {column} = {column} + 0.25 WHERE rowid = "
                  f"(SELECT max(rowid) FROM {table})")  # fmt: skip
        assert not health(path).sound


@pytest.mark.parametrize("blob", ["x'fffe'", "CAST(x'fffe41' AS TEXT)"])
@pytest.mark.parametrize("column", ["status", "reason", "session"])
def test_a_session_whose_rows_are_no_text_can_be_taken_out(
    path: Path, column: str, blob: str
) -> None:
    sql(path, f"UPDATE frame_position SET {column} = {blob}")
    sql(path, f"UPDATE trajectory SET {column} = {blob}")
    assert health(path).problems
    with open_map(path, writable=True) as universal:
        universal.remove_session("a")
        assert [info.active for info in universal.sessions()] == [False, True, False]
    assert health(path).problems
    with open_map(path, writable=True) as universal:
        universal.repair()
    assert_fitting(path)


def test_text_and_a_blob_of_the_same_bytes_are_two_things(path: Path) -> None:
    sql(path, "UPDATE trajectory SET reason = CAST(reason AS BLOB) WHERE reason <> ''")
    assert health(path).problems
