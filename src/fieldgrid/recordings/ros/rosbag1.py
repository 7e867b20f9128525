"""ROS 1 bags (format 2.0), read without their index.

http://wiki.ros.org/Bags/Format/2.0 describes the records.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator, Mapping
from itertools import permutations
from operator import itemgetter

from fieldgrid.core import RecordingError, limits, quoted
from fieldgrid.recordings.ros.chunked import ChunkedFile, Run
from fieldgrid.recordings.ros.model import UNCLOSED, Connection, Definition, Record, ros2_name
from fieldgrid.recordings.ros.source import COMPRESSIONS, BadChunkError, BoundedFile, Torn

MAGIC = b"#ROSBAG V"
_VERSION = b"2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_OPS = {_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION}
_MAX_HEADER_BYTES = 1 << 20
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_WIDEST_CHUNK_HEADER = 64
_MESSAGE_FIELDS = {b"conn": "I", b"op": "B", b"time": "II"}


class _MessageHeader:
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


_MESSAGE_HEADERS = {names: _MessageHeader(names) for names in permutations(_MESSAGE_FIELDS)}


class _BagRun(Run):
    chunk_mark = re.compile(rb"\x04\x00\x00\x00op=\x05")
    widest_mark = _WIDEST_CHUNK_HEADER

    def __init__(
        self, part: ChunkedFile, source: BoundedFile, topics: Collection[str] | None
    ) -> None:
        super().__init__(part, source, topics)
        self._header = _MESSAGE_HEADERS[b"conn", b"op", b"time"]
        self._indexed = 0  # messages that the index counts
        self._chunks, self._chunks_of_header = 0, -1
        self._is_closed = False

    def begin(self) -> None:
        magic = self.source.rest(len(MAGIC) + len(_VERSION))
        if not magic.endswith(_VERSION):
            version = magic[len(MAGIC) :].decode("ascii", "replace").strip()
            raise RecordingError(
                f"{self.path} is a ROS 1 bag of format {quoted(version)}; convert it to format 2.0 "
                "with `rosbag fix`."
            )

    def next_records(self) -> Iterator[Record]:
        source = self.source
        header = _fields(source.take(self._header_length()))
        op = _op(header)
        if op == _CHUNK:
            yield from self._chunk(header)
        elif op in (_MESSAGE, _CONNECTION):
            yield from self.inner_records(self._whole_record())
        else:
            if op == _BAG:
                self._bag(header)
            length = _U32.unpack(source.take(4))[0]
            if op == _CHUNK_INFO:
                self._indexed += _count(source.take(length))
            else:
                source.skip(length)

    def has_all(self) -> bool:
        return self._is_closed and 0 < self._chunks_of_header <= self._chunks

    def finish(self) -> None:
        damage = self.damage
        damage.lacks(self._indexed, self.seen, self.source.size)
        if not self._is_closed and not damage.end:
            damage.end = UNCLOSED
        elif self._chunks < self._chunks_of_header and not damage.end:
            damage.end = f"holds {self._chunks} of the {self._chunks_of_header} chunks that it had"

    def _header_length(self) -> int:
        length: int = _U32.unpack(self.source.take(4))[0]
        if length > _MAX_HEADER_BYTES:
            raise Torn
        return length

    def _bag(self, header: Mapping[bytes, bytes]) -> None:
        if header.get(b"encryptor"):
            raise RecordingError(
                f"{self.path} is encrypted; decrypt it with `rosbag decrypt` first."
            )
        self._is_closed = any(header.get(b"index_pos", b""))
        count = header.get(b"chunk_count", b"")
        self._chunks_of_header = _U32.unpack(count)[0] if len(count) == 4 else -1

    def _chunk(self, header: Mapping[bytes, bytes]) -> Iterator[Record]:
        length: int = _U32.unpack(self.source.take(4))[0]
        compression = header.get(b"compression", b"").decode("ascii", "replace")
        if compression not in COMPRESSIONS:
            raise Torn
        declared = header.get(b"size", b"")
        full_bytes = _U32.unpack(declared)[0] if len(declared) == 4 else limits().piece_bytes + 1
        self._chunks += 1
        yield from self.chunk_records(length, compression, full_bytes)

    def inner_records(self, data: bytes) -> Iterator[Record]:
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
            record = self._inner_record(view, at, body, after)
            if record is not None:
                yield record
            at = after

    def _inner_record(self, view: memoryview, at: int, body: int, after: int) -> Record | None:
        usual = self._header
        if body - at == usual.head.size:
            fields = usual.head.unpack_from(view, at)
            if usual.marks(fields) == usual.right_marks:
                number, kind, secs, nsecs = usual.values(fields)
                if kind == _MESSAGE:
                    return self.record(number, secs * 10**9 + nsecs, view[body + 4 : after])
        try:
            header = _fields(bytes(view[at + 4 : body]))
            kind = _op(header)
        except Torn as error:
            raise BadChunkError from error
        number = header.get(b"conn", b"")
        if kind == _MESSAGE:
            self._header = _MESSAGE_HEADERS.get(tuple(header), self._header)
            time = header.get(b"time", b"")
            if len(time) != 8 or len(number) != 4:
                raise BadChunkError
            secs, nsecs = _TIME.unpack(time)
            time_ns = secs * 10**9 + nsecs
            return self.record(_U32.unpack(number)[0], time_ns, view[body + 4 : after])
        if kind == _CONNECTION and len(number) == 4:
            self._connect(_U32.unpack(number)[0], header, bytes(view[body + 4 : after]))
        return None

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
        self.connections.add(
            number, Connection(topic, ros2_name(name), "ros1", Definition("msg", text))
        )

    def _whole_record(self) -> bytes:
        """The bytes of the whole record that starts at `at`, and not only its header."""
        source = self.source
        source.skip(_U32.unpack(source.take(4))[0])
        end = source.offset
        source.go(self.at)
        return source.take(end - self.at)

    def chunk_at(self, mark: int) -> int:
        """The start of the chunk record whose `op` field is there."""
        source = self.source
        first = max(0, mark - _WIDEST_CHUNK_HEADER)
        source.go(first)
        block = source.rest(2 * _WIDEST_CHUNK_HEADER)
        for at in range(mark - first - 4, -1, -1):
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


class Rosbag1File(ChunkedFile):
    """One `.bag` file."""

    run = _BagRun
