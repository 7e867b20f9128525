"""A journal beside a map that is not its own: refused, and the map left as it is."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import pytest

from fieldgrid.errors import MapError
from fieldgrid.mapfile import open_map
from tests.mapfile.content import content
from tests.mapfile.maps import drive, write_map, write_session


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


def test_what_is_no_file_is_no_journal(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(1)])
    os.mkfifo(path.with_name("map.gpkg-journal"))
    with pytest.raises(MapError, match="is no file"):
        open_map(path)
