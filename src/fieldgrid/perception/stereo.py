"""Rectified pairs to disparity: OpenCV's matchers, searching only what can land in the grid."""

from __future__ import annotations

import math
import threading
from typing import NamedTuple, Protocol

import cv2
import numpy as np

from fieldgrid.core import CalibrationError, ConfigError, Int16, MatcherKind, StereoSettings, UInt8
from fieldgrid.geometry import Rig, StereoCamera

SUBPIXELS = 16
"""Disparities are int16 in sixteenths of a pixel, as OpenCV writes them."""

INVALID = np.int16(-SUBPIXELS)
"""The disparity of a pixel without a match; anything below 0 is one."""

LEVEL_MARGIN_DEG = 4.0
"""How far the vehicle may pitch before the slice leaves the searched rows."""

EXPOSURE_RATIO = 1.25
"""From here on a pair's images are brought to the same exposure: below, the matcher bears it."""


class SearchRegion(NamedTuple):
    """The image rows and the disparities that are searched.

    Disparities start at 0 although nothing so far away lands in the grid: a background that
    is denied its true disparity is matched to a wrong, near one instead.
    """

    row_start: int
    row_stop: int
    num_disparities: int


class Disparity(NamedTuple):
    """Disparity of the left image's rows `row_start`…, int16 in sixteenths, < 0 invalid."""

    values: Int16
    row_start: int


class _Matcher(Protocol):
    def compute(self, left: UInt8, right: UInt8) -> Int16: ...


def whole_image(camera: StereoCamera, num_disparities: int) -> SearchRegion:
    """All rows: what a bare matcher searches."""
    return SearchRegion(0, camera.height_px, num_disparities)


def search_region(
    rig: Rig, settings: StereoSettings, max_height_m: float, max_range_m: float
) -> SearchRegion:
    """What can land in a slice up to `max_height_m` above the ground, to `max_range_m`.

    Disparities reach to the point at `min_range_m`. The top row is the highest at which a
    point of the slice can appear at any range, with a margin for the vehicle's pitch.
    """
    camera, mount = rig.camera, rig.mount
    if camera.disparity_offset_px < -1.0:
        raise CalibrationError(
            f"The right camera's cx is {-camera.disparity_offset_px:.1f} px beyond the left's, so "
            "far points have negative disparities, which are not searched; rectify with zero "
            "disparity at infinity (CALIB_ZERO_DISPARITY)."
        )
    nearest_px = camera.focal_baseline_px_m / settings.min_range_m + camera.disparity_offset_px
    # n disparities are 0 … n - 1, and OpenCV wants a multiple of 16.
    num_disparities = max(16, math.ceil((nearest_px + 1.0) / 16.0) * 16)
    if num_disparities > camera.width_px // 2:
        raise ConfigError(
            f"A nearest range of {settings.min_range_m} m asks for {num_disparities} disparities "
            f"in images {camera.width_px} px wide; give a larger min_range_m."
        )
    rise_m = max_height_m - mount.height_m
    steepest_deg = math.degrees(
        math.atan2(rise_m, settings.min_range_m if rise_m > 0.0 else max_range_m)
    )
    above_axis_deg = steepest_deg + mount.tilt_deg + LEVEL_MARGIN_DEG + abs(mount.roll_deg)
    top = camera.cy_px - camera.focal_px * math.tan(math.radians(min(above_axis_deg, 80.0)))
    row_start = int(np.clip(math.floor(top), 0, camera.height_px - 16))
    return SearchRegion(row_start, camera.height_px, num_disparities)


