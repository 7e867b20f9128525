"""Image files: decoded to grey, 8 bit, and refused before they can do harm."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple, cast

import cv2
import numpy as np

from fieldgrid.core import RecordingError
from fieldgrid.recordings.files import RecordedFile
from fieldgrid.recordings.frames.frames import Image
from fieldgrid.recordings.frames.image_header import ImageHeader, read_header
from fieldgrid.recordings.frames.pixels import BITS, Pixels, to_grey

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".tif", ".tiff"})
"""File name endings of images that can be read, in lower case."""

MAX_PIXELS = 100_000_000
_KINDS = {1: "mono", 3: "bgr", 4: "bgra"}
"""What ROS calls pixels of so many channels."""


class ImageFormat(NamedTuple):
    """What image files do not say of themselves: the colours of a Bayer mosaic, of the first two
    rows (like "rggb", None for none), and how many of 16 bits the camera fills."""

    bayer: str | None = None
    bits: int = BITS[-1]


AS_STORED = ImageFormat()
"""No mosaic, and all bits filled."""


@dataclass(frozen=True, slots=True)
class ImageFile(RecordedFile):
    """An image in a file: PNG, JPEG, BMP, PGM, PPM or TIFF of at most `max_pixels`."""

    max_pixels: int = MAX_PIXELS
    format: ImageFormat = AS_STORED

    def read(self) -> Image:
        """Grey, 8 bit, as stored: a rotation noted in the file is not applied."""
        return decode_image(self.data(), self.name, self.max_pixels, self.format)

    def encoded(self) -> bytes:
        """The file, if it is a JPEG or PNG and nothing is to be told beside it; else empty."""
        return self_contained(self.data()) if self.format == AS_STORED else b""

    def size_px(self) -> tuple[int, int]:
        """(width, height) by the file's own header."""
        return checked_header(self.data(), self.name, self.max_pixels)[:2]

    def is_whole(self) -> bool:
        """Whether the end of a PNG, JPEG or TIFF is there, as far as can be seen without decoding;
        not before its beginning is."""
        header = read_header(self.data())
        return header is not None and header.is_whole

    def deep_pixels(self) -> Pixels | None:
        """The pixels as stored if their values have 16 bits, else None."""
        data = self.data()
        header = checked_header(data, self.name, self.max_pixels)
        return stored_pixels(data, header, self.name) if header.is_deep else None


def self_contained(data: bytes) -> bytes:
    """Image data that are a JPEG or a PNG; empty for others."""
    return data if data.startswith((b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")) else b""


def decode_image(
    data: bytes, name: str, max_pixels: int = MAX_PIXELS, image_format: ImageFormat = AS_STORED
) -> Image:
    """Grey, 8 bit, of an encoded image as stored; `name` is what errors call it.

    Colour becomes luma, a Bayer mosaic too; of 16 bit the upper 8 of those that the format says
    to be filled are kept, the same in every image.
    """
    header = checked_header(data, name, max_pixels)
    if image_format.bayer is None and not header.is_deep:
        grey = stored_pixels(data, header, name, cv2.IMREAD_GRAYSCALE)
        return np.ascontiguousarray(grey, dtype=np.uint8)
    pixels = stored_pixels(data, header, name)
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if image_format.bayer is not None and channels != 1:
        raise RecordingError(
            f"{name} is a colour image, and recording.toml says that images are a Bayer mosaic; "
            "leave bayer out."
        )
    kind = f"bayer_{image_format.bayer}" if image_format.bayer else _KINDS[channels]
    return to_grey(pixels, f"{kind}{8 * pixels.itemsize}", image_format.bits)


def checked_header(
    data: bytes, name: str, max_pixels: int = MAX_PIXELS, tiff_bits: Collection[int] = (8, 16)
) -> ImageHeader:
    """What an image says of itself, once it is sure that such an image can be."""
    if not data:
        raise RecordingError(f"{name} is empty; record or copy it again.")
    header = read_header(data, tiff_bits)
    if header is None:
        raise RecordingError(
            f"{name} is no PNG, JPEG, BMP, PGM, PPM or plain TIFF image; convert it, or restore it."
        )
    if header.width_px * header.height_px > max_pixels:
        raise RecordingError(
            f"{name} claims {header.width_px} x {header.height_px} px, more than "
            f"{max_pixels} in all; scale the images down."
        )
    return header


def stored_pixels(
    data: bytes, header: ImageHeader, name: str, flags: int = cv2.IMREAD_UNCHANGED
) -> Pixels:
    """The pixels of an image that the header is of; RecordingError where they are not all there."""
    pixels: Pixels | None = None
    if header.is_whole:
        # A calibration is for the pixels as stored, so no orientation tag may turn them.
        flags |= cv2.IMREAD_IGNORE_ORIENTATION
        with suppress(cv2.error):
            pixels = cast(Pixels, cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags))
    if pixels is None or pixels.shape[:2] != (header.height_px, header.width_px):
        raise RecordingError(f"{name} is truncated or damaged; copy it again.")
    return pixels
