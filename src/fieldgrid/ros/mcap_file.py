"""MCAP files, read from the first byte to the last without their summary.

A file whose recorder was killed has no summary; and what a damaged chunk still gives is worth
more than the chunk's absence. https://mcap.dev/spec describes the records.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from fieldgrid.ros.model import (
    MAX_CONNECTIONS,
    MAX_DEFINITION_CHARS,
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
_MAX_NAME_BYTES = 16  # of a compression
_ROS_SYNTAX = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl"}
_CHUNK_START = re.compile(
    rb"\x06.{5}\x00{3}.{28}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})", re.DOTALL
)
_WIDEST_START = 64


class _Schema(NamedTuple):
    name: str
    encoding: str
    data: bytes


class McapFile:
    """One `.mcap` file."""

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
            source.skip(len(MAGIC))
            yield from _Reading(self, source, topics).records()


class _Reading:
    """One run through a file."""

    def __init__(self, part: McapFile, source: Source, topics: Collection[str] | None) -> None:
        self._source = source
        self._damage = part.damage
        self._channels = part.connections
        self._topics = topics
        self._schemas: dict[int, _Schema] = {}
        self._schema_bytes = 0
        self._seen = 0

    def records(self) -> Iterator[Record]:
        source = self._source
        while source.left:
            start = source.offset
            try:
                op, length = _HEAD.unpack(source.take(_HEAD.size))
                if (op, length) == (_DATA_END, 4):
                    source.skip(length)
                    self._compare()
                    return
                if (op, length) == (_FOOTER, 20):
                    return
                if op == _CHUNK:
                    yield from self._chunk(length, start)
                elif op == _MESSAGE:
                    record = self._message(memoryview(source.take(length)))
                    if record is not None:
                        yield record
                elif op in (_SCHEMA, _CHANNEL):
                    if length > _MAX_SMALL_BYTES:
                        raise Torn
                    self._define(op, source.take(length))
                elif 0 < op < _DATA_END or op >= _FIRST_PRIVATE_OP:
                    source.skip(length)
                else:
                    raise Torn
            except (Torn, BadChunkError):
                if not self._resume(start):
                    return
        if not self._damage.end:
            self._damage.end = UNCLOSED

    def _compare(self) -> None:
        """Note how many messages the summary counts that were not read."""
        source = self._source
        with suppress(Torn):
            while True:
                op, length = _HEAD.unpack(source.take(_HEAD.size))
                if op == _STATISTICS:
                    self._damage.lacks(_U64.unpack(source.take(8))[0], self._seen, source.size)
                    return
                source.skip(length)

    def _chunk(self, length: int, start: int) -> Iterator[Record]:
        source = self._source
        compression, inflated_bytes, crc, stored_bytes = self._chunk_head(length)
        whole = stored_bytes <= source.left
        if stored_bytes > MAX_RECORD_BYTES or inflated_bytes > MAX_RECORD_BYTES:
            source.skip(stored_bytes)
            self._damage.lose_chunk(stored_bytes)
            return
        data = inflate(source.rest(stored_bytes), compression, inflated_bytes)
        if whole and len(data) == inflated_bytes and crc and zlib.crc32(data) != crc:
            self._damage.lose_chunk(
                stored_bytes
            )  # There is no telling which of its messages are right.
            return
        try:
            yield from self._inner(data, whole=whole and len(data) == inflated_bytes)
        except BadChunkError:
            # What came before the fault is used.
            if whole:
                self._damage.lose_chunk(stored_bytes)
            else:
                self._damage.cut("a chunk", source.size - start, partly=True)

    def _chunk_head(self, length: int) -> tuple[str, int, int, int]:
        """The compression of the chunk, its bytes without it, their CRC, its bytes in the file."""
        source = self._source
        _, _, inflated_bytes, crc, name_bytes = _CHUNK_HEAD.unpack(source.take(_CHUNK_HEAD.size))
        if name_bytes > _MAX_NAME_BYTES:
            raise Torn
        compression = source.take(name_bytes).decode("ascii", "replace")
        stored_bytes: int = _U64.unpack(source.take(_U64.size))[0]
        if compression not in COMPRESSIONS or (
            length != _CHUNK_HEAD.size + name_bytes + _U64.size + stored_bytes
        ):
            raise Torn
        return compression, inflated_bytes, crc, stored_bytes

    def _inner(self, data: bytes, *, whole: bool) -> Iterator[Record]:
        """The messages of the records that follow one another in `data`."""
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
        if not whole:
            raise BadChunkError

    def _message(self, view: memoryview) -> Record | None:
        if len(view) < _MESSAGE_HEAD.size:
            self._damage.messages += 1
            return None
        channel, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(view)
        connection = self._channels.get(channel)
        if connection is None or log_time_ns > _MAX_TIME_NS:
            self._damage.messages += 1
            return None
        self._seen += 1
        if self._topics is not None and connection.topic not in self._topics:
            return None
        return Record(connection, log_time_ns, view[_MESSAGE_HEAD.size :])

    def _define(self, op: int, data: bytes) -> None:
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
        if syntax and schema.data.strip() and len(schema.data) <= MAX_DEFINITION_CHARS:
            definition = Definition(syntax, schema.data.decode("utf-8", "replace"))
        name = ros2_name(schema.name) if encoding in ("cdr", "ros1") else schema.name
        self._channels.add(number, Connection(topic, name, encoding, definition))

    def _resume(self, start: int) -> bool:
        """Go on at the next chunk after damage; notes how much is lost."""
        source = self._source
        try:
            found = source.find(_CHUNK_START, start + 1, self._is_chunk, _WIDEST_START)
        except Torn:
            found = False
        if not found or self._damage.gaps == MAX_GAPS:
            self._damage.cut("a record", source.size - start)
            return False
        self._damage.gaps += 1
        self._damage.gap_bytes += source.offset - start
        return True

    def _is_chunk(self, offset: int) -> bool:
        source = self._source
        source.go(offset)
        try:
            self._chunk_head(_HEAD.unpack(source.take(_HEAD.size))[1])
        except Torn:
            return False
        return True


def _prefixed(data: bytes, at: int) -> tuple[bytes, int]:
    """The bytes that follow their own length, and the offset after them."""
    end = at + 4 + _U32.unpack_from(data, at)[0]
    if end > len(data):
        raise Torn
    return data[at + 4 : end], end


def _string(data: bytes, at: int) -> tuple[str, int]:
    text, end = _prefixed(data, at)
    return text.decode(), end
