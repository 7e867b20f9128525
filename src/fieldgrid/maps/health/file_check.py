"""A map as SQLite and GeoPackage see it: the file, the layout of its tables, what they hold."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import lru_cache
from typing import Any

from fieldgrid.core import shortened
from fieldgrid.maps.file import schema
from fieldgrid.maps.file.database import MAX_VALUE_BYTES
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.records import MAX_DOCUMENT
from fieldgrid.maps.file.root import meddling_triggers
from fieldgrid.maps.health import row_sums
from fieldgrid.maps.tiles.tiling import TileMatrixSet
from fieldgrid.maps.vector.marks import create_marks
from fieldgrid.maps.writing.subject import Subject

MAX_PROBLEMS = 100
"""The largest number of problems that are listed."""

_STORED = {
    "INTEGER": ("integer", "a whole number"),
    "TINYINT": ("integer", "a whole number"),
    "DOUBLE": ("real", "a number"),
    "TEXT": ("text", "a text"),
    "DATETIME": ("text", "a date and time"),
}
"""What SQLite holds in a column of a type, and how that is called; a blob in all others."""

_TAKES_ANY_ROW = """
SELECT NOT i."unique" AND NOT i.partial AND NOT EXISTS (
    SELECT 1 FROM pragma_index_xinfo(i.name) AS x
    WHERE x.key AND (x.cid = -2 OR upper(x.coll) NOT IN ('BINARY', 'NOCASE', 'RTRIM'))
) FROM pragma_index_list(?) AS i WHERE i.name = ?
"""
"""Of an index: that it is not unique, and without conditions, expressions, which may fail, and
orders of text that SQLite itself does not have."""

_NO_NUMBER = f"typeof(seq) <> 'integer' OR seq NOT BETWEEN 0 AND {1 << 53}"
"""Of the numbers from which SQLite counts on: it takes no row behind the largest that it has, and
some programs count no further."""


def check_pages(subject: Subject) -> Iterator[str]:
    """The pages of the file, and the numbers that SQLite keeps of it."""
    connection = subject.connection
    yield from damaged_pages(connection)
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version != schema.GEOPACKAGE_VERSION:
        yield (
            f"The file says that it is a GeoPackage of version {version}, and not "
            f"{schema.GEOPACKAGE_VERSION}."
        )
    for (table,) in connection.execute(f"SELECT name FROM sqlite_sequence WHERE {_NO_NUMBER}"):
        yield f"The number of the last row of {shortened(table, 60)} is none."


def check_layout(subject: Subject) -> Iterator[str]:
    """The tables, their indexes, and triggers that change them."""
    connection, (known, _) = subject.connection, _layout(subject)
    ours = set(
        connection.execute(
            "SELECT type, name, tbl_name, sql FROM sqlite_schema WHERE sql IS NOT NULL"
        )
    )
    tables = {*(row[2] for row in known), "layer_styles"}
    for kind, name, _, _ in sorted(known - ours):
        yield f"The {kind} {name} is not laid out as in a map."
    for kind, name, table, _ in sorted(ours - known):
        if (
            kind == "index"
            and table in tables
            and connection.execute(_TAKES_ANY_ROW, (table, name)).fetchall() != [(1,)]
        ):
            yield f"The index {name} of {table} may refuse new rows; drop it."
    for name, table in meddling_triggers(connection):
        yield f"A trigger {name} of {table} changes the map behind its back; drop it."


def check_types(subject: Subject) -> Iterator[str]:
    """What each column of each table holds, which SQLite itself does not enforce."""
    connection, (_, columns) = subject.connection, _layout(subject)
    for table, column, declared, is_needed in columns:
        held, called = _STORED.get(declared, ("blob", "a blob"))
        allowed = f"'{held}'" if is_needed else f"'{held}', 'null'"
        longest = MAX_DOCUMENT if held == "text" else MAX_VALUE_BYTES
        try:
            for row_id, found in connection.execute(
                f"SELECT rowid, typeof({column}) FROM {table} WHERE typeof({column}) NOT IN "
                f"({allowed}) OR length({column}) > {longest}"
            ):
                wrong = "that is too long" if found == held else f"where {called} belongs"
                yield f"Row {row_id} of {table} has {found} in {column}, {wrong}."
        except sqlite3.DataError:
            yield f"A row of {table} has a value in {column} that is too long."


def damaged_pages(connection: sqlite3.Connection) -> Iterator[str]:
    """What SQLite finds wrong with its own file."""
    query = f"PRAGMA integrity_check({MAX_PROBLEMS})"
    with ThreadPoolExecutor(1) as beside:
        rows = beside.submit(lambda: connection.execute(query).fetchall())
        try:
            lines = rows.result()
        except BaseException:  # a signal, which this thread hears
            connection.interrupt()
            raise
    for (line,) in lines:
        if line != "ok":
            yield f"The file is damaged: {shortened(line)}."


def check_counts(subject: Subject) -> Iterator[str]:
    """The rows of layers that GDAL counts by triggers, in a table of its own."""
    connection = subject.connection
    if not schema.has_table(connection, schema.GDAL_COUNTS):
        return
    for table, kept in connection.execute(
        f"SELECT c.table_name, c.feature_count FROM {schema.GDAL_COUNTS} AS c JOIN sqlite_schema "
        "AS s ON s.name = c.table_name WHERE s.type = 'table' AND s.rootpage > 0 "
        "AND c.feature_count IS NOT NULL"
    ).fetchall():
        quoted = table.replace('"', '""')
        (rows,) = connection.execute(f'SELECT count(*) FROM "{quoted}"').fetchone()
        if kept != rows:
            yield (
                f"The layer {shortened(table, 60)} has {rows} rows, and GDAL is told of "
                f"{shortened(kept, 60)}."
            )


def check_references(subject: Subject) -> Iterator[str]:
    """Rows that belong to nothing, in one sentence a table: there may be very many."""
    query = (
        'SELECT "table", "parent", count(*), min("rowid") FROM pragma_foreign_key_check '
        "GROUP BY 1, 2 ORDER BY 1, 2"
    )
    for name, parent, rows, first in subject.connection.execute(query):
        yield f"{rows} rows of {name} have no counterpart in {parent}, {first} first."


def renew_file(connection: sqlite3.Connection) -> None:
    """Bring what `check_pages` finds of the file's own numbers up to date."""
    connection.execute(f"PRAGMA user_version = {schema.GEOPACKAGE_VERSION}")
    connection.execute(f"DELETE FROM sqlite_sequence WHERE {_NO_NUMBER}")


