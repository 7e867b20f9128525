"""MCAP files, read without their summary: https://mcap.dev/spec describes the records."""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator
from contextlib import suppress
from typing import NamedTuple

from fieldgrid.recordings.ros.chunked import ChunkedFile, Run
from fieldgrid.recordings.ros.model import (
    MAX_CONNECTIONS,
    UNCLOSED,
    Connection,
    Definition,
    Record,
    ros2_name,
)
from fieldgrid.recordings.ros.source import COMPRESSIONS, BadChunkError, BoundedFile, Torn

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_STATISTICS = 0x0B
_FIRST_PRIVATE_OP = 0x80
_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_MAX_TIME_NS = (1 << 63) - 1
_MAX_SMALL_BYTES = 1 << 24  # a schema or a channel
_MAX_SCHEMAS_BYTES = 1 << 26  # all of them
_MOST_DEFINED = 100 * MAX_CONNECTIONS  # each chunk may define its connections again
_MAX_NAME_BYTES = 16  # of a compression
_ROS_SYNTAX = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl"}


class _Schema(NamedTuple):
    name: str
    encoding: str
    data: bytes


class McapRun(Run):
    """One run through an `.mcap` file."""

    chunk_mark = re.compile(
        rb"\x06.{5}\x00{3}.{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})", re.DOTALL
    )
    widest_mark = 64

    def __init__(
        self, part: ChunkedFile, source: BoundedFile, topics: Collection[str] | None
    ) -> None:
        super().__init__(part, source, topics)
        self._schemas: dict[int, _Schema] = {}
        self._defined = self._schema_bytes = 0

    def begin(self) -> None:
        """Check and pass over the start."""
        self.source.skip(len(MAGIC))

    def next_records(self) -> Iterator[Record]:
        """See `Run`."""
        source = self.source
        op, length = _HEAD.unpack(source.take(_HEAD.size))
        if op == _CHUNK:
            compression, full_bytes, crc, stored_bytes = self._chunk_head(length)
            yield from self.chunk_records(stored_bytes, compression, full_bytes, crc)
        elif op == _MESSAGE:
            record = self._message(memoryview(source.take(length)))
            if record is not None:
                yield record
        elif (op, length) in ((_DATA_END, 4), (_FOOTER, 20)):
            if op == _DATA_END:
                source.skip(length)
                self._compare()
            self.has_ended = True
        elif op in (_SCHEMA, _CHANNEL):
            if length > _MAX_SMALL_BYTES:
                raise Torn
            self._define(op, source.take(length))
        elif 0 < op < _DATA_END or op >= _FIRST_PRIVATE_OP:
            source.skip(length)
        else:
            raise Torn

    def inner_records(self, data: bytes) -> Iterator[Record]:
        """See `Run`."""
        view = memoryview(data)
        end = len(data)
        at = 0
        while at < end:
            if at + _HEAD.size > end:
                raise BadChunkError
            op, length = _HEAD.unpack_from(view, at)
            at += _HEAD.size
            if at + length > end:
                raise BadChunkError
            if op == _MESSAGE:
                record = self._message(view[at : at + length])
                if record is not None:
                    yield record
            elif op in (_SCHEMA, _CHANNEL) and length <= _MAX_SMALL_BYTES:
                self._define(op, bytes(view[at : at + length]))
            at += length

    def chunk_at(self, mark: int) -> int:
        """See `Run`."""
        self.source.go(mark)
        try:
            self._chunk_head(_HEAD.unpack(self.source.take(_HEAD.size))[1])
        except Torn:
            return -1
        return mark

    def finish(self) -> None:
        """See `Run`."""
        if not self.has_ended and not self.damage.end:
            self.damage.end = UNCLOSED

    def _compare(self) -> None:
        """Note how many messages the summary counts that were not read."""
        source = self.source
        with suppress(Torn):
            while True:
                op, length = _HEAD.unpack(source.take(_HEAD.size))
                if op == _STATISTICS:
                    self.damage.lacks(_U64.unpack(source.take(8))[0], self.seen, source.size)
                    return
                source.skip(length)

    def _chunk_head(self, length: int) -> tuple[str, int, int, int]:
        """The compression of the chunk, its bytes without it, their CRC, its bytes in the file."""
        source = self.source
        _, _, full_bytes, crc, name_bytes = _CHUNK_HEAD.unpack(source.take(_CHUNK_HEAD.size))
        if name_bytes > _MAX_NAME_BYTES:
            raise Torn
        compression = source.take(name_bytes).decode("ascii", "replace")
        stored_bytes: int = _U64.unpack(source.take(_U64.size))[0]
        if compression not in COMPRESSIONS or (
            length != _CHUNK_HEAD.size + name_bytes + _U64.size + stored_bytes
        ):
            raise Torn
        return compression, full_bytes, crc, stored_bytes

    def _message(self, view: memoryview) -> Record | None:
        if len(view) < _MESSAGE_HEAD.size:
            self.damage.messages += 1
            return None
        channel, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(view)
        if log_time_ns > _MAX_TIME_NS:
            self.damage.messages += 1
            return None
        return self.record(channel, log_time_ns, view[_MESSAGE_HEAD.size :])

    def _define(self, op: int, data: bytes) -> None:
        self._defined += 1
        if self._defined > _MOST_DEFINED:
            return
        try:
            if op == _SCHEMA:
                self._add_schema(data)
            else:
                self._add_channel(data)
        except (struct.error, Torn, UnicodeDecodeError):
            return  # The messages that need it are counted as lost.

    def _add_schema(self, data: bytes) -> None:
        number = _U16.unpack_from(data)[0]
        name, at = _string(data, 2)
        encoding, at = _string(data, at)
        text, _ = _prefixed(data, at)
        self._schema_bytes += len(text)
        if len(self._schemas) < MAX_CONNECTIONS and self._schema_bytes < _MAX_SCHEMAS_BYTES:
            self._schemas.setdefault(number, _Schema(name, encoding, text))

    def _add_channel(self, data: bytes) -> None:
        number, schema_number = struct.unpack_from("<HH", data)
        topic, at = _string(data, 4)
        encoding, _ = _string(data, at)
        schema = self._schemas.get(schema_number, _Schema("", "", b""))
        syntax = _ROS_SYNTAX.get(schema.encoding)
        definition = None
        if syntax and schema.data.strip():
            definition = Definition(syntax, schema.data.decode("utf-8", "replace"))
        name = ros2_name(schema.name) if encoding in ("cdr", "ros1") else schema.name
        self.connections.add(number, Connection(topic, name, encoding, definition))


def _prefixed(data: bytes, at: int) -> tuple[bytes, int]:
    """The bytes that follow their own length, and the offset after them."""
    end = at + 4 + _U32.unpack_from(data, at)[0]
    if end > len(data):
        raise Torn
    return data[at + 4 : end], end


def _string(data: bytes, at: int) -> tuple[str, int]:
    text, end = _prefixed(data, at)
    return text.decode(), end
