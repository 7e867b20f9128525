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
    Record,
    definition_of,
    ros2_name,
)
from fieldgrid.recordings.ros.source import COMPRESSIONS, Torn

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
_MAX_NAME_BYTES = 16  # of a compression


class McapReader(ChunkedReader):
    """One run through an `.mcap` file."""

    magic = b"\x89MCAP0\r\n"
    chunk_mark = re.compile(
        rb"\x06.{5}\x00{3}.{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})", re.DOTALL
    )

    def next_records(self) -> Iterator[Record]:
        """See `ChunkedReader`."""
        source = self.source
        head = source.take(_HEAD.size)
        op, length = _HEAD.unpack(head)
        if op == _CHUNK:
            yield from self.chunk_records(*self._chunk_head(length))
        elif op in _READ:
            yield from self.inner_records(head + source.take(length))
        elif (op, length) in _ENDS or 0 < op < _DATA_END or op >= _FIRST_PRIVATE_OP:
            if (op, length) in _ENDS:
                self.data_end = self.at
            source.skip(length)
        else:
            raise Torn

    def inner_records(self, data: bytes | bytearray) -> Iterator[Record]:
        """See `ChunkedReader`."""
        view, at = memoryview(data), 0
        while at < len(data):
            op, length = _HEAD.unpack_from(view, at)
            begin, at = at + _HEAD.size, at + _HEAD.size + length
            if at > len(data):
                raise Torn
            if op == _MESSAGE:
                channel, _, time_ns, _ = _MESSAGE_HEAD.unpack_from(view, begin)
                record = self.message(channel, time_ns, view[begin + _MESSAGE_HEAD.size : at])
                if record is not None:
                    yield record
            elif op == _STATISTICS:
                self.told = _U64.unpack_from(view, begin)[0]
            elif op in _READ and _U16.unpack_from(view, begin)[0] not in (
                self.known.schemas if op == _SCHEMA else self.met
            ):
                self._read_about(op, view[begin:at])

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

    def _read_about(self, op: int, view: memoryview) -> None:
        """Keep what a schema or a channel says."""
        stream = ReadDataStream(BytesIO(view))
        try:
            if op == _SCHEMA:
                schema = Schema.read(stream)
                self.known.add_schema(schema.id, *named(schema))
            else:
                channel = Channel.read(stream)
                about = self.known.schemas.get(channel.schema_id, UNNAMED)
                self.meet(channel.id, connection_of(channel, about))
        except (struct.error, EndOfFile, UnicodeDecodeError):
            pass  # The messages that need it are counted as lost.


Named = tuple[str, str | None]
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
