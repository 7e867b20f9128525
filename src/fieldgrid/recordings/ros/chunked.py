"""What .bag and .mcap have in common: records one after the other, some of which are chunks.

A file whose recorder was killed has no index, and one that was cut off has a useless one. So
indexes are not used, and reading goes on at the next chunk after damage.
"""

from __future__ import annotations

import re
import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import ClassVar

from fieldgrid.core import UnfoldBudget, limits
from fieldgrid.recordings.ros.model import MAX_GAPS, Connections, Damage, Record
from fieldgrid.recordings.ros.source import BadChunkError, BoundedFile, Torn, inflate


class ChunkedFile:
    """One file (a `BagPart`), which a `run` of its kind reads."""

    def __init__(self, run: type[Run], path: Path, file: Path) -> None:
        self.run, self.path, self.file = run, path, file
        self.damage, self.connections = Damage(), Connections()
        self.orphans: dict[tuple[int, int], int] = {}
        """Messages, by place and number, that came before what their connection is."""

    def records(self, topics: Collection[str] | None = None, start: int = 0) -> Iterator[Record]:
        """Every message that is readable, in the order of the file."""
        self.damage = Damage()
        with BoundedFile(self.file) as source:
            yield from self.run(self, source, topics).records(start)


class Run(ABC):
    """One run through a file."""

    chunk_mark: ClassVar[re.Pattern[bytes]]
    """What every chunk has at its start or soon after."""
    widest_mark: ClassVar[int]

    def __init__(
        self, part: ChunkedFile, source: BoundedFile, topics: Collection[str] | None
    ) -> None:
        self.path = part.path
        self.source = source
        self.damage = part.damage
        self.connections = part.connections
        self._orphans, self._passed = part.orphans, dict[tuple[int, int], int]()
        self.seen = 0
        self.at = 0
        self.has_ended = False
        self._topics = topics
        self._budget = UnfoldBudget(part.path, source.size)

    @abstractmethod
    def begin(self) -> None:
        """Pass over what the file begins with."""

    @abstractmethod
    def next_records(self) -> Iterator[Record]:
        """The messages of the next record of the file, a chunk or not. Sets `has_ended` where no
        message follows any more."""

    @abstractmethod
    def inner_records(self, data: bytes) -> Iterator[Record]:
        """The messages of records that follow one another in `data`; BadChunkError where they
        make no sense."""

    @abstractmethod
    def chunk_at(self, mark: int) -> int:
        """Where the chunk starts whose mark is at this offset; negative if there is none."""

    @abstractmethod
    def finish(self) -> None:
        """Note what is missing of a file whose end was reached."""

    def has_all(self) -> bool:
        """Whether all messages are known to be read, so that damage does not matter any more."""
        return self.has_ended

    def records(self, start: int) -> Iterator[Record]:
        """Every message from there on."""
        source = self.source
        if start:
            source.go(start)
        else:
            self.begin()
        while source.left and not self.has_ended:
            self.at = source.offset
            try:
                yield from self.next_records()
            except (Torn, BadChunkError):
                if self.has_all() or not self._resume():
                    return
        self.finish()

    def chunk_records(
        self, stored_bytes: int, compression: str, full_bytes: int, crc: int = 0
    ) -> Iterator[Record]:
        """The messages of a chunk, of which the next `stored_bytes` are left; what came before a
        fault within it is used."""
        source, damage = self.source, self.damage
        whole = stored_bytes <= source.left
        if max(stored_bytes, full_bytes) > limits().piece_bytes:
            source.skip(stored_bytes)
            damage.lose_chunk(stored_bytes)
            return
        data = inflate(source.rest(stored_bytes), compression, full_bytes)
        self._budget.spend(len(data))
        if whole and len(data) == full_bytes and crc and zlib.crc32(data) != crc:
            damage.lose_chunk(stored_bytes)  # there is no telling which messages are right
            return
        try:
            yield from self.inner_records(data)
            if not whole or len(data) < full_bytes:
                raise BadChunkError
        except BadChunkError:
            if whole:
                damage.lose_chunk(stored_bytes)
            else:
                damage.cut("a chunk", source.size - self.at, partly=True)

    def record(self, number: int, time_ns: int, data: memoryview) -> Record | None:
        """A message of the connection of that number, if it is one that is asked for."""
        connection = self.connections.get(number)
        if connection is None or (self._orphans and self._is_orphan(number)):
            self.damage.messages += 1
            if connection is None:
                self._pass_orphan(number)
            return None
        self.seen += 1
        if self._topics is not None and connection.topic not in self._topics:
            return None
        return Record(connection, time_ns, data, self.at)

    def _is_orphan(self, number: int) -> bool:
        """Whether this message came too early in the first run, which is what counts: where the
        file is damaged, a later run may know connections that the first one met only afterwards."""
        place = self.at, number
        passed = self._passed.get(place, 0)
        if passed >= self._orphans.get(place, 0):
            return False
        self._passed[place] = passed + 1
        return True

    def _pass_orphan(self, number: int) -> None:
        place = self.at, number
        passed = self._passed[place] = self._passed.get(place, 0) + 1
        self._orphans[place] = max(self._orphans.get(place, 0), passed)

    def _resume(self) -> bool:
        """Go on at the next chunk after damage; notes how much is lost."""
        source, damage = self.source, self.damage
        start, begin = self.at, -1
        try:
            if damage.gaps < MAX_GAPS and source.find(
                self.chunk_mark, start + 1, lambda mark: self.chunk_at(mark) > start,
                self.widest_mark,
            ):  # fmt: skip
                begin = self.chunk_at(source.offset)
        except Torn:
            pass
        if begin < 0:
            damage.cut("a record", source.size - start)
            return False
        source.go(begin)
        damage.gaps += 1
        damage.gap_bytes += begin - start
        return True
