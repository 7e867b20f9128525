"""Image files: decoded to grey, 8 bit, and refused before they can do harm."""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from fieldgrid.errors import RecordingError
from fieldgrid.recording.files import read_bytes
from fieldgrid.recording.protocol import Image

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm"})
"""File name endings of images that can be read, in lower case."""

MAX_PIXELS = 100_000_000
_MAX_FILE_BYTES = 8 * MAX_PIXELS
_PNM = re.compile(rb"P[2356](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")
# Frames of JPEG, progressive and others; C4, C8 and CC are no frames.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


@dataclass(frozen=True, slots=True)
class ImageFile:
    """An image in a file: PNG, JPEG, BMP, PGM or PPM of at most `max_pixels`."""

    path: Path
    max_pixels: int = MAX_PIXELS

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    def read(self) -> Image:
        """Grey, 8 bit, as stored: a rotation noted in the file is not applied.

        Colour becomes luma; of 16 bit the upper 8 are kept, the same in every image.
        """
        data = read_bytes(self.path, _MAX_FILE_BYTES)
        if not data:
            raise RecordingError(f"{self.path} is empty; record or copy it again.")
        header = _header(data)
        if header is None:
            raise RecordingError(
                f"{self.path} is no PNG, JPEG, BMP, PGM or PPM image; convert it, or restore it."
            )
        if header.width_px * header.height_px > self.max_pixels:
            raise RecordingError(
                f"{self.path} claims {header.width_px} x {header.height_px} px, more than "
                f"{self.max_pixels} in all; scale the images down."
            )
        image = _decode(data) if header.is_whole else None
        if image is None or image.shape != (header.height_px, header.width_px):
            raise RecordingError(f"{self.path} is truncated or damaged; copy it again.")
        return image

    def sha256(self) -> str:
        """The hash of the file."""
        return hashlib.sha256(read_bytes(self.path, _MAX_FILE_BYTES)).hexdigest()


class _Header(NamedTuple):
    width_px: int
    height_px: int
    is_whole: bool = True


def _decode(data: bytes) -> Image | None:
    # A calibration is for the pixels as stored, so no orientation tag may turn them.
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        return None
    return None if image is None else np.ascontiguousarray(image, dtype=np.uint8)


def _header(data: bytes) -> _Header | None:
    """Size of an image by its own header, None if it is no image that we read.

    The decoder would allocate whatever the header claims.
    """
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            width, height = struct.unpack(">II", data[16:24])
            return _Header(width, height)
        if data.startswith(b"\xff\xd8"):
            return _jpeg_header(data)
        if data.startswith(b"BM"):
            width, height = struct.unpack("<ii", data[18:26])
            return _Header(width, abs(height))
    except struct.error:
        return None
    match = _PNM.match(data)
    return None if match is None else _Header(int(match[1]), int(match[2]))


def _jpeg_header(data: bytes) -> _Header | None:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        kind = data[at + 1]
        if kind == 0xFF:  # padding
            at += 1
        elif kind in _JPEG_FRAMES:
            height, width = struct.unpack(">HH", data[at + 5 : at + 9])
            # Some decoders fill a cut JPEG with grey. In coded data FF is never followed by D9,
            # so the last FF D9 is the end of the image, or of a thumbnail before it.
            return _Header(width, height, data.rfind(b"\xff\xd9") > at)
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None