_Layout = tuple[frozenset[tuple[Any, ...]], tuple[tuple[str, str, str, int], ...]]
"""The tables of a map (type, name, table, statement), and their columns (table, column, type, and
whether it is needed)."""


def _layout(subject: Subject) -> _Layout:
    """The layout of a new map with the tables that the map has."""
    connection = subject.connection
    marks, sums = (schema.has_table(connection, f"fieldgrid_{name}") for name in ("mark", "sum"))
    return _empty(subject.header._replace(groups=()), marks, sums)


@lru_cache(maxsize=8)
def _empty(header: MapHeader, marks: bool, sums: bool) -> _Layout:
    with closing(sqlite3.connect("", isolation_level=None)) as made:
        schema.create(made, header.datum, TileMatrixSet(header.lattice), header.transfer, ())
        if marks:
            create_marks(made)
        if sums:
            made.execute(row_sums.LAYOUT)
        query = "SELECT type, name, tbl_name, sql FROM sqlite_schema WHERE sql IS NOT NULL"
        columns = made.execute(
            'SELECT t.name, c.name, c.type, c."notnull" OR c.pk FROM sqlite_schema AS t '
            "JOIN pragma_table_info(t.name) AS c WHERE t.type = 'table' "
            "AND t.name NOT LIKE 'sqlite_%' ORDER BY 1, c.cid"
        )
        return frozenset(made.execute(query)), tuple(columns)
