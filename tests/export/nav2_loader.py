"""What Nav2's map server makes of a YAML file and its picture, written from its rules.

Both generations of the loader, which differ at the thresholds themselves, in rounding and in how
transparency counts: the one up to Jazzy looks at pixels one by one, the later one at arrays.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import yaml
from PIL import Image


class Grid(NamedTuple):
    """nav_msgs/OccupancyGrid: int8 [height, width], row 0 at the origin's y, and its metadata."""

    data: npt.NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]

    def at(self, x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        """The cells' values at points; -1 outside."""
        assert self.origin[2] == 0.0
        column = np.floor((x - self.origin[0]) / self.resolution).astype(int)
        row = np.floor((y - self.origin[1]) / self.resolution).astype(int)
        height, width = self.data.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        found = np.full(x.shape, -1, dtype=np.int64)
        found[inside] = self.data[row[inside], column[inside]]
        return found


def load(path: Path, *, vectorised: bool = False) -> Grid:
    about: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    with Image.open(path.parent / about["image"]) as picture:
        assert picture.mode in ("L", "LA")
        pixels = np.asarray(picture)
    shade, alpha = (pixels[..., 0], pixels[..., 1]) if pixels.ndim == 3 else (pixels, None)
    rules = _vectorised if vectorised else _pixel_by_pixel
    assert len(about["origin"]) == 3
    return Grid(rules(about, shade, alpha)[::-1], about["resolution"], tuple(about["origin"]))


def _pixel_by_pixel(about: dict[str, Any], shade: Any, alpha: Any) -> npt.NDArray[np.int8]:
    mode, free, occupied = (
        about.get("mode", "trinary"),
        about["free_thresh"],
        about["occupied_thresh"],
    )
    if mode == "raw":
        return np.where(shade <= 100, shade, -1).astype(np.int8)
    bright = shade / 255.0
    if mode == "trinary" and alpha is not None:
        bright = (3.0 * bright + alpha / 255.0) / 4.0
    occ = bright if about["negate"] else 1.0 - bright
    between = np.full(occ.shape, -1.0)
    if mode == "scale":
        between = np.rint((occ - free) / (occupied - free) * 100.0)
    found = np.where(occupied < occ, 100, np.where(occ < free, 0, between))
    if mode == "scale" and alpha is not None:
        found[alpha != 255] = -1
    return found.astype(np.int8)


def _vectorised(about: dict[str, Any], shade: Any, alpha: Any) -> npt.NDArray[np.int8]:
    mode = about.get("mode", "trinary")
    if mode == "raw":
        value = shade.astype(np.int8)  # which wraps: 255 is -1
        return np.where((value < 0) | (value > 100), -1, value).astype(np.int8)
    free, occupied = np.float32(about["free_thresh"]), np.float32(about["occupied_thresh"])
    occ = shade.astype(np.float32) / np.float32(255.0)
    if not about["negate"]:
        occ = np.float32(1.0) - occ
    found = np.full(occ.shape, -1, dtype=np.int8)
    found[occ >= occupied] = 100
    found[occ <= free] = 0
    if mode == "scale":
        between = (occ > free) & (occ < occupied)
        scaled = (occ - free) / (occupied - free) * np.float32(100.0)
        found[between] = np.floor(scaled[between] + np.float32(0.5)).astype(np.int8)
    if alpha is not None:
        found[alpha < 255] = -1
    return found
