"""Whether the journal beside a map is its own: SQLite plays back any that it finds.

A map that was restored from a copy, beside the journal of the map that it replaces, would be
destroyed by that. The journal holds pages as they were before a change, so it fits only a map
whose first page is that one, or the one that the change made of it.
"""

from __future__ import annotations

import os
import stat
import struct
from pathlib import Path

from fieldgrid.errors import MapError
from fieldgrid.mapfile.database import open_files

_MAGIC = bytes.fromhex("d9d505f920a163d7")
_HEADER = struct.Struct(">8sIIIII")
_COUNTER = slice(24, 28)
"""Of the changes, in the first page of a database."""
_ANY = 0xFFFFFFFF
_MOST_RECORDS = 1_000_000

_OPEN: dict[tuple[int, int], int] = {}
"""Maps that were seen beside a journal. They stay open while this process uses them: closing a file
lets go of all locks that the process has on it, also those of a writer in another thread."""
_MOST_OPEN = 32


def check_journal(path: Path) -> None:
    """Raise MapError when what lies beside a map as its journal is none, or another map's."""
    journal = path.with_name(f"{path.name}-journal")
    try:
        mode = os.stat(journal).st_mode
    except OSError:
        return
    if not stat.S_ISREG(mode):
        raise MapError(f"{journal} is no file, and no journal of a map can be; remove it.")
    before = _counter_before(journal)
    if before is None:
        return
    now = _counter_now(path)
    if now in (None, before, (before + 1) & 0xFFFFFFFF):
        return
    if _counter_before(journal) == before:  # else a writer has begun or ended meanwhile
        raise MapError(
            f"{journal} belongs to another state of {path}, and would damage it: remove the "
            "journal if the map was restored from a copy, or restore the map that it belongs to."
        )


def _counter_now(path: Path) -> int | None:
    """The count of changes in a map's first page."""
    try:
        with open_files() as used:
            found = path.stat()
            key = found.st_dev, found.st_ino
            if key not in _OPEN:
                if len(_OPEN) >= _MOST_OPEN:
                    for unused in _OPEN.keys() - used:
                        os.close(_OPEN.pop(unused))
                _OPEN[key] = os.open(path, os.O_RDONLY)
            return int.from_bytes(os.pread(_OPEN[key], 100, 0)[_COUNTER], "big")
    except OSError:
        return None


def _counter_before(journal: Path) -> int | None:
    """The count of changes in the first page that a journal keeps; None where it keeps none."""
    try:
        file = journal.open("rb")
    except OSError:
        return None
    with file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(_HEADER.size)
        if len(head) < _HEADER.size or not head.startswith(_MAGIC):
            return None
        _, count, _, _, sector, page = _HEADER.unpack(head)
        record = page + 8
        if page < 512 or sector < 512 or size <= sector:
            return None
        fitting = (size - sector) // record
        for k in range(min(fitting if count in (0, _ANY) else min(count, fitting), _MOST_RECORDS)):
            file.seek(sector + k * record)
            if file.read(4) == b"\0\0\0\x01":
                return int.from_bytes(file.read(28)[_COUNTER], "big")
    return None
