"""An open map belongs to the process that opened it: forks, pickles and other threads."""

from __future__ import annotations

import gc
import os
import pickle
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from fieldgrid.core import MapError, MapWriteError
from fieldgrid.maps import MapFile, create_map, open_map, reading
from tests.maps.file.maps import CELL_M, DATUM, drive, write_map, write_session

OURS, LEFT = 0, 7


def in_a_copy(work: Callable[[], None]) -> int:
    """Do it in a copy of this process, which ends as a program does that knows nothing of maps;
    returns its exit status, 1 where it failed."""
    child = os.fork()
    if not child:
        status = 1
        try:
            work()
            status = LEFT
        finally:
            gc.collect()
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def new_map(path: Path) -> MapFile:
    return create_map(path, DATUM, cell_m=CELL_M)


@pytest.mark.parametrize("end", ["close", "discard", "_release"])
def test_a_copy_of_the_process_leaves_a_new_map_alone(end: str, tmp_path: Path) -> None:
    path = tmp_path / "field.gpkg"
    with new_map(path) as universal:
        write_session(universal, "0", drive(2))
        (draft,) = tmp_path.iterdir()
        assert in_a_copy(getattr(universal, end)) == LEFT
        assert list(tmp_path.iterdir()) == [draft]
        write_session(universal, "1", drive(2, heading_deg=120.0))
    assert list(tmp_path.iterdir()) == [path]
    with open_map(path) as found:
        assert [info.name for info in found.sessions()] == ["0", "1"]
        assert found.verify().problems == ()


def test_a_copy_that_ends_within_a_session_leaves_it_alone(tmp_path: Path) -> None:
    path = tmp_path / "field.gpkg"
    frames = drive(4)
    with new_map(path) as universal, universal.add_session("0") as session:
        for grid, pose in frames[:2]:
            session.add(grid, pose)
        assert in_a_copy(session.discard) == LEFT
        for grid, pose in frames[2:]:
            session.add(grid, pose)
    with open_map(path) as found:
        assert len(list(found.frames())) == 4
        assert found.verify().problems == ()


def test_an_exit_of_the_interpreter_in_a_copy_removes_nothing(tmp_path: Path) -> None:
    """What is called at the exit, and what is collected then, is of both processes."""
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\n"
        "from pathlib import Path\n"
        "from tests.maps.file.maps import CELL_M, DATUM, drive, write_session\n"
        "from fieldgrid.maps import create_map\n"
        "with create_map(Path(sys.argv[1]), DATUM, cell_m=CELL_M) as universal:\n"
        "    write_session(universal, '0', drive(1))\n"
        "    child = os.fork()\n"
        "    if not child:\n"
        "        sys.exit(0)\n"
        "    assert os.waitpid(child, 0)[1] == 0\n"
        "    write_session(universal, '1', drive(1, heading_deg=120.0))\n"
    )
    path = tmp_path / "field.gpkg"
    root = str(Path(__file__).parents[3])
    status = os.spawnve(
        os.P_WAIT,
        sys.executable,
        [sys.executable, str(script), str(path)],
        {**os.environ, "PYTHONPATH": root},
    )
    assert status == 0
    with open_map(path) as found:
        assert [info.name for info in found.sessions()] == ["0", "1"]
        assert found.verify().problems == ()


def test_a_copy_of_the_process_is_told_to_open_the_map_again(tmp_path: Path) -> None:
    path = write_map(tmp_path / "field.gpkg", [drive(2)])

    def use() -> None:
        said = "was opened by another process, of which this one is a copy"
        with pytest.raises(MapError, match=said):
            universal.sessions()
        with pytest.raises(MapError, match=said):
            list(universal.frames())
        with pytest.raises(MapError, match=said):
            write_session(universal, "1", drive(1))
        with open_map(path) as again:
            assert len(again.sessions()) == 1

    with open_map(path, writable=True) as universal:
        assert in_a_copy(use) == LEFT
        write_session(universal, "1", drive(1, heading_deg=120.0))
        assert len(universal.sessions()) == 2


def test_an_open_map_is_not_pickled(tmp_path: Path) -> None:
    path = write_map(tmp_path / "field.gpkg", [drive(1)])
    with open_map(path) as universal, pytest.raises(TypeError, match="is open and cannot be sent"):
        pickle.dumps(universal)


def test_another_thread_may_take_a_map_over(tmp_path: Path) -> None:
    path = write_map(tmp_path / "field.gpkg", [drive(2)])
    names: list[str] = []
    with open_map(path) as universal:
        thread = threading.Thread(target=lambda: names.extend(s.name for s in universal.sessions()))
        thread.start()
        thread.join()
        assert names == ["0"]


def test_a_change_while_the_map_is_being_read_is_refused_with_what_to_do(tmp_path: Path) -> None:
    path = write_map(tmp_path / "field.gpkg", [drive(2)])
    with open_map(path, writable=True) as universal:
        connection = universal._connection
        with (
            reading(connection, path),
            pytest.raises(MapWriteError, match="open the map once for each thread"),
        ):
            universal.rename_session("0", "1")
        universal.rename_session("0", "1")
