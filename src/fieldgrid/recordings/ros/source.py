"""A file that is read from its start to its end, and may be cut off, damaged or hostile."""

from __future__ import annotations

import bz2
import os
import re
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Protocol

import lz4.frame

from fieldgrid.core import Closing, RecordingError, UnfoldBudget, limits

_STEP_BYTES = 1 << 22
_SEARCH_BYTES = 1 << 20
_MAX_SEARCHED_BYTES = 1 << 30
_MAX_WRONG = 10_000
_MAX_WINDOW_BYTES = 1 << 27


class Torn(Exception):  # noqa: N818 - a way of ending, not an error of the caller
    """The file ends, or stops to make sense, before what was to be read."""


class BadChunkError(Exception):
    """The records within a chunk make no sense."""


class BoundedFile(Closing):
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

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def left(self) -> int:
        """Bytes from here to the end of the file."""
        return self.size - self.offset

    def take(self, count: int) -> bytes:
        """The next `count` bytes; raises Torn if the file has fewer, or `count` is absurd."""
        if count > self.left or count > limits().piece_bytes:
            raise Torn
        return self.rest(count)

    def rest(self, count: int) -> bytes:
        """The next `count` bytes, or fewer where the file ends."""
        wanted = min(count, self.left, limits().piece_bytes)
        try:
            data = self._file.read(wanted)
        except OSError as error:  # a bad block of the disk
            raise Torn from error
        self.offset += len(data)
        if len(data) < wanted:  # cut off meanwhile
            raise Torn
        return data

    def skip(self, count: int) -> None:
        """Pass over the next `count` bytes; raises Torn if the file has fewer."""
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

        Gives up after many that are not, and after a gigabyte: they are there to cost time.
        """
        wrong, stop = 0, min(self.size, start + _MAX_SEARCHED_BYTES)
        while start < stop and wrong < _MAX_WRONG:
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


class _Unpacker(Protocol):
    @property
    def eof(self) -> bool: ...

    def decompress(self, data: bytes, max_length: int, /) -> bytes: ...


class _UnpackedStream:
    """A stream from an object that unpacks bit by bit."""

    def __init__(self, unpacker: _Unpacker, data: bytes) -> None:
        self._unpacker, self._data = unpacker, data

    def read(self, size: int) -> bytes:
        if self._unpacker.eof:
            return b""
        data, self._data = self._data, b""
        return bytes(self._unpacker.decompress(data, size))


def _zstd(source: bytes | BinaryIO) -> _Stream:
    import zstandard

    reader = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
    return reader.stream_reader(BytesIO(source) if isinstance(source, bytes) else source)


_CODECS: dict[str, Callable[[bytes], _Stream]] = {
    "bz2": lambda data: _UnpackedStream(bz2.BZ2Decompressor(), data),
    "lz4": lambda data: _UnpackedStream(lz4.frame.LZ4FrameDecompressor(), data),
    "zstd": _zstd,
}
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
UNCOMPRESSED = {"", "none"}
COMPRESSIONS = UNCOMPRESSED | set(_CODECS)


def inflate(data: bytes, compression: str, most: int) -> bytes:
    """What compressed data hold, up to `most` bytes and as far as they are whole.

    Memory grows with what really comes out, whatever the data claim. `compression` is one of
    `COMPRESSIONS`.
    """
    if compression in UNCOMPRESSED:
        return data[:most]
    import zstandard

    stream = _CODECS[compression](data)
    found = bytearray()
    while len(found) < most:
        try:
            piece = stream.read(min(most - len(found), _STEP_BYTES))
        # The first errors are of bz2 and of lz4.
        except (OSError, EOFError, RuntimeError, ValueError, MemoryError, zstandard.ZstdError):
            break
        if not piece:
            break
        if not found and len(piece) == most:
            return piece
        found += piece
    return bytes(found)


def unpacked_pieces(packed: BinaryIO, budget: UnfoldBudget) -> Iterator[bytes]:
    """What a file compressed by zstd holds, piece by piece. Raises EOFError where it is damaged,
    and LimitError beyond the budget."""
    import zstandard

    stream = _zstd(packed)
    try:
        while piece := stream.read(_STEP_BYTES):
            budget.spend(len(piece))
            yield piece
    except zstandard.ZstdError as error:
        raise EOFError(str(error)) from error
