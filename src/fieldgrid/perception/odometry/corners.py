"""What is remembered of a frame: corners that both cameras see, where they are, how they look."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from fieldgrid.core import CalibrationError, Float32, Float64, UInt8, UInt64, kernel
from fieldgrid.geometry import StereoCamera
from fieldgrid.perception.odometry.detection import find_corners
from fieldgrid.perception.odometry.sparse import row_disparities

# How the neighbourhood of a corner looks, in 256 bits that can be compared fast.


PATTERN_PX = 15
"""Half the side of the described patch at scale 1."""

LARGEST_SCALE = 5.0
"""The pyramid of three levels has none for larger patches."""


def describe(levels: Sequence[UInt8], places_px: Float64, scale: Float64) -> UInt64:
    """Descriptors [n, 4], uint64: which spot of each of 256 pairs is the darker one.

    `levels` are an image and two more, each half the size of the one before, whose pixel (i, j)
    lies on pixel (2 i, 2 j) of that. `places_px` [n, 2 or more] are column and row in the first;
    the pattern is enlarged by `scale` [n] and read from the level that fits.
    """
    smooth = [cv2.GaussianBlur(image, (7, 7), 2.0) for image in levels]
    descriptors = np.zeros((len(scale), 4), dtype=np.uint64)
    _describe(*smooth, places_px, scale, *_pattern(), descriptors)
    return descriptors


@lru_cache(maxsize=1)
def _pattern() -> tuple[Float32, Float32]:
    """x and y of the compared spots, [512] each: of one of each pair, then of the other.

    They crowd in the middle, as BRIEF (Calonder et al., 2010) recommends. Python's own
    generator gives the same numbers in every version.
    """
    draw = random.Random(256).random
    middle = [[sum(draw() for _ in range(3)) / 1.5 - 1.0 for _ in range(4)] for _ in range(256)]
    spots = np.array(middle, dtype=np.float32) * np.float32(PATTERN_PX)
    return spots[:, 0::2].T.ravel(), spots[:, 1::2].T.ravel()


@kernel
def _describe(full, half, quarter, places_px, scale, pattern_x, pattern_y, descriptors):  # type: ignore[no-untyped-def]
    """Fill in `descriptors` [n, 4]."""
    columns, rows = np.empty(512, dtype=np.int32), np.empty(512, dtype=np.int32)
    for k in range(len(scale)):
        level = 2 if scale[k] >= 2.8 else (1 if scale[k] >= 1.4 else 0)
        image = quarter if level == 2 else (half if level == 1 else full)
        per_px = np.float32(0.5**level)
        # Half a pixel is added, so that cutting off the fraction rounds.
        x = np.float32(places_px[k, 0]) * per_px + np.float32(0.5)
        y = np.float32(places_px[k, 1]) * per_px + np.float32(0.5)
        grow = np.float32(scale[k]) * per_px
        bottom, right = np.int32(image.shape[0] - 1), np.int32(image.shape[1] - 1)
        # Patches at the border are cut there: their inner half still tells them apart.
        for i in range(512):
            columns[i] = min(max(np.int32(x + grow * pattern_x[i]), np.int32(0)), right)
            rows[i] = min(max(np.int32(y + grow * pattern_y[i]), np.int32(0)), bottom)
        for word in range(4):
            bits = np.uint64(0)
            for bit in range(64):
                i = 64 * word + bit
                darker = image[rows[i], columns[i]] < image[rows[i + 256], columns[i + 256]]
                bits |= np.uint64(darker) << np.uint64(bit)
            descriptors[k, word] = bits


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
