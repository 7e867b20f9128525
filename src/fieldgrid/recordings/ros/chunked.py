"""What .bag and .mcap have in common: records one after the other, some of which are chunks.

A file whose recorder was killed has no index, and one that was cut off has a useless one. So
indexes are not used, whole files and damaged ones are read in the same way, and reading goes on at
the next chunk after damage.
"""

from __future__ import annotations

import re
import struct
import zlib
from abc import abstractmethod
from collections.abc import Iterator
from typing import ClassVar

from fieldgrid.core import UnfoldBudget, limits
from fieldgrid.recordings.ros.model import MAX_GAPS, FileReader, Record, size
from fieldgrid.recordings.ros.source import BoundedFile, Torn, inflate

UNCLOSED = "was not closed by its recorder, so its last messages may be missing"
TORN = (Torn, struct.error)
"""What reading raises where bytes end or make no sense."""


class ChunkedReader(FileReader):
    """One run through a file of records."""

    chunk_mark: ClassVar[re.Pattern[bytes]]
    """How a chunk begins."""

    at = 0
    told, _seen = 0, 0  # messages that the recorder counted, and that were read
    is_closed = False  # by its recorder
    has_all = False  # so that damage does not matter any more

    @abstractmethod
    def begin(self) -> None:
        """Pass over what the file begins with."""

    @abstractmethod
    def next_records(self) -> Iterator[Record]:
        """The messages of the next record of the file, a chunk or not."""

    @abstractmethod
    def inner_records(self, data: bytes) -> Iterator[Record]:
        """The messages of records that follow one another in `data`; raises one of `TORN` where
        they make no sense."""

    def is_chunk(self) -> bool:
        """Whether what begins here like a chunk is one."""
        return True

    def lacking(self) -> str:
        """What a file lacks that was closed, a clause; or nothing."""
        return ""

    def records(self, start: int = 0) -> Iterator[Record]:
        """See `FileReader`."""
        with BoundedFile(self.file) as self.source:
            self._budget = UnfoldBudget(self.path, self.source.size)
            if start:
                self.source.go(start)
            else:
                self.begin()
            while self.source.left:
                self.at = self.source.offset
                try:
                    yield from self.next_records()
                except TORN:
                    if self.has_all or not self._resume():
                        break
            damage = self.damage
            damage.end = damage.end or (self.lacking() if self.is_closed else UNCLOSED)
            if self.told <= self.source.size:
                damage.messages = max(damage.messages, self.told - self._seen)

    def chunk_records(
        self, stored_bytes: int, compression: str, full_bytes: int, crc: int = 0
    ) -> Iterator[Record]:
        """The messages of a chunk, of which the next `stored_bytes` are left; what came before a
        fault within it is used."""
        source, damage = self.source, self.damage
        if max(stored_bytes, full_bytes) > limits().piece_bytes:
            source.skip(stored_bytes)
            damage.lost["chunk"].append(stored_bytes)
            return
        whole = stored_bytes <= source.left
        data = inflate(source.rest(stored_bytes), compression, full_bytes)
        self._budget.spend(len(data))
        if whole and len(data) == full_bytes and crc and zlib.crc32(data) != crc:
            damage.lost["chunk"].append(
                stored_bytes
            )  # there is no telling which messages are right
            return
        try:
            yield from self.inner_records(data)
            if not whole or len(data) < full_bytes:
                raise Torn
        except TORN:
            if whole:
                damage.lost["chunk"].append(stored_bytes)
            else:
                self._cut("a chunk", " or only in part")

    def record(self, number: int, time_ns: int, data: memoryview, offset: int) -> Record | None:
        """A message of the connection of that number, if it is one that is asked for.

        One that lies before its connection is lost, as it was in the first run.
        """
        known = self.connections.get(number)
        if known is None or known.since > (self.at, offset):
            self.damage.messages += 1
            return None
        self._seen += 1
        connection = known.connection
        if self.topics is not None and connection.topic not in self.topics:
            return None
        return Record(connection, time_ns, data, self.at)

    def _cut(self, what: str, how_much: str = "") -> None:
        """Note that the file ends in the middle of something that begins here."""
        self.damage.end = (
            f"ends in the middle of {what}: its last {size(self.source.size - self.at)} cannot be "
            f"read{how_much}"
        )

    def _resume(self) -> bool:
        """Go on at the next chunk after damage; notes how much is lost."""
        source, start, gaps = self.source, self.at, self.damage.lost["place"]
        try:
            if len(gaps) < MAX_GAPS and source.find(self.chunk_mark, start + 1, self.is_chunk):
                gaps.append(source.offset - start)
                return True
        except TORN:
            pass
        self._cut("a record")
        return False
