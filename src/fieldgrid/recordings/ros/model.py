"""What every container of ROS messages holds, and what a reader of one file gives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import ClassVar, NamedTuple

from fieldgrid.core import counted


class Topic(NamedTuple):
    """A topic of a bag: its name, its type in ROS 2 spelling and how many messages are readable."""

    name: str
    type: str
    count: int  # type: ignore[assignment]  # in the place of tuple.count, which nobody needs


MAX_DEFINITION_CHARS = 1 << 16
"""Ten times what the largest types have. A definition takes 10 microseconds a character to parse,
and one that is beyond this is taken to be missing."""


def definition_of(encoding: str, text: str) -> str | None:
    """The definition that a bag has in an encoding of schemas of MCAP; None for one of another
    encoding, for none and for one beyond all measure."""
    is_one = encoding in ("ros1msg", "ros2msg") and len(text) <= MAX_DEFINITION_CHARS
    return text if is_one and text.strip() else None


class Connection(NamedTuple):
    """What the messages of a topic are: `encoding` is "cdr", "ros1" or a foreign one. The
    `definition` of the type and of those within it is as in `.msg` files."""

    topic: str
    type: str
    encoding: str
    definition: str | None


class Message(NamedTuple):
    """One message as it was recorded, and what it is; it can be pickled and decoded anywhere."""

    connection: Connection
    receive_ns: int
    data: bytes

    @property
    def topic(self) -> str:
        """The topic that it was sent to."""
        return self.connection.topic


class Record(NamedTuple):
    """A message within the reader's buffer, which is good until the next one is asked for.

    `at` is a place in the file from which reading can start to meet it again.
    """

    connection: Connection
    receive_ns: int
    data: bytes | memoryview
    at: int


MAX_GAPS = 1000
"""A file with more damaged places than this is given up at the last of them."""


def size_text(count: int) -> str:
    """A number of bytes as people read it."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{count / scale:.1f} {unit}"
    return counted(count, "byte")


_MAX_CHARS = 1 << 24
"""Of the names and the definitions of a file, each connection counting some hundred by itself."""

_CONNECTION_CHARS = 400


class Known(NamedTuple):
    """A connection, and the place in its file where it was met first."""

    connection: Connection
    at: int


class Connections(dict[int, Known]):
    """The connections of one file by their number, as many as a real file has; of an MCAP also
    the `schemas` of those to come, names and definitions."""

    def __init__(self) -> None:
        super().__init__()
        self.schemas: dict[int, tuple[str, str | None]] = {}
        self._room_chars = _MAX_CHARS

    def added(self, number: int, connection: Connection, at: int) -> Connection | None:
        """The connection of that number, which is this one if there was none; None for one beyond
        all measure, whose messages are left out."""
        topic, name, _, definition = connection
        if number not in self and self._has_room(topic, name, definition or ""):
            self[number] = Known(connection, at)
        return self[number].connection if number in self else None

    def add_schema(self, number: int, name: str, definition: str | None) -> None:
        """Take a schema, as a connection is taken."""
        if number not in self.schemas and self._has_room(name, definition or ""):
            self.schemas[number] = name, definition

    def _has_room(self, *texts: str) -> bool:
        self._room_chars -= _CONNECTION_CHARS + sum(map(len, texts))
        return self._room_chars > 0


class FileReader(ABC):
    """One run through one file of a bag, known to begin as its kind does: `path` names it, `file`
    is read. `known` are the connections that runs have met so far.

    What cannot be read is known when the run has ended. `end` is a clause that follows the name of
    the file: how it ends before its time. `lost` are the bytes of places that are damaged, and
    `unread` is the number of messages that cannot be read one by one.
    """

    magic: ClassVar[bytes]
    """What such a file begins with."""

    def __init__(
        self,
        path: Path,
        file: Path,
        known: Connections,
        topics: Collection[str] | None = None,
    ) -> None:
        self.path, self.file = path, file
        self.known, self.topics = known, topics
        self.end, self.unread = "", 0
        self.lost: list[int] = []

    @abstractmethod
    def records(self, start: int = 0) -> Iterator[Record]:
        """What can be read, in the order of the file; of these topics, or of all. `start` is
        where, an `at` of a record of an earlier run. Raises LimitError for a file that unfolds
        to more than it may."""

    def damage(self) -> Iterator[str]:
        """Clauses on what is lost of the file; none for a whole one."""
        if self.end:
            yield f"{self.path.name} {self.end}"
        if self.lost:
            places = counted(len(self.lost), "damaged place")
            yield f"{self.path.name} holds {places} ({size_text(sum(self.lost))})"
        if self.unread:
            yield f"{self.path.name} holds {counted(self.unread, 'unreadable message')}"


def ros2_name(name: str) -> str:
    """The ROS 2 spelling of a type: `sensor_msgs/Image` is `sensor_msgs/msg/Image`."""
    package, slash, rest = name.partition("/")
    return f"{package}/msg/{rest}" if slash and "/" not in rest else name