class StereoMatcher:
    """Matches pairs of one camera; safe to call from several threads."""

    def __init__(self, camera: StereoCamera, settings: StereoSettings, region: SearchRegion):
        self.camera = camera
        self.settings = settings
        self.region = region
        # OpenCV's matchers keep their buffers, so each thread needs one of its own.
        self._local = threading.local()

    def disparity(self, left: UInt8, right: UInt8) -> Disparity:
        """Match two grey images [height, width] of the camera's size.

        Raises CalibrationError when a size differs from the calibration's.
        """
        expected = (self.camera.height_px, self.camera.width_px)
        for side, image in (("left", left), ("right", right)):
            if image.shape != expected:
                raise CalibrationError(
                    f"The {side} image is {image.shape[1]} x {image.shape[0]} px, the "
                    f"calibration is for {expected[1]} x {expected[0]}; use the calibration of "
                    "these images."
                )
        if not hasattr(self._local, "matcher"):
            self._local.matcher = make_matcher(self.settings, self.region.num_disparities)
        rows = slice(self.region.row_start, self.region.row_stop)
        left, right = equally_exposed(left[rows], right[rows])
        if self.settings.row_step == 1:
            values = self._local.matcher.compute(left, right)
        else:
            values = self._local.matcher.compute(row_pair_means(left), row_pair_means(right))
            values = between_row_pairs(values, self.settings.speckle_step_px, len(left))
        return Disparity(values, self.region.row_start)


def equally_exposed(left: UInt8, right: UInt8) -> tuple[UInt8, UInt8]:
    """A pair [rows, columns] of one exposure: where they differ by more than `EXPOSURE_RATIO`, the
    darker image gets the mean and the standard deviation of the brighter one."""
    pair = [left, right]
    means, deviations = np.array([np.ravel(cv2.meanStdDev(image)) for image in pair]).T
    dark, bright = np.argsort(means)
    if means[bright] > EXPOSURE_RATIO * max(means[dark], 1.0):
        gain = deviations[bright] / max(deviations[dark], 1.0)
        offset = means[bright] - gain * means[dark]
        pair[dark] = np.asarray(cv2.addWeighted(pair[dark], gain, pair[dark], 0.0, offset))
    return pair[0], pair[1]


def row_pair_means(image: UInt8) -> UInt8:
    """The mean of each two rows of an image [height, width]: uint8 [height // 2, width]."""
    even = len(image) // 2 * 2
    return np.asarray(cv2.addWeighted(image[:even:2], 0.5, image[1:even:2], 0.5, 0.0))


def between_row_pairs(values: Int16, step_px: int, height: int) -> Int16:
    """Disparities of `height` rows from those of the means of each two [height // 2, width], in
    sixteenths of a pixel.

    A row lies a quarter of the way to the next pair of rows, and so does its disparity where
    both have one and they are of the same surface, no more than `step_px` apart. An odd last
    row has that of the row above.
    """
    upper, lower = values[:-1], values[1:]
    same = (upper >= 0) & (lower >= 0) & (np.abs(lower - upper) <= SUBPIXELS * step_px)
    quarter = np.where(same, lower - upper, np.int16(0)) + np.int16(2) >> 2
    rows = np.repeat(values, 2, axis=0)
    rows[1:-1:2] += quarter
    rows[2::2] -= quarter
    return rows if height == len(rows) else np.concatenate([rows, rows[-1:]])


def make_matcher(settings: StereoSettings, num_disparities: int) -> _Matcher:
    """OpenCV's matcher for these settings, disparities 0 … num_disparities - 1."""
    block = settings.block()
    # OpenCV's SGBM takes 0 and -1 for 1; only a large difference switches its check off.
    left_right_px = settings.left_right_px or num_disparities
    speckle_px = settings.speckle_px // settings.row_step  # counted in the rows that are matched
    if settings.matcher is MatcherKind.BM:
        bm = cv2.StereoBM_create(num_disparities, block)
        bm.setUniquenessRatio(settings.uniqueness_percent)
        bm.setDisp12MaxDiff(left_right_px)
        bm.setSpeckleWindowSize(speckle_px)
        bm.setSpeckleRange(settings.speckle_step_px)
        return bm  # type: ignore[no-any-return]
    mode = (
        cv2.STEREO_SGBM_MODE_SGBM_3WAY
        if settings.matcher is MatcherKind.SGBM_3WAY
        else cv2.STEREO_SGBM_MODE_SGBM
    )
    return cv2.StereoSGBM_create(  # type: ignore[no-any-return]
        minDisparity=0,
        numDisparities=num_disparities,
        blockSize=block,
        P1=8 * block * block,
        P2=32 * block * block,
        disp12MaxDiff=left_right_px,
        uniquenessRatio=settings.uniqueness_percent,
        speckleWindowSize=speckle_px,
        speckleRange=settings.speckle_step_px,
        mode=mode,
    )
