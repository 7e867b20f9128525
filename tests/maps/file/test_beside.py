"""A journal or a write-ahead log beside a map: its own is played back, another one is refused."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fieldgrid.cli import app
from fieldgrid.core import MapError
from fieldgrid.maps import create_map, open_map
from tests.maps.file.content import content
from tests.maps.file.maps import DATUM, drive, write_map, write_session

STRANGE = r"does not belong to .* as it is, and would damage it"
TWO_LANES = Path(__file__).resolve().parents[3] / "examples" / "two_lanes"


def interrupted(path: Path, *, by_another: bool = False) -> Path:
    """Kill a writer in the middle of a change, or another program at the end of its commit, which
    wrote the first page late; returns the journal that it leaves."""
    journal = path.with_name(f"{path.name}-journal")
    child = os.fork()
    if child == 0 and by_another:
        database = sqlite3.connect(path, isolation_level=None)
        database.execute("PRAGMA cache_size = 4")
        database.execute("CREATE TABLE others (x)")
        database.executemany("INSERT INTO others VALUES (?)", [("x" * 900,)] * 99)
        database.execute("PRAGMA journal_mode = PERSIST")  # only the header goes at the end
        database.execute("BEGIN IMMEDIATE")
        database.execute("UPDATE others SET x = upper(x)")
        fill(database)
        header = journal.read_bytes()[:28]
        database.execute("COMMIT")
        with journal.open("r+b") as file:
            file.write(header)
        os.kill(os.getpid(), signal.SIGKILL)
    if child == 0:
        with open_map(path, writable=True) as universal, universal._changing():
            universal._connection.execute("PRAGMA cache_size = 4")
            universal._connection.execute("UPDATE fieldgrid_session SET source = 'other'")
            fill(universal._connection)
            os.kill(os.getpid(), signal.SIGKILL)
    assert os.WIFSIGNALED(os.waitpid(child, 0)[1])
    assert journal.stat().st_size > 1000
    return journal


def fill(database: sqlite3.Connection) -> None:
    """Write more than is kept in memory."""
    database.execute("CREATE TABLE filling (x)")
    database.execute("INSERT INTO filling VALUES (zeroblob(2000000))")


@pytest.mark.parametrize("by_another", [False, True])
def test_the_journal_of_the_map_itself_is_played_back(tmp_path: Path, by_another: bool) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    before = content(path)
    journal = interrupted(path, by_another=by_another)
    with open_map(path) as universal:
        assert universal.verify(deep=True).sound
    assert content(path) == before
    assert not journal.exists()


@pytest.mark.parametrize("by_another", [False, True])
def test_a_journal_of_another_state_does_not_destroy_a_restored_map(
    tmp_path: Path, by_another: bool
) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    copy = Path(shutil.copy(path, tmp_path / "copy.gpkg"))
    for name in "ab":
        with open_map(path, writable=True) as universal:
            write_session(universal, name, drive(3, heading_deg=80.0))
    journal = interrupted(path, by_another=by_another)
    shutil.copy(copy, path)
    for writable in (False, True):
        with pytest.raises(MapError, match=f"journal {STRANGE}: move it elsewhere"):
            open_map(path, writable=writable)
    with pytest.raises(MapError, match=STRANGE):
        create_map(path, DATUM, overwrite=True)
    assert path.read_bytes() == copy.read_bytes()
    journal.unlink()
    with open_map(path) as universal:
        assert universal.verify(deep=True).sound


def test_a_journal_that_is_none_is_refused(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    journal = interrupted(path)
    map_bytes, whole = path.read_bytes(), journal.read_bytes()
    for data in (b"x" + whole[1:], whole[:20], whole[:18] + b"\1" + whole[19:], b"a text"):
        journal.write_bytes(data)
        with pytest.raises(MapError, match=STRANGE):
            open_map(path)
        assert (path.read_bytes(), journal.read_bytes()) == (map_bytes, data)
    journal.unlink()
    os.mkfifo(journal)
    with pytest.raises(MapError, match=STRANGE):
        open_map(path)


@pytest.mark.parametrize("beginning", [b"", bytes(5000), b"\xd9\xd5\x05".ljust(512, b"\0")])
def test_a_journal_that_was_not_needed_is_none(tmp_path: Path, beginning: bytes) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    path.with_name("map.gpkg-journal").write_bytes(beginning)
    with open_map(path) as universal:
        assert universal.verify().sound


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv takes the rights of root")
@pytest.mark.parametrize(("file", "folder"), [(0o444, 0o555), (0o644, 0o555), (0o444, 0o755)])
def test_a_journal_that_cannot_be_played_back_where_it_lies_is_told(
    tmp_path: Path, file: int, folder: int
) -> None:
    place = tmp_path / "map"
    place.mkdir()
    path = write_map(place / "map.gpkg", [drive(2)])
    before = content(path)
    journal = interrupted(path)
    data = journal.read_bytes()
    for one, mode in ((path, file), (journal, file), (place, folder)):
        one.chmod(mode)
    rights = "-dac_override,-dac_read_search"
    limited = ["setpriv", "--bounding-set", rights, "--inh-caps", rights] if not os.getuid() else []
    done = subprocess.run(
        [*limited, sys.executable, "-m", "fieldgrid", "sessions", path],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    place.chmod(0o755)
    assert done.returncode == 1
    assert "was left by a writer that was interrupted" in done.stderr
    assert journal.read_bytes() == data
    copied = Path(shutil.copytree(place, tmp_path / "writable")) / "map.gpkg"
    for one in (copied, copied.with_name(journal.name)):
        one.chmod(0o644)
    with open_map(copied) as universal:
        assert universal.verify().sound
    assert content(copied) == before


def test_looking_at_a_journal_takes_no_locks_from_this_process(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    with open_map(path, writable=True) as universal, universal._changing():
        universal._connection.execute("UPDATE fieldgrid_session SET source = 'other'")
        assert path.with_name("map.gpkg-journal").exists()
        with open_map(path) as again:
            assert again.sessions()[0].source == ""
        child = "import sqlite3, sys; sqlite3.connect(sys.argv[1], 0).execute('BEGIN IMMEDIATE')"
        other = subprocess.run([sys.executable, "-c", child, path], capture_output=True, text=True)
        assert "database is locked" in other.stderr


def log_of_a_copy(path: Path, folder: Path) -> Path:
    """The write-ahead log of a copy of a map that was changed."""
    copy = Path(shutil.copy(path, folder / "copy.gpkg"))
    with closing(sqlite3.connect(copy, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("UPDATE fieldgrid_session SET name = 'older' || id")
        return Path(shutil.copy(folder / "copy.gpkg-wal", folder / "older-wal"))


def journal_of_a_copy(path: Path, folder: Path) -> Path:
    """The journal of a change of a copy of a map that was changed already."""
    copy = Path(shutil.copy(path, folder / "copy.gpkg"))
    for name in "ab":
        with open_map(copy, writable=True) as universal:
            write_session(universal, name, drive(1, heading_deg=80.0))
    return interrupted(copy)


@pytest.fixture(scope="module", params=[log_of_a_copy, journal_of_a_copy])
def strange(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a map, beside which there is what belongs to another state of it."""
    folder = tmp_path_factory.mktemp("strange")
    path = write_map(folder / "map.gpkg", [drive(2), drive(2, heading_deg=80.0)])
    beside = request.param(path, tmp_path_factory.mktemp("copy"))
    shutil.copy(beside, folder / f"map.gpkg-{beside.name.rsplit('-')[-1]}")
    return folder


