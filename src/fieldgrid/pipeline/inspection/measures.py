"""What one pair of images is like, in a few numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from fieldgrid.core import Float64, UInt8
from fieldgrid.geometry import StereoCamera
from fieldgrid.perception import FrameGround, shift_px, vertical_shifts

DARK_LEVEL, SATURATED_LEVEL = 16, 250
"""Grey levels of 255: at and below the first a sensor gives noise, at and above the second it is
saturated."""

DARK_SHARE, DARK_MEAN = 0.5, 30.0
"""An image is dark when half of it is noise, or its mean is so low."""

BLUR_PX = 9
"""Width of the strong smoothing that an image is compared with."""


class ImageMeasures(NamedTuple):
    """What the two images of a pair are like.

    Brightness is the mean of 255; shares are of the pixels of the darker, or brighter, image.
    `blur` is the share of the change from pixel to pixel that survives a strong smoothing, of
    the blurrier image. `shifts` [n, 3] are column and row in the left image, and how many rows
    lower the same thing is in the right one, all in pixels.
    """

    brightness: tuple[float, float]
    dark_share: float
    saturated_share: float
    blur: float
    shifts: Float64

    @classmethod
    def of(cls, left: UInt8, right: UInt8, camera: StereoCamera) -> ImageMeasures:
        """Measure a rectified pair."""
        pair = (left, right)
        return cls(
            (float(left.mean()), float(right.mean())),
            max(float((image <= DARK_LEVEL).mean()) for image in pair),
            max(float((image >= SATURATED_LEVEL).mean()) for image in pair),
            max(map(blur, pair)),
            vertical_shifts(left, right, camera),
        )

    @property
    def is_dark(self) -> bool:
        """Whether half of an image is noise, or its mean is low."""
        return self.dark_share > DARK_SHARE or min(self.brightness) < DARK_MEAN

    @property
    def exposure_ratio(self) -> float:
        """How many times brighter the brighter image is."""
        low, high = sorted(self.brightness)
        return high / max(low, 1.0)


class PairMeasures(NamedTuple):
    """One pair that was looked at closely. `points` have a depth."""

    frame_id: str
    time_ns: int
    images: ImageMeasures
    points: int
    ground: FrameGround
    observed_share: float

    @property
    def shift_px(self) -> float | None:
        """The median of the shifts; None with fewer than eight."""
        return shift_px(self.images.shifts)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "frame_id": self.frame_id,
            "time_ns": self.time_ns,
            "brightness_left": self.images.brightness[0],
            "brightness_right": self.images.brightness[1],
            "dark_share": self.images.dark_share,
            "saturated_share": self.images.saturated_share,
            "blur": self.images.blur,
            "points_with_depth": self.points,
            "vertical_shift_px": self.shift_px,
            "ground_found": self.ground.refined,
            "camera_height_m": self.ground.camera_height_m if self.ground.refined else None,
            "observed_share": self.observed_share,
        }


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
