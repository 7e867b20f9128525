"""The time in the header of a serialised message, without reading the rest of it."""

from __future__ import annotations

import struct

_LITTLE = struct.Struct("<iI")
_BIG = struct.Struct(">iI")
_ROS1 = struct.Struct("<II")
_OFFSET = 4  # after the CDR encapsulation or the sequence number
_END = _OFFSET + 8


def stamp_ns(encoding: str, data: bytes | memoryview) -> int:
    """The stamp of the standard header that the message begins with; 0 where it is too short."""
    if len(data) < _END:
        return 0
    if encoding == "ros1":
        unpack = _ROS1
    else:
        unpack = _LITTLE if data[1] & 1 else _BIG
    seconds, nanoseconds = unpack.unpack_from(data, _OFFSET)
    return int(seconds) * 10**9 + int(nanoseconds)
