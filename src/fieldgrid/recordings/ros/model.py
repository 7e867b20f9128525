"""What every container of ROS messages holds, and what a reader of one file gives."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

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


class BagPart(Protocol):
    """One file of a bag, known to begin as its kind does: `path` names it, `file` is read."""

    path: Path
    file: Path
    damage: Damage
    """Of the latest run of `records`, and complete when that has ended."""
    connections: Connections
    """All that a run has met so far."""

    def records(self, topics: Collection[str] | None = None, start: int = 0) -> Iterator[Record]:
        """What can be read, in the order of the file; of these topics, or of all. `start` is
        where, an `at` of a record of an earlier run. Raises LimitError for a file that unfolds
        to more than it may."""


MAX_GAPS = 1000
"""A file with more damaged places than this is given up at the last of them."""

UNCLOSED = "was not closed by its recorder, so its last messages may be missing"


@dataclass
class Damage:
    """What could not be read of one file.

    `end` and `notes` are clauses that follow the name of the file: how it ends before its time,
    and what else is wrong. `chunks` of `chunk_bytes` are damaged within, `gaps` of `gap_bytes`
    make no sense, and single `messages` could not be read.
    """

    end: str = ""
    chunks: int = 0
    chunk_bytes: int = 0
    gaps: int = 0
    gap_bytes: int = 0
    messages: int = 0
    notes: list[str] = field(default_factory=list)

    def lose_chunk(self, count: int) -> None:
        """Count a chunk of this many bytes as damaged."""
        self.chunks += 1
        self.chunk_bytes += count

    def cut(self, what: str, count: int, *, partly: bool = False) -> None:
        """Note that the file ends in the middle of something, so that `count` bytes are lost."""
        self.end = f"ends in the middle of {what}: its last {size(count)} cannot be read" + (
            " or only in part" if partly else ""
        )

    def lacks(self, expected: int, read: int, most: int) -> None:
        """Note the messages that the recorder counted and that were not read, up to `most`."""
        if expected <= most:
            self.messages = max(self.messages, expected - read)

    def clauses(self, name: str) -> list[str]:
        """What is lost of the file `name`; nothing for a whole file."""
        found = [self.end] if self.end else []
        if self.chunks:
            chunks = counted(self.chunks, "damaged chunk")
            found.append(f"holds {chunks} ({size(self.chunk_bytes)})")
        if self.gaps:
            places = counted(self.gaps, "damaged place")
            found.append(f"holds {places} ({size(self.gap_bytes)})")
        if self.messages:
            found.append(f"holds {counted(self.messages, 'unreadable message')}")
        return [f"{name} {clause}" for clause in found + self.notes]


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


class Connections:
    """The connections of one file by their number, as many as a real file has."""

    def __init__(self) -> None:
        self._known: dict[int, Connection] = {}
        self._definitions: dict[Definition, Definition] = {}
        self._chars = self._name_chars = 0

    def add(self, number: int, connection: Connection) -> None:
        """Take a connection. One beyond all measure is left out, and its messages with it."""
        if number in self._known or len(self._known) == MAX_CONNECTIONS:
            return
        self._name_chars += len(connection.topic) + len(connection.type)
        if self._name_chars < _MAX_NAME_CHARS:
            definition = self._taken(connection.definition)
            self._known[number] = connection._replace(definition=definition)

    def _taken(self, definition: Definition | None) -> Definition | None:
        """One shared definition object for all connections whose definition is equal."""
        if definition is None or len(definition.text) > MAX_DEFINITION_CHARS:
            return None
        if definition not in self._definitions:
            self._chars += len(definition.text)
            if self._chars > _MAX_CHARS:
                return None
            self._definitions[definition] = definition
        return self._definitions[definition]

    def items(self) -> Iterable[tuple[int, Connection]]:
        """The connections with their numbers."""
        return self._known.items()

    def get(self, number: int) -> Connection | None:
        """The connection of that number, if there is one."""
        return self._known.get(number)


def ros2_name(name: str) -> str:
    """The ROS 2 spelling of a type: `sensor_msgs/Image` is `sensor_msgs/msg/Image`."""
    package, slash, rest = name.partition("/")
    return f"{package}/msg/{rest}" if slash and "/" not in rest else name
