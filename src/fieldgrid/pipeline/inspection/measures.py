"""What one pair of images is like, in a few numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from fieldgrid.core import Float64, UInt8
from fieldgrid.perception import FrameGround, shift_px

DARK_LEVEL, SATURATED_LEVEL = 16, 250
"""Grey levels of 255: at and below the first a sensor gives noise, at and above the second it is
saturated."""

BLUR_PX = 9
"""Width of the strong smoothing that an image is compared with."""


class PairMeasures(NamedTuple):
    """One pair that was looked at closely.

    Brightness is the mean of 255; shares are of the pixels of the darker, or brighter, image.
    `blur` is the share of the change from pixel to pixel that survives a strong smoothing, of
    the blurrier image. `points` have a depth. `shifts` [n, 3] are column and row in the left
    image, and how many rows lower the same thing is in the right one, all in pixels.
    """

    frame_id: str
    time_ns: int
    brightness: tuple[float, float]
    dark_share: float
    saturated_share: float
    blur: float
    points: int
    shifts: Float64
    ground: FrameGround
    observed_share: float

    @property
    def shift_px(self) -> float | None:
        """The median of the shifts; None with fewer than eight."""
        return shift_px(self.shifts)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "frame_id": self.frame_id,
            "time_ns": self.time_ns,
            "brightness_left": self.brightness[0],
            "brightness_right": self.brightness[1],
            "dark_share": self.dark_share,
            "saturated_share": self.saturated_share,
            "blur": self.blur,
            "points_with_depth": self.points,
            "vertical_shift_px": self.shift_px,
            "ground_found": self.ground.refined,
            "camera_height_m": self.ground.camera_height_m if self.ground.refined else None,
            "observed_share": self.observed_share,
        }


def exposure(left: UInt8, right: UInt8) -> tuple[tuple[float, float], float, float]:
    """Mean brightness of both, and the larger dark and saturated share of the two."""
    dark = max(float((image <= DARK_LEVEL).mean()) for image in (left, right))
    saturated = max(float((image >= SATURATED_LEVEL).mean()) for image in (left, right))
    return (float(left.mean()), float(right.mean())), dark, saturated


def blur(image: UInt8) -> float:
    """The no-reference measure of Crete et al. (2007), 0 sharp to 1, of the worse direction.

    Contrast cancels in it. Sharp images of five cameras had 0.18 to 0.29; smoothed by a Gaussian
    of 1, 1.5 and 2 pixels they had 0.32 to 0.40, 0.40 to 0.47 and 0.44 to 0.52, and moved by 15
    pixels during exposure 0.55 to 0.70. (The variance of the Laplacian of the sharp ones lay
    between 210 and 1750.)
    """
    grey = image.astype(np.float32)
    worst = 0.0
    for axis, size in ((1, (BLUR_PX, 1)), (0, (1, BLUR_PX))):
        change = np.abs(np.diff(grey, axis=axis))
        smoothed = np.abs(np.diff(cv2.blur(grey, size), axis=axis))
        total = float(change.sum())
        if total > 0.0:
            worst = max(worst, 1.0 - float(np.maximum(change - smoothed, 0.0).sum()) / total)
    return worst
