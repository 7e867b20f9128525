"""A journal beside a map that is not its own: refused, and the map left as it is."""

from __future__ import annotations

import os
import shutil
import signal
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import MapError
from fieldgrid.maps import open_map
from fieldgrid.maps.health import hot_journal
from fieldgrid.maps.health.hot_journal import check_journal
from fieldgrid.maps.health.journal_file import MAGIC, _segments
from tests.maps.file.content import content
from tests.maps.file.maps import drive, write_map, write_session


def interrupted(path: Path) -> Path:
    """Kill a writer in the middle of a commit; returns the journal that it leaves."""
    child = os.fork()
    if child == 0:
        with open_map(path, writable=True) as universal:
            database = universal._connection
            database.execute("PRAGMA cache_size = 4")
            database.execute("BEGIN IMMEDIATE")
            database.execute("UPDATE fieldgrid_tile SET data = data || x'00'")
            database.execute("UPDATE density SET tile_data = tile_data || x'00'")
            database.execute("UPDATE fieldgrid_session SET source = 'other'")
            database.execute("CREATE TABLE filling (x)")
            database.execute("INSERT INTO filling VALUES (zeroblob(2000000))")
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    journal = path.with_name(f"{path.name}-journal")
    assert journal.stat().st_size > 1000
    return journal


