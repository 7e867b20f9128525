"""Pixels as cameras deliver them to grey, 8 bit: the one way for files and messages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple, cast

import cv2
import numpy as np
import numpy.typing as npt

from fieldgrid.core import RecordingError, quoted
from fieldgrid.recordings.frames.frames import Image

Pixels = npt.NDArray[np.uint8 | np.uint16]
"""Values [row, column] or [row, column, channel] in the machine's byte order."""

BAYER_PATTERNS = ("rggb", "bggr", "gbrg", "grbg")
"""The colours of the first two pixels of the first row, then of the second."""

BITS = range(8, 17)
"""How many bits of 16 a camera can fill."""


class PixelLayout(NamedTuple):
    """How an encoding stores a pixel: `channels` numbers of `dtype`; what OpenCV calls the way to
    its luma, or which of the numbers is the luma, if not the only one."""

    dtype: npt.DTypeLike
    channels: int
    code: int | None = None
    luma: int | None = None


# OpenCV names a mosaic by the second and third pixel of the second and third row.
_BAYER_CODES = {
    "rggb": cv2.COLOR_BayerBG2GRAY,
    "bggr": cv2.COLOR_BayerRG2GRAY,
    "gbrg": cv2.COLOR_BayerGR2GRAY,
    "grbg": cv2.COLOR_BayerGB2GRAY,
}
_DEPTHS = {"8": np.uint8, "16": np.uint16}
_LAYOUTS = {
    **{f"mono{bits}": PixelLayout(dtype, 1) for bits, dtype in _DEPTHS.items()},
    **{f"{bits}UC1": PixelLayout(dtype, 1) for bits, dtype in _DEPTHS.items()},
    **{
        f"{name}{bits}": PixelLayout(dtype, channels, code)
        for name, channels, code in (
            ("bgr", 3, cv2.COLOR_BGR2GRAY),
            ("rgb", 3, cv2.COLOR_RGB2GRAY),
            ("bgra", 4, cv2.COLOR_BGRA2GRAY),
            ("rgba", 4, cv2.COLOR_RGBA2GRAY),
            *((f"bayer_{pattern}", 1, code) for pattern, code in _BAYER_CODES.items()),
        )
        for bits, dtype in _DEPTHS.items()
    },
    "8UC3": PixelLayout(np.uint8, 3, cv2.COLOR_BGR2GRAY),
    "8UC4": PixelLayout(np.uint8, 4, cv2.COLOR_BGRA2GRAY),
    # Every pixel has its own luma; the chroma beside it is shared by two.
    **dict.fromkeys(("yuv422", "uyvy"), PixelLayout(np.uint8, 2, luma=1)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), PixelLayout(np.uint8, 2, luma=0)),
}


def layout(encoding: str) -> PixelLayout:
    """How an encoding by ROS's name stores a pixel; RecordingError for one that is unknown."""
    found = _LAYOUTS.get(encoding)
    if found is None:
        raise RecordingError(
            f"Images are encoded as {quoted(encoding)}, which is not read; record them as mono8, "
            "bgr8, rgb8, mono16, a bayer_ or a yuv422 encoding."
        )
    return found


def to_grey(pixels: Pixels, encoding: str, bits: int = 16) -> Image:
    """Grey, 8 bit, of pixels in an encoding by ROS's name.

    `pixels` has the dtype and the channels of :func:`layout`. Colour becomes luma, as by
    OpenCV's BGR2GRAY. Of 16-bit pixels the camera fills the lower `bits`; the upper 8 of those
    are kept, the same in every image, and what is brighter than they can say is 255.
    Raises RecordingError for an unknown encoding, or pixels that are not laid out by it.
    """
    wanted = layout(encoding)
    shape = pixels.shape[:2] if wanted.channels == 1 else (*pixels.shape[:2], wanted.channels)
    if pixels.ndim < 2 or pixels.shape != shape or pixels.dtype != wanted.dtype or 0 in shape:
        raise RecordingError(
            f"An image encoded as {encoding} has pixels {pixels.dtype} of shape {pixels.shape}; "
            "record it again, or correct its encoding."
        )
    if encoding.startswith("bayer_") and min(shape) < 3:
        raise RecordingError(
            f"A Bayer mosaic of {shape[1]} x {shape[0]} px is no image; record it again."
        )
    grey = np.ascontiguousarray(pixels if wanted.luma is None else pixels[..., wanted.luma])
    if wanted.code is not None:
        grey = cast(Pixels, cv2.cvtColor(grey, wanted.code))
    upper = np.minimum(grey >> (bits - 8), 255) if grey.dtype == np.uint16 else grey
    return np.asarray(upper, dtype=np.uint8)


def significant_bits(samples: Iterable[Pixels]) -> int:
    """How many of 16 bits a camera fills, by some of its images: 8, 10, 12, 14 or 16.

    It is to be asked once a recording: a scale that changed with the image would make a wall's
    brightness depend on what else is in sight.
    """
    brightest = max((int(sample.max(initial=0)) for sample in samples), default=0)
    if brightest == 0:  # nothing was seen
        return BITS[-1]
    return max(BITS[0], 2 * math.ceil(brightest.bit_length() / 2))
