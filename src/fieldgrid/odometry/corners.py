"""What is remembered of a frame: corners that both cameras see, where they are, how they look."""

from __future__ import annotations

import math
import random
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from fieldgrid.array_types import Float32, Float64, UInt8, UInt64
from fieldgrid.errors import CalibrationError
from fieldgrid.kernel import kernel
from fieldgrid.odometry.sparse import row_disparities
from fieldgrid.rig import StereoCamera

CELLS = 1200
"""At most one corner is kept in each of about so many cells of the image, at each scale, so
that corners cover the far view, which tells the turn, and the ground, which tells the way."""

BORDER_PX = 4
EDGE_PX = 8
"""Nearer to the edge of an image than this, a corner has no window to be looked up by."""

MIN_CORNER = 2e-5
"""OpenCV's smaller eigenvalue, of 8-bit images scaled to 0..1, below which a spot is flat."""

CORNER_BLOCK_PX = 5
DENOISE_PX = 1.5
"""A corner that outlives so much smoothing is no grain of the sensor, and is found again from
nearer."""

NEAREST_M = 2.0
"""Nothing nearer is looked for: at walking pace it has left the image by the next frame."""

FARTHEST_DISPARITY_PX = 1.0
"""Of points beyond, the depth is a guess, and with it how much of their motion is parallax."""

PATTERN_PX, PATCH_M = 15, 0.2
"""Half the side of the described patch: so many pixels, but no less than so many metres, so
that a stone looks the same from 8 m and from 6 m."""

LARGEST_PATCH = 5.0
"""Times the pattern's size; the pyramid has no level for more."""


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
    levels = (left, half, cv2.pyrDown(half))
    found = [_corners(image, 1 << k) for k, image in enumerate(levels[:2])]
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
    points_m = _points(camera, measured_px)
    smooth = [cv2.GaussianBlur(image, (7, 7), 2.0) for image in levels]
    patch_px = PATCH_M * camera.focal_px / points_m[:, 2]
    scale = np.clip(patch_px / PATTERN_PX, 1.0, LARGEST_PATCH)
    descriptors = describe(*smooth, measured_px, scale, _pattern())
    return Features(measured_px, points_m, blur_px[kept], descriptors)


def nearest_disparity_px(camera: StereoCamera) -> float:
    """The largest disparity that is looked for."""
    return min(camera.focal_baseline_px_m / NEAREST_M, camera.width_px / 3.0)


def _points(camera: StereoCamera, measured_px: Float64) -> Float64:
    """Points [n, 3] in metres, in the frame of the left camera."""
    u, v, disparity = measured_px.T
    depth = camera.focal_baseline_px_m / disparity
    per_px = depth / camera.focal_px
    return np.column_stack([(u - camera.cx_px) * per_px, (v - camera.cy_px) * per_px, depth])


def _corners(image: UInt8, px: int) -> Float64:
    """Corners [n, 2], column and row of the full image, of an image `px` times smaller."""
    smooth = cv2.GaussianBlur(image, (0, 0), DENOISE_PX)
    strength = cv2.cornerMinEigenVal(smooth, CORNER_BLOCK_PX)
    full_area_px = image.size * px * px
    cell_px = max(8, round(math.sqrt(full_area_px / CELLS)))
    corners: Float64 = strongest(strength, cell_px, np.float32(MIN_CORNER)) * px
    return corners


@lru_cache(maxsize=1)
def _pattern() -> Float32:
    """Pairs of spots of a patch that are compared, [256, 4]: x, y of one, x, y of the other.

    They crowd in the middle, as BRIEF (Calonder et al., 2010) recommends. Python's own
    generator gives the same numbers in every version.
    """
    draw = random.Random(256).random
    middle = [[sum(draw() for _ in range(3)) / 1.5 - 1.0 for _ in range(4)] for _ in range(256)]
    return np.array(middle, dtype=np.float32) * np.float32(PATTERN_PX)


@kernel
def strongest(strength, cell_px, least):  # type: ignore[no-untyped-def]
    """The strongest local maximum of each cell, [n, 2] column and row, between pixels."""
    height, width = strength.shape
    found = np.empty(((height // cell_px + 1) * (width // cell_px + 1), 2))
    n = 0
    for top in range(0, height, cell_px):
        for start in range(0, width, cell_px):
            best, x, y = least, -1, -1
            for row in range(max(top, BORDER_PX), min(top + cell_px, height - BORDER_PX)):
                for column in range(max(start, BORDER_PX), min(start + cell_px, width - BORDER_PX)):
                    if strength[row, column] > best:
                        best, x, y = strength[row, column], column, row
            # The strongest of a cell may lie on the slope of a stronger one next door.
            if x >= 0 and strength[y - 1 : y + 2, x - 1 : x + 2].max() <= best:
                found[n, 0] = x + _peak(strength[y, x - 1], best, strength[y, x + 1])
                found[n, 1] = y + _peak(strength[y - 1, x], best, strength[y + 1, x])
                n += 1
    return found[:n]


@kernel
def _peak(before, at, after):  # type: ignore[no-untyped-def]
    """Where the parabola through three neighbours has its top, from the middle one, -0.5..0.5."""
    curvature = before - 2.0 * at + after
    return 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0


@kernel
def describe(full, half, quarter, measured_px, scale, pattern):  # type: ignore[no-untyped-def]
    """Descriptors, uint64 [n, 4]: which spot of each pair is the darker one.

    The pattern is enlarged by `scale` and read from the level of the pyramid that fits.
    """
    descriptors = np.zeros((len(scale), 4), dtype=np.uint64)
    for k in range(len(scale)):
        level = 2 if scale[k] >= 2.8 else (1 if scale[k] >= 1.4 else 0)
        image = quarter if level == 2 else (half if level == 1 else full)
        height, width = image.shape
        per_px = np.float32(0.5**level)
        # Half a pixel is added, so that cutting off the fraction rounds.
        x = np.float32(measured_px[k, 0]) * per_px + np.float32(0.5)
        y = np.float32(measured_px[k, 1]) * per_px + np.float32(0.5)
        grow = np.float32(scale[k]) * per_px
        for word in range(4):
            bits = np.uint64(0)
            for bit in range(64):
                dx, dy, ex, ey = pattern[64 * word + bit]
                # Patches at the border are cut there: their inner half still tells them apart.
                a = image[
                    min(max(int(y + grow * dy), 0), height - 1),
                    min(max(int(x + grow * dx), 0), width - 1),
                ]
                b = image[
                    min(max(int(y + grow * ey), 0), height - 1),
                    min(max(int(x + grow * ex), 0), width - 1),
                ]
                if a < b:
                    bits |= np.uint64(1) << np.uint64(bit)
            descriptors[k, word] = bits
    return descriptors
