"""ROS 2 bags in SQLite, `.db3`: every row that can be read, in the order of recording.

The user's files are only read. A database whose writer was killed may have its latest rows in a
write-ahead log, or be in the middle of a transaction, or end within a page; a copy is mended.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

from fieldgrid.core import RecordingError, UnfoldBudget, limits
from fieldgrid.recordings.ros.model import (
    MAX_GAPS,
    Connection,
    FileReader,
    Record,
    definition_of,
    ros2_name,
    size_text,
)

_TABLES = {"topics", "messages"}
_MAX_TOPICS = 10_000
_ROWS = (
    "SELECT rowid, topic_id, timestamp, data FROM messages"
    " WHERE rowid > ? AND typeof(rowid) = 'integer' {} ORDER BY rowid"
)
_HEADER_BYTES = 100
_FURTHEST_ROW = (1 << 63) - 1
_ROW_BYTES = 64  # what a row costs without its data


class Db3Reader(FileReader):
    """One run through a `.db3` file."""

    magic = b"SQLite format 3\0"

    def records(self, start: int = 0) -> Iterator[Record]:
        """See `FileReader`."""
        try:
            with _opened(self.file) as database:
                self._check_tables(database)
                self._connect(database)
                yield from self._rows(database, start)
        except sqlite3.Error as error:
            raise RecordingError(
                f"{self.path} is a damaged database ({error}), whose topics cannot be read; "
                "recover it with `sqlite3 FILE .recover`."
            ) from error

    def _check_tables(self, database: sqlite3.Connection) -> None:
        if not _tables(database) >= _TABLES:
            is_cut = _missing_bytes(self.file) > 0
            cut = ", or is cut off so early that it holds no message" if is_cut else ""
            raise RecordingError(
                f"{self.path} is a database but no ROS 2 bag: it has no tables of topics and "
                f"messages{cut}; copy it again."
            )
        columns = database.execute("PRAGMA table_xinfo(messages)").fetchall()
        if any(name.lower() == "rowid" or hidden for _, name, *_, hidden in columns):
            raise RecordingError(
                f"{self.path} is no ROS 2 bag: its messages have columns that are computed, or "
                "take the place of the row number; record again."
            )

    def _connect(self, database: sqlite3.Connection) -> None:
        definitions = _definitions(database)
        rows = database.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        )
        for number, topic, name, encoding in rows.fetchmany(_MAX_TOPICS):
            if isinstance(number, int) and isinstance(topic, str) and isinstance(name, str):
                about = definitions.get(name)
                self.known.added(
                    number, Connection(topic, ros2_name(name), str(encoding), about), 0
                )

    def _rows(self, database: sqlite3.Connection, start: int) -> Iterator[Record]:
        chosen = ""
        if self.topics is not None:
            known = self.known.items()
            numbers = [str(n) for n, one in known if one.connection.topic in self.topics]
            chosen = f"AND topic_id IN ({', '.join(numbers)})"
        query = _ROWS.format(chosen)
        budget = UnfoldBudget(self.path, self.file.stat().st_size)
        last = intact = start - 1
        step, gaps = 1, 0
        while last < _FURTHEST_ROW and gaps <= MAX_GAPS:
            try:
                for row, *fields in database.execute(query, (last,)):
                    if step > 1:  # There were others, which cannot be read.
                        self.unread += row - intact - 1
                    last, step = row, 1
                    record = self._record(row, *fields)
                    budget.spend(_ROW_BYTES + (len(record.data) if record else 0))
                    if record:
                        yield record
                return
            except (sqlite3.Error, OverflowError, MemoryError) as error:
                if step == 1:
                    intact = last
                    gaps += 1
                    missing = _missing_bytes(self.file)
                    self.end = self.end or (
                        f"is cut off: its last {size_text(missing)} are missing"
                        if missing > 0
                        else f"is a damaged database ({error}), of which not all can be read"
                    )
            # Behind a page that is damaged, there may be others that are not.
            last, step = last + step, 2 * step

    def _record(self, row: int, topic: object, time_ns: object, data: object) -> Record | None:
        known = self.known.get(topic) if isinstance(topic, int) else None
        if known is None or not isinstance(time_ns, int) or not isinstance(data, bytes):
            self.unread += 1
            return None
        return Record(known.connection, time_ns, data, row)


def _definitions(database: sqlite3.Connection) -> dict[str, str | None]:
    """The definitions by their type, which bags have from ROS 2 Iron on."""
    found: dict[str, str | None] = {}
    with suppress(sqlite3.Error):  # no such table, or a damaged one
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        for name, encoding, text in rows.fetchmany(_MAX_TOPICS):
            found[name] = definition_of(str(encoding), str(text))
    return found


@contextmanager
def _opened(file: Path, *, mend: bool = False) -> Iterator[sqlite3.Connection]:
    """The database as it is, without its log, or to be mended. Raises sqlite3.Error."""
    mode = "mode=rw" if mend else "mode=ro&immutable=1"
    uri = f"{file.absolute().as_uri()}?{mode}"
    with closing(sqlite3.connect(uri, uri=True, check_same_thread=False)) as database:
        # With it, SQLite opens a database that has been cut off.
        database.execute("PRAGMA writable_schema = ON")
        database.execute("PRAGMA trusted_schema = OFF")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limits().piece_bytes)
        database.text_factory = lambda text: text.decode("utf-8", "replace")
        yield database


def _tables(database: sqlite3.Connection) -> set[str]:
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
    with suppress(sqlite3.Error), _opened(copy, mend=True) as database:
        _tables(database)  # Reading plays the log back, and closing puts it into the file.
    return copy


def _missing_bytes(path: Path) -> int:
    """How much shorter the file is than its own header says; 0 where that cannot be told."""
    page_bytes, pages = _pages(path)
    return max(0, pages * page_bytes - path.stat().st_size)


def _pages(path: Path) -> tuple[int, int]:
    """The size of a page and the number of pages, as the header has them."""
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    page_bytes = int.from_bytes(head[16:18], "big")
    return (65536 if page_bytes <= 1 else page_bytes), int.from_bytes(head[28:32], "big")
