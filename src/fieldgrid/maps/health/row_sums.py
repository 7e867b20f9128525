"""Sums of the rows of a map's tables: what tells, in one reading, that none was changed since.

Of each table it is the sum modulo 2^256 of the SHA-256 of its rows. What a commit takes away is
subtracted as it is found, and not as it should be: a row that was changed from outside stays
missing in the sum, also after it was replaced or another one was made of it. So sums that fit say
that the map is what its writers made of it, and are begun only where that was verified.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import product
from typing import Any

from fieldgrid.maps.file.root import root_in_meta
from fieldgrid.maps.file.schema import DERIVED_TABLES, EVIDENCE_TABLES, GEOMETRIES, has_table
from fieldgrid.maps.health.row_digest import of_row, of_rows

SUMMED_TABLES = (*EVIDENCE_TABLES, *DERIVED_TABLES, "density", *GEOMETRIES)
"""What commits change row by row. The root digest covers the rest, or it is made again in no time:
`fieldgrid_meta`, the marks, and what is announced to a GIS."""

_MODULUS = 1 << 256
_ROOT = "root"
"""Beside the tables: the root digest of the state whose sums are kept. A program that knows of no
sums leaves that of before."""

_LAYOUT = """CREATE TABLE fieldgrid_sum (
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


def fits(kept: str | None, total: int) -> bool:
    """Whether a sum that is kept is that of the rows."""
    return kept == _written(total)


def create_sums(connection: sqlite3.Connection) -> None:
    """Lay out the table of sums."""
    connection.execute(_LAYOUT)


def begin_sums(connection: sqlite3.Connection) -> None:
    """Keep the sums of what the map holds, within the caller's transaction, and from then on.

    The map has been verified, and sealed.
    """
    drop_sums(connection)
    create_sums(connection)
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
        if not kept_sums(self._connection):
            drop_sums(self._connection)  # what happened since is not known
            yield
            return
        self._watch()
        self._changes = dict.fromkeys(SUMMED_TABLES, 0)
        yield
        for table, change in self._changes.items():
            if change:
                row = self._connection.execute(
                    "SELECT sum FROM fieldgrid_sum WHERE rows_of = ?", (table,)
                ).fetchone()
                # What is no number stays so, and no sum fits.
                with suppress(TypeError, ValueError):
                    self._connection.execute(
                        "UPDATE fieldgrid_sum SET sum = ? WHERE rows_of = ?",
                        (_written(int(row[0], 16) + change), table),
                    )
        _note_root(self._connection)

    def _watch(self) -> None:
        """Create the triggers that are missing: all at first, and those of a transaction that was
        rolled back or of tables that were made anew."""
        query = "SELECT name FROM sqlite_temp_schema WHERE type = 'trigger'"
        there = {name for (name,) in self._connection.execute(query)}
        if len(there) == len(SUMMED_TABLES) * len(_EVENTS):
            return
        rows = self._connection.execute(
            "SELECT t.name, c.name FROM sqlite_schema AS t JOIN pragma_table_info(t.name) AS c "
            "WHERE t.type = 'table' AND t.name IN (SELECT value FROM json_each(?)) "
            "ORDER BY 1, c.cid",
            (json.dumps(SUMMED_TABLES),),
        )
        columns: dict[str, list[str]] = {}
        for table, column in rows:
            columns.setdefault(table, []).append(column)
        for table, event in product(columns, _EVENTS):
            name = f"{table}_{event}"
            if name not in there:
                # A value as it is hashed: text as x and the digits of its bytes.
                counted = (
                    f"fieldgrid_count('{table}', {sign}, "
                    + ", ".join(
                        f"CASE typeof({row}.{column}) WHEN 'text' THEN 'x' || hex({row}.{column}) "
                        f"ELSE {row}.{column} END"
                        for column in columns[table]
                    )
                    + ")"
                    for row, sign in _EVENTS[event].items()
                )
                self._connection.execute(
                    f"CREATE TEMP TRIGGER {name} AFTER {event} ON main.{table} "
                    f"BEGIN SELECT {', '.join(counted)}; END"
                )

    def _count(self, table: str, sign: int, *row: Any) -> None:
        self._changes[table] += sign * of_row(row)


def _note_root(connection: sqlite3.Connection) -> None:
    connection.execute(
        "INSERT OR REPLACE INTO fieldgrid_sum VALUES (?, ?)", (_ROOT, root_in_meta(connection))
    )


def _written(total: int) -> str:
    return f"{total % _MODULUS:064x}"
