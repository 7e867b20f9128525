"""What lies beside a map, and belongs to another state of it: refused before SQLite plays it back.

SQLite plays back any journal and any write-ahead log that has the name for it. Beside a map that
was restored from a copy, those of the map that it replaces would destroy it, or silently make an
older state of it.
"""

from __future__ import annotations

import stat
import struct
from pathlib import Path
from typing import BinaryIO

from fieldgrid.core import MapError

_MAGIC = bytes.fromhex("d9d505f920a163d7")
_HEADER = struct.Struct(">8sIIIII")
"""Of each part of a journal: magic number, count of pages, nonce, pages of the map before, bytes of
a sector, and of a page."""

_PAGE = struct.Struct(">16xH6xII")
"""The beginning of a map's first page: bytes of a page, changes so far, pages."""

_SMALLEST_PAGE = 512
"""Of SQLite, bytes."""


def check(path: Path) -> None:
    """Raise MapError for a journal or a write-ahead log beside a map that is not its own.

    The map is opened and closed, which takes all locks on it from this process: it must not be
    open in it.
    """
    for name in ("wal", "journal"):
        beside = path.with_name(f"{path.name}-{name}")
        # Twice, because another program may begin or end writing meanwhile.
        if _is_strange(path, beside) and _is_strange(path, beside):
            raise MapError(
                f"{beside} does not belong to {path} as it is, and would damage it: move it "
                "elsewhere if the map was restored from a copy, or restore the map that it "
                "belongs to."
            )


def whole_bytes(path: Path) -> int:
    """How long a map says that it is; 0 where it is no database."""
    page = _first_page(path)
    if not page.startswith(b"SQLite format 3\0") or len(page) < _PAGE.size:
        return 0
    page_size, _, pages = _numbers(page)
    return page_size * pages


def _first_page(path: Path) -> bytes:
    """The beginning of it; empty where the map cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(_PAGE.size)
    except OSError:
        return b""


def _numbers(first_page: bytes) -> tuple[int, int, int]:
    """Bytes of a page, changes so far, and pages of a map."""
    page_size, changes, pages = _PAGE.unpack(first_page)
    return 65536 if page_size == 1 else page_size, changes, pages


def _is_strange(path: Path, beside: Path) -> bool:
    """Whether it is the write-ahead log of a map that has none, or anything but a journal with
    pages as they were before a change of this map. After the log of a map that has one, since
    another program has it open or was killed, SQLite looks."""
    try:
        if beside.name.endswith("-wal"):
            return beside.stat().st_size > 0 and _first_page(path)[18:20] != b"\2\2"
        if not stat.S_ISREG(beside.stat().st_mode):
            return True
        with beside.open("rb") as file:
            head = file.read(_HEADER.size)
            magic = head[: len(_MAGIC)].rstrip(b"\0")
            if magic != _MAGIC and _MAGIC.startswith(magic):
                return False  # its writer was interrupted before it changed the map
            first = _first_page(path)
            if magic != _MAGIC or len(head) < _HEADER.size or len(first) < _PAGE.size:
                return True
            *_, pages, _, page_size = _HEADER.unpack(head)
            size_now, changes_now, _ = _numbers(first)
            if page_size != size_now or page_size < _SMALLEST_PAGE:
                return True
            before = _numbers(_page_before(file, page_size) or first)
    except OSError:
        return False
    return before not in ((page_size, changes_now - k, pages) for k in (0, 1))


def _page_before(file: BinaryIO, page_size: int) -> bytes:
    """The first page as it was; empty where a journal does not have it, as the map's is still that
    one. A change of ours writes it first, that of another program may do so later."""
    start, record = 0, 8 + page_size
    while True:
        file.seek(start)
        head = file.read(_HEADER.size)
        if len(head) < _HEADER.size or not head.startswith(_MAGIC):
            return b""
        _, count, _, _, sector, _ = _HEADER.unpack(head)
        sector = max(sector, _HEADER.size)
        start += sector
        for _ in range(count):
            file.seek(start)
            number, page = file.read(4), file.read(_PAGE.size)
            if len(page) < _PAGE.size:
                return b""
            if number == b"\0\0\0\1":
                return page
            start += record
        start = -(-start // sector) * sector
