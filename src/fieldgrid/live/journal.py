"""A file that grows by whole records: what was pushed is there again after a kill.

Each record is a JSON value with its CRC-32. A record that was not written to its end is not in the
file; one that was damaged later is left out, and those after it are found again.
"""

from __future__ import annotations

import json
import os
import threading
import zlib
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO

from fieldgrid.closing import Closing
from fieldgrid.documents import parse_json
from fieldgrid.errors import MapError

MAGIC = b"fieldgrid journal 1\n"
_RECORD = Struct("<4sII")
"""Of each record: a mark, the length of its JSON, the CRC-32 of that."""
_MARK = b"\xf1LIV"
MAX_RECORD_BYTES = 64 << 20
_SEARCHED_BYTES = 1 << 20
"""So much is read at a time to find the next record behind a damaged one."""
DAMAGED = "damaged"
MAX_WAITING_BYTES = 16 << 20
"""What waits in memory while the disk takes nothing: minutes of all sensors."""

Record = tuple[str, Any]
"""What a record is, and its value."""


class Journal(Closing):
    """A journal that is open to append to it, from any thread."""

    def __init__(self, path: Path) -> None:
        """Open a journal, or make it. MapError for another file, OSError where there can be
        none."""
        self._lock = threading.Lock()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._part = 0  # bytes of the first that waits which are written
        self._synced = True
        self.lost = 0
        """Records that no longer fitted into memory while the disk took nothing."""
        self._file: int | None = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            is_new = os.fstat(self._file).st_size < len(MAGIC)
            self._end = len(MAGIC)
            for self._end, _ in () if is_new else _scan(path):
                pass
            os.pwrite(self._file, MAGIC, 0)  # it may be damaged
            os.ftruncate(self._file, self._end)
        except BaseException:
            self.close()
            raise

    def append(self, kind: str, value: Any) -> bool:
        """Write a record behind the others; False while the disk does not take it: it waits in
        memory, up to a bound, and goes before those that follow."""
        body = json.dumps([kind, value], ensure_ascii=False, separators=(",", ":")).encode()
        record = _RECORD.pack(_MARK, len(body), zlib.crc32(body)) + body
        with self._lock:
            if self._waiting_bytes + len(record) > MAX_WAITING_BYTES:
                self.lost += 1
                return False
            self._waiting.append(record)
            self._waiting_bytes += len(record)
            return self._write()

    def waiting(self) -> list[Record]:
        """The records that the disk did not take yet, in order: they follow those of the file."""
        with self._lock:
            bodies = [record[_RECORD.size :] for record in self._waiting]
        return [record for body in bodies if (record := _record(body)) is not None]

    def _write(self) -> bool:
        """Write what waits; whole records, since a part of one counts as none."""
        if self._file is None:
            return False
        try:
            while self._waiting:
                record = self._waiting[0]
                written = os.pwrite(self._file, record[self._part :], self._end)
                self._end += written
                self._part += written
                self._synced = False
                if self._part == len(record):
                    self._waiting_bytes -= len(self._waiting.popleft())
                    self._part = 0
        except OSError:
            return False
        return True

    def sync(self) -> bool:
        """Return when all of it is on the disk; False where the disk does not take it."""
        with self._lock:
            if not self._write() or self._file is None:
                return False
            if self._synced:
                return True
            file, self._synced = os.dup(self._file), True
        try:
            os.fsync(file)
        except OSError:
            self._synced = False
            return False
        finally:
            os.close(file)
        return True

    def close(self) -> None:
        """Write what waits, if the disk takes it, and close the file."""
        with self._lock:
            if self._file is not None:
                self._write()
                os.close(self._file)
                self._file = None


def read_journal(path: Path) -> Iterator[Record]:
    """The records of a journal, in order, and `(DAMAGED, bytes)` for a stretch between or before
    them that cannot be read. MapError for another file."""
    for _, record in _scan(path):
        yield record


def _scan(path: Path) -> Iterator[tuple[int, Record]]:
    """Each whole record or stretch that is damaged, and where the next one goes."""
    with path.open("rb") as file:
        is_journal = file.read(len(MAGIC)) == MAGIC
        offset = len(MAGIC)
        while (found := _next_record(file, offset)) is not None:
            start, end, record = found
            if start > offset or not is_journal:
                yield start, (DAMAGED, start - offset if is_journal else start)
            is_journal = True
            offset = end
            yield offset, record
        if not is_journal:
            raise MapError(f"{path} is no journal of a live session. Check the name.")


def _next_record(file: BinaryIO, offset: int) -> tuple[int, int, Record] | None:
    """Where the first whole record from `offset` on begins and ends, and what it is; None where
    none follows."""
    while True:
        file.seek(offset)
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            return None
        mark, length, check = _RECORD.unpack(head)
        if mark == _MARK and length <= MAX_RECORD_BYTES:
            body = file.read(length)
            if len(body) == length and zlib.crc32(body) == check and (record := _record(body)):
                return offset, offset + _RECORD.size + length, record
        file.seek(offset + 1)
        searched = file.read(_SEARCHED_BYTES)
        at = searched.find(_MARK)
        # A mark may lie across the end of what was searched.
        offset += 1 + (at if at >= 0 else max(0, len(searched) - len(_MARK) + 1))


def _record(body: bytes) -> Record | None:
    try:
        kind, value = parse_json(body)
    except (ValueError, TypeError):
        return None
    return (kind, value) if isinstance(kind, str) else None
