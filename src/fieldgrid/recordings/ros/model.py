"""What every container of ROS messages holds, and what a reader of one file gives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Sized
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import counted


class Topic(NamedTuple):
    """A topic of a bag: its name, its type in ROS 2 spelling and how many messages are readable."""

    name: str
    type: str
    count: int  # type: ignore[assignment]  # in the place of tuple.count, which nobody needs


class Definition(NamedTuple):
    """The text that defines a type and the types within it: `syntax` is "msg" or "idl"."""

    syntax: str
    text: str


_SYNTAX = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl"}


def definition_of(encoding: str, text: str) -> Definition | None:
    """The definition that a bag has in an encoding of schemas of MCAP; None for none of ROS."""
    return Definition(_SYNTAX[encoding], text) if encoding in _SYNTAX and text.strip() else None


class Connection(NamedTuple):
    """What the messages of a topic are: `encoding` is "cdr", "ros1" or a foreign one."""

    topic: str
    type: str
    encoding: str
    definition: Definition | None


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


class Damage:
    """What could not be read of one file.

    `end` is a clause that follows the name of the file: how it ends before its time. Of chunks and
    places that are `lost` it has the bytes; single `messages` could not be read.
    """

    def __init__(self) -> None:
        self.end = ""
        self.messages = 0
        self.lost: dict[str, list[int]] = {"chunk": [], "place": []}

    def clauses(self, name: str) -> list[str]:
        """What is lost of the file `name`; nothing for a whole file."""
        found = [self.end] if self.end else []
        for what, counts in self.lost.items():
            if counts:
                number = counted(len(counts), f"damaged {what}")
                found.append(f"holds {number} ({size(sum(counts))})")
        if self.messages:
            found.append(f"holds {counted(self.messages, 'unreadable message')}")
        return [f"{name} {clause}" for clause in found]


def size(count: int) -> str:
    """A number of bytes as people read it."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{count / scale:.1f} {unit}"
    return counted(count, "byte")


MAX_CONNECTIONS = 10_000
MAX_DEFINITION_CHARS = 1 << 16
"""Ten times what the largest types have. A definition takes 10 microseconds a character to parse,
and one that is beyond this is taken to be missing."""

_MAX_CHARS = 1 << 20  # of all definitions that differ
_MAX_NAME_CHARS = 1 << 22


class Known(NamedTuple):
    """A connection, and where in its file it is told: place and offset, as of a record."""

    connection: Connection
    since: tuple[int, int]


class Connections(dict[int, Known]):
    """The connections of one file by their number, as many as a real file has; of an MCAP also
    the `schemas` of those to come, names and definitions."""

    def __init__(self) -> None:
        super().__init__()
        self.schemas: dict[int, tuple[str, Definition | None]] = {}
        self._definitions: dict[Definition, Definition] = {}
        self._chars = self._name_chars = 0

    def add(self, number: int, connection: Connection, since: tuple[int, int] = (-1, 0)) -> None:
        """Take a connection. One beyond all measure is left out, and its messages with it."""
        if number not in self and self._has_room(self, connection.topic + connection.type):
            definition = self.shared(connection.definition)
            self[number] = Known(connection._replace(definition=definition), since)

    def add_schema(self, number: int, name: str, definition: Definition | None) -> None:
        """Take a schema, as a connection is taken."""
        if number not in self.schemas and self._has_room(self.schemas, name):
            self.schemas[number] = name, self.shared(definition)

    def _has_room(self, among: Sized, names: str) -> bool:
        self._name_chars += len(names)
        return len(among) < MAX_CONNECTIONS and self._name_chars < _MAX_NAME_CHARS

    def shared(self, definition: Definition | None) -> Definition | None:
        """One object for all definitions that are equal; None for one beyond all measure."""
        if definition is None or len(definition.text) > MAX_DEFINITION_CHARS:
            return None
        if definition not in self._definitions:
            self._chars += len(definition.text)
            if self._chars > _MAX_CHARS:
                return None
            self._definitions[definition] = definition
        return self._definitions[definition]


class FileReader(ABC):
    """One run through one file of a bag, known to begin as its kind does: `path` names it, `file`
    is read. `connections` are all that runs have met so far, and `damage` is whole when the run has
    ended."""

    def __init__(
        self,
        path: Path,
        file: Path,
        connections: Connections,
        topics: Collection[str] | None = None,
    ) -> None:
        self.path, self.file = path, file
        self.connections, self.topics = connections, topics
        self.damage = Damage()

    @abstractmethod
    def records(self, start: int = 0) -> Iterator[Record]:
        """What can be read, in the order of the file; of these topics, or of all. `start` is
        where, an `at` of a record of an earlier run. Raises LimitError for a file that unfolds
        to more than it may."""


def ros2_name(name: str) -> str:
    """The ROS 2 spelling of a type: `sensor_msgs/Image` is `sensor_msgs/msg/Image`."""
    package, slash, rest = name.partition("/")
    return f"{package}/msg/{rest}" if slash and "/" not in rest else name
