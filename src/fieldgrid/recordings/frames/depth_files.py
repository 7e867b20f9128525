"""Files of depths and disparities, as cameras and matchers export them, to depths in metres."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Float32, RecordingError
from fieldgrid.recordings.files import RecordedFile
from fieldgrid.recordings.frames.frame_table import FrameLayout
from fieldgrid.recordings.frames.frames import DepthFrame, Frame
from fieldgrid.recordings.frames.images import checked_header, stored_pixels
from fieldgrid.recordings.frames.npy import parse_npy
from fieldgrid.recordings.stored import Shot

Numbers = npt.NDArray[np.generic]
"""Depths or disparities as they are stored [row, column]."""

SUFFIXES = frozenset({".png", ".tif", ".tiff", ".npy", ".pfm"})
"""File name endings of depths and disparities, in lower case."""

DEPTHS = FrameLayout(("depth",), ("depth",), SUFFIXES, "depth image")
DISPARITIES = FrameLayout(("disparity",), ("disparity",), SUFFIXES, "disparity image")

_USUAL = {"depth": ("scale_m", 0.001), "disparity": ("scale_px", 1.0 / 256.0)}
"""The setting that says what one unit is worth, and what it is for whole numbers without: metres
of depths, px of disparities."""

_NEAREST_M, _FARTHEST_M = 0.001, 1e6
MOST_PACKED = 2000
"""No PNG or TIFF packs as many pixels into a byte."""
_PFM = re.compile(rb"Pf\s+(\d{1,9})\s+(\d{1,9})\s+(-?[0-9.eE+-]{1,20})\s")


@dataclass(frozen=True, slots=True)
class DepthFormat:
    """What the numbers of depth files mean.

    `unit` is what one is worth, metres or px; None for the usual: whole numbers are millimetres,
    or 1/256 px, and floats metres, or px. For disparities, depth is
    `focal_baseline_px_m` / (disparity - `offset_px`).
    """

    role: Literal["depth", "disparity"]
    unit: float | None = None
    focal_baseline_px_m: float = 0.0
    offset_px: float = 0.0


@dataclass(frozen=True, slots=True)
class DepthFile(RecordedFile):
    """A 16-bit PNG or TIFF, a float32 TIFF, a NumPy array or a PFM, of one channel."""

    format: DepthFormat

    def read(self) -> Float32:
        """Depth along the optical axis [row, column], metres; NaN where there is none."""
        stored, stated = self._stored(), self.format
        setting, unit = _USUAL[stated.role]
        if stated.unit is not None:
            unit = stated.unit
        elif stored.dtype.kind == "f":
            unit = 1.0
        elif stored.dtype.itemsize == 1:
            raise RecordingError(
                f"{self.path} has 8 bit, which is not usual; say in recording.toml what one is "
                f"worth: [{stated.role}] {setting}."
            )
        with np.errstate(all="ignore"):  # what overflows is no depth
            measured = stored.astype(np.float32)
            known = measured > 0.0
            measured *= np.float32(unit)
            if stated.role == "disparity":
                measured = np.float32(stated.focal_baseline_px_m) / (
                    measured - np.float32(stated.offset_px)
                )
            known &= (measured > _NEAREST_M) & (measured < _FARTHEST_M)
        measured[~known] = np.nan
        return measured

    def _stored(self) -> Numbers:
        data = self.data()
        if data.startswith(b"\x93NUMPY"):
            stored = parse_npy(data, self.name)
        elif data.startswith(b"Pf"):
            stored = _parse_pfm(data, self.name)
        else:
            stored = decode_depth_image(data, self.name)
        if stored.ndim != 2 or not stored.size:
            raise RecordingError(
                f"{self.path} has numbers of shape {stored.shape}; depths have one channel, "
                "[row, column]."
            )
        return stored


@dataclass(frozen=True, slots=True)
class DepthKind:
    """Depth images for a calibration of `size_px`."""

    size_px: tuple[int, int]
    format: DepthFormat

    @property
    def roles(self) -> tuple[str, ...]:
        """Depth or disparity."""
        return (self.format.role,)

    def frame(self, folder: Path, shot: Shot) -> Frame:
        """The depth image, unread."""
        (name,) = shot.files
        source = DepthFile(folder / name, self.format)
        return DepthFrame(shot.frame_id, shot.time_ns, source, self.size_px)


def _parse_pfm(data: bytes, name: str) -> Numbers:
    match = _PFM.match(data[:1024])
    if match is None:
        raise RecordingError(f"{name} has no header of a grey PFM; write it again.")
    width, height, left = int(match[1]), int(match[2]), len(data) - match.end()
    if width * height * 4 != left:
        raise RecordingError(
            f"{name} claims {width} x {height} px and has {left} bytes of them; it is truncated or "
            "damaged, copy it again."
        )
    order = "<" if match[3].startswith(b"-") else ">"
    upwards = np.frombuffer(data, dtype=f"{order}f4", offset=match.end()).reshape(height, width)
    return upwards[::-1]


def decode_depth_image(data: bytes, name: str) -> Numbers:
    """The numbers in a PNG or plain TIFF, [row, column] if it has one channel; RecordingError for
    what is neither."""
    header = checked_header(data, name, tiff_bits=(8, 16, 32))
    if header.width_px * header.height_px > MOST_PACKED * len(data):
        header = header._replace(is_whole=False)
    return stored_pixels(data, header, name)
