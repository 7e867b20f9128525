"""MCAP files, read without their summary: https://mcap.dev/spec describes the records."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Schema

from fieldgrid.recordings.ros.chunked import ChunkedReader
from fieldgrid.recordings.ros.model import (
    Connection,
    Definition,
    Record,
    definition_of,
    ros2_name,
)
from fieldgrid.recordings.ros.source import COMPRESSIONS, Torn

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
_STATISTICS = 0x0B
_READ = {_SCHEMA, _CHANNEL, _MESSAGE, _STATISTICS}
_ENDS = {(_DATA_END, 4), (_FOOTER, 20)}
_FIRST_PRIVATE_OP = 0x80
_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_U16 = struct.Struct("<H")
_U64 = struct.Struct("<Q")
_MAX_TIME_NS = (1 << 63) - 1
_MAX_NAME_BYTES = 16  # of a compression


class McapReader(ChunkedReader):
    """One run through an `.mcap` file."""

    chunk_mark = re.compile(
        rb"\x06.{5}\x00{3}.{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})", re.DOTALL
    )

    def begin(self) -> None:
        """See `ChunkedReader`."""
        self.source.skip(len(MAGIC))

    def next_records(self) -> Iterator[Record]:
        """See `ChunkedReader`."""
        source = self.source
        op, length = _HEAD.unpack(source.take(_HEAD.size))
        if op == _CHUNK:
            compression, full_bytes, crc, stored_bytes = self._chunk_head(length)
            yield from self.chunk_records(stored_bytes, compression, full_bytes, crc)
        elif op in _READ:
            record = self._read(op, memoryview(source.take(length)), 0)
            if record is not None:
                yield record
        elif (op, length) in _ENDS or 0 < op < _DATA_END or op >= _FIRST_PRIVATE_OP:
            self.is_closed = self.has_all = self.has_all or (op, length) in _ENDS
            source.skip(length)
        else:
            raise Torn

    def inner_records(self, data: bytes) -> Iterator[Record]:
        """See `ChunkedReader`."""
        view, at = memoryview(data), 0
        while at < len(data):
            op, length = _HEAD.unpack_from(view, at)
            begin, at = at + _HEAD.size, at + _HEAD.size + length
            if at > len(data):
                raise Torn
            record = self._read(op, view[begin:at], begin)
            if record is not None:
                yield record

    def is_chunk(self) -> bool:
        """See `ChunkedReader`."""
        try:
            self._chunk_head(_HEAD.unpack(self.source.take(_HEAD.size))[1])
        except Torn:
            return False
        return True

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

    def _read(self, op: int, view: memoryview, offset: int) -> Record | None:
        """The message of a record, if it is one; what others say is kept."""
        if op == _MESSAGE:
            if len(view) >= _MESSAGE_HEAD.size:
                channel, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(view)
                if log_time_ns <= _MAX_TIME_NS:
                    return self.record(channel, log_time_ns, view[_MESSAGE_HEAD.size :], offset)
            self.damage.messages += 1
        elif op == _STATISTICS:
            self.told = _U64.unpack_from(view)[0]
        elif op in _READ and _U16.unpack_from(view)[0] not in (
            self.connections.schemas if op == _SCHEMA else self.connections
        ):
            stream = ReadDataStream(BytesIO(view))
            try:
                if op == _SCHEMA:
                    schema = Schema.read(stream)
                    self.connections.add_schema(schema.id, *named(schema))
                else:
                    channel = Channel.read(stream)
                    about = self.connections.schemas.get(channel.schema_id, UNNAMED)
                    connection = connection_of(channel, about)
                    self.connections.add(channel.id, connection, (self.at, offset))
            except (struct.error, EndOfFile, UnicodeDecodeError):
                pass  # The messages that need it are counted as lost.
        return None


Named = tuple[str, Definition | None]
"""The name of a type and its definition, if there is any."""

UNNAMED: Named = ("", None)


def named(schema: Schema) -> Named:
    """What a schema says."""
    text = schema.data.decode("utf-8", "replace")
    return schema.name, definition_of(schema.encoding, text)


def connection_of(channel: Channel, schema: Named) -> Connection:
    """What the messages of a channel are."""
    name, definition = schema
    encoding = channel.message_encoding
    if encoding in ("cdr", "ros1"):
        name = ros2_name(name)
    return Connection(channel.topic, name, encoding, definition)
