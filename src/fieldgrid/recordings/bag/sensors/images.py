"""Images in messages: stereo, depth and disparity, decoded when they are asked for.

ROS's transport `compressedDepth` writes twelve bytes first: a format and the two numbers by which
metres were made whole ones, z = A / (n - B). Depths in millimetres are packed as they are. RVL
(Wilson 2017, Fast Lossless Depth Image Compression) writes runs of pixels with and without a
depth, and of the latter the differences, in groups of three bits.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldgrid.core import AnyArray, Float32, RecordingError, UInt16, UInt32, kernel, quoted
from fieldgrid.recordings.bag.topic_names import COMPRESSED
from fieldgrid.recordings.frames.depth_files import MOST_PACKED, decode_depth_image
from fieldgrid.recordings.frames.frames import Image
from fieldgrid.recordings.frames.images import MAX_PIXELS, decode_image, self_contained
from fieldgrid.recordings.frames.pixels import Pixels, layout, to_grey
from fieldgrid.recordings.ros.definitions import decode
from fieldgrid.recordings.ros.model import Message

MILLIMETRES, METRES = ("16UC1", "mono16"), "32FC1"
"""Encodings of depths."""

_CONFIG = struct.Struct("<iff")
_SIDES = struct.Struct("<II")


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
        message = self.decoded()
        return hashlib.sha256(getattr(message, "image", message).data.tobytes()).hexdigest()


@dataclass(frozen=True, slots=True)
class RawImage(MessageSource):
    """A sensor_msgs/Image; of 16 bits the camera fills the lower `bits`."""

    bits: int = 16

    def read(self) -> Image:
        """Grey, 8 bit."""
        pixels, encoding = self.pixels()
        try:
            return to_grey(pixels, encoding, self.bits)
        except RecordingError as problem:
            raise RecordingError(f"{self.name}: {problem}") from problem

    def encoded(self) -> bytes:
        """Nothing: the message holds pixels."""
        return b""

    def pixels(self) -> tuple[Pixels, str]:
        """The pixels as recorded, and their encoding."""
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


def image_source(message: Message, time_ns: int, bits: int = 16) -> RawImage | CompressedImage:
    """One side of a pair, by the type of its message."""
    if message.connection.type == COMPRESSED:
        return CompressedImage(message, time_ns)
    return RawImage(message, time_ns, bits)


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
    stored = dtype.newbyteorder(">" if message.is_bigendian else "<")
    strides = (step, channels * dtype.itemsize, dtype.itemsize)
    pixels = np.ndarray((height, width, channels), stored, message.data, 0, strides)
    return np.ascontiguousarray(pixels[..., 0] if channels == 1 else pixels, dtype=dtype)


@dataclass(frozen=True, slots=True)
class PackedDepthImage(MessageSource):
    """A sensor_msgs/CompressedImage of depths: of the transport `compressedDepth`, or a plain
    PNG of millimetres."""

    def read(self) -> Float32:
        """Depth along the optical axis, metres; NaN where there is none."""
        message = self.decoded()
        said, data = str(message.format), message.data.tobytes()
        if "compressedDepth" not in said:
            return depths_of_units(self._png(data, said))
        encoding = said.partition(";")[0].strip()
        if encoding not in (*MILLIMETRES, METRES):
            raise self._unknown(said)
        if len(data) < _CONFIG.size + _SIDES.size:
            raise RecordingError(f"{self.name} is truncated; record it again.")
        _, a, b = _CONFIG.unpack_from(data)
        packed = data[_CONFIG.size :]
        whole = self._rvl(packed) if said.endswith("rvl") else self._png(packed, said)
        if encoding in MILLIMETRES:
            return depths_of_units(whole)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            depth_m = np.float32(a) / (whole.astype(np.float32) - np.float32(b))
        depth_m[whole == 0] = np.nan
        return known_depths(depth_m)

    def _png(self, data: bytes, said: str) -> UInt16:
        whole = decode_depth_image(data, self.name)
        if whole.dtype != np.uint16 or whole.ndim != 2:
            raise self._unknown(said)
        return np.asarray(whole, dtype=np.uint16)

    def _unknown(self, said: str) -> RecordingError:
        return RecordingError(
            f"{self.name}: depths are packed as {quoted(said)}, which is not read; record them as "
            "compressedDepth, or as PNG of 16 bits in millimetres."
        )

    def _rvl(self, data: bytes) -> UInt16:
        width, height = _SIDES.unpack_from(data)
        # A word of 32 bits tells of eight numbers, and two numbers of a run of any length, so
        # only the bound on the size of an image says what a few bytes may unfold to.
        if not 0 < width * height <= min(MAX_PIXELS, MOST_PACKED * len(data)):
            raise RecordingError(
                f"{self.name} claims {width} x {height} px in {len(data)} bytes; it is damaged, "
                "record it again."
            )
        words = np.frombuffer(data, "<u4", (len(data) - _SIDES.size) // 4, _SIDES.size)
        pixels = np.zeros(width * height, dtype=np.uint16)
        if unpack_rvl(words.astype(np.uint32), pixels) != pixels.size:
            raise RecordingError(f"{self.name} is truncated or damaged; record it again.")
        return pixels.reshape(height, width)


@kernel
def unpack_rvl(words: UInt32, pixels: UInt16) -> int:
    """Fill `pixels` (all 0 before), shape (N,), from RVL; returns how many it tells of.

    That is fewer than N where `words` end too early, and more where a run goes on past N.
    """
    place, groups, word = 0, 0, np.uint32(0)
    empty_is_next, with_depth = True, 0
    done, before = 0, 0
    while done < pixels.size:
        number, bits, group = 0, 0, 8
        while group >= 8 and bits < 30:  # three bits a group, the lowest first; the 4th: go on
            if groups == 0:
                if place == words.size:
                    return done
                word, groups = words[place], 8
                place += 1
            group = int(word >> np.uint32(28))
            word = np.uint32(word << np.uint32(4))
            groups -= 1
            number |= (group & 7) << bits
            bits += 3
        if with_depth:
            before += (number >> 1) ^ -(number & 1)
            pixels[done] = before & 0xFFFF
            done += 1
            with_depth -= 1
        elif empty_is_next:
            done += number
            empty_is_next = False
        else:
            with_depth = number
            empty_is_next = True
    return done + with_depth
