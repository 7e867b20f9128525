"""Sixteen programs that add sessions to one map at once, while others read it.

    python -m tests.crash.writers 50 [WRITERS]

Each writer adds so many sessions, one transaction each, and waits for the others as long as it
takes. None may be lost, none refused, and each state that a reader meets must be one that was
committed: its density is that of its sessions, folded anew.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from fieldgrid.geometry import GridSpec
from fieldgrid.maps import Patience, open_map
from tests.crash.operations import make
from tests.maps.file.maps import grid_of, pose_at

READERS = 2
PATIENCE = Patience(600.0)
_SPEC = GridSpec(width_m=1.0, length_m=1.5, cell_m=0.1)


def _write(path: Path, writer: int, sessions: int) -> None:
    for number in range(sessions):
        with (
            open_map(path, writable=True, patience=PATIENCE) as universal,
            universal.add_session(f"{writer}-{number}") as session,
        ):
            pose = pose_at(0.31 * writer, 0.27 * number, 7.0 * number, time_ns=number)
            session.add(grid_of(writer, _SPEC), pose)


def _read(
    path: Path, stop: multiprocessing.synchronize.Event, seen: multiprocessing.Queue[int]
) -> None:
    count = 0
    while not stop.is_set():
        with open_map(path) as universal, universal.content():
            names = [info.name for info in universal.sessions()]
            stored = universal.read()
            anew = universal.read(sessions=names, frame_filter=lambda _: True)
            np.testing.assert_array_equal(stored.density, anew.density)
            count += 1
    seen.put(count)


def run_writers(writers: int, sessions: int, folder: Path) -> int:
    """Let them write and read; returns how often the map was read. AssertionError at any loss."""
    path = folder / "map.gpkg"
    make(path)
    fork = multiprocessing.get_context("fork")
    stop, seen = fork.Event(), fork.Queue()
    readers = [fork.Process(target=_read, args=(path, stop, seen)) for _ in range(READERS)]
    many = [fork.Process(target=_write, args=(path, k, sessions)) for k in range(writers)]
    for process in (*readers, *many):
        process.start()
    for process in many:
        process.join()
    stop.set()
    read = sum(seen.get(timeout=600) for _ in readers)
    for process in readers:
        process.join()
    assert [process.exitcode for process in (*many, *readers)] == [0] * (writers + READERS)
    with open_map(path) as universal:
        names = {info.name for info in universal.sessions()}
        assert names == {"0"} | {f"{k}-{n}" for k in range(writers) for n in range(sessions)}
        verdict = universal.verify(deep=True)
    assert verdict.sound, verdict.problems
    return read


def main() -> None:
    """Run as a program."""
    sessions = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    writers = int(sys.argv[2]) if len(sys.argv) > 2 else 16
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        read = run_writers(writers, sessions, Path(folder))
    print(
        f"{writers} writers of {sessions} sessions each in {time.perf_counter() - start:.0f} s: "
        f"none lost, none refused; read {read} times meanwhile, each time a committed state"
    )


if __name__ == "__main__":
    main()
