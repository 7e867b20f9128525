"""An SQLite database of somebody else, opened to be read whatever state it is in.

The user's files are only read. A database whose writer was killed may have its latest rows in a
write-ahead log, or be in the middle of a transaction, or end within a page; a copy is mended.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from contextlib import ExitStack, closing, suppress
from pathlib import Path

from fieldgrid.core import limits

MAGIC = b"SQLite format 3\0"
_HEADER_BYTES = 100


def connect(file: Path, *, mend: bool = False) -> sqlite3.Connection:
    """The database as it is, without its log, or to be mended. Raises sqlite3.Error."""
    mode = "mode=rw" if mend else "mode=ro&immutable=1"
    database = sqlite3.connect(
        f"{file.absolute().as_uri()}?{mode}", uri=True, check_same_thread=False
    )
    try:
        # With it, SQLite opens a database that has been cut off.
        database.execute("PRAGMA writable_schema = ON")
        database.execute("PRAGMA trusted_schema = OFF")
    except sqlite3.Error:
        database.close()
        raise
    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limits().piece_bytes)
    database.text_factory = lambda text: text.decode("utf-8", "replace")
    return database


def tables(database: sqlite3.Connection) -> set[str]:
    """The names of the tables; views and virtual tables, which have no page, are none."""
    rows = database.execute("SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0")
    return {str(name) for (name,) in rows}


def mended(path: Path, stack: ExitStack) -> Path:
    """The database itself, or a copy that has been mended where it is in need of that.

    The copy is gone when the stack is closed. Raises OSError where the disk has no room for it.
    """
    page_bytes, _ = _pages(path)
    torn_bytes = path.stat().st_size % page_bytes  # of a file that ends within its last page
    logs = [path.with_name(path.name + end) for end in ("-wal", "-journal")]
    if not torn_bytes and not any(log.is_file() and log.stat().st_size for log in logs):
        return path
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    for file in (path, *logs):
        if file.is_file():
            shutil.copyfile(file, folder / file.name)
    copy = folder / path.name
    # SQLite would take what is missing of the last page for zeros.
    os.truncate(copy, copy.stat().st_size - torn_bytes)
    # A failure leaves what there is to be read.
    with suppress(sqlite3.Error), closing(connect(copy, mend=True)) as database:
        tables(database)  # Reading plays the log back, and closing puts it into the file.
    return copy


def missing_bytes(path: Path) -> int:
    """How much shorter the file is than its own header says; 0 where that cannot be told."""
    page_bytes, pages = _pages(path)
    return max(0, pages * page_bytes - path.stat().st_size)


def _pages(path: Path) -> tuple[int, int]:
    """The size of a page and the number of pages, as the header has them."""
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    page_bytes = int.from_bytes(head[16:18], "big")
    return (65536 if page_bytes <= 1 else page_bytes), int.from_bytes(head[28:32], "big")
