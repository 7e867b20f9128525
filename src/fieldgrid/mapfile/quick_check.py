"""Whether a map is what its writers made of it: every byte is read, nothing is made again.

The sums of its rows tell; with them go the file itself, the root digest, and what follows from
little. What is wrong is found out by `verification`, from the frames.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator

from fieldgrid.errors import FieldgridError
from fieldgrid.mapfile.database import alone
from fieldgrid.mapfile.feature_check import check_announced
from fieldgrid.mapfile.file_check import check_layout, check_pages, orphans
from fieldgrid.mapfile.marks import check_marks
from fieldgrid.mapfile.records import SESSION_SQL, session_info
from fieldgrid.mapfile.root import check_digest
from fieldgrid.mapfile.row_digest import of_rows
from fieldgrid.mapfile.row_sums import SUMMED_TABLES, fits, kept_sums
from fieldgrid.mapfile.shared_sums import sharing_sums
from fieldgrid.mapfile.stored_features import check_stored
from fieldgrid.mapfile.subject import Subject
from fieldgrid.mapfile.tile_check import check_extent

_LONG = ("fieldgrid_grid", "fieldgrid_tile", "fieldgrid_session_tile")
"""The tables that take most of the time; begun first, so that no process is left with one."""


def is_as_written(subject: Subject) -> bool:
    """Whether a map that keeps sums is what its writers made of it."""
    connection = subject.connection
    tables = (*_LONG, *(table for table in SUMMED_TABLES if table not in _LONG))
    try:
        kept = kept_sums(connection)
        if not kept:
            return False
        # While texts are read as bytes, no other thread may read them.
        with alone(connection), sharing_sums(connection, tables, subject.runner.here) as sums:
            return all(next(check(subject), None) is None for check in _CHECKS) and all(
                fits(kept.get(table), total) for table, total in sums.finish().items()
            )
    except (FieldgridError, sqlite3.DatabaseError, UnicodeDecodeError):
        return False


def check_sums(subject: Subject) -> Iterator[str]:
    """The sums of all tables, where they are those of the map as it is."""
    kept = kept_sums(subject.connection)
    for table in SUMMED_TABLES if kept else ():
        if not fits(kept.get(table), of_rows(subject.connection, table)):
            yield (
                f"The rows of {table} are not those that were written, although they fit the "
                "frames, or the sum that is kept of them is damaged; repair the map."
            )


def _check_references(subject: Subject) -> Iterator[str]:
    """References of rows that no sum is kept of; those of the others are as they were written."""
    query = "SELECT name FROM sqlite_schema WHERE type = 'table'"
    for (table,) in subject.connection.execute(query).fetchall():
        if table not in SUMMED_TABLES:
            yield from orphans(subject.connection, f"'{table.replace(chr(39), chr(39) * 2)}'")


def _check_sessions(subject: Subject) -> Iterator[str]:
    for row in subject.connection.execute(f"{SESSION_SQL} ORDER BY id"):
        session_info(row)
    yield from ()


_CHECKS: tuple[Callable[[Subject], Iterator[str]], ...] = (
    check_pages,
    _check_references,
    check_layout,
    check_digest,
    check_marks,
    check_stored,
    _check_sessions,
    check_announced,
    check_extent,
)
