"""ROS 1 bags (format 2.0), read from the first byte to the last without their index.

A bag whose recorder was killed has no index, and one that was cut off has a useless one; so the
index is not used at all. http://wiki.ros.org/Bags/Format/2.0 describes the records.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator, Mapping
from itertools import permutations
from operator import itemgetter
from pathlib import Path

from fieldgrid.errors import RecordingError
from fieldgrid.ros.model import (
    MAX_GAPS,
    UNCLOSED,
    Connection,
    Connections,
    Damage,
    Definition,
    Record,
    ros2_name,
)
from fieldgrid.ros.source import (
    COMPRESSIONS,
    MAX_RECORD_BYTES,
    BadChunkError,
    Source,
    Torn,
    inflate,
)

MAGIC = b"#ROSBAG V"
_VERSION = b"2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_OPS = {_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION}
_MAX_HEADER_BYTES = 1 << 20
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")

_CHUNK_OP = re.compile(rb"\x04\x00\x00\x00op=\x05")
_WIDEST_CHUNK_HEADER = 64


_MESSAGE_FIELDS = {b"conn": "I", b"op": "B", b"time": "II"}


class _Layout:
    """The header of a message, whose fields a recorder always puts in the same order."""

    def __init__(self, names: tuple[bytes, ...]) -> None:
        marks = [
            _U32.pack(len(name) + 1 + struct.calcsize(f"<{_MESSAGE_FIELDS[name]}")) + name + b"="
            for name in names
        ]
        parts = [f"{len(m)}s{_MESSAGE_FIELDS[n]}" for m, n in zip(marks, names, strict=True)]
        self.head = struct.Struct(f"<I{''.join(parts)}")
        at, offsets = 1, {}
        for name in names:
            offsets[name] = at
            at += 1 + len(_MESSAGE_FIELDS[name])
        self.marks = itemgetter(0, *offsets.values())
        self.right_marks = (self.head.size - 4, *marks)
        conn, op, time = (offsets[name] for name in _MESSAGE_FIELDS)
        self.values = itemgetter(conn + 1, op + 1, time + 1, time + 2)


_LAYOUTS = {names: _Layout(names) for names in permutations(_MESSAGE_FIELDS)}


class Rosbag1File:
    """One `.bag` file."""

    def __init__(self, path: Path, file: Path) -> None:
        self.path = path
        self._file = file
        self.damage = Damage()
        self.connections = Connections()

    def records(self, topics: Collection[str] | None = None) -> Iterator[Record]:
        """Every message that is readable, in the order of the file."""
        self.damage = Damage()
        self.connections = Connections()
        with Source(self._file) as source:
            self._check_magic(source)
            yield from _Reading(self, source, topics).records()

    def _check_magic(self, source: Source) -> None:
        magic = source.rest(len(MAGIC) + len(_VERSION))
        if not magic.endswith(_VERSION):
            version = magic[len(MAGIC) :].decode("ascii", "replace").strip()
            raise RecordingError(
                f"{self.path} is a ROS 1 bag of format {version!r}; convert it to format 2.0 with "
                "`rosbag fix`."
            )


class _Reading:
    """One run through a bag."""

    def __init__(self, part: Rosbag1File, source: Source, topics: Collection[str] | None) -> None:
        self._path = part.path
        self._source = source
        self._damage = part.damage
        self._connections = part.connections
        self._topics = topics
        self._layout = _LAYOUTS[b"conn", b"op", b"time"]
        self._seen = self._counted = 0  # messages: read, and in the index
        self._chunks = 0
        self._chunks_of_header = -1
        self._closed = False

    def records(self) -> Iterator[Record]:
        source = self._source
        while source.left:
            start = source.offset
            try:
                header = _fields(source.take(self._header_length()))
                op = _op(header)
                if op == _CHUNK:
                    yield from self._chunk(header, start)
                elif op in (_MESSAGE, _CONNECTION):
                    yield from self._inner(self._frame_again(start), whole=True)
                else:
                    if op == _BAG:
                        self._bag(header)
                    length = _U32.unpack(source.take(4))[0]
                    if op == _CHUNK_INFO:
                        self._counted += _count(source.take(length))
                    else:
                        source.skip(length)
            except (Torn, BadChunkError):
                if self._closed and 0 < self._chunks_of_header <= self._chunks:
                    return  # Only the index is damaged, which is not used.
                if not self._resume(start):
                    return
        self._damage.lacks(self._counted, self._seen, source.size)
        if not self._closed and not self._damage.end:
            self._damage.end = UNCLOSED
        elif self._chunks < self._chunks_of_header and not self._damage.end:
            self._damage.end = (
                f"holds {self._chunks} of the {self._chunks_of_header} chunks that it had"
            )

    def _header_length(self) -> int:
        length: int = _U32.unpack(self._source.take(4))[0]
        if length > _MAX_HEADER_BYTES:
            raise Torn
        return length

    def _bag(self, header: Mapping[bytes, bytes]) -> None:
        if header.get(b"encryptor"):
            raise RecordingError(
                f"{self._path} is encrypted; decrypt it with `rosbag decrypt` first."
            )
        self._closed = any(header.get(b"index_pos", b""))
        count = header.get(b"chunk_count", b"")
        self._chunks_of_header = _U32.unpack(count)[0] if len(count) == 4 else -1

    def _chunk(self, header: Mapping[bytes, bytes], start: int) -> Iterator[Record]:
        source = self._source
        length: int = _U32.unpack(source.take(4))[0]
        compression = header.get(b"compression", b"").decode("ascii", "replace")
        if compression not in COMPRESSIONS:
            raise Torn
        whole = length <= source.left
        declared = header.get(b"size", b"")
        most = _U32.unpack(declared)[0] if len(declared) == 4 else MAX_RECORD_BYTES + 1
        self._chunks += 1
        if length > MAX_RECORD_BYTES or most > MAX_RECORD_BYTES:
            source.skip(length)
            self._damage.lose_chunk(length)
            return
        data = inflate(source.rest(length), compression, most)
        try:
            yield from self._inner(data, whole=whole and len(data) == most)
        except BadChunkError:
            # What came before the fault is used.
            if whole:
                self._damage.lose_chunk(length)
            else:
                self._damage.cut("a chunk", source.size - start, partly=True)

    def _inner(self, data: bytes, *, whole: bool) -> Iterator[Record]:
        """The messages of the records that follow one another in `data`."""
        view = memoryview(data)
        end = len(data)
        at = 0
        while at < end:
            if at + 4 > end:
                raise BadChunkError
            body = at + 4 + _U32.unpack_from(view, at)[0]
            if body + 4 > end:
                raise BadChunkError
            after = body + 4 + _U32.unpack_from(view, body)[0]
            if after > end:
                raise BadChunkError
            record = self._record(view, at, body, after)
            if record is not None:
                yield record
            at = after
        if not whole:
            raise BadChunkError

    def _record(self, view: memoryview, at: int, body: int, after: int) -> Record | None:
        layout = self._layout
        if body - at == layout.head.size:
            fields = layout.head.unpack_from(view, at)
            if layout.marks(fields) == layout.right_marks:
                number, kind, secs, nsecs = layout.values(fields)
                if kind == _MESSAGE:
                    return self._message(number, secs * 10**9 + nsecs, view[body + 4 : after])
        try:
            header = _fields(bytes(view[at + 4 : body]))
            kind = _op(header)
        except Torn as error:
            raise BadChunkError from error
        number = header.get(b"conn", b"")
        if kind == _MESSAGE:
            self._layout = _LAYOUTS.get(tuple(header), self._layout)
            time = header.get(b"time", b"")
            if len(time) != 8 or len(number) != 4:
                raise BadChunkError
            secs, nsecs = _TIME.unpack(time)
            return self._message(
                _U32.unpack(number)[0], secs * 10**9 + nsecs, view[body + 4 : after]
            )
        if kind == _CONNECTION and len(number) == 4:
            self._connect(_U32.unpack(number)[0], header, bytes(view[body + 4 : after]))
        return None

    def _message(self, number: int, time_ns: int, data: memoryview) -> Record | None:
        connection = self._connections.get(number)
        if connection is None:
            self._damage.messages += 1
            return None
        self._seen += 1
        if self._topics is not None and connection.topic not in self._topics:
            return None
        return Record(connection, time_ns, data)

    def _connect(self, number: int, header: Mapping[bytes, bytes], data: bytes) -> None:
        try:
            fields = _fields(data)
            name = fields[b"type"].decode()
            topic = header[b"topic"].decode()
        except (Torn, KeyError, UnicodeDecodeError):
            return  # Its messages are counted as lost.
        text = fields.get(b"message_definition", b"").decode("utf-8", "replace")
        # ROS 1 does not care about slashes that double or trail.
        topic = "/" * topic.startswith("/") + "/".join(filter(None, topic.split("/")))
        self._connections.add(
            number, Connection(topic, ros2_name(name), "ros1", Definition("msg", text))
        )

    def _frame_again(self, start: int) -> bytes:
        """The bytes of the whole record that starts there."""
        source = self._source
        source.skip(_U32.unpack(source.take(4))[0])
        end = source.offset
        source.go(start)
        return source.take(end - start)

    def _resume(self, start: int) -> bool:
        """Go on at the next chunk after damage; notes how much is lost."""
        source = self._source
        try:
            found = source.find(_CHUNK_OP, start + 1, self._is_chunk, _WIDEST_CHUNK_HEADER)
            begin = self._chunk_start(source.offset) if found else source.size
        except Torn:
            found = False
        if not found or self._damage.gaps == MAX_GAPS:
            self._damage.cut("a record", source.size - start)
            return False
        source.go(begin)
        self._damage.gaps += 1
        self._damage.gap_bytes += begin - start
        return True

    def _is_chunk(self, op_offset: int) -> bool:
        return self._chunk_start(op_offset) >= 0

    def _chunk_start(self, op_offset: int) -> int:
        """The offset of the chunk record whose `op` field is there; negative if there is none."""
        source = self._source
        first = max(0, op_offset - _WIDEST_CHUNK_HEADER)
        source.go(first)
        block = source.rest(2 * _WIDEST_CHUNK_HEADER)
        for at in range(op_offset - first - 4, -1, -1):
            length = _U32.unpack_from(block, at)[0]
            if at + 4 + length > len(block) or length > _WIDEST_CHUNK_HEADER:
                continue
            try:
                header = _fields(block[at + 4 : at + 4 + length])
            except Torn:
                continue
            if header.keys() >= {b"op", b"compression", b"size"} and header[b"op"] == b"\x05":
                return first + at
        return -1


def _fields(data: bytes) -> dict[bytes, bytes]:
    """The `name=value` fields of a header."""
    found: dict[bytes, bytes] = {}
    at = 0
    while at < len(data):
        if at + 4 > len(data):
            raise Torn
        end = at + 4 + _U32.unpack_from(data, at)[0]
        name, equals, value = data[at + 4 : end].partition(b"=")
        if end > len(data) or not equals:
            raise Torn
        found[name] = value
        at = end
    return found


def _count(data: bytes) -> int:
    """The messages of a chunk, after what the index says of each of its connections."""
    pairs = len(data) // 8
    return sum(struct.unpack(f"<{2 * pairs}I", data[: 8 * pairs])[1::2])


def _op(header: Mapping[bytes, bytes]) -> int:
    op = header.get(b"op", b"")
    if len(op) != 1 or op[0] not in _OPS:
        raise Torn
    return op[0]
