"""What one pair of images is like, in a few numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from fieldgrid.array_types import Float32, Float64, UInt8
from fieldgrid.localgrid import FrameGround
from fieldgrid.rig import StereoCamera

DARK_LEVEL, SATURATED_LEVEL = 16, 250
"""Of 255: at and below the one a sensor gives noise, at and above the other nothing."""

BLUR_PX = 9
"""Width of the strong smoothing that an image is compared with."""

PATCH_PX = 7
"""Half the side of the patches that are looked up in the right image."""

SEARCH_SHARE, MOST_SEARCHED = 0.05, 160
"""Of an image's height: how far up and down a patch is looked for. Of how many patches."""

ALIKE, LEAD = 0.8, 0.05
"""A patch is found where it correlates so well, and better by so much than elsewhere."""


class Look(NamedTuple):
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
        return float(np.median(self.shifts[:, 2])) if len(self.shifts) >= 8 else None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        ground = self.ground
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
            "ground_found": ground.refined,
            "camera_height_m": ground.camera_height_m if ground.refined else None,
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
            lost = float(np.maximum(change - smoothed, 0.0).sum())
            worst = max(worst, 1.0 - lost / total)
    return worst


def vertical_shifts(left: UInt8, right: UInt8, camera: StereoCamera) -> Float64:
    """How many rows lower corners of the left image are in the right one: [n, 3] with column,
    row and shift. In a rectified pair all shifts are 0."""
    height, width = left.shape
    reach = max(4, round(SEARCH_SHARE * height))
    far, near = _disparities(camera)
    found = []
    for column, row in _corners(left):
        x, y = round(float(column)), round(float(row))
        first = max(x - near - PATCH_PX, 0)
        last = min(x - far + PATCH_PX + 3, width - 1)
        inside = PATCH_PX <= x < width - PATCH_PX
        inside &= reach + PATCH_PX <= y < height - reach - PATCH_PX
        if not inside or last - first < 4 * PATCH_PX:
            continue
        patch = left[y - PATCH_PX : y + PATCH_PX + 1, x - PATCH_PX : x + PATCH_PX + 1]
        strip = right[y - reach - PATCH_PX : y + reach + PATCH_PX + 1, first : last + 1]
        rows = _found(cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED))
        if rows is not None:
            found.append((float(column), float(row), rows - reach))
    return np.array(found, dtype=np.float64).reshape(-1, 3)


def _corners(image: UInt8) -> Float64:
    """Column and row of corners [n, 2], well apart."""
    apart_px = max(6.0, image.shape[0] / 40.0)
    found = cv2.goodFeaturesToTrack(image, MOST_SEARCHED, 0.01, apart_px)
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)


def _disparities(camera: StereoCamera) -> tuple[int, int]:
    """The least and the largest disparity that is looked for, as in the odometry."""
    nearest = min(camera.focal_baseline_px_m / 2.0, camera.width_px / 3.0)
    return round(camera.disparity_offset_px) - 2, round(camera.disparity_offset_px + nearest)


def _found(scores: Float32) -> float | None:
    """The row, to a fraction, at which a patch is found for certain."""
    _, best, _, place = cv2.minMaxLoc(scores)
    x, y = int(place[0]), int(place[1])
    height, width = scores.shape
    if best < ALIKE or not (0 < y < height - 1 and 0 < x < width - 1):
        return None
    before, after = float(scores[y - 1, x]), float(scores[y + 1, x])
    rest = scores.copy()
    rest[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4] = -1.0
    curvature = before - 2.0 * best + after
    if float(rest.max()) > best - LEAD or curvature >= 0.0:
        return None
    return float(y + 0.5 * (before - after) / curvature)
