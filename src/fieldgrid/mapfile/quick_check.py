"""Whether a map is what its writers made of it: every byte is read, nothing is made again.

The sums of its rows tell; with them go the file itself, the root digest, and what follows from
little. What is wrong is found out by `verification`, from the frames.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from queue import SimpleQueue

from fieldgrid.errors import FieldgridError
from fieldgrid.mapfile.database import connect
from fieldgrid.mapfile.feature_check import check_announced
from fieldgrid.mapfile.file_check import check_file, check_layout
from fieldgrid.mapfile.marks import check_marks
from fieldgrid.mapfile.records import SESSION_SQL, session_info
from fieldgrid.mapfile.root import read_root
from fieldgrid.mapfile.row_sums import SUMMED_TABLES, kept_sums, sum_of
from fieldgrid.mapfile.subject import Subject
from fieldgrid.mapfile.tile_check import check_extent
from fieldgrid.workers.order import in_order

_LONG = ("fieldgrid_grid", "fieldgrid_tile", "fieldgrid_session_tile")
"""The tables that take most of the time; begun first, so that no thread is left with one."""


def is_as_written(subject: Subject) -> bool:
    """Whether a map that keeps sums is what its writers made of it."""
    tables = (*_LONG, *(table for table in SUMMED_TABLES if table not in _LONG))
    checks: tuple[Callable[[Subject], Iterator[str]], ...] = (
        check_file,
        *(partial(check_sum, table=table) for table in tables),
        *(check_layout, _check_root, check_marks, _check_sessions, check_announced, check_extent),
    )
    try:
        with _readers(subject) as readers:
            free: SimpleQueue[sqlite3.Connection] = SimpleQueue()
            for reader in readers:
                free.put(reader)

            def is_sound(k: int) -> bool:
                reader = free.get()
                try:
                    return next(checks[k](subject._replace(connection=reader)), None) is None
                finally:
                    free.put(reader)

            return all(in_order(is_sound, range(len(checks)), len(readers)))
    except (FieldgridError, sqlite3.DatabaseError, UnicodeDecodeError):
        return False


def check_sums(subject: Subject) -> Iterator[str]:
    """The sums of all tables, where they are those of the map as it is."""
    if kept_sums(subject.connection):
        for table in SUMMED_TABLES:
            yield from check_sum(subject, table)


def check_sum(subject: Subject, table: str) -> Iterator[str]:
    """The rows of a table against the sum that is kept of them."""
    if kept_sums(subject.connection).get(table) != sum_of(subject.connection, table):
        yield (
            f"The rows of {table} are not those that were written, although they fit the frames, "
            "or the sum that is kept of them is damaged; repair the map."
        )


def _check_root(subject: Subject) -> Iterator[str]:
    if not read_root(subject.connection).sound:
        yield "The root digest is another."


def _check_sessions(subject: Subject) -> Iterator[str]:
    for row in subject.connection.execute(f"{SESSION_SQL} ORDER BY id"):
        session_info(row)
    yield from ()


@contextmanager
def _readers(subject: Subject) -> Iterator[list[sqlite3.Connection]]:
    """The map's connection, and others to the same state for as many threads."""
    assert subject.runner is not None
    count = subject.runner.here
    readers = [subject.connection]
    (*_, file) = subject.connection.execute("PRAGMA database_list").fetchone()
    (mode,) = subject.connection.execute("PRAGMA journal_mode").fetchone()
    with ExitStack() as opened:
        # While this map is being read nobody commits, unless with a write-ahead log. Where another
        # program is about to, there is no further reader: it would wait for us, and we for it.
        with suppress(FieldgridError, sqlite3.Error):
            while file and mode == "delete" and len(readers) < count:
                reader = opened.enter_context(
                    closing(connect(Path(file), subject.path, writable=False))
                )
                reader.execute("PRAGMA busy_timeout = 0")
                reader.execute("BEGIN")
                reader.execute("SELECT 1 FROM sqlite_schema").fetchone()
                readers.append(reader)
        yield readers