COMMANDS = (
    *("sessions {map}", "verify {map}", "verify --deep {map}", "repair {map}", "rows {map}"),
    *("show {map} -o {new}.png", "query {map} 1 1", "export {map} {new}.tif", "view {map}"),
    *("diff {map} --from 0 --to 1", "merge {map} -o {new}.gpkg", "farm {folder}", "mark {map}"),
    *("align {map} --dry-run", "route {map} --from 1,1 --to 3,3 -o {new}.csv"),
    *(f"build {{drive}} -o {{map}} --{how}" for how in ("append", "overwrite")),
)


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_plays_back_what_belongs_to_another_state(
    strange: Path, tmp_path: Path, command: str
) -> None:
    folder = Path(shutil.copytree(strange, tmp_path / "maps"))
    before = {one.name: one.read_bytes() for one in folder.iterdir()}
    assert len(before) == 2
    named = {"map": folder / "map.gpkg", "new": folder / "new", "folder": folder}
    named["drive"] = f"{TWO_LANES} --gnss gnss_rtk.nmea"
    result = CliRunner().invoke(app, command.format(**named).split())
    said = f"{result.output} {result.exception}"
    assert re.search(r"map\.gpkg-(wal|journal) does not belong to", said), said
    assert {one.name: one.read_bytes() for one in folder.iterdir()} == before


def test_a_new_map_does_not_become_the_older_one(strange: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(strange, tmp_path / "maps"))
    (folder / "map.gpkg").unlink()
    with pytest.raises(MapError, match=STRANGE):
        open_map(folder / "map.gpkg", datum=DATUM)


def test_a_map_that_another_program_has_open_with_a_log_is_read(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("UPDATE fieldgrid_session SET source = 'in the log'")
        with open_map(path) as universal:
            assert universal.sessions()[0].source == "in the log"
    with open_map(path, writable=True) as universal:
        assert universal.sessions()[0].source == "in the log"
    assert [one.name for one in tmp_path.iterdir()] == ["map.gpkg"]
