"""The time in the header of a serialised message, without reading the rest of it."""

from __future__ import annotations

import struct

_OFFSET = 4  # after the CDR encapsulation or the sequence number
_END = _OFFSET + 8


def stamp_ns(encoding: str, data: bytes | memoryview) -> int:
    """The stamp of the standard header that the message begins with; 0 where it is too short."""
    if len(data) < _END:
        return 0
    order = "<II" if encoding == "ros1" else "<iI" if data[1] & 1 else ">iI"
    seconds, nanoseconds = struct.unpack_from(order, data, _OFFSET)
    return int(seconds) * 10**9 + int(nanoseconds)
