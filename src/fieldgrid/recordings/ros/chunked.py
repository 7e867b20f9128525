"""What .bag and .mcap have in common: records one after the other, some of which are chunks.

A file whose recorder was killed has no index, and one that was cut off has a useless one. So
indexes are not used, whole files and damaged ones are read in the same way, and reading goes on at
the next chunk after damage.
"""

from __future__ import annotations

import re
import struct
import sys
import zlib
from abc import abstractmethod
from collections.abc import Iterator
from typing import ClassVar

from fieldgrid.core import UnfoldBudget, limits
from fieldgrid.recordings.ros.model import MAX_GAPS, Connection, FileReader, Record, size_text
from fieldgrid.recordings.ros.source import BoundedFile, Torn, inflate

TORN = (Torn, struct.error)
"""What reading raises where bytes end or make no sense."""

_MAX_TIME_NS = (1 << 63) - 1


class ChunkedReader(FileReader):
    """One run through a file of records."""

    chunk_mark: ClassVar[re.Pattern[bytes]]
    """How a chunk begins."""

    at = 0  # the place of the record that is read
    data_end = sys.maxsize  # where a recorder that closed the file ended the messages
    told, _seen = 0, 0  # messages that the recorder counted, and that were read

    @abstractmethod
    def next_records(self) -> Iterator[Record]:
        """The messages of the next record of the file, a chunk or not."""

    @abstractmethod
    def inner_records(self, data: bytes | bytearray) -> Iterator[Record]:
        """The messages of records that follow one another in `data`; raises one of `TORN` where
        they make no sense."""

    def is_chunk(self) -> bool:
        """Whether what begins here like a chunk is one."""
        return True

    def records(self, start: int = 0) -> Iterator[Record]:
        """See `FileReader`."""
        with BoundedFile(self.file) as self.source:
            self._budget = UnfoldBudget(self.path, self.source.size)
            self.met = {n: known.connection for n, known in self.known.items() if known.at < start}
            self.source.go(start or len(self.magic))
            while self.source.left:
                self.at = self.source.offset
                try:
                    yield from self.next_records()
                except TORN:
                    if self.at >= self.data_end or not self._resume():
                        break
            if self.data_end > self.source.size and not self.end:
                self.end = "was cut off, or not closed by its recorder: its end may be missing"
            if self.told <= self.source.size:
                self.unread = max(self.unread, self.told - self._seen)

    def chunk_records(
        self, compression: str, full_bytes: int, crc: int, stored_bytes: int
    ) -> Iterator[Record]:
        """The messages of a chunk, whose next `stored_bytes` are left to be read; what came before
        a fault within it is used. Raises Torn where the file ends before the chunk does."""
        source, lost = self.source, self.lost
        if max(stored_bytes, full_bytes) > limits().piece_bytes:
            source.skip(stored_bytes)
            lost.append(stored_bytes)
            return
        is_whole = stored_bytes <= source.left
        data = inflate(source.rest(stored_bytes), compression, full_bytes)
        self._budget.spend(len(data))
        if crc and len(data) == full_bytes and zlib.crc32(data) != crc:
            data = b""  # there is no telling which messages are right
        try:
            yield from self.inner_records(data)
            if len(data) < full_bytes:
                raise Torn
        except TORN:
            if not is_whole:
                raise
            lost.append(stored_bytes)

    def meet(self, number: int, connection: Connection) -> None:
        """Take a connection where its record is, from where on its messages are read."""
        known = self.known.added(number, connection, self.at)
        if known is not None:
            self.met[number] = known

    def message(self, number: int, time_ns: int, data: memoryview) -> Record | None:
        """A message of the connection of that number, if it is one that is asked for."""
        connection = self.met.get(number)
        if connection is None or time_ns > _MAX_TIME_NS:
            self.unread += 1
            return None
        self._seen += 1
        if self.topics is not None and connection.topic not in self.topics:
            return None
        return Record(connection, time_ns, data, self.at)

    def _resume(self) -> bool:
        """Go on at the next chunk after damage; notes how much is lost."""
        source, start, lost = self.source, self.at, self.lost
        try:
            if len(lost) < MAX_GAPS and source.find(self.chunk_mark, start + 1, self.is_chunk):
                lost.append(source.offset - start)
                return True
        except TORN:
            pass
        rest = size_text(source.size - start)
        self.end = f"ends in the middle of a record: its last {rest} cannot be read or only in part"
        return False
