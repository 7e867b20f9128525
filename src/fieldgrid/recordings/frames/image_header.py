"""What an image file says of itself, before a decoder believes it and allocates."""

from __future__ import annotations

import re
import struct
from collections.abc import Collection
from typing import NamedTuple

_PNM = re.compile(
    rb"P[2356](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s"
)
# Frames of JPEG, progressive and others; C4, C8 and CC are no frames.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _OFFSETS, _LENGTHS = 256, 257, 258, 259, 273, 279
_TIFF_TAGS = frozenset({_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _OFFSETS, _LENGTHS})
_TIFF_KINDS = {3: "H", 4: "I"}  # SHORT and LONG
_TIFF_COMPRESSIONS = frozenset({1, 5, 8, 32773, 32946})  # none, LZW, deflate, PackBits, deflate
_TIFF_MAX_STRIPS = 100_000
_MOST_PARTS = 500_000
"""No PNG or JPEG is made of so many; what claims more is not looked at to its end."""
_MAX_PNM_HEADER = 1 << 16


class ImageHeader(NamedTuple):
    """Size, whether a value of a pixel has 16 bits, and whether the end of the file is there, as
    far as can be seen without decoding."""

    width_px: int
    height_px: int
    is_deep: bool = False
    is_whole: bool = True


def read_header(data: bytes, tiff_bits: Collection[int] = (8, 16)) -> ImageHeader | None:
    """What an image says of itself, None if it is no image that we read; of TIFFs those with
    `tiff_bits` in a value."""
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            width, height, depth = struct.unpack(">IIB", data[16:25])
            # Whether all chunks are there: a decoder makes room for what they claim.
            at, kind = 8, b""
            for _ in range(_MOST_PARTS):
                if kind == b"IEND" or at + 12 > len(data):
                    break
                kind = data[at + 4 : at + 8]
                at += 12 + int.from_bytes(data[at : at + 4], "big")
            return ImageHeader(width, height, depth == 16, kind == b"IEND" and at <= len(data))
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data.startswith(b"BM"):
            width, height = struct.unpack("<ii", data[18:26])
            return ImageHeader(width, abs(height)) if width >= 0 else None
        if data.startswith((b"II*\0", b"MM\0*")):
            return _tiff(data, tiff_bits)
    except struct.error:
        return None
    match = _PNM.match(data[:_MAX_PNM_HEADER])
    return None if match is None else ImageHeader(int(match[1]), int(match[2]), int(match[3]) > 255)


def _tiff(data: bytes, bits: Collection[int]) -> ImageHeader | None:
    """The first image of a TIFF, if it is of the plain kind that cameras write: in strips, with
    one of these numbers of bits. Others can ask a decoder for anything."""
    order = "<" if data.startswith(b"II") else ">"
    (at,) = struct.unpack(f"{order}I", data[4:8])
    (count,) = struct.unpack(f"{order}H", data[at : at + 2])
    tags: dict[int, tuple[int, ...]] = {}
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind, length, start = struct.unpack_from(f"{order}HHII", data, entry)
        code = _TIFF_KINDS.get(kind, "")
        if tag in _TIFF_TAGS - tags.keys() and code and 1 <= length <= _TIFF_MAX_STRIPS:
            numbers = struct.Struct(f"{order}{length}{code}")
            tags[tag] = numbers.unpack_from(data, entry + 8 if numbers.size <= 4 else start)
    if not tags.keys() >= {_WIDTH, _HEIGHT, _OFFSETS, _LENGTHS}:
        return None
    (compression, *_), depths = tags.get(_COMPRESSION, (1,)), set(tags.get(_BITS, (1,)))
    if compression not in _TIFF_COMPRESSIONS or len(depths) != 1 or not depths <= set(bits):
        return None
    ends = [start + size for start, size in zip(tags[_OFFSETS], tags[_LENGTHS], strict=False)]
    return ImageHeader(tags[_WIDTH][0], tags[_HEIGHT][0], depths == {16}, max(ends) <= len(data))


def _jpeg(data: bytes) -> ImageHeader | None:
    at = 2
    for _ in range(_MOST_PARTS):
        if at + 9 > len(data) or data[at] != 0xFF:
            break
        kind = data[at + 1]
        if kind == 0xFF:  # padding
            at += 1
        elif kind in _JPEG_FRAMES:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            # Some decoders fill a cut JPEG with grey. In coded data FF is never followed by D9,
            # so the last FF D9 is the end of the image, or of a thumbnail before it.
            return ImageHeader(width, height, is_whole=data.rfind(b"\xff\xd9") > at)
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None
