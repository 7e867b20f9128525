"""A file that is read from its start to its end, and may be cut off, damaged or hostile."""

from __future__ import annotations

import bz2
import os
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame

from fieldgrid.core import Closing, limits

_STEP_BYTES = 1 << 20
_SEARCH_BYTES = 1 << 20
_MAX_WRONG = 10_000
_WIDEST_MATCH = 64
_MAX_WINDOW_BYTES = 1 << 27


class Torn(Exception):  # noqa: N818 - a way of ending, not an error of the caller
    """The file ends, or stops to make sense, before what was to be read."""


class BoundedFile(Closing):
    """A file open for reading, which gives no byte beyond its end and none unasked."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
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
        wanted = min(count, self.left)
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

    def find(self, pattern: re.Pattern[bytes], start: int, is_right: Callable[[], bool]) -> bool:
        """Go to the next match of `pattern` that is right, as is asked there.

        Gives up after many that are not: they are there to cost time.
        """
        wrong = 0
        while start < self.size and wrong < _MAX_WRONG:
            self.go(start)
            block = self.rest(_SEARCH_BYTES + _WIDEST_MATCH)
            for match in pattern.finditer(block):
                place = start + match.start()
                self.go(place)
                if match.start() < _SEARCH_BYTES and is_right():
                    self.go(place)
                    return True
                wrong += 1
            start += _SEARCH_BYTES
        return False


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def _unzstd(packed: BinaryIO) -> Any:
    import zstandard

    return zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES).stream_reader(packed)


_UNPACKERS: dict[str, Callable[[BinaryIO], Any]] = {
    "bz2": bz2.open,
    "lz4": lz4.frame.open,
    "zstd": _unzstd,
}
COMPRESSIONS = {"", "none", *_UNPACKERS}


def unpacked_pieces(packed: BinaryIO, compression: str) -> Iterator[bytes]:
    """What compressed data hold, piece by piece. Raises EOFError where they are damaged."""
    import zstandard

    try:
        stream = _UNPACKERS[compression](packed)
        while piece := stream.read1(_STEP_BYTES):
            yield piece
    # The first errors are of bz2 and of lz4.
    except (OSError, EOFError, RuntimeError, ValueError, MemoryError, zstandard.ZstdError) as error:
        raise EOFError(str(error)) from error


def inflate(data: bytes, compression: str, most: int) -> bytes | bytearray:
    """What compressed data hold, up to `most` bytes and as far as they are whole.

    Memory grows with what really comes out, whatever the data claim. `compression` is one of
    `COMPRESSIONS`.
    """
    if compression not in _UNPACKERS:
        return data[:most]
    found = bytearray()
    with suppress(EOFError):
        for piece in unpacked_pieces(BytesIO(data), compression):
            found += piece
            if len(found) >= most:
                break
    del found[most:]
    return found
