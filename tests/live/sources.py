"""What sources are tested with: a session that only takes notes, receivers on sockets, and a folder
into which images come."""

from __future__ import annotations

import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fieldgrid.geometry import Fix, Rig
from fieldgrid.live import LiveResult, Pauses, Sources, What
from fieldgrid.live.pose.sensor_rows import Rows
from fieldgrid.recordings import Frame
from tests.live.making import Told
from tests.scenes import paper_rig

TIMEOUT_S = 120.0

QUICK = Pauses(first_s=0.01, most_s=0.02, silent_s=60.0, dead_s=60.0, no_fix_s=60.0)
"""Nothing is silent for so long here that it counts."""


class Heard(Told):
    """Keeps what a session tells, and can be waited for."""

    def __init__(self) -> None:
        super().__init__()
        self._changed = threading.Condition()

    def __call__(self, result: LiveResult) -> None:
        with self._changed:
            super().__call__(result)
            self._changed.notify_all()

    def wait(self, is_so: Callable[[], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(is_so, TIMEOUT_S), self.results[-5:]

    def wait_text(self, part: str, count: int = 1) -> None:
        """Until so many events have said this."""
        self.wait(lambda: sum(part in one for one in self.texts("input")) >= count)


class Notes:
    """Stands for a session: keeps what sources push and tell."""

    def __init__(self, rig: Rig | None = None) -> None:
        self.rig = rig or paper_rig()
        self.fixes: list[Fix] = []
        self.rows: list[tuple[str, Rows]] = []
        self.frames: list[Frame] = []
        self.told: list[str] = []
        self._changed = threading.Condition()

    def _note(self, notes: list[Any], one: Any) -> None:
        with self._changed:
            notes.append(one)
            self._changed.notify_all()

    def push_fix(self, fix: Fix) -> None:
        self._note(self.fixes, fix)

    def push_rows(self, part: str, rows: Rows) -> None:
        self._note(self.rows, (part, rows))

    def push_frame(self, frame: Frame, *, wait: bool = False) -> bool:
        self._note(self.frames, frame)
        return True

    def drain(self) -> bool:
        return True

    def tell(self, what: What, text: str) -> None:
        assert what is What.INPUT
        self._note(self.told, text)

    def wait(self, is_so: Callable[[], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(is_so, TIMEOUT_S), (len(self.fixes), self.told)

    def wait_told(self, part: str, count: int = 1) -> None:
        self.wait(lambda: sum(part in text for text in self.told) >= count)


@contextmanager
def running(source: Any, pauses: Pauses = QUICK, rig: Rig | None = None) -> Iterator[Notes]:
    """A source that runs until the end of the block; what it gave is still there after it."""
    notes = Notes(rig)
    with Sources(notes, (source,), pauses):  # type: ignore[arg-type]
        yield notes


@contextmanager
def listening() -> Iterator[tuple[socket.socket, str]]:
    """A server's socket on the loopback, and its address."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(TIMEOUT_S)
        yield server, f"127.0.0.1:{server.getsockname()[1]}"


def empty_copy(drive: Path, folder: Path) -> Path:
    """A folder as a drive has it before its first image: the calibration and the table's header."""
    folder.mkdir(parents=True)
    shutil.copytree(drive / "calibration", folder / "calibration")
    shutil.copy(drive / "session.json", folder)
    for side in ("left", "right"):
        (folder / side).mkdir()
    with (drive / "frames.csv").open() as table:
        (folder / "frames.csv").write_text(table.readline())
    return folder


def rows_of(drive: Path) -> list[str]:
    """The rows of the table of a drive, a line each."""
    return (drive / "frames.csv").read_text().splitlines(keepends=True)[1:]


def drop(drive: Path, folder: Path, row: str) -> None:
    """Let a pair and its row appear in a folder."""
    for name in row.strip().split(",")[-2:]:
        shutil.copy(drive / name, folder / name)
    append(folder, row)


def append(folder: Path, text: str) -> None:
    with (folder / "frames.csv").open("a") as table:
        table.write(text)
