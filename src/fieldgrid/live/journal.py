"""A file that grows by whole records: what was pushed is there again after a kill.

Each record is a JSON value with its CRC-32. A record that was not written to its end is not in the
file; one that was damaged later is left out, and those after it are found again.
"""

from __future__ import annotations

import json
import os
import threading
import zlib
from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from typing import Any

from fieldgrid.closing import Closing
from fieldgrid.documents import parse_json
from fieldgrid.errors import MapError

MAGIC = b"fieldgrid journal 1\n"
_RECORD = Struct("<4sII")
"""Of each record: a mark, the length of its JSON, the CRC-32 of that."""
_MARK = b"\xf1LIV"
MAX_RECORD_BYTES = 64 << 20
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
        self._waiting = bytearray()
        self._synced = True
        self.lost = 0
        """Records that no longer fitted into memory while the disk took nothing."""
        self._file: int | None = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if os.fstat(self._file).st_size < len(MAGIC):
                os.pwrite(self._file, MAGIC, 0)
            self._end = len(MAGIC)
            for self._end, _ in _scan(path):
                pass
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
            if len(self._waiting) + len(record) > MAX_WAITING_BYTES:
                self.lost += 1
                return False
            self._waiting += record
            return self._write()

    def _write(self) -> bool:
        """Write what waits; whole records, since a part of one counts as none."""
        if self._file is None:
            return False
        try:
            while self._waiting:
                written = os.pwrite(self._file, self._waiting, self._end)
                self._end += written
                del self._waiting[:written]
                self._synced = False
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
    """The records of a journal, in order. MapError for another file."""
    for _, record in _scan(path):
        yield record


def _scan(path: Path) -> Iterator[tuple[int, Record]]:
    """Each whole record, and where the next one goes."""
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise MapError(f"{path} is no journal of a live session. Check the name.")
        offset = len(MAGIC)
        while True:
            file.seek(offset)
            head = file.read(_RECORD.size)
            if len(head) < _RECORD.size:
                return
            mark, length, check = _RECORD.unpack(head)
            body = file.read(length) if mark == _MARK and length <= MAX_RECORD_BYTES else b""
            record = _record(body) if len(body) == length and zlib.crc32(body) == check else None
            if record is not None:
                offset += _RECORD.size + length
                yield offset, record
                continue
            file.seek(offset + 1)
            found = _next_mark(file.read(MAX_RECORD_BYTES))
            if found is None:
                return
            offset += 1 + found


def _next_mark(data: bytes) -> int | None:
    """Where the next record that is whole begins."""
    at = data.find(_MARK)
    while at >= 0:
        if at + _RECORD.size <= len(data):
            _, length, check = _RECORD.unpack_from(data, at)
            body = data[at + _RECORD.size : at + _RECORD.size + length]
            if len(body) == length and zlib.crc32(body) == check:
                return at
        at = data.find(_MARK, at + 1)
    return None


def _record(body: bytes) -> Record | None:
    try:
        kind, value = parse_json(body)
    except (ValueError, TypeError):
        return None
    return (kind, value) if isinstance(kind, str) else None
