"""Whether the journal beside a map is its own: SQLite plays back any that it finds.

A map that was restored from a copy, beside the journal of the map that it replaces, would be
destroyed by that. The journal holds pages as they were before a change, so it fits only a map
whose first page is that one, or the one that the change made of it.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from fieldgrid.core import MapError
from fieldgrid.maps.file.database import open_files
from fieldgrid.maps.health.journal_file import FIRST_BYTES, PAGES, damage, first_page, page_size

_COUNTER = slice(24, 28)
"""Of the changes, in the first page of a database."""

_OPEN: dict[tuple[int, int], int] = {}
"""Maps that were seen beside a journal. They stay open while this process uses them: closing a file
lets go of all locks that the process has on it, also those of a writer in another thread."""
_MOST_OPEN = 32


def check_journal(path: Path) -> None:
    """Raise MapError when what lies beside a map as its journal is none, is damaged, or is
    another map's."""
    journal = path.with_name(f"{path.name}-journal")
    try:
        mode = os.stat(journal).st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        raise MapError(f"{journal} is no file, and no journal of a map can be; remove it.")
    found = _found(path, journal)
    if found and _found(path, journal) == found:  # else a writer has begun or ended meanwhile
        raise MapError(found)


def _found(path: Path, journal: Path) -> str:
    """What speaks against playing back a journal; empty where nothing does."""
    now = first_page_now(path)
    try:
        with journal.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            before = first_page(file, size)
            damaged = damage(file, size, now) if len(now) == FIRST_BYTES else ""
    except OSError:
        return ""
    if now and before is not None:
        count, was = (int.from_bytes(page[_COUNTER], "big") for page in (now, before))
        if count not in (was, (was + 1) & 0xFFFFFFFF) and not damaged:
            return (
                f"{journal} belongs to another state of {path}, and would damage it: remove the "
                "journal if the map was restored from a copy, or restore the map that it belongs "
                "to."
            )
    if damaged:
        return (
            f"{journal} is damaged ({damaged}), and {path} cannot be brought back by it to what it "
            "was before its writer was interrupted: restore a copy of the map, with the journal "
            "moved elsewhere; without a copy, move the journal, too, and run fieldgrid verify."
        )
    return ""


def whole_bytes(path: Path) -> int:
    """How long a map says it is; 0 where it is no database."""
    page = first_page_now(path)
    if not page.startswith(b"SQLite format 3\0") or len(page) < FIRST_BYTES:
        return 0
    return page_size(page) * int.from_bytes(page[PAGES], "big")


def first_page_now(path: Path) -> bytes:
    """The beginning of a map's first page; empty where it cannot be read."""
    try:
        with open_files() as used:
            found = path.stat()
            key = found.st_dev, found.st_ino
            if key not in _OPEN:
                if len(_OPEN) >= _MOST_OPEN:
                    for unused in _OPEN.keys() - used:
                        os.close(_OPEN.pop(unused))
                _OPEN[key] = os.open(path, os.O_RDONLY)
            return os.pread(_OPEN[key], FIRST_BYTES, 0)
    except OSError:
        return b""
