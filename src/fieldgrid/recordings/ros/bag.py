"""One bag, of whatever container and of however many files."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fieldgrid.core import (
    MIN_TIME_NS,
    Closing,
    Int64,
    LimitError,
    RecordingError,
    UnfoldBudget,
    counted,
    limits,
    utc_text,
)
from fieldgrid.recordings.ros.db3 import Db3Reader, mended
from fieldgrid.recordings.ros.definitions import has_header, stamp_ns
from fieldgrid.recordings.ros.folder import PACKED, BagFiles, find_files, is_bag_folder
from fieldgrid.recordings.ros.mcap_file import McapReader
from fieldgrid.recordings.ros.model import (
    Connection,
    Connections,
    FileReader,
    Message,
    Record,
    Topic,
)
from fieldgrid.recordings.ros.rosbag1 import Rosbag1Reader
from fieldgrid.recordings.ros.source import ZSTD_MAGIC, inflate, unpacked_pieces

_KINDS = (Rosbag1Reader, McapReader, Db3Reader)
_SUFFIXES = (".bag", ".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_MAGIC_BYTES = 16
_SHOWN_CLAUSES = 3
_MOST_MESSAGES = 1_000_000  # and one more for each 8 bytes of the files
_SPAN = 1 << 44  # places in a bag: those of one file after those of the one before

Take = Callable[[Message, int], None]
"""Takes a message and its place among those of its topic."""

Listen = Callable[[str, str], Take | None]
"""Asked at the first message of a topic, by name and type: what takes its messages, if anything."""


def as_utc(time_ns: Int64, epoch_ns: int | None) -> Int64:
    """Times of which those of a clock that counts from its own start, if it is known when that was,
    become UTC; 0 stays what stands for none."""
    if epoch_ns is None:
        return time_ns
    return np.where((time_ns > 0) & (time_ns < MIN_TIME_NS), time_ns + epoch_ns, time_ns)


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
    return path.name.endswith(_SUFFIXES) or start.startswith(
        (Rosbag1Reader.magic, McapReader.magic)
    )


def open_bag(
    path: Path, listen: Listen = lambda _name, _type: None, epoch_ns: int | None = None
) -> Bag:
    """Open a bag and read it once; it is to be closed. Raises RecordingError, in one sentence,
    for what cannot be used at all; what is damaged is used as far as it can be.

    What `listen` gives for a topic takes its messages in this one run. `epoch_ns` is the UTC at
    which a clock began that counts from its own start, that of a simulation.
    """
    return Bag(path, listen, epoch_ns)


class Bag(Closing):
    """An open bag: its topics, its messages as a stream, and what of it could not be read.

    `topics`, by their names, count the readable messages, of `files` in their order; `start_ns` and
    `end_ns` are the times at which the first and the last of them were received. `damage` is empty,
    or one sentence. A bag can be pickled; the copy reads as long as the original is open.
    """

    def __init__(self, path: Path, listen: Listen, epoch_ns: int | None) -> None:
        self.path = path
        self._epoch_ns = epoch_ns
        self._topics: dict[str, _Topic] = {}
        self._runs: list[Callable[[Collection[str] | None], FileReader]] = []  # one for each file
        self._stack = ExitStack()
        try:
            with _told(path):
                self._read(listen)
        except BaseException:
            self._stack.close()
            raise
        received = [topic.received for topic in self._topics.values() if topic.received]
        self.start_ns, self.end_ns = min(map(min, received)), max(map(max, received))
        self.damage = self._damage()
        self.topics = {
            name: Topic(name, topic.connection.type, len(topic.received))
            for name, topic in sorted(self._topics.items())
        }

    def __getstate__(self) -> dict[str, Any]:
        # What was unpacked for this bag is removed when it is closed, and not when a copy is.
        return {**self.__dict__, "_stack": ExitStack()}

    def close(self) -> None:
        """Remove what was unpacked; the bag cannot be read any more."""
        self._stack.close()

    def stamps(self, topic: str) -> tuple[Int64, Int64]:
        """The stamps in the headers of a topic's messages, 0 where the type has no header, and
        the times at which they were received: nanoseconds, in the order of `messages`."""
        found = self._topics[topic]
        return self.dated(np.array(found.stamped)), self.dated(np.array(found.received))

    def dated(self, time_ns: Int64) -> Int64:
        """Times of a clock that counts from its own start as UTC, if its epoch is known; 0 stays
        what stands for none."""
        return as_utc(time_ns, self._epoch_ns)

    def places(self, topic: str) -> Int64:
        """Where in the bag each message of a topic is; never decreasing. Messages that lie
        together, as in a chunk, have one place."""
        return np.array(self._topics[topic].places)

    def messages(self, topics: Collection[str] | None = None, start: int = 0) -> Iterator[Message]:
        """The messages of these topics, or of all, in the order of recording, from a place on."""
        wanted = None if topics is None else frozenset(topics)
        first, at = divmod(start, _SPAN)
        for run in self._runs[first:]:
            for connection, receive_ns, data, _ in self._whole(run(wanted).records(at)):
                topic = self._topics.get(connection.topic)
                if topic is not None and topic.takes(connection):
                    yield Message(connection, receive_ns, bytes(data))
            at = 0

    def _read(self, listen: Listen) -> None:
        """Read everything once: topics, counts, times, places, and what is listened to."""
        files = find_files(self.path) if self.path.is_dir() else BagFiles([self.path], [])
        self.files: tuple[str, ...] = ()
        self._clauses = [*files.notes]
        self._bytes = sum(path.stat().st_size for path in files.paths if path.is_file())
        self._room = _MOST_MESSAGES + self._bytes // 8
        for path in files.paths:
            try:
                self._read_file(path, listen)
            except LimitError:
                raise
            except RecordingError:
                if len(files.paths) == 1:
                    raise
                self._clauses.append(f"{path.name} cannot be read")
        for name, topic in self._topics.items():
            topic.take = None
            if topic.others:
                self._clauses.append(
                    f"{counted(topic.others, 'message')} of {name} that are not of type "
                    f"{topic.connection.type} are left out"
                )
        if not any(topic.received for topic in self._topics.values()):
            raise RecordingError(
                f"{self.path} holds no message that can be read"
                + (f" ({self._clauses[0]})" if self._clauses else "")
                + "; record again."
            )

    def _read_file(self, path: Path, listen: Listen) -> None:
        if not path.is_file():
            raise RecordingError(f"{path} is not there, or is no file; check its name.")
        file = self._unpacked(path)
        start = _start(file)
        kind = next((kind for kind in _KINDS if start.startswith(kind.magic)), None)
        if kind is None:
            what = "does not begin like any bag" if start else "is empty"
            raise RecordingError(
                f"{path} {what}: it is not a .bag (of format 2.0), .mcap or .db3 file that can be "
                "used; record again, copy it again, or convert an older .bag with `rosbag fix`."
            )
        if kind is Db3Reader:
            file = mended(file, self._stack)
        known = Connections()
        run = kind(path, file, known)
        place = len(self._runs) * _SPAN
        for record in self._whole(run.records()):
            self._count(record, place, listen)
        self._runs.append(partial(kind, path, file, known))
        self.files += (path.name,)
        self._clauses += run.damage()
        for one in known.values():
            self._topics.setdefault(one.connection.topic, _Topic(one.connection))

    def _unpacked(self, path: Path) -> Path:
        """The file itself, or what it holds if it is compressed, as far as it is whole."""
        with path.open("rb") as packed:
            if packed.read(len(ZSTD_MAGIC)) != ZSTD_MAGIC:
                return path
            packed.seek(0)
            folder = self._stack.enter_context(TemporaryDirectory())
            inner = Path(folder, path.name.removesuffix(PACKED))
            budget = UnfoldBudget(path, path.stat().st_size)
            with inner.open("wb") as whole:
                try:
                    for piece in unpacked_pieces(packed, "zstd"):
                        budget.spend(len(piece))
                        whole.write(piece)
                except EOFError:
                    self._clauses.append(f"{path.name} cannot be decompressed to its end")
        return inner

    def _count(self, record: Record, place: int, listen: Listen) -> None:
        connection, receive_ns, data, at = record
        name = connection.topic
        topic = self._topics.get(name)
        if topic is None:
            topic = self._topics[name] = _Topic(connection)
        if not topic.takes(connection):
            topic.others += 1
            return
        self._room -= 1
        if self._room < 0:
            raise LimitError(
                f"{self.path} holds more messages than a bag of its size can; it was damaged or "
                "made to do harm, record again."
            )
        number = len(topic.received)
        if number == 0:
            topic.take = listen(name, connection.type)
        topic.received.append(receive_ns)
        topic.stamped.append(stamp_ns(connection.encoding, data) if topic.has_header else 0)
        topic.places.append(place + min(at, _SPAN - 1))
        if topic.take is not None:
            topic.take(Message(connection, receive_ns, bytes(data)), number)

    def _whole(self, records: Iterator[Record]) -> Iterator[Record]:
        """The records, those that are compressed one by one decompressed."""
        budget = UnfoldBudget(self.path, self._bytes)
        with _told(self.path):
            for record in records:
                if record.connection.encoding == "cdr" and record.data[:4] == ZSTD_MAGIC:
                    # No CDR begins like this.
                    data = inflate(bytes(record.data), "zstd", limits().piece_bytes)
                    budget.spend(len(data))
                    yield record._replace(data=bytes(data))
                else:
                    yield record

    def _damage(self) -> str:
        shown, rest = self._clauses[:_SHOWN_CLAUSES], self._clauses[_SHOWN_CLAUSES:]
        if not shown:
            return ""
        more = [counted(len(rest), "further fault")] if rest else []
        number = sum(len(topic.received) for topic in self._topics.values())
        used = f"{counted(number, 'message')} up to {utc_text(self.end_ns)[:19]}Z are used"
        return f"{'; '.join([*shown, *more, used])}."


class _Topic:
    """What is known of a topic. Its first connection says what its messages are; `others` are of
    another type."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.has_header = has_header(connection)
        self.stamped, self.received, self.places = array("q"), array("q"), array("q")
        self.others = 0
        self.take: Take | None = None

    def takes(self, connection: Connection) -> bool:
        """Whether messages of this connection are what those of the topic are, though the
        definition may be another."""
        first = self.connection
        return connection is first or (
            connection.type == first.type and connection.encoding == first.encoding
        )


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Makes an error of the disk one that says what to do."""
    try:
        yield
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be read ({error.strerror}); check its permissions, and the space for "
            "temporary files."
        ) from error


def _start(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_MAGIC_BYTES)
