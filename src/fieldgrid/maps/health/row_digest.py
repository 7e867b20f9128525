"""The SHA-256 of a row, and the sum of those of many, by the standard library alone.

It is also a program, `python row_digest.py MAP`, that starts in a tenth of the time that importing
this package takes. It writes `GREETING`, then reads lines `TABLE FIRST LAST` from its standard
input and answers each with the sum of these rows.
"""

from __future__ import annotations

import hashlib
import sqlite3
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any

GREETING = "sums of rows\n"
"""By which who starts this program knows that it is this one."""


_AS_WRITTEN: Mapping[type, str] = {
    bytes: "[%d]",  # a blob by its length
    bytearray: '"x%s"',  # a text by the digits of its bytes, which need be no UTF-8
    str: '"%s"',  # such digits already
    int: "%r",
    float: "%r",
    type(None): "null%.0s",  # which writes nothing of the value
}


@lru_cache
def _form_of(types: tuple[type, ...]) -> tuple[str, tuple[int, ...], tuple[int, ...]]:
    """How a row of values of some types is hashed: its line, and which values are blobs and texts.
    Rows of one table have few forms, and a map has many rows."""
    line = ",".join(_AS_WRITTEN[kind] for kind in types)
    blobs = tuple(k for k, kind in enumerate(types) if kind is bytes)
    texts = tuple(k for k, kind in enumerate(types) if kind is bytearray)
    return f"[{line}]\n", blobs, texts


def of_row(row: Sequence[Any]) -> int:
    """The SHA-256 of a row: a line of values, a blob as a list of its length, then the blobs."""
    line, blobs, texts = _form_of(tuple(map(type, row)))
    values = list(row)
    for k in texts:
        values[k] = row[k].hex().upper()
    for k in blobs:
        values[k] = len(row[k])
    hashed = hashlib.sha256((line % tuple(values)).encode())
    for k in blobs:
        hashed.update(row[k])
    return int.from_bytes(hashed.digest(), "big")


def of_rows(connection: sqlite3.Connection, table: str, rows: tuple[int, int] | None = None) -> int:
    """The sum over the rows of a table, or over those from a first to a last row id."""
    chosen = "" if rows is None else " WHERE rowid BETWEEN ? AND ?"
    as_usual, connection.text_factory = connection.text_factory, bytearray
    try:
        return sum(map(of_row, connection.execute(f"SELECT * FROM {table}{chosen}", rows or ())))
    finally:
        connection.text_factory = as_usual


def main() -> None:
    """Greet, then answer lines until there are no more."""
    print(GREETING, end="", flush=True)
    place = Path(sys.argv[1]).resolve().as_uri()
    with closing(sqlite3.connect(f"{place}?mode=ro", uri=True, isolation_level=None)) as connection:
        connection.execute("PRAGMA busy_timeout = 0")
        connection.execute("PRAGMA trusted_schema = OFF")
        connection.execute("PRAGMA cell_size_check = ON")
        connection.execute("BEGIN")
        for line in sys.stdin:
            table, first, last = line.split()
            print(of_rows(connection, table, (int(first), int(last))), flush=True)


if __name__ == "__main__":
    main()
