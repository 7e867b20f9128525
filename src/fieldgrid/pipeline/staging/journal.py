"""A file that grows by whole records: what was written is there again after a kill.

A record is a JSON value, with its CRC-32, and blobs behind it, each with its own. A record that was
not written to its end is not in the file; one that was damaged later is left out and reported, and
those after it are found again.
"""

from __future__ import annotations

import json
import os
import threading
import zlib
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain, starmap
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO, NamedTuple

from fieldgrid.core import Closing, MapError, parse_json

MAGIC = b"fieldgrid journal 4\n"
_HEAD = Struct("<4sIII")
"""The head of each record: a mark, how long its JSON is and its blobs are, the CRC-32 of the JSON,
which begins with the latter."""
_MARK = b"\xf1LIV"
MAX_JSON_BYTES = 64 << 20
_BEGINS = b'["'
"""The first bytes of each JSON."""
_SEARCHED_BYTES = 1 << 12
"""Number of bytes that are read at first to find the next mark; twice as many each time after."""
DAMAGED = "damaged"
MAX_WAITING_BYTES = 16 << 20
"""What waits in memory while the disk takes nothing: minutes of all sensors."""


class Blob(NamedTuple):
    """Bytes behind a record: where they are in the file, and their CRC-32."""

    start: int
    size: int
    check: int


class JournalRecord(NamedTuple):
    """A record: what it is, its value, its blobs, and where it begins; that is -1 for one that
    still waits for the disk."""

    kind: str
    value: Any
    blobs: tuple[Blob, ...]
    start: int


class Journal(Closing):
    """A journal that is open to append to it, from any thread."""

    def __init__(self, path: Path) -> None:
        """Open a journal, or make it. MapError for another file, OSError where there can be
        none."""
        self._path = path
        self._lock = threading.Lock()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._part = 0  # bytes of the first that waits which are written
        self._synced = True
        self.lost = 0
        """Records that no longer fitted into memory while the disk took nothing."""
        self.problem = OSError("The journal is closed.")
        """Why the disk took nothing when it did so last."""
        self._file: int | None = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            self._end = len(MAGIC)
            for _, self._end, _ in _scan(path):
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

    def append(self, kind: str, value: Any, *blobs: bytes) -> bool:
        """Write a record behind the others; False while the disk does not take it. One without
        blobs waits in memory then, up to a bound, and goes before those that follow; one with blobs
        is not kept."""
        about = [[len(blob), zlib.crc32(blob)] for blob in blobs]
        said = [kind, value, *([about] if about else [])]
        body = json.dumps(said, ensure_ascii=False, separators=(",", ":")).encode()
        size = sum(map(len, blobs))
        record = _HEAD.pack(_MARK, len(body), size, zlib.crc32(body, size)) + body
        with self._lock:
            if not blobs and self._waiting_bytes + len(record) > MAX_WAITING_BYTES:
                self.lost += 1
                return False
            self._waiting.append(b"".join((record, *blobs)))
            self._waiting_bytes += len(self._waiting[-1])
            is_written = self._write()
            if blobs and not is_written:
                self._waiting_bytes -= len(self._waiting.pop())
                if not self._waiting and self._file is not None:
                    self._end -= self._part
                    self._part = 0
                    with suppress(OSError):
                        os.ftruncate(self._file, self._end)  # other records need the room
            return is_written

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
        except OSError as error:
            self.problem = error
            return False
        return True

    def records(self) -> Iterator[JournalRecord]:
        """The records in order, those that wait for the disk behind those of the file, and
        `DAMAGED`, with the number of bytes, for a stretch before, between or behind them that
        cannot be read. A record at the end that was not written to its end is none."""
        with self._lock:
            waiting = [(-1, -1, one[_HEAD.size :]) for one in self._waiting]
        return starmap(_record, chain(_scan(self._path), waiting))

    def at(self, start: int) -> JournalRecord | None:
        """The record that begins there; None where it is damaged."""
        assert self._file is not None, "the journal is closed"
        _, length, blobs, check = _HEAD.unpack(os.pread(self._file, _HEAD.size, start))
        body = os.pread(self._file, length, start + _HEAD.size)
        return _record(start, start, body) if zlib.crc32(body, blobs) == check else None

    def read(self, blob: Blob) -> bytes | None:
        """What a blob holds; None where it is damaged."""
        assert self._file is not None, "the journal is closed"
        data = os.pread(self._file, blob.size, blob.start)
        return data if zlib.crc32(data) == blob.check else None

    def waits(self) -> int:
        """The number of records that the disk did not take yet."""
        return len(self._waiting)

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


def read_journal(path: Path) -> Iterator[JournalRecord]:
    """The records of a journal that need not be open, as `Journal.records`. MapError for another
    file."""
    return starmap(_record, _scan(path))


def _record(start: int, end: int, body: bytes) -> JournalRecord:
    """The record of a JSON that is whole; `DAMAGED` of none, or of what no record begins with."""
    try:
        kind, value, *about = parse_json(body)
        blobs, at = list[Blob](), start + _HEAD.size + len(body)
        for size, check in about[0] if about else ():
            blobs.append(Blob(at, size, check))
            at += size
        return JournalRecord(str(kind), value, tuple(blobs), start)
    except (ValueError, TypeError):
        return JournalRecord(DAMAGED, end - start, (), start)


def _scan(path: Path) -> Iterator[tuple[int, int, bytes]]:
    """Where each whole record begins and ends, and its JSON, empty of a stretch that is damaged."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        magic = file.read(len(MAGIC))
        if len(magic) == len(MAGIC) and magic != MAGIC and magic.startswith(MAGIC[:-2]):
            raise MapError(
                f"{path} is the journal of a drive of another version of this program; finish the "
                "drive with that version, or remove the file."
            )
        if magic != MAGIC[: len(magic)] and any(magic):  # a power cut may leave zeros
            raise MapError(f"{path} is no journal of a drive. Check the name, or remove the file.")
        at, read_to, whole_to = len(MAGIC), len(MAGIC), size
        while at < size:
            body, end = _body_at(file, at, size)
            if body is None:
                if whole_to == size and _is_torn(file, at, size):
                    whole_to = at
                at = _next_mark(file, at + 1, size)
                continue
            if at > read_to:
                yield read_to, at, b""
            yield at, end, body
            at, read_to, whole_to = end, end, size
        if read_to < whole_to:
            yield read_to, whole_to, b""


def _body_at(file: BinaryIO, at: int, size: int) -> tuple[bytes | None, int]:
    """The JSON of the whole record that begins there, and where that ends; None where there is
    none."""
    file.seek(at)
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None, at
    mark, length, blobs, check = _HEAD.unpack(head)
    end = at + _HEAD.size + length + blobs
    if mark != _MARK or length > MAX_JSON_BYTES or end > size:
        return None, at
    body = b""
    while len(body) < length:
        part = file.read(min(length - len(body), max(_SEARCHED_BYTES, len(body))))
        body += part
        # No JSON has a mark: a damaged length is noticed where the next record begins, so that no
        # byte is read for many records that are none.
        if not part or not body.startswith(_BEGINS) or _MARK in body:
            return None, at
    return (body if zlib.crc32(body, blobs) == check else None), end


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
    file.seek(at)
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return _MARK.startswith(head[: len(_MARK)])
    mark, length, blobs, _ = _HEAD.unpack(head)
    end = at + len(head) + int(length) + int(blobs)
    return bool(mark == _MARK) and length <= MAX_JSON_BYTES and end > size
