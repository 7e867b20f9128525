"""The sums of a map's rows, made by several processes.

Rows are short, so most of the time goes into the interpreter, whose lock lets threads gain nothing.
While this process reads the map nobody commits, so all processes see the same state.
"""

from __future__ import annotations

import os
import re
import select
import sqlite3
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from fieldgrid.maps.health import row_digest

BYTES_A_PROCESS = 32 << 20
"""What one process reads while another one starts, many times over."""

GREETING_S = 2.0
"""How long a process may take until it greets; it takes a tenth of a second."""

_PIECES = 64


_Piece = tuple[str, tuple[int, int] | None]
"""Rows of a table: those from a first to a last row id, or all."""


@contextmanager
def sharing_sums(
    connection: sqlite3.Connection, tables: Sequence[str], jobs: int
) -> Iterator[SharedSums]:
    """Begins to sum the rows of tables by up to `jobs` processes, this one included.

    The others end with the block.
    """
    (*_, file) = connection.execute("PRAGMA database_list").fetchone()
    (mode,) = connection.execute("PRAGMA journal_mode").fetchone()
    # With a write-ahead log, others would see another state.
    size = Path(file).stat().st_size if file and mode == "delete" and _has_python() else 0
    sums = SharedSums(connection, Path(file), min(jobs - 1, size // BYTES_A_PROCESS))
    try:
        sums.begin(tables)
        yield sums
    finally:
        sums.stop()


class SharedSums:
    """Sums that are being made, piece by piece, by this process and a number of `others`."""

    def __init__(self, connection: sqlite3.Connection, file: Path, others: int) -> None:
        self._connection, self._file, self._others = connection, file, others
        self._pieces = deque[_Piece]()
        self._done = list[tuple[str, int]]()
        self._threads = list[threading.Thread]()

    def begin(self, tables: Sequence[str]) -> None:
        """Start the processes; the largest tables should come first."""
        for table in tables:
            if self._others > 0:
                self._pieces += _pieces(self._connection, table)
            else:
                self._pieces.append((table, None))
        for _ in range(self._others):
            thread = threading.Thread(target=self._share, name="fieldgrid-sums", daemon=True)
            self._threads.append(thread)
            thread.start()

    def finish(self) -> dict[str, int]:
        """The sum of each table. This process does what no other one has begun yet."""
        self._work()
        self._join()
        self._work()  # what others have left
        sums = dict.fromkeys((table for table, _ in self._done), 0)
        for table, part in self._done:
            sums[table] += part
        return sums

    def stop(self) -> None:
        """Begin no other piece, and wait for the processes to end."""
        self._pieces.clear()
        self._join()

    def _join(self) -> None:
        for thread in self._threads:
            thread.join()

    def _work(self) -> None:
        while piece := self._next():
            self._done.append((piece[0], row_digest.of_rows(self._connection, *piece)))

    def _next(self) -> _Piece | None:
        with suppress(IndexError):
            return self._pieces.popleft()
        return None

    def _share(self) -> None:
        """Have another process do pieces while there are any."""
        command = [sys.executable, "-I", "-S", row_digest.__file__, str(self._file)]
        pipe = subprocess.PIPE
        with (
            suppress(OSError, TypeError, ValueError),
            subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True, bufsize=1
            ) as process,
        ):
            assert process.stdin is not None
            assert process.stdout is not None
            if not _greets(process.stdout.fileno()):
                process.kill()
                return
            while (piece := self._next()) and piece[1] is not None:
                table, (first, last) = piece[0], piece[1]
                try:
                    process.stdin.write(f"{table} {first} {last}\n")
                    part = int(process.stdout.readline())
                except (OSError, ValueError):
                    # It could not read the map, which a writer may be waiting for.
                    self._pieces.append(piece)
                    return
                self._done.append((table, part))


def _has_python() -> bool:
    """Whether this program can start the one that sums rows, and is not itself what would start:
    another program that has an interpreter within it, or one that is made of this package."""
    if getattr(sys, "frozen", False) or not sys.executable:
        return False
    name = Path(sys.executable).name.lower()
    is_python = re.fullmatch(r"(python|pypy)[0-9.]*[a-z]{0,2}(\.exe)?", name) is not None
    return is_python and Path(row_digest.__file__).is_file()


def _greets(output: int) -> bool:
    """Whether a process says in time that it is the program that sums rows."""
    greeting, found = row_digest.GREETING.encode(), b""
    until = time.monotonic() + GREETING_S
    poll = select.poll()
    poll.register(output, select.POLLIN)
    # Not by readline(), which would wait for the end of the line.
    while found != greeting and greeting.startswith(found):
        left_s = until - time.monotonic()
        if left_s <= 0 or not poll.poll(1000.0 * left_s):
            return False
        part = os.read(output, len(greeting) - len(found))
        if not part:
            return False
        found += part
    return found == greeting


def _pieces(connection: sqlite3.Connection, table: str) -> Iterator[_Piece]:
    first, last = connection.execute(f"SELECT min(rowid), max(rowid) FROM {table}").fetchone()
    if first is None:
        yield table, (0, 0)
        return
    step = max((last - first) // _PIECES, 100)
    for start in range(first, last + 1, step):
        yield table, (start, min(start + step - 1, last))
