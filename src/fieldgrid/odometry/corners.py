"""What is remembered of a frame: corners that both cameras see, where they are, how they look."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from fieldgrid.array_types import Float64, UInt8, UInt64
from fieldgrid.errors import CalibrationError
from fieldgrid.odometry.descriptors import LARGEST_SCALE, PATTERN_PX, describe
from fieldgrid.odometry.detection import find_corners
from fieldgrid.odometry.sparse import row_disparities
from fieldgrid.rig import StereoCamera

CELLS = 1200
"""Approximate number of cells of the image; each keeps at most one corner at each scale, so
that corners cover the far view, which tells the turn, and the ground, which tells the way."""

EDGE_PX = 8
"""Nearer to the edge of an image than this, a corner has no window to be looked up by."""

MIN_CORNER = 2e-5
"""OpenCV's smaller eigenvalue, of 8-bit images scaled to 0..1, below which a spot is flat."""

DENOISE_PX = 1.5
"""A corner that outlives smoothing by this sigma is no grain of the sensor, and is found again from
nearer."""

NEAREST_M = 2.0
"""Nothing nearer is looked for: at walking pace it has left the image by the next frame."""

FARTHEST_DISPARITY_PX = 1.0
"""Of points beyond, the depth is a guess, and with it how much of their motion is parallax."""

PATCH_M = 0.2
"""Half the side of the described patch is no less than this, metres, so that a stone looks the
same from 8 m and from 6 m."""


class Features(NamedTuple):
    """The corners of one frame, length n.

    `measured_px` [n, 3] holds column and row in the left image and the disparity less that of
    a point at infinity; `points_m` [n, 3] is the same in the frame of the left camera (x right,
    y down, z forward); `blur_px` [n] is the size of a pixel of the scale at which the corner
    was found; `descriptors` [n, 4] are 256 comparisons of brightness.
    """

    measured_px: Float64
    points_m: Float64
    blur_px: Float64
    descriptors: UInt64


def features(camera: StereoCamera, left: UInt8, right: UInt8) -> Features:
    """The corners of a rectified pair of grey images [height, width].

    It needs no disparity map: each corner is looked up along its row of the right image.
    Raises CalibrationError when a size differs from the calibration's.
    """
    expected = (camera.height_px, camera.width_px)
    for side, image in (("left", left), ("right", right)):
        if image.shape != expected:
            raise CalibrationError(
                f"The {side} image is {image.shape[1]} x {image.shape[0]} px, the calibration is "
                f"for {expected[1]} x {expected[0]}; use the calibration of these images."
            )
    # Each level's pixel (i, j) lies on pixel (2 i, 2 j) of the one below.
    half, right_half = cv2.pyrDown(left), cv2.pyrDown(right)
    found = [_corners(image, px) for image, px in ((left, 1), (half, 2))]
    corners_px = np.concatenate(found)
    blur_px = np.repeat([1.0, 2.0], [len(part) for part in found])

    offset_px = camera.disparity_offset_px
    nearest_px = nearest_disparity_px(camera)
    disparity_px = row_disparities(
        left, right, half, right_half, corners_px, offset_px, offset_px + nearest_px
    )
    disparity_px -= offset_px
    kept = disparity_px >= FARTHEST_DISPARITY_PX  # never, when it is NaN
    measured_px = np.column_stack([corners_px, disparity_px])[kept]

    u, v, disparity = measured_px.T
    depth_m = camera.focal_baseline_px_m / disparity
    per_px = depth_m / camera.focal_px
    points_m = np.column_stack([(u - camera.cx_px) * per_px, (v - camera.cy_px) * per_px, depth_m])
    patch_px = PATCH_M * camera.focal_px / depth_m
    scale = np.clip(patch_px / PATTERN_PX, 1.0, LARGEST_SCALE)
    descriptors = describe((left, half, cv2.pyrDown(half)), measured_px, scale)
    return Features(measured_px, points_m, blur_px[kept], descriptors)


def nearest_disparity_px(camera: StereoCamera) -> float:
    """The largest disparity that is looked for."""
    return min(camera.focal_baseline_px_m / NEAREST_M, camera.width_px / 3.0)


def _corners(image: UInt8, px: int) -> Float64:
    """Corners [n, 2], column and row of the full image, of an image `px` times smaller."""
    smooth = cv2.GaussianBlur(image, (0, 0), DENOISE_PX)
    full_area_px = image.size * px * px
    cell_px = max(8, round(math.sqrt(full_area_px / CELLS)))
    return find_corners(smooth, cell_px, MIN_CORNER) * px
