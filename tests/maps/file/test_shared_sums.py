"""Sums that several processes make are those that one makes, also where some of them fail."""

from __future__ import annotations

import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import pytest

from fieldgrid.maps import open_map
from fieldgrid.maps.health import row_digest, shared_sums
from fieldgrid.maps.health.row_digest import of_rows
from fieldgrid.maps.health.row_sums import SUMMED_TABLES
from fieldgrid.maps.health.shared_sums import SharedSums, sharing_sums
from tests.maps.file.maps import drive, write_map


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of more rows than a piece has."""
    return write_map(tmp_path_factory.mktemp("shared") / "map.gpkg", [drive(120)])


@pytest.fixture
def shared(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Every map is large enough for other processes; how many pieces those have done."""
    monkeypatch.setattr(shared_sums, "BYTES_A_PROCESS", 1000)
    done: list[int] = []
    original = SharedSums._work

    def slow(sums: SharedSums) -> None:
        # The others have the first turn: this process would be done before they have started.
        sums._join()
        done.append(len(sums._done))
        original(sums)

    monkeypatch.setattr(SharedSums, "_work", slow)
    return done


def expected(connection: sqlite3.Connection) -> dict[str, int]:
    return {table: of_rows(connection, table) for table in SUMMED_TABLES}


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_processes_have_the_sums_of_one(sound: Path, shared: list[int], jobs: int) -> None:
    with (
        closing(sqlite3.connect(sound)) as connection,
        sharing_sums(connection, SUMMED_TABLES, jobs) as sums,
    ):
        assert sums.finish() == expected(connection)
    assert (shared[0] > len(SUMMED_TABLES)) == (jobs > 1)


@pytest.mark.parametrize(
    "script",
    [
        None,
        "exit 1",
        "exec sleep 3000",
        "printf 'sums of'; exec sleep 3000",
        "echo welcome; exec sleep 3000",
        "printf 'sums of rows\\n'; exit 1",
        "printf 'sums of rows\\nwelcome\\n'; read line",
    ],
)
def test_where_no_other_process_works_this_one_does_all(
    sound: Path,
    tmp_path: Path,
    shared: list[int],
    script: str | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One that does not answer is not waited for: some sleep for longer than a run of tests."""
    program = tmp_path / "python3"
    if script is not None:
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    monkeypatch.setattr(shared_sums, "GREETING_S", 0.5)
    with (
        closing(sqlite3.connect(sound)) as connection,
        sharing_sums(connection, SUMMED_TABLES, 3) as sums,
    ):
        assert sums.finish() == expected(connection)
    assert shared[0] == 0


@pytest.mark.parametrize("executable", [None, "", "/usr/bin/qgis", "/usr/bin/uwsgi", "frozen"])
def test_a_program_that_is_not_python_does_not_start_itself(
    sound: Path, shared: list[int], executable: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if executable == "frozen":
        monkeypatch.setattr(sys, "frozen", True, raising=False)
    else:
        monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setattr(SharedSums, "_share", lambda _: pytest.fail("a process"))
    with (
        closing(sqlite3.connect(sound)) as connection,
        sharing_sums(connection, SUMMED_TABLES, 3) as sums,
    ):
        assert sums._others == 0
        assert sums.finish() == expected(connection)


def test_a_package_in_an_archive_starts_no_process(
    sound: Path, tmp_path: Path, shared: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(row_digest, "__file__", str(tmp_path / "all.zip" / "row_digest.py"))
    with (
        closing(sqlite3.connect(sound)) as connection,
        sharing_sums(connection, SUMMED_TABLES, 3) as sums,
    ):
        assert sums._others == 0


def test_a_writer_that_waits_is_not_waited_for(sound: Path, shared: list[int]) -> None:
    """Another process could not read any more, and the writer waits for this one."""
    with closing(sqlite3.connect(sound, isolation_level=None)) as connection:
        connection.execute("BEGIN")
        connection.execute("SELECT count(*) FROM fieldgrid_frame").fetchone()
        with closing(sqlite3.connect(sound, isolation_level=None, timeout=0.0)) as writer:
            writer.execute("BEGIN IMMEDIATE")
            writer.execute("UPDATE fieldgrid_frame SET frame_id = 'x' WHERE id = 1")
            with pytest.raises(sqlite3.OperationalError, match="locked"):
                writer.execute("COMMIT")  # which lets no further reader in
            with sharing_sums(connection, SUMMED_TABLES, 2) as sums:
                assert sums.finish() == expected(connection)
            writer.execute("ROLLBACK")
    assert shared[0] == 0


@pytest.mark.parametrize("table", ["fieldgrid_grid", "fieldgrid_tile", "density"])
def test_processes_find_a_row_that_was_changed(
    sound: Path, tmp_path: Path, shared: list[int], table: str
) -> None:
    path = Path(shutil.copy(sound, tmp_path / "map.gpkg"))
    column = "tile_data" if table == "density" else "data"
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute(
            f"UPDATE {table} SET {column} = {column} || x'00' "
            f"WHERE rowid = (SELECT max(rowid) FROM {table})"
        )
    with open_map(path) as universal:
        found = universal.verify(2)
    assert found.deep
    assert not found.sound
    assert shared


def test_a_map_that_is_read_at_once_starts_no_process(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SharedSums, "_share", lambda _: pytest.fail("a process"))
    with open_map(sound) as universal:
        assert universal.verify(8).sound
