"""ROS 2 bags in SQLite, `.db3`: every row that can be read, in the order of recording."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing, suppress
from pathlib import Path

from fieldgrid.errors import RecordingError
from fieldgrid.ros.model import (
    MAX_CONNECTIONS,
    MAX_GAPS,
    Connection,
    Connections,
    Damage,
    Definition,
    Record,
    ros2_name,
    size,
)
from fieldgrid.ros.sqlite_file import connect, missing_bytes, tables

_TABLES = {"topics", "messages"}
_ROWS = (
    "SELECT rowid, topic_id, timestamp, data FROM messages"
    " WHERE rowid > ? AND typeof(rowid) = 'integer' ORDER BY rowid"
)
_SYNTAX = {"ros2msg": "msg", "ros2idl": "idl"}
_FURTHEST_ROW = (1 << 63) - 1


class Db3File:
    """One `.db3` file."""

    def __init__(self, path: Path, file: Path) -> None:
        self.path = path
        self._file = file
        self.damage = Damage()
        self.connections = Connections()

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Every message that is readable, in the order of the file."""
        self.damage = Damage()
        try:
            database = connect(self._file)
        except sqlite3.Error as error:
            raise self._unusable(error) from error
        with closing(database):
            try:
                self._check_tables(database)
                self.connections = _connections(database)
            except sqlite3.Error as error:
                raise self._unusable(error) from error
            yield from self._rows(database, topics)

    def _unusable(self, error: sqlite3.Error) -> RecordingError:
        return RecordingError(
            f"{self.path} is a damaged database ({error}), whose topics cannot be read; recover "
            "it with `sqlite3 FILE .recover`."
        )

    def _check_tables(self, database: sqlite3.Connection) -> None:
        if tables(database) >= _TABLES:
            return
        if missing_bytes(self._file):
            raise RecordingError(
                f"{self.path} is cut off so early that it holds no message; copy it again."
            )
        raise RecordingError(
            f"{self.path} is a database but no ROS 2 bag: it has no tables of topics and messages."
        )

    def _rows(
        self,
        database: sqlite3.Connection,
        topics: Collection[str] | None,
    ) -> Iterator[Record]:
        last = intact = -1
        step, gaps = 1, 0
        while last < _FURTHEST_ROW and gaps <= MAX_GAPS:
            try:
                for row, *fields in database.execute(_ROWS, (last,)):
                    if step > 1:  # There were others, which cannot be read.
                        self.damage.messages += row - intact - 1
                    last, step = row, 1
                    record = self._record(*fields)
                    if record and (topics is None or record.connection.topic in topics):
                        yield record
                return
            except (sqlite3.Error, OverflowError, MemoryError) as error:
                if step == 1:
                    intact = last
                    gaps += 1
                    self._note(error)
            # Behind a page that is damaged, there may be others that are not.
            last, step = last + step, 2 * step

    def _note(self, error: BaseException) -> None:
        if not self.damage.end:
            missing = missing_bytes(self._file)
            self.damage.end = (
                f"is cut off: its last {size(missing)} are missing"
                if missing > 0
                else f"is a damaged database ({error}), of which not all can be read"
            )

    def _record(self, topic: object, time_ns: object, data: object) -> Record | None:
        connection = self.connections.get(topic) if isinstance(topic, int) else None
        if connection is None or not isinstance(time_ns, int) or not isinstance(data, bytes):
            self.damage.messages += 1
            return None
        return Record(connection, time_ns, data)


def is_db3(path: Path) -> bool:
    """Whether this SQLite database has the tables of a bag."""
    try:
        with closing(connect(path)) as database:
            return tables(database) >= _TABLES
    except sqlite3.Error:
        return False


def _connections(database: sqlite3.Connection) -> Connections:
    definitions = _definitions(database)
    connections = Connections()
    rows = database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
    for number, topic, name, encoding in rows.fetchmany(MAX_CONNECTIONS):
        if isinstance(number, int) and all(isinstance(text, str) for text in (topic, name)):
            type_name = ros2_name(name)
            connections.add(
                number, Connection(topic, type_name, str(encoding), definitions.get(name))
            )
    return connections


def _definitions(database: sqlite3.Connection) -> dict[str, Definition]:
    """The definitions by their type, which bags have from ROS 2 Iron on."""
    found: dict[str, Definition] = {}
    with suppress(sqlite3.Error):  # no such table, or a damaged one
        rows = database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        for name, encoding, text in rows.fetchmany(MAX_CONNECTIONS):
            if encoding in _SYNTAX and isinstance(text, str) and text.strip():
                found[name] = Definition(_SYNTAX[encoding], text)
    return found
