"""Files of depths and disparities, as cameras and matchers export them, to depths in metres."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Float32, RecordingError
from fieldgrid.recordings.files import RecordedFile
from fieldgrid.recordings.frames.frame_table import FrameLayout
from fieldgrid.recordings.frames.frames import DepthFrame, Frame
from fieldgrid.recordings.frames.images import checked_header, stored_pixels
from fieldgrid.recordings.frames.npy import parse_npy
from fieldgrid.recordings.stored import Shot

_Any = npt.NDArray[np.generic]

SUFFIXES = frozenset({".png", ".tif", ".tiff", ".npy", ".pfm"})
"""File name endings of depths and disparities, in lower case."""

DEPTHS = FrameLayout(("depth",), ("depth",), SUFFIXES, "depth image")
DISPARITIES = FrameLayout(("disparity",), ("disparity",), SUFFIXES, "disparity image")

MILLIMETRES, KITTI_DISPARITY = 0.001, 1.0 / 256.0
"""What one unit of whole numbers is when nothing is said: of depths, metres; of disparities, px."""

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
        values = _decode(self.data(), self.path)
        stated = self.format
        whole = values.dtype.kind in "iu"
        unit = stated.unit
        if unit is None:
            if whole and values.dtype.itemsize == 1:
                raise RecordingError(
                    f"{self.path} has 8 bit, which is not usual; say in recording.toml what one "
                    f"is worth: [{stated.role}] scale_{'m' if stated.role == 'depth' else 'px'}."
                )
            usual = MILLIMETRES if stated.role == "depth" else KITTI_DISPARITY
            unit = usual if whole else 1.0
        with np.errstate(all="ignore"):  # what overflows is no depth
            measured = values.astype(np.float32)
            known = measured > 0.0
            measured *= np.float32(unit)
            if stated.role == "disparity":
                measured = np.float32(stated.focal_baseline_px_m) / (
                    measured - np.float32(stated.offset_px)
                )
            known &= (measured > _NEAREST_M) & (measured < _FARTHEST_M)
        depth_m: Float32 = np.where(known, measured, np.float32(np.nan))
        return depth_m


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


def _decode(data: bytes, path: Path) -> _Any:
    """The numbers as stored, [row, column]."""
    if data.startswith(b"\x93NUMPY"):
        values = parse_npy(data, str(path))
    elif data.startswith(b"Pf"):
        match = _PFM.match(data[:1024])
        if match is None:
            raise RecordingError(f"{path} has no header of a grey PFM; write it again.")
        width, height = int(match[1]), int(match[2])
        order = "<" if match[3].startswith(b"-") else ">"
        if width * height * 4 != len(data) - match.end():
            raise RecordingError(
                f"{path} claims {width} x {height} px and has {len(data) - match.end()} bytes of "
                "them; it is truncated or damaged, copy it again."
            )
        upwards = np.frombuffer(data, dtype=f"{order}f4", offset=match.end()).reshape(height, width)
        values = upwards[::-1]
    else:
        values = decode_depth_image(data, str(path))
    if values.ndim != 2 or 0 in values.shape:
        raise RecordingError(
            f"{path} has numbers of shape {values.shape}; depths have one channel, [row, column]."
        )
    return values


def decode_depth_image(data: bytes, name: str) -> _Any:
    """The numbers in a PNG or plain TIFF of one channel, [row, column]; RecordingError for what is
    none."""
    header = checked_header(data, name, tiff_bits=(8, 16, 32))
    if data.startswith(b"\x89PNG") and data[25:26] not in (b"", b"\0"):
        raise RecordingError(f"{name} is a colour image; depths have one channel.")
    can_be = header.width_px * header.height_px <= MOST_PACKED * len(data)
    whole = header._replace(is_whole=header.is_whole and can_be)
    return cast(_Any, stored_pixels(data, whole, name))
