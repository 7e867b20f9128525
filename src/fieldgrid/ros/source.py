"""A file that is read from its start to its end, and may be cut off, damaged or hostile."""

from __future__ import annotations

import bz2
import os
import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Protocol

from fieldgrid.errors import RecordingError

MAX_RECORD_BYTES = 1 << 30
"""No record, chunk or message beyond this is read: images and clouds are far smaller."""

_STEP_BYTES = 1 << 22
_SEARCH_BYTES = 1 << 20
_MAX_WRONG = 10_000


class Torn(Exception):  # noqa: N818 - a way of ending, not an error of the caller
    """The file ends, or stops to make sense, before what was to be read."""


class BadChunkError(Exception):
    """The records within a chunk make no sense."""


class Source:
    """A file open for reading, which gives no byte beyond its end and none unasked."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise RecordingError(
                f"{path} cannot be opened ({error.strerror}); check its permissions."
            ) from error
        self.size = os.fstat(self._file.fileno()).st_size
        self.offset = 0

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @property
    def left(self) -> int:
        """Bytes from here to the end of the file."""
        return self.size - self.offset

    def take(self, count: int) -> bytes:
        """The next `count` bytes; raises Torn where the file has not so many, or that is absurd."""
        if count > self.left or count > MAX_RECORD_BYTES:
            raise Torn
        return self.rest(count)

    def rest(self, count: int) -> bytes:
        """The next `count` bytes, or fewer where the file ends."""
        wanted = min(count, self.left, MAX_RECORD_BYTES)
        try:
            data = self._file.read(wanted)
        except OSError as error:  # a bad block of the disk
            raise Torn from error
        self.offset += len(data)
        if len(data) < wanted:  # cut off meanwhile
            raise Torn
        return data

    def skip(self, count: int) -> None:
        """Pass over the next `count` bytes; raises Torn where the file has not so many."""
        if count > self.left:
            raise Torn
        self.go(self.offset + count)

    def go(self, offset: int) -> None:
        """Continue at this offset."""
        self._file.seek(offset)
        self.offset = offset

    def find(
        self, pattern: re.Pattern[bytes], start: int, is_right: Callable[[int], bool], width: int
    ) -> bool:
        """Go to the next match of `pattern` (at most `width` bytes wide) that is right.

        Gives up after many that are not: they are there to cost time.
        """
        wrong = 0
        while start < self.size and wrong < _MAX_WRONG:
            self.go(start)
            block = self.rest(_SEARCH_BYTES + width)
            for match in pattern.finditer(block):
                if match.start() < _SEARCH_BYTES and is_right(start + match.start()):
                    self.go(start + match.start())
                    return True
                wrong += 1
            start += _SEARCH_BYTES
        return False


class _Stream(Protocol):
    def read(self, size: int, /) -> bytes: ...


class _Bz2:
    def __init__(self, data: bytes) -> None:
        self._inner = bz2.BZ2Decompressor()
        self._data = data

    def read(self, size: int) -> bytes:
        if self._inner.eof:
            return b""
        data, self._data = self._data, b""
        return self._inner.decompress(data, size)


class _Lz4:
    def __init__(self, data: bytes) -> None:
        import lz4.frame

        self._inner = lz4.frame.LZ4FrameDecompressor()
        self._data = data

    def read(self, size: int) -> bytes:
        if self._inner.eof:
            return b""
        data, self._data = self._data, b""
        return bytes(self._inner.decompress(data, size))


def _zstd(data: bytes) -> _Stream:
    import zstandard

    return zstandard.ZstdDecompressor().stream_reader(BytesIO(data))


_CODECS: dict[str, Callable[[bytes], _Stream]] = {"bz2": _Bz2, "lz4": _Lz4, "zstd": _zstd}
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
UNCOMPRESSED = {"", "none"}
COMPRESSIONS = UNCOMPRESSED | set(_CODECS)


def inflate(data: bytes, compression: str, most: int = MAX_RECORD_BYTES) -> bytes:
    """What compressed data hold, up to `most` bytes and as far as they are whole.

    Memory grows with what really comes out, whatever the data claim. `compression` is one of
    `COMPRESSIONS`.
    """
    if compression in UNCOMPRESSED:
        return data[:most]
    import zstandard

    stream = _CODECS[compression](data)
    pieces = []
    missing = min(most, MAX_RECORD_BYTES)
    # The first errors are of bz2 and of lz4.
    while missing > 0:
        try:
            piece = stream.read(min(missing, _STEP_BYTES))
        except (OSError, EOFError, RuntimeError, ValueError, zstandard.ZstdError):
            break
        if not piece:
            break
        pieces.append(piece)
        missing -= len(piece)
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)
