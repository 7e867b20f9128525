"""ROS 1 bags (format 2.0), read without their index.

http://wiki.ros.org/Bags/Format/2.0 describes the records.
"""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping

from fieldgrid.core import RecordingError
from fieldgrid.recordings.ros.chunked import TORN, ChunkedReader
from fieldgrid.recordings.ros.model import Connection, Record, definition_of, ros2_name
from fieldgrid.recordings.ros.source import COMPRESSIONS, Torn

_MESSAGE, _BAG, _INDEX = b"\x02", b"\x03", b"\x04"
_CHUNK, _CHUNK_INFO, _CONNECTION = b"\x05", b"\x06", b"\x07"
_MAX_HEADER_BYTES = 1 << 20
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_PAIR = struct.Struct("<II")
_USUAL_MESSAGE = re.compile(
    rb"(?:\x09\0{3}conn=(.{4})|\x04\0{3}op=\x02|\x0d\0{3}time=(.{8})){3}", re.DOTALL
)
"""The header of a message that has these three fields alone, as of every recorder, in any order."""


class Rosbag1Reader(ChunkedReader):
    """One run through a `.bag` file."""

    magic = b"#ROSBAG V2.0\n"
    chunk_mark = re.compile(
        rb".\0{3}(?:\x04\0{3}op=\x05|\x09\0{3}size=.{4}"
        rb"|[\x0f\x10]\0{3}compression=(?:none|bz2|lz4)){3}",
        re.DOTALL,
    )

    def next_records(self) -> Iterator[Record]:
        """See `ChunkedReader`."""
        source = self.source
        head_bytes: int = _U32.unpack(source.take(4))[0]
        if head_bytes > _MAX_HEADER_BYTES:
            raise Torn
        header = _fields(source.take(head_bytes))
        data_bytes: int = _U32.unpack(source.take(4))[0]
        if header[b"op"] == _CHUNK:
            compression = header[b"compression"].decode("ascii", "replace")
            if compression not in COMPRESSIONS:
                raise Torn
            full_bytes = _U32.unpack(header[b"size"])[0]
            yield from self.chunk_records(compression, full_bytes, 0, data_bytes)
        elif header[b"op"] == _INDEX:
            source.skip(data_bytes)
        else:
            source.go(self.at)
            yield from self.inner_records(source.take(4 + head_bytes + 4 + data_bytes))

    def inner_records(self, data: bytes | bytearray) -> Iterator[Record]:
        """See `ChunkedReader`."""
        view, at = memoryview(data), 0
        while at < len(data):
            begin, body = at + 4, at + 4 + _U32.unpack_from(view, at)[0]
            at = body + 4 + _U32.unpack_from(view, body)[0]
            if at > len(data):
                raise Torn
            usual = _USUAL_MESSAGE.fullmatch(view, begin, body)
            if usual:
                number, time = usual.groups(b"")
                record = self._message(number, time, view[body + 4 : at])
            else:
                record = self._read(_fields(bytes(view[begin:body])), view[body + 4 : at])
            if record is not None:
                yield record

    def _message(self, number: bytes, time: bytes, data: memoryview) -> Record | None:
        secs, nsecs = _PAIR.unpack(time)
        return self.message(_U32.unpack(number)[0], secs * 10**9 + nsecs, data)

    def _read(self, header: Mapping[bytes, bytes], data: memoryview) -> Record | None:
        """The message of a record, if it is one; what others say is kept."""
        op = header[b"op"]
        if op == _MESSAGE:
            return self._message(header[b"conn"], header[b"time"], data)
        if op == _CONNECTION:
            self._connect(header, bytes(data))
        elif op == _CHUNK_INFO:  # pairs of a connection and its number of messages in a chunk
            pairs = data[: len(data) // 8 * 8]
            self.told += sum(count for _, count in _PAIR.iter_unpack(pairs))
        elif op == _BAG:
            if header[b"encryptor"]:
                raise RecordingError(
                    f"{self.path} is encrypted; decrypt it with `rosbag decrypt` first."
                )
            self.data_end = _U64.unpack(header[b"index_pos"])[0] or self.data_end
        elif op not in (_CHUNK, _INDEX):
            raise Torn
        return None

    def _connect(self, header: Mapping[bytes, bytes], data: bytes) -> None:
        try:
            number: int = _U32.unpack(header[b"conn"])[0]
            if number in self.met:
                return
            fields = _fields(data)
            name, topic = fields[b"type"].decode(), header[b"topic"].decode()
        except (*TORN, UnicodeDecodeError):
            return  # Its messages are counted as lost.
        text = fields[b"message_definition"].decode("utf-8", "replace")
        definition = definition_of("ros1msg", text)
        # ROS 1 does not care about slashes that double or trail.
        topic = "/" * topic.startswith("/") + "/".join(filter(None, topic.split("/")))
        self.meet(number, Connection(topic, ros2_name(name), "ros1", definition))


def _fields(data: bytes) -> Mapping[bytes, bytes]:
    """The `name=value` fields of a header; those that it lacks are empty."""
    found = defaultdict[bytes, bytes](bytes)
    at = 0
    while at < len(data):
        end = at + 4 + _U32.unpack_from(data, at)[0]
        name, equals, value = data[at + 4 : end].partition(b"=")
        if end > len(data) or not equals:
            raise Torn
        found[name] = value
        at = end
    return found
