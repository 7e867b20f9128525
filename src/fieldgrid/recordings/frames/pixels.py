"""Pixels as cameras deliver them to grey, 8 bit: the one way for files and messages."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple, cast

import cv2
import numpy as np
import numpy.typing as npt

from fieldgrid.core import RecordingError
from fieldgrid.recordings.frames.frames import Image

Pixels = npt.NDArray[np.uint8 | np.uint16]
"""Values [row, column] or [row, column, channel] in the machine's byte order."""

BAYER_PATTERNS = ("rggb", "bggr", "gbrg", "grbg")
"""The colours of the first two pixels of the first row, then of the second."""

BITS = range(8, 17)
"""How many bits of 16 a camera can fill."""


class PixelLayout(NamedTuple):
    """How an encoding stores a pixel: `channels` numbers of `dtype`."""

    dtype: npt.DTypeLike
    channels: int


# Which of a pixel's two bytes is its luma.
_YUV = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}

_LAYOUTS = {
    **dict.fromkeys(("mono8", "8UC1"), PixelLayout(np.uint8, 1)),
    **dict.fromkeys(("mono16", "16UC1"), PixelLayout(np.uint16, 1)),
    **dict.fromkeys(("bgr8", "rgb8", "8UC3"), PixelLayout(np.uint8, 3)),
    **dict.fromkeys(("bgra8", "rgba8", "8UC4"), PixelLayout(np.uint8, 4)),
    **dict.fromkeys(("bgr16", "rgb16"), PixelLayout(np.uint16, 3)),
    **dict.fromkeys(("bgra16", "rgba16"), PixelLayout(np.uint16, 4)),
    **{f"bayer_{pattern}8": PixelLayout(np.uint8, 1) for pattern in BAYER_PATTERNS},
    **{f"bayer_{pattern}16": PixelLayout(np.uint16, 1) for pattern in BAYER_PATTERNS},
    **dict.fromkeys(_YUV, PixelLayout(np.uint8, 2)),
}
# OpenCV names a mosaic by the second and third pixel of the second and third row.
_BAYER_CODES = {
    "rggb": cv2.COLOR_BayerBG2GRAY,
    "bggr": cv2.COLOR_BayerRG2GRAY,
    "gbrg": cv2.COLOR_BayerGR2GRAY,
    "grbg": cv2.COLOR_BayerGB2GRAY,
}
_COLOUR_CODES = {
    **{"bgr": cv2.COLOR_BGR2GRAY, "rgb": cv2.COLOR_RGB2GRAY, "8UC3": cv2.COLOR_BGR2GRAY},
    **{"bgra": cv2.COLOR_BGRA2GRAY, "rgba": cv2.COLOR_RGBA2GRAY, "8UC4": cv2.COLOR_BGRA2GRAY},
}


def layout(encoding: str) -> PixelLayout:
    """How an encoding by ROS's name stores a pixel; RecordingError for one that is unknown."""
    found = _LAYOUTS.get(encoding)
    if found is None:
        raise RecordingError(
            f"Images are encoded as {encoding[:40]!r}, which is not read; record them as mono8, "
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
    grey = _luma(np.ascontiguousarray(pixels), encoding)
    upper = np.minimum(grey >> (bits - 8), 255) if grey.dtype == np.uint16 else grey
    return np.asarray(upper, dtype=np.uint8)


def _luma(pixels: Pixels, encoding: str) -> Pixels:
    """One channel of the same depth."""
    name = encoding.removesuffix("16").removesuffix("8")
    code = _COLOUR_CODES.get(name)
    if name.startswith("bayer_"):
        if min(pixels.shape) < 3:
            raise RecordingError(
                f"A Bayer mosaic of {pixels.shape[1]} x {pixels.shape[0]} px is no image; record "
                "it again."
            )
        code = _BAYER_CODES[name.removeprefix("bayer_")]
    elif encoding in _YUV:
        # Every pixel has its own luma; the chroma beside it is shared by two.
        return np.ascontiguousarray(pixels[..., _YUV[encoding]])
    return pixels if code is None else cast(Pixels, cv2.cvtColor(pixels, code))


def significant_bits(samples: Iterable[Pixels]) -> int:
    """How many of 16 bits a camera fills, by some of its images: 8, 10, 12, 14 or 16.

    It is to be asked once a recording: a scale that changed with the image would make a wall's
    brightness depend on what else is in sight.
    """
    brightest = max((int(sample.max(initial=0)) for sample in samples), default=0)
    if brightest == 0:  # nothing was seen
        return BITS[-1]
    return max(BITS[0], 2 * math.ceil(brightest.bit_length() / 2))
