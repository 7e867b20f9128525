"""ROS 2 bags in SQLite, `.db3`: every row that can be read, in the order of recording."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

from fieldgrid.core import RecordingError, UnfoldBudget
from fieldgrid.recordings.ros.model import (
    MAX_CONNECTIONS,
    MAX_GAPS,
    Connection,
    Definition,
    FileReader,
    Record,
    definition_of,
    ros2_name,
    size,
)
from fieldgrid.recordings.ros.sqlite_file import connect, missing_bytes, tables

_TABLES = {"topics", "messages"}
_ROWS = (
    "SELECT rowid, topic_id, timestamp, data FROM messages"
    " WHERE rowid > ? AND typeof(rowid) = 'integer' {} ORDER BY rowid"
)
_FURTHEST_ROW = (1 << 63) - 1
_ROW_BYTES = 64  # what a row costs without its data


class Db3Reader(FileReader):
    """One run through a `.db3` file."""

    def records(self, start: int = 0) -> Iterator[Record]:
        """See `FileReader`."""
        try:
            with closing(connect(self.file)) as database:
                self._check_tables(database)
                self._connect(database)
                yield from self._rows(database, start)
        except sqlite3.Error as error:
            raise RecordingError(
                f"{self.path} is a damaged database ({error}), whose topics cannot be read; "
                "recover it with `sqlite3 FILE .recover`."
            ) from error

    def _check_tables(self, database: sqlite3.Connection) -> None:
        if tables(database) >= _TABLES:
            columns = database.execute("PRAGMA table_xinfo(messages)").fetchall()
            if any(name.lower() == "rowid" or hidden for _, name, *_, hidden in columns):
                raise RecordingError(
                    f"{self.path} is no ROS 2 bag: its messages have columns that are computed, or "
                    "take the place of the row number; record again."
                )
            return
        if missing_bytes(self.file):
            raise RecordingError(
                f"{self.path} is cut off so early that it holds no message; copy it again."
            )
        raise RecordingError(
            f"{self.path} is a database but no ROS 2 bag: it has no tables of topics and messages."
        )

    def _connect(self, database: sqlite3.Connection) -> None:
        definitions = _definitions(database)
        rows = database.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        )
        for number, topic, name, encoding in rows.fetchmany(MAX_CONNECTIONS):
            if isinstance(number, int) and all(isinstance(text, str) for text in (topic, name)):
                connection = Connection(
                    topic, ros2_name(name), str(encoding), definitions.get(name)
                )
                self.connections.add(number, connection)

    def _rows(self, database: sqlite3.Connection, start: int) -> Iterator[Record]:
        chosen = ""
        if self.topics is not None:
            known = self.connections.items()
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
                        self.damage.messages += row - intact - 1
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
                    missing = missing_bytes(self.file)
                    self.damage.end = self.damage.end or (
                        f"is cut off: its last {size(missing)} are missing"
                        if missing > 0
                        else f"is a damaged database ({error}), of which not all can be read"
                    )
            # Behind a page that is damaged, there may be others that are not.
            last, step = last + step, 2 * step

    def _record(self, row: int, topic: object, time_ns: object, data: object) -> Record | None:
        known = self.connections.get(topic) if isinstance(topic, int) else None
        if known is None or not isinstance(time_ns, int) or not isinstance(data, bytes):
            self.damage.messages += 1
            return None
        return Record(known.connection, time_ns, data, row)


def is_db3(path: Path) -> bool:
    """Whether this SQLite database has the tables of a bag."""
    try:
        with closing(connect(path)) as database:
            return tables(database) >= _TABLES
    except sqlite3.Error:
        return False


def _definitions(database: sqlite3.Connection) -> dict[str, Definition | None]:
    """The definitions by their type, which bags have from ROS 2 Iron on."""
    found: dict[str, Definition | None] = {}
    with suppress(sqlite3.Error):  # no such table, or a damaged one
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        for name, encoding, text in rows.fetchmany(MAX_CONNECTIONS):
            found[name] = definition_of(str(encoding), str(text))
    return found
