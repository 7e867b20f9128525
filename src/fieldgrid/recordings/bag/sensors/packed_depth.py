"""Depth images as ROS's transports pack them: PNG and RVL, of millimetres or of inverse depths.

The transport `compressedDepth` writes twelve bytes first: a format and the two numbers by which
metres were made whole ones, z = A / (n - B). Depths in millimetres are packed as they are. RVL
(Wilson 2017, Fast Lossless Depth Image Compression) writes runs of pixels with and without a
depth, and of the latter the differences, in groups of three bits.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from fieldgrid.core import Float32, RecordingError, UInt16, UInt32, kernel, quoted
from fieldgrid.recordings.bag.sensors.images import (
    MessageSource,
    depths_of_units,
    known_depths,
)
from fieldgrid.recordings.frames.depth_files import MOST_PACKED, decode_depth_image
from fieldgrid.recordings.frames.images import MAX_PIXELS

_CONFIG = struct.Struct("<iff")
_SIDES = struct.Struct("<II")


@dataclass(frozen=True, slots=True)
class PackedDepthImage(MessageSource):
    """A sensor_msgs/CompressedImage of depths: of the transport `compressedDepth`, or a plain
    PNG of millimetres."""

    def read(self) -> Float32:
        """Depth along the optical axis, metres; NaN where there is none."""
        message = self.decoded()
        said, data = str(message.format), message.data.tobytes()
        encoding = said.partition(";")[0].strip()
        if "compressedDepth" not in said:
            return depths_of_units(self._png(data, said))
        if encoding not in ("16UC1", "mono16", "32FC1"):
            raise self._unknown(said)
        if len(data) < _CONFIG.size:
            raise RecordingError(f"{self.name} is truncated; record it again.")
        _, a, b = _CONFIG.unpack_from(data)
        packed = data[_CONFIG.size :]
        whole = self._rvl(packed) if said.endswith("rvl") else self._png(packed, said)
        if encoding != "32FC1":
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
        if len(data) < _SIDES.size:
            raise RecordingError(f"{self.name} is truncated; record it again.")
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
