"""One bag, of whatever container and of however many files."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from fieldgrid.array_types import Int64
from fieldgrid.errors import RecordingError
from fieldgrid.ros.db3 import Db3File, is_db3
from fieldgrid.ros.definitions import decode, has_header
from fieldgrid.ros.folder import Files, find_files, is_bag_folder, unpacked
from fieldgrid.ros.mcap_file import MAGIC as MCAP_MAGIC
from fieldgrid.ros.mcap_file import McapFile
from fieldgrid.ros.model import Connection, Message, Part, Record, Topic, counted
from fieldgrid.ros.rosbag1 import MAGIC as ROSBAG1_MAGIC
from fieldgrid.ros.rosbag1 import Rosbag1File
from fieldgrid.ros.source import ZSTD_MAGIC, inflate
from fieldgrid.ros.sqlite_file import MAGIC as SQLITE_MAGIC
from fieldgrid.ros.sqlite_file import mended
from fieldgrid.ros.stamps import stamp_ns

_PARTS: dict[bytes, type[Part]] = {
    ROSBAG1_MAGIC: Rosbag1File,
    MCAP_MAGIC: McapFile,
    SQLITE_MAGIC: Db3File,
}
_SUFFIXES = (".bag", ".mcap", ".db3")
_PACKED = (".mcap.zstd", ".db3.zstd")
_SHOWN_CLAUSES = 3
_MOST_MESSAGES = 1_000_000  # and one more for each 8 bytes of the files
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def is_bag(path: Path) -> bool:
    """Whether this is, by its content or else by its name, a ROS bag or the folder of one."""
    try:
        if path.is_dir():
            return is_bag_folder(path)
        if not path.is_file():
            return False
        start = _start(path)
    except OSError:
        return False
    if path.name.endswith((*_SUFFIXES, *_PACKED)):
        return True
    if start.startswith(SQLITE_MAGIC):
        return is_db3(path)  # A map is an SQLite database too.
    return start.startswith(tuple(_PARTS))


def open_bag(path: Path) -> Bag:
    """Open a bag and scan it once; it is to be closed. Raises RecordingError, in one sentence,
    for what cannot be used at all; what is damaged is used as far as it can be."""
    return Bag(path)


class Bag:
    """An open bag: its topics, its messages as a stream, and what of it could not be read.

    `topics` counts the readable messages; `start_ns` and `end_ns` are the times at which the
    first and the last of them were received. `damage` is empty, or one sentence.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._topics: dict[str, _Topic] = {}
        self._others: dict[str, int] = {}
        self._notes: list[str] = []
        self._stack = ExitStack()
        try:
            self._parts = self._open_parts()
            self._scan()
        except BaseException as error:
            self._stack.close()
            if isinstance(error, OSError):
                raise RecordingError(
                    f"{path} cannot be read ({error.strerror}); check its permissions, and the "
                    "space for temporary files."
                ) from error
            raise
        self.topics: Mapping[str, Topic] = MappingProxyType(
            {name: topic.summary() for name, topic in sorted(self._topics.items())}
        )
        times = [topic.received for topic in self._topics.values() if topic.received]
        self.start_ns = min(min(received) for received in times)
        self.end_ns = max(max(received) for received in times)
        self.damage = self._damage()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def files(self) -> tuple[str, ...]:
        """The names of the files that are read, in their order."""
        return tuple(part.path.name for part in self._parts)

    def close(self) -> None:
        """Remove what was unpacked; the bag cannot be read any more."""
        self._stack.close()

    def stamps(self, topic: str) -> tuple[Int64, Int64]:
        """The stamps in the headers of a topic's messages, 0 where the type has no header, and
        the times at which they were received: nanoseconds, in the order of `messages`."""
        found = self._topic(topic)
        return np.array(found.stamped, dtype=np.int64), np.array(found.received, dtype=np.int64)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages of these topics, or of all, in the order of recording."""
        wanted = None if topics is None else frozenset(topics)
        for part in self._parts:
            for connection, receive_ns, data in _whole(part.records(wanted)):
                topic = self._topics.get(connection.topic)
                if topic is not None and topic.takes(connection):
                    yield Message(connection.topic, receive_ns, bytes(data))

    def decode(self, message: Message) -> Any:
        """The message as a dataclass with the fields of its type.

        Raises RecordingError for bytes that do not fit the type's definition, for a type without
        one and for messages that are not of ROS.
        """
        first: RecordingError | None = None
        for connection in self._topic(message.topic).connections:
            try:
                return decode(connection, message.data)
            except RecordingError as error:
                first = first or error
        assert first is not None
        raise first

    def _topic(self, name: str) -> _Topic:
        if name not in self._topics:
            raise RecordingError(
                f"{self.path} has no topic {name!r}; it has {', '.join(sorted(self._topics))}."
            )
        return self._topics[name]

    def _open_parts(self) -> list[Part]:
        files = find_files(self.path) if self.path.is_dir() else Files([self.path], [])
        self._notes += files.notes
        if len(files.paths) == 1:
            return [self._part(files.paths[0])]
        parts = []
        for path in files.paths:
            try:
                parts.append(self._part(path))
            except RecordingError:
                self._notes.append(f"{path.name} is empty or does not begin like any bag")
        return parts

    def _part(self, path: Path) -> Part:
        if not path.is_file():
            raise RecordingError(f"{path} is not there, or is no file; check its name.")
        file, is_all = unpacked(path, self._stack)
        start = _start(file)
        if start.startswith(SQLITE_MAGIC):
            file, note = mended(file, self._stack)
            self._notes += [f"{path.name} {note}"] * bool(note)
        if not is_all:
            self._notes.append(f"{path.name} cannot be decompressed to its end")
        for magic, kind in _PARTS.items():
            if start.startswith(magic):
                return kind(path, file)
        what = "is empty" if not start else "does not begin like any bag"
        raise RecordingError(
            f"{path} {what}: it is not a .bag, .mcap or .db3 file that can be used; record again, "
            "or copy it again."
        )

    def _scan(self) -> None:
        """Read everything once: topics, counts and times."""
        room = _MOST_MESSAGES + sum(part.path.stat().st_size for part in self._parts) // 8
        for part in list(self._parts):
            try:
                for record in _whole(part.records()):
                    self._count(*record)
                    room -= 1
                    if room < 0:
                        raise RecordingError(
                            f"{self.path} holds more messages than a bag of its size can; it was "
                            "damaged or made to do harm, record again."
                        )
            except RecordingError:
                if len(self._parts) == 1 or room < 0:
                    raise
                self._parts.remove(part)
                self._notes.append(f"{part.path.name} cannot be read")
            for connection in part.connections:
                self._topics.setdefault(connection.topic, _Topic(connection))
        if not any(topic.received for topic in self._topics.values()):
            found = self._clauses()
            raise RecordingError(
                f"{self.path} holds no message that can be read"
                + (f" ({found[0]})" if found else "")
                + "; record again."
            )

    def _count(self, connection: Connection, receive_ns: int, data: bytes | memoryview) -> None:
        name = connection.topic
        topic = self._topics.get(name)
        if topic is None:
            topic = self._topics[name] = _Topic(connection)
        if topic.adds(connection):
            topic.received.append(receive_ns)
            topic.stamped.append(stamp_ns(connection.encoding, data) if topic.has_header else 0)
        else:
            self._others[name] = self._others.get(name, 0) + 1

    def _clauses(self) -> list[str]:
        found = list(self._notes)
        for part in self._parts:
            found += part.damage.clauses(part.path.name)
        for topic, number in self._others.items():
            found.append(
                f"{counted(number, 'message')} of {topic} that are not of type "
                f"{self._topics[topic].connections[0].type} are left out"
            )
        return found

    def _damage(self) -> str:
        clauses = self._clauses()
        if not clauses:
            return ""
        if len(clauses) > _SHOWN_CLAUSES:
            rest = counted(len(clauses) - _SHOWN_CLAUSES, "further fault")
            clauses = [*clauses[:_SHOWN_CLAUSES], rest]
        number = sum(len(topic.received) for topic in self._topics.values())
        used = f"{counted(number, 'message')} up to {_utc(self.end_ns)} are used"
        return f"{'; '.join([*clauses, used])}."


class _Topic:
    """What the scan finds of a topic. Its first connection says what its messages are."""

    def __init__(self, connection: Connection) -> None:
        self.connections: list[Connection] = [connection]  # no two alike
        self._seen = {id(connection): connection}
        self.has_header = has_header(connection)
        self.stamped = array("q")
        self.received = array("q")

    def summary(self) -> Topic:
        connection = self.connections[0]
        return Topic(connection.topic, connection.type, len(self.received))

    def takes(self, connection: Connection) -> bool:
        """Whether messages of this connection are what those of the topic are."""
        first = self.connections[0]
        return connection.type == first.type and connection.encoding == first.encoding

    def adds(self, connection: Connection) -> bool:
        """Whether it takes the connection, whose definition may be another."""
        if id(connection) in self._seen:
            return True
        if not self.takes(connection):
            return False
        self._seen[id(connection)] = connection  # kept, so that no other gets its id
        if connection not in self.connections:
            self.connections.append(connection)
        return True


def _whole(records: Iterator[Record]) -> Iterator[Record]:
    """The records, those that are compressed one by one decompressed."""
    for record in records:
        if record.connection.encoding == "cdr" and record.data[:4] == ZSTD_MAGIC:
            # No CDR begins like this.
            yield record._replace(data=inflate(bytes(record.data), "zstd"))
        else:
            yield record


def _start(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(max(len(magic) for magic in _PARTS))


def _utc(time_ns: int) -> str:
    try:
        time = _EPOCH + timedelta(seconds=time_ns // 10**9)
    except OverflowError:
        return f"{time_ns} ns"
    return time.strftime("%Y-%m-%dT%H:%M:%SZ")
