"""What a rollback journal of SQLite holds, and whether it is whole.

SQLite plays back a damaged one up to where it notices, deletes it, and says nothing: the map is
then neither as it was before the change nor after it, and what could have undone it is gone.
A journal is segments, each a header in a sector of its own and the pages that it counts, as they
were before the change. A header is on the disk before the map is touched, with the count of pages
that are; what follows the last one that counts any has changed nothing.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import numpy as np

MAGIC = bytes.fromhex("d9d505f920a163d7")
_HEADER = struct.Struct(">8sIIIII")
_ANY = 0xFFFFFFFF
"""A count that says: all that there are, as of a writer that does not wait for the disk."""
_SECTORS = {1 << k for k in range(5, 17)}
_PAGES = {1 << k for k in range(9, 17)}
_SUMMED_EVERY = 200
"""SQLite adds up each 200th byte of a page, from its end."""

FIRST_BYTES = 100
"""What is looked at of the first page: its header."""
PAGES = slice(28, 32)
"""The size of a database in pages, in its first page."""
_LASTING = (slice(0, 18), slice(20, 24), slice(52, 60), slice(64, 92))
_VERSIONS = slice(18, 20)
"""What no change of a map makes another in the first page: what it is, and how it is laid out."""


class Segment(NamedTuple):
    """A header, and where its `pages` begin, each as long as `page` and 8 bytes.
    Headers lie at multiples of `sector`."""

    start: int
    pages: int
    nonce: int
    pages_before: int
    sector: int
    page: int

    @property
    def end(self) -> int:
        """Behind the last page."""
        return self.start + self.pages * (self.page + 8)

    @property
    def next(self) -> int:
        """Where another header would be."""
        return -(-self.end // self.sector) * self.sector


def first_page(file: BinaryIO, size: int) -> bytes | None:
    """The beginning of the map's first page as it was; None where the journal does not have it."""
    for segment in _segments(file, size):
        for k in range(segment.pages):
            file.seek(segment.start + k * (segment.page + 8))
            if file.read(4) == b"\0\0\0\x01":
                return file.read(FIRST_BYTES)
    return None


def damage(file: BinaryIO, size: int, now: bytes) -> str:
    """What is wrong with a journal of `size` bytes; empty where nothing is wrong, or nothing is to
    be undone. `now` is the beginning of the map's first page as it is."""
    file.seek(0)
    head = file.read(_HEADER.size)
    if len(head) < _HEADER.size or head[0] == 0:
        return ""  # SQLite, too, takes it for one that was never needed
    if not head.startswith(MAGIC):
        return "" if _is_torn(head) else "it does not begin as one"
    seen: set[int] = set()
    segments = list(_segments(file, size))
    if not segments:
        return "its header is wrong"
    if segments[0].pages == 0:
        return ""
    first = now
    for segment in segments:
        if segment.page != page_size(now) or segment[3:] != segments[0][3:]:
            return "its header is wrong"
        if segment.end > size:
            return "its end is missing"
        for number, data in _pages(file, segment):
            if number in seen or not 0 < number <= segment.pages_before:
                return "the number of a page is wrong"
            seen.add(number)
            if data is None:
                return "a page has another sum"
            if number == 1:
                first = data
    is_known = set(first[_VERSIONS]) <= {1, 2}  # another program may choose the second
    if not is_known or any(first[part] != now[part] for part in _LASTING):
        return "the map's first page is another's"
    if int.from_bytes(first[PAGES], "big") != segments[0].pages_before:
        return "it is of a map of another size"
    last = segments[-1]
    if last.pages and last.end < size < last.next + _HEADER.size:
        return "its end is missing"  # a header is written at once
    return "" if _ends(file, size, last) else "a header is wrong"


def _segments(file: BinaryIO, size: int) -> Iterator[Segment]:
    at = 0
    while at + _HEADER.size <= size:
        file.seek(at)
        magic, count, nonce, pages_before, sector, page = _HEADER.unpack(file.read(_HEADER.size))
        if magic != MAGIC or sector not in _SECTORS or page not in _PAGES:
            return
        if count == _ANY:
            count = max(size - at - sector, 0) // (page + 8)
        yield (segment := Segment(at + sector, count, nonce, pages_before, sector, page))
        if count == 0:
            return
        at = segment.next


def _pages(file: BinaryIO, segment: Segment) -> Iterator[tuple[int, bytes | None]]:
    """Number and content of each page; None for one that has another sum than it says."""
    for k in range(segment.pages):
        file.seek(segment.start + k * (segment.page + 8))
        record = file.read(segment.page + 8)
        data = record[4:-4]
        summed = np.frombuffer(data, np.uint8)[segment.page - _SUMMED_EVERY : 0 : -_SUMMED_EVERY]
        expected = (segment.nonce + int(summed.sum())) & 0xFFFFFFFF
        is_whole = expected == int.from_bytes(record[-4:], "big")
        yield int.from_bytes(record[:4], "big"), data if is_whole else None


def _ends(file: BinaryIO, size: int, last: Segment) -> bool:
    """Whether nothing follows the last segment that could be one with a damaged header."""
    if last.pages == 0:
        return True
    file.seek(max(size - 8, 0))
    if file.read(8) == MAGIC:
        return True  # the name of a journal of several databases
    file.seek(last.next)
    head = file.read(_HEADER.size)
    return not any(head[: len(MAGIC)]) or _is_torn(head)


def _is_torn(head: bytes) -> bool:
    """Whether a header has no more than a part of its magic number. SQLite writes that and the
    count at once, when the pages are on the disk and before it touches the map: so it did not."""
    if len(head) < _HEADER.size:
        return False
    _, count, nonce, _, sector, page = _HEADER.unpack(head)
    is_part = MAGIC.startswith(head[: len(MAGIC)].rstrip(b"\0")) and count == 0
    return is_part and nonce != 0 and sector in _SECTORS and page in _PAGES


def page_size(first: bytes) -> int:
    """Of a database, in its first page."""
    size = int.from_bytes(first[16:18], "big")
    return 65536 if size == 1 else size
