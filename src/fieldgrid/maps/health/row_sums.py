"""Sums of the rows of a map's tables: what tells, in one reading, that none was changed since.

Of each table it is the sum modulo 2^256 of the SHA-256 of its rows. What a commit takes away is
subtracted as it is found, and not as it should be: a row that was changed from outside stays
missing in the sum, also after it was replaced or another one was made of it. So sums that fit say
that the map is what its writers made of it, and are begun only where that was verified.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import lru_cache
from itertools import product
from typing import Any

from fieldgrid.maps.file.digest import of_row, of_rows
from fieldgrid.maps.file.root import root_in_meta
from fieldgrid.maps.file.schema import (
    DERIVED_TABLES,
    EVIDENCE_TABLES,
    GEOMETRIES,
    TABLES,
    has_table,
)
from fieldgrid.maps.writing.subject import Subject

SUMMED_TABLES = (*EVIDENCE_TABLES, *DERIVED_TABLES, "density", *GEOMETRIES)
"""What commits change row by row. The root digest covers the rest, or it is made again in no time:
`fieldgrid_meta`, the marks, and what is announced to a GIS."""

_MODULUS = 1 << 256
_ROOT = "root"
"""Beside the tables: the root digest of the state whose sums are kept. A program that knows of no
sums leaves that of before."""

LAYOUT = """CREATE TABLE fieldgrid_sum (
    rows_of TEXT NOT NULL PRIMARY KEY,
    sum TEXT NOT NULL
)"""

_OLD, _NEW = {"old": -1}, {"new": 1}
_EVENTS: Mapping[str, Mapping[str, int]] = {"INSERT": _NEW, "DELETE": _OLD, "UPDATE": _OLD | _NEW}
"""The rows that each takes from a sum, or adds to it."""


def kept_sums(connection: sqlite3.Connection) -> dict[str, str]:
    """The sums that are kept, by table; none where they are those of another state."""
    if not has_table(connection, "fieldgrid_sum"):
        return {}
    kept = dict(connection.execute("SELECT rows_of, sum FROM fieldgrid_sum").fetchall())
    return kept if kept.pop(_ROOT, None) == root_in_meta(connection) else {}


def check_sums(subject: Subject) -> Iterator[str]:
    """The rows of all tables against the sums that are kept of them, where those are of the map as
    it is."""
    kept = kept_sums(subject.connection)
    for table in SUMMED_TABLES if kept else ():
        if kept.get(table) != _written(of_rows(subject.connection, table)):
            yield (
                f"The rows of {table} are not those that were written, although they fit the "
                "frames, or the sum that is kept of them is damaged; repair the map."
            )


def begin_sums(connection: sqlite3.Connection) -> None:
    """Keep the sums of what the map holds, within the caller's transaction, and from then on.

    The map has been verified, and sealed.
    """
    drop_sums(connection)
    connection.execute(LAYOUT)
    sums = {table: _written(of_rows(connection, table)) for table in SUMMED_TABLES}
    connection.executemany("INSERT INTO fieldgrid_sum VALUES (?, ?)", sums.items())
    _note_root(connection)


def drop_sums(connection: sqlite3.Connection) -> None:
    """Keep no sums any more, within the caller's transaction."""
    connection.execute("DROP TABLE IF EXISTS fieldgrid_sum")


class RowCounter:
    """Keeps the sums of a map in step with what one connection changes.

    Triggers of the connection, which are in no file, see every row that comes or goes.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._changes = dict.fromkeys(SUMMED_TABLES, 0)
        connection.create_function("fieldgrid_count", -1, self._count)

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Within the caller's transaction, at whose end the map is sealed: its sums follow."""
        kept = kept_sums(self._connection)
        if not kept:
            drop_sums(self._connection)  # what happened since is not known
            yield
            return
        self._watch()
        self._changes = dict.fromkeys(SUMMED_TABLES, 0)
        yield
        changed = {table: change for table, change in self._changes.items() if change}
        for table, change in changed.items():
            # What is no number, or missing, stays so, and no sum fits.
            with suppress(KeyError, TypeError, ValueError):
                self._connection.execute(
                    "UPDATE fieldgrid_sum SET sum = ? WHERE rows_of = ?",
                    (_written(int(kept[table], 16) + change), table),
                )
        _note_root(self._connection)

    def _watch(self) -> None:
        """Create the triggers that are missing: all at first, and those of a transaction that was
        rolled back or of tables that were made anew."""
        query = "SELECT name FROM sqlite_temp_schema WHERE type = 'trigger'"
        there = {name for (name,) in self._connection.execute(query)}
        for name, statement in _triggers().items():
            if name not in there:
                self._connection.execute(statement)

    def _count(self, table: str, sign: int, *row: Any) -> None:
        self._changes[table] += sign * of_row(row)


@lru_cache
def _triggers() -> Mapping[str, str]:
    """The statements that make the triggers, by their names."""
    with closing(sqlite3.connect("")) as made:
        made.executescript(TABLES)
        found = {}
        for table, (event, rows) in product(SUMMED_TABLES, _EVENTS.items()):
            columns = made.execute(f"PRAGMA table_info({table})").fetchall()
            counted = ", ".join(
                f"fieldgrid_count('{table}', {sign}, {_values(row, columns)})"
                for row, sign in rows.items()
            )
            found[f"{table}_{event}"] = (
                f"CREATE TEMP TRIGGER {table}_{event} AFTER {event} ON main.{table} "
                f"BEGIN SELECT {counted}; END"
            )
        return found


def _values(row: str, columns: Sequence[tuple[Any, ...]]) -> str:
    """The values of a row as they are hashed: text as x and the digits of its bytes, which need be
    no UTF-8."""
    return ", ".join(
        f"CASE typeof({row}.{name}) WHEN 'text' THEN 'x' || hex({row}.{name}) ELSE {row}.{name} END"
        if kind in ("TEXT", "DATETIME")
        else f"{row}.{name}"
        for _, name, kind, *_ in columns
    )


def _note_root(connection: sqlite3.Connection) -> None:
    connection.execute(
        "INSERT OR REPLACE INTO fieldgrid_sum VALUES (?, ?)", (_ROOT, root_in_meta(connection))
    )


def _written(total: int) -> str:
    return f"{total % _MODULUS:064x}"