def test_the_journal_of_the_map_itself_is_played_back(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    before = content(path)
    interrupted(path)
    with open_map(path) as universal:
        assert universal.verify(deep=True).sound
    assert content(path) == before


def test_a_journal_of_another_state_does_not_destroy_a_restored_map(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    copy = Path(shutil.copy(path, tmp_path / "copy.gpkg"))
    for name in "ab":
        with open_map(path, writable=True) as universal:
            write_session(universal, name, drive(3, heading_deg=80.0))
    journal = interrupted(path)
    shutil.copy(copy, path)
    for writable in (False, True):
        with pytest.raises(MapError, match=r"belongs to another state of .*remove the journal"):
            open_map(path, writable=writable)
    assert path.read_bytes() == copy.read_bytes()
    journal.unlink()
    with open_map(path) as universal:
        assert universal.verify(deep=True).sound


def test_a_damaged_journal_is_refused_and_nothing_is_touched(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    before = content(path)
    journal = interrupted(path)
    map_bytes, whole = path.read_bytes(), journal.read_bytes()
    segments = [at for at in range(0, len(whole), 512) if whole.startswith(MAGIC, at)]
    assert len(segments) > 3
    record, third = 512, segments[2]
    page = whole.index(b"\0\0\0\x01SQLite format 3") + 4
    places = {
        0: "does not begin as one", 7: "does not begin as one", 8: "its end is missing",
        13: "another sum", 19: "(header|page) is wrong",
        22: "header is wrong", 25: "header is wrong",
        record: "number of a page", record + 3: "number of a page",
        record + 4 + 96: "another sum", record + 4 + 3896: "another sum",
        record + 4 + 4096: "another sum", third + 2: "header is wrong", third + 11: ".",
        third + 512 + 4 + 296: "another sum", page + 3: "another's", page + 18: "another's",
        page + 29: "another size", page + 57: "another's", page + 70: "another's",
    }  # fmt: skip
    damaged = {f"{at}": (whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :], why)
               for at, why in places.items()}  # fmt: skip
    damaged |= {f"cut at {end}": (whole[:end], "its end is missing") for end in (600, 9000, 28000)}
    for what, (data, why) in damaged.items():
        path.write_bytes(map_bytes)
        journal.write_bytes(data)
        for writable in (False, True):
            with pytest.raises(MapError, match=f"is damaged .*{why}.*run fieldgrid verify"):
                open_map(path, writable=writable)
        assert (path.read_bytes(), journal.read_bytes()) == (map_bytes, data), what
    journal.write_bytes(whole)
    with open_map(path) as universal:
        assert universal.verify(deep=True).sound
    assert content(path) == before


@pytest.mark.long
def test_each_byte_of_a_journal_leaves_old_or_is_told(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    before = content(path)
    journal = interrupted(path)
    map_bytes, whole = path.read_bytes(), journal.read_bytes()
    random = np.random.default_rng(4)
    old = 0
    for at in [*range(28), *random.integers(28, len(whole), 300)]:
        data = whole[:at] + bytes([whole[at] ^ int(random.integers(1, 256))]) + whole[at + 1 :]
        path.write_bytes(map_bytes)
        journal.write_bytes(data)
        try:
            with open_map(path) as universal:
                is_sound = universal.verify(jobs=1).sound
        except MapError as error:
            if "-journal is damaged" in str(error):
                assert (path.read_bytes(), journal.read_bytes()) == (map_bytes, data)
        else:
            old += is_sound
            assert not is_sound or content(path) == before
    assert old > 10


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


@pytest.mark.parametrize("beginning", [b"", bytes(512), bytes(5000)])
def test_a_journal_that_was_not_needed_is_none(tmp_path: Path, beginning: bytes) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    path.with_name("map.gpkg-journal").write_bytes(beginning)
    with open_map(path) as universal:
        assert universal.verify().sound


@pytest.mark.parametrize("written", [1, 6, 7])
def test_a_header_that_was_torn_as_it_was_completed_is_none(tmp_path: Path, written: int) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    untouched, before = path.read_bytes(), content(path)
    journal = interrupted(path)
    whole = journal.read_bytes()
    torn = MAGIC[:written] + bytes(12 - written) + whole[12:512]
    with journal.open("rb") as file:
        *_, last = (found for found in _segments(file, len(whole)) if found.pages)
    added = whole[: last.end].ljust(last.next, b"\0") + torn
    for map_bytes, data in ((untouched, torn + whole[512:]), (path.read_bytes(), added)):
        path.write_bytes(map_bytes)
        journal.write_bytes(data)
        with open_map(path) as universal:
            assert universal.verify(deep=True).sound
        assert content(path) == before
    path.write_bytes(untouched)
    journal.write_bytes(torn[:12] + bytes(16) + whole[28:])
    with pytest.raises(MapError, match="does not begin as one"):
        open_map(path)


def test_what_is_no_file_is_no_journal(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    os.mkfifo(path.with_name("map.gpkg-journal"))
    with pytest.raises(MapError, match="is no file"):
        open_map(path)


def test_maps_beside_journals_do_not_use_up_descriptors(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    for k in range(80):  # as a server does that looks at maps while they are written
        check_journal(being_written(path, tmp_path / f"{k}.gpkg"))
    assert 0 < len(kept_open(tmp_path)) < 40


def test_a_map_in_use_is_not_let_go_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hot_journal, "_MOST_OPEN", 2)
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    mine = Path(shutil.copy(path, tmp_path / "mine.gpkg"))
    with open_map(mine, writable=True) as universal:
        database = universal._connection
        database.execute("PRAGMA cache_size = 4")
        database.execute("BEGIN IMMEDIATE")
        database.execute("CREATE TABLE filling (x)")
        database.execute("INSERT INTO filling VALUES (zeroblob(2000000))")
        check_journal(mine)  # opens a second descriptor of it, which takes the locks when closed
        for k in range(6):
            check_journal(being_written(path, tmp_path / f"{k}.gpkg"))
        assert mine.name in kept_open(tmp_path)
        child = "import sqlite3, sys; sqlite3.connect(sys.argv[1], 0).execute('BEGIN IMMEDIATE')"
        other = subprocess.run([sys.executable, "-c", child, mine], capture_output=True, text=True)
        assert "database is locked" in other.stderr
        database.execute("ROLLBACK")


def being_written(path: Path, copy: Path) -> Path:
    """Copy a map, beside a journal with the first page of it."""
    page, pages = path.read_bytes()[:4096], path.stat().st_size // 4096
    head = struct.pack(">8sIIIII", bytes.fromhex("d9d505f920a163d7"), 1, 0, pages, 512, len(page))
    summed = sum(page[at] for at in range(len(page) - 200, 0, -200))
    copy.write_bytes(path.read_bytes())
    journal = copy.with_name(f"{copy.name}-journal")
    journal.write_bytes(head.ljust(512, b"\0") + b"\0\0\0\x01" + page + summed.to_bytes(4, "big"))
    return copy


def kept_open(folder: Path) -> set[str]:
    """The maps in a folder that the journals' check has open."""
    found = ((one.stat(), one.name) for one in folder.glob("*.gpkg"))
    return {name for one, name in found if (one.st_dev, one.st_ino) in hot_journal._OPEN}
