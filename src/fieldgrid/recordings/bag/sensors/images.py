"""Images in messages: stereo, depth and disparity, decoded when they are asked for."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldgrid.core import AnyArray, Float32, RecordingError, UInt16, quoted
from fieldgrid.recordings.frames.frames import Image
from fieldgrid.recordings.frames.images import MAX_PIXELS, decode_image, self_contained
from fieldgrid.recordings.frames.pixels import Pixels, layout, to_grey
from fieldgrid.recordings.ros.definitions import decode
from fieldgrid.recordings.ros.model import Message

MILLIMETRES, METRES = ("16UC1", "mono16"), "32FC1"
"""Encodings of depths."""


@dataclass(frozen=True, slots=True)
class MessageSource:
    """One message with an image or a cloud; `time_ns` is that of its frame.

    It holds the bytes as recorded, and nothing decoded.
    """

    message: Message
    time_ns: int

    @property
    def name(self) -> str:
        """The topic and the time."""
        return f"{self.message.topic} @ {self.time_ns}"

    def decoded(self) -> Any:
        """The message; RecordingError when its bytes are no message of its type."""
        return decode(self.message)

    def sha256(self) -> str:
        """The hash of the image's or cloud's own bytes, without header and layout."""
        return hashlib.sha256(self.payload().data.tobytes()).hexdigest()

    def payload(self) -> Any:
        """What of the message has the `data`."""
        return self.decoded()


@dataclass(frozen=True, slots=True)
class RawImage(MessageSource):
    """A sensor_msgs/Image; of 16 bits the camera fills the lower `bits`."""

    bits: int = 16

    def read(self) -> Image:
        """Grey, 8 bit."""
        pixels, encoding = self._pixels()
        try:
            return to_grey(pixels, encoding, self.bits)
        except RecordingError as problem:
            raise RecordingError(f"{self.name}: {problem}") from problem

    def encoded(self) -> bytes:
        """Nothing: the message holds pixels."""
        return b""

    def deep_pixels(self) -> Pixels | None:
        """The pixels as recorded if their values have 16 bits, else None."""
        pixels, _ = self._pixels()
        return pixels if pixels.dtype == np.uint16 else None

    def _pixels(self) -> tuple[Pixels, str]:
        message = self.decoded()
        encoding = str(message.encoding)
        try:
            kind = layout(encoding)
        except RecordingError as problem:
            raise RecordingError(f"{self.name}: {problem}") from problem
        return pixels_of(message, np.dtype(kind.dtype), kind.channels, self.name), encoding


@dataclass(frozen=True, slots=True)
class CompressedImage(MessageSource):
    """A sensor_msgs/CompressedImage, by the same decoder as image files."""

    def read(self) -> Image:
        """Grey, 8 bit."""
        return decode_image(self.decoded().data.tobytes(), self.name)

    def encoded(self) -> bytes:
        """The image as recorded, if it is a JPEG or a PNG."""
        return self_contained(self.decoded().data.tobytes())


@dataclass(frozen=True, slots=True)
class DepthImage(MessageSource):
    """A sensor_msgs/Image of depths: 16UC1 in units, usually millimetres, or 32FC1 in metres."""

    unit_m: float = 0.001

    def read(self) -> Float32:
        """Depth along the optical axis, metres; NaN where there is none."""
        message = self.decoded()
        if message.encoding in MILLIMETRES:
            whole = pixels_of(message, np.dtype(np.uint16), 1, self.name)
            return depths_of_units(whole, self.unit_m)
        if message.encoding == METRES:
            return known_depths(pixels_of(message, np.dtype(np.float32), 1, self.name).copy())
        raise RecordingError(
            f"{self.name}: depths are encoded as {quoted(message.encoding)}, which is not "
            "read; record them as 16UC1 (millimetres) or 32FC1 (metres)."
        )


@dataclass(frozen=True, slots=True)
class DisparityImage(MessageSource):
    """A stereo_msgs/DisparityImage: depth is f·T / disparity."""

    def payload(self) -> Any:
        """The image inside."""
        return self.decoded().image

    def read(self) -> Float32:
        """Depth along the optical axis, metres; NaN where there is no disparity."""
        message = self.decoded()
        if message.image.encoding != METRES:
            raise RecordingError(
                f"{self.name}: disparities are encoded as {quoted(message.image.encoding)}, "
                f"not {METRES}; record them as stereo_image_proc gives them."
            )
        product = float(message.f) * float(message.t)
        if not (np.isfinite(product) and product > 0.0):
            raise RecordingError(
                f"{self.name}: f·T is {product}, which gives no depth; restore the calibration."
            )
        disparity = pixels_of(message.image, np.dtype(np.float32), 1, self.name)
        known = np.isfinite(disparity) & (disparity > 0.0)
        known &= (disparity >= message.min_disparity) & (disparity <= message.max_disparity)
        depth_m = np.full(disparity.shape, np.nan, dtype=np.float32)
        with np.errstate(over="ignore", under="ignore"):
            np.divide(np.float32(product), disparity, out=depth_m, where=known)
        return known_depths(depth_m)


def depths_of_units(units: UInt16, unit_m: float = 0.001) -> Float32:
    """Metres, NaN where there is no depth."""
    return known_depths(units.astype(np.float32) * np.float32(unit_m))


def known_depths(depth_m: Float32) -> Float32:
    """The depths, NaN in place of those that are none."""
    depth_m[~(np.isfinite(depth_m) & (depth_m > 0.0))] = np.nan
    return depth_m


def pixels_of(message: Any, dtype: np.dtype[Any], channels: int, name: str) -> AnyArray:
    """The pixels of a sensor_msgs/Image [row, column] or [row, column, channel], in the
    machine's byte order; nothing is copied where that can be avoided."""
    width, height, step = int(message.width), int(message.height), int(message.step)
    row = width * channels * dtype.itemsize
    if not 0 < width * height <= MAX_PIXELS:
        raise RecordingError(
            f"{name} claims {width} x {height} px, which is none or more than {MAX_PIXELS} in "
            "all; record it again, or scale the images down."
        )
    if step < row or step * (height - 1) + row > len(message.data):
        raise RecordingError(
            f"{name} has {len(message.data)} bytes in rows of {step}, too few for {width} x "
            f"{height} px of {channels * dtype.itemsize} bytes; it is damaged, record it again."
        )
    data = np.ascontiguousarray(message.data, dtype=np.uint8)
    rows = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1), writeable=False)
    stored = dtype.newbyteorder(">" if message.is_bigendian else "<")
    shape = (height, width) if channels == 1 else (height, width, channels)
    pixels = np.ascontiguousarray(rows).view(stored).reshape(shape)
    return pixels.astype(dtype, copy=False)
