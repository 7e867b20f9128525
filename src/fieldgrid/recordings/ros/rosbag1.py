"""ROS 1 bags (format 2.0), read without their index.

http://wiki.ros.org/Bags/Format/2.0 describes the records.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping

from fieldgrid.core import RecordingError, limits, quoted
from fieldgrid.recordings.ros.chunked import TORN, ChunkedReader
from fieldgrid.recordings.ros.model import Connection, Definition, Record, ros2_name
from fieldgrid.recordings.ros.source import COMPRESSIONS, Torn

MAGIC = b"#ROSBAG V"
_VERSION = b"2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_OPS = {_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION}
_MAX_HEADER_BYTES = 1 << 20
_U32 = struct.Struct("<I")
_PAIR = struct.Struct("<II")
_USUAL_MESSAGE = re.compile(
    rb"(?:\x09\0{3}conn=(.{4})|\x04\0{3}op=\x02|\x0d\0{3}time=(.{8})){3}", re.DOTALL
)
"""The header of a message that has these three fields alone, as of every recorder, in any order."""


class Rosbag1Reader(ChunkedReader):
    """One run through a `.bag` file."""

    chunk_mark = re.compile(
        rb".\0{3}(?:\x04\0{3}op=\x05|\x09\0{3}size=.{4}"
        rb"|[\x0f\x10]\0{3}compression=(?:none|bz2|lz4)){3}",
        re.DOTALL,
    )
    _chunks, _chunks_of_header = 0, -1

    def begin(self) -> None:
        """See `ChunkedReader`."""
        magic = self.source.rest(len(MAGIC) + len(_VERSION))
        if not magic.endswith(_VERSION):
            version = magic[len(MAGIC) :].decode("ascii", "replace").strip()
            raise RecordingError(
                f"{self.path} is a ROS 1 bag of format {quoted(version)}; convert it to format 2.0 "
                "with `rosbag fix`."
            )

    def next_records(self) -> Iterator[Record]:
        """See `ChunkedReader`."""
        source = self.source
        length: int = _U32.unpack(source.take(4))[0]
        if length > _MAX_HEADER_BYTES:
            raise Torn
        header = _fields(source.take(length))
        op = _op(header)
        length = _U32.unpack(source.take(4))[0]
        if op == _CHUNK:
            compression = header.get(b"compression", b"").decode("ascii", "replace")
            if compression not in COMPRESSIONS:
                raise Torn
            full_bytes = _number(header, b"size", limits().piece_bytes + 1)
            self._chunks += 1
            self.has_all = self.is_closed and 0 < self._chunks_of_header <= self._chunks
            yield from self.chunk_records(length, compression, full_bytes)
        elif op == _INDEX:
            source.skip(length)
        else:
            record = self._read(op, header, memoryview(source.take(length)), 0)
            if record is not None:
                yield record

    def lacking(self) -> str:
        """See `ChunkedReader`."""
        if self._chunks < self._chunks_of_header:
            return f"holds {self._chunks} of the {self._chunks_of_header} chunks that it had"
        return ""

    def inner_records(self, data: bytes) -> Iterator[Record]:
        """See `ChunkedReader`."""
        view, at = memoryview(data), 0
        while at < len(data):
            begin, body = at + 4, at + 4 + _U32.unpack_from(view, at)[0]
            at = body + 4 + _U32.unpack_from(view, body)[0]
            if at > len(data):
                raise Torn
            usual = _USUAL_MESSAGE.fullmatch(view, begin, body)
            number, time = usual.groups() if usual else (None, None)
            if number is None or time is None:
                header = _fields(bytes(view[begin:body]))
                record = self._read(_op(header), header, view[body + 4 : at], begin)
            else:
                record = self._message(number, time, view[body + 4 : at], begin)
            if record is not None:
                yield record

    def _message(self, number: bytes, time: bytes, data: memoryview, offset: int) -> Record | None:
        secs, nsecs = _PAIR.unpack(time)
        return self.record(_U32.unpack(number)[0], secs * 10**9 + nsecs, data, offset)

    def _read(
        self, op: int, header: Mapping[bytes, bytes], data: memoryview, offset: int
    ) -> Record | None:
        """The message of a record, if it is one; what others say is kept."""
        if op == _MESSAGE:
            return self._message(header.get(b"conn", b""), header.get(b"time", b""), data, offset)
        if op == _CONNECTION:
            self._connect(header, bytes(data), offset)
        elif op == _CHUNK_INFO:  # pairs of a connection and its number of messages in a chunk
            pairs = data[: len(data) // 8 * 8]
            self.told += sum(count for _, count in _PAIR.iter_unpack(pairs))
        elif op == _BAG:
            if header.get(b"encryptor"):
                raise RecordingError(
                    f"{self.path} is encrypted; decrypt it with `rosbag decrypt` first."
                )
            self.is_closed = any(header.get(b"index_pos", b""))
            self._chunks_of_header = _number(header, b"chunk_count", -1)
        return None

    def _connect(self, header: Mapping[bytes, bytes], data: bytes, offset: int) -> None:
        try:
            fields = _fields(data)
            number: int = _U32.unpack(header[b"conn"])[0]
            name = fields[b"type"].decode()
            topic = header[b"topic"].decode()
        except (*TORN, KeyError, UnicodeDecodeError):
            return  # Its messages are counted as lost.
        text = fields.get(b"message_definition", b"").decode("utf-8", "replace")
        # ROS 1 does not care about slashes that double or trail.
        topic = "/" * topic.startswith("/") + "/".join(filter(None, topic.split("/")))
        connection = Connection(topic, ros2_name(name), "ros1", Definition("msg", text))
        self.connections.add(number, connection, (self.at, offset))


def _fields(data: bytes) -> dict[bytes, bytes]:
    """The `name=value` fields of a header."""
    found: dict[bytes, bytes] = {}
    at = 0
    while at < len(data):
        end = at + 4 + _U32.unpack_from(data, at)[0]
        name, equals, value = data[at + 4 : end].partition(b"=")
        if end > len(data) or not equals:
            raise Torn
        found[name] = value
        at = end
    return found


def _number(header: Mapping[bytes, bytes], name: bytes, otherwise: int) -> int:
    value = header.get(name, b"")
    return int.from_bytes(value, "little") if len(value) == 4 else otherwise


def _op(header: Mapping[bytes, bytes]) -> int:
    op = header.get(b"op", b"")
    if len(op) != 1 or op[0] not in _OPS:
        raise Torn
    return op[0]
