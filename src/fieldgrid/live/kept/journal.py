"""A file that grows by whole records: what was pushed is there again after a kill.

Each record is a JSON value with its CRC-32. A record that was not written to its end is not in the
file; one that was damaged later is left out and reported, and those after it are found again.
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

from fieldgrid.core import Closing, MapError, parse_json

MAGIC = b"fieldgrid journal 1\n"
_RECORD = Struct("<4sII")
"""The head of each record: a mark, the length of its JSON, the CRC-32 of that."""
_MARK = b"\xf1LIV"
MAX_RECORD_BYTES = 64 << 20
_BEGINS = b'["'
"""The first bytes of each JSON."""
_SEARCHED_BYTES = 1 << 12
"""Number of bytes that are read at first to find the next mark; twice as many each time after."""
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
            # What is damaged stays, so that it is reported each time; what is torn goes.
            # A full disk may refuse to write even what is there already.
            if os.pread(self._file, len(MAGIC), 0) != MAGIC:
                os.pwrite(self._file, MAGIC, 0)
            if os.fstat(self._file).st_size > self._end:
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
    """The records of a journal, in order, and `(DAMAGED, bytes)` for a stretch before, between or
    behind them that cannot be read. A record at the end that was not written to its end is none.
    MapError for another file."""
    for _, record in _scan(path):
        yield record


def _scan(path: Path) -> Iterator[tuple[int, Record]]:
    """Each whole record or stretch that is damaged, and where the next one goes."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        magic = file.read(len(MAGIC))
        is_journal = magic == MAGIC or not any(magic)  # a power cut may leave zeros
        read_to = len(MAGIC) if magic == MAGIC else 0
        last = at = len(MAGIC)
        while at < size:
            record, end = _record_at(file, at, size)
            if record is None:
                last, at = at, _next_mark(file, at + 1, size)
                continue
            if at > read_to:
                yield at, (DAMAGED, at - read_to)
            is_journal = True
            last = at = read_to = end
            yield end, record
        if not is_journal:
            raise MapError(
                f"{path} is no journal of a live session. Check the name, or remove the file."
            )
        end = last if _is_torn(file, last, size) else size
        if end > read_to:
            yield end, (DAMAGED, end - read_to)


def _record_at(file: BinaryIO, at: int, size: int) -> tuple[Record | None, int]:
    """The whole record that begins there, and where it ends; None where there is none."""
    file.seek(at)
    head = file.read(_RECORD.size)
    if len(head) < _RECORD.size:
        return None, at
    mark, length, check = _RECORD.unpack(head)
    end = at + _RECORD.size + length
    if mark != _MARK or length > MAX_RECORD_BYTES or end > size:
        return None, at
    body = b""
    while len(body) < length:
        part = file.read(min(length - len(body), max(_SEARCHED_BYTES, len(body))))
        body += part
        # No JSON has a mark: a damaged length is noticed where the next record begins, so that no
        # byte is read for many records that are none.
        if not part or not body.startswith(_BEGINS) or _MARK in body:
            return None, at
    return (_record(body) if zlib.crc32(body) == check else None), end


def _next_mark(file: BinaryIO, at: int, size: int) -> int:
    """Where the next mark is from there on; the size where none follows."""
    searched_bytes = _SEARCHED_BYTES
    while at < size:
        file.seek(at)
        searched = file.read(searched_bytes)
        found = searched.find(_MARK)
        if found >= 0:
            return at + found
        if len(searched) < len(_MARK):
            break
        at += len(searched) - len(_MARK) + 1  # it may lie across the end of what was searched
        searched_bytes = min(2 * searched_bytes, 1 << 20)
    return size


def _is_torn(file: BinaryIO, at: int, size: int) -> bool:
    """Whether the file ends, from there on, with the first part of one record."""
    if size - at >= _RECORD.size + MAX_RECORD_BYTES:
        return False
    file.seek(at)
    head = file.read(_RECORD.size)
    if len(head) < _RECORD.size:
        return _MARK.startswith(head[: len(_MARK)])
    mark, length, _ = _RECORD.unpack(head)
    body = file.read(size - at - len(head))
    return (
        mark == _MARK
        and len(body) < length <= MAX_RECORD_BYTES
        and body.startswith(_BEGINS[: len(body)])
        and b"\0" not in body  # of what a power cut left unwritten
        and _record(body) is None  # its length is damaged
    )


def _record(body: bytes) -> Record | None:
    try:
        kind, value = parse_json(body)
    except (ValueError, TypeError):
        return None
    return (kind, value) if isinstance(kind, str) else None
