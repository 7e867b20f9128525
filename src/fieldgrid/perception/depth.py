"""Images of depths as codes with a table, and the rays that carry their pixels to points.

A disparity and a depth image differ only in what their integers mean. So both are int16 codes,
and a table tells the depth of each code: the inner loops are the same, and as fast.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float32, Float64, Int16, kernel
from fieldgrid.geometry import DepthCamera, Rig, StereoCamera

FINEST_STEP_M = 0.001
"""Depths are told to a millimetre, which reaches to 32.767 m; coarser only where a grid needs
more."""

FLYING_SHARE = 0.1
"""A pixel between foreground and background, nearer than one neighbour and farther than the
opposite one by more than this share of its depth, is a mixture of the two, and nothing is there.
Cameras that average over pixels make such, and so does scaling of their images. In the vineyard's
true depths, averaged over 3 x 3 pixels, dropping them raises the precision of obstacles from 93 to
97 % and costs 2 % of recall; of depths that are not mixed 0.3 % of recall."""

_CODES = 1 << 15


class CodedDepth(NamedTuple):
    """An image of depths: codes int16 [row, column] of the rows from `row_start`, where 0 and
    less is no depth, and `depth_m`, float32, the depth in metres along the optical axis by code."""

    codes: Int16
    row_start: int
    depth_m: Float32


class CameraRays(NamedTuple):
    """How a pixel becomes a point: P = z·(origin_ray + u·du + v·dv) + offset.

    Each a vector (x right, y forward, z up) in a level frame below the sensor; `offset_m` is
    the optical centre, of a pair that of the left camera.
    """

    origin_ray: Float32
    du: Float32
    dv: Float32
    offset_m: Float32


def rays(rig: Rig, A_grid_camera: Float64, height_m: float) -> CameraRays:
    """The rays of the camera that the depths are of, for the axes of a grid and a height above
    its ground."""
    camera = rig.sensor
    if isinstance(camera, StereoCamera):
        per_px_x = per_px_y = 1.0 / camera.focal_px
        centre = np.array([-camera.baseline_m / 2.0, 0.0, 0.0])  # left of the middle
    elif isinstance(camera, DepthCamera):
        per_px_x, per_px_y = 1.0 / camera.fx_px, 1.0 / camera.fy_px
        centre = np.zeros(3)
    else:
        raise CalibrationError("A lidar has no pixels; give its points as a cloud.")
    vectors = (
        A_grid_camera @ np.array([-camera.cx_px * per_px_x, -camera.cy_px * per_px_y, 1.0]),
        A_grid_camera[:, 0] * per_px_x,
        A_grid_camera[:, 1] * per_px_y,
        A_grid_camera @ centre + np.array([0.0, 0.0, height_m]),
    )
    return CameraRays(*(vector.astype(np.float32) for vector in vectors))


def depth_table(rig: Rig, num_disparities: int, subpixels: int) -> Float32:
    """Depth in metres by disparity in subpixels; infinite at 0, which also stands for no match."""
    disparity = np.arange((num_disparities + 1) * subpixels, dtype=np.float64) / subpixels
    effective = disparity - rig.camera.disparity_offset_px
    with np.errstate(divide="ignore"):
        depth = rig.camera.focal_baseline_px_m / effective
    depth[effective <= 0.0] = np.inf
    depth[0] = np.inf
    return depth.astype(np.float32)


def metric_table(farthest_m: float) -> Float32:
    """Depth in metres by code for depths up to at least `farthest_m`; infinite at 0."""
    step_m = max(FINEST_STEP_M, farthest_m / (_CODES - 1))
    depth = np.arange(_CODES, dtype=np.float64) * step_m
    depth[0] = np.inf
    return depth.astype(np.float32)


def encode_depth(depth_m: Float32, table_m: Float32) -> CodedDepth:
    """Depths [row, column] in metres, NaN where there is none, by a table of `metric_table`.

    What lies beyond the table has no depth either, as it is beyond the grid; nor has a pixel that
    mixes foreground and background.
    """
    per_code = (len(table_m) - 1) / float(table_m[-1])
    return CodedDepth(_coded(depth_m, np.float32(per_code)), 0, table_m)


@kernel
def _coded(depth_m, per_code):  # type: ignore[no-untyped-def]
    """The codes, without a branch in the inner loop: so it runs in vector registers."""
    height, width = depth_m.shape
    codes = np.zeros((height, width), dtype=np.int16)
    most, share = np.float32(_CODES - 1), np.float32(FLYING_SHARE)
    half, one, none = np.float32(0.5), np.float32(1.0), np.float32(0.0)
    padded = np.empty(width + 2, dtype=np.float32)
    for v in range(height):
        above, row, below = depth_m[max(v - 1, 0)], depth_m[v], depth_m[min(v + 1, height - 1)]
        padded[1:-1] = row
        padded[0], padded[-1] = row[0], row[-1]
        for u in range(width):
            z, left, right = row[u], padded[u], padded[u + 2]
            far, near = z + share * z, z - share * z
            flying = ((left < near) & (right > far)) | ((left > far) & (right < near))
            flying |= ((above[u] < near) & (below[u] > far)) | (
                (above[u] > far) & (below[u] < near)
            )
            code = z * per_code + half
            known = (code >= one) & (code < most) & (not flying)
            codes[v, u] = np.int16(np.int32(code if known else none))
    return codes


def points_per_rad(rig: Rig) -> float:
    """How many points the rig's sensor takes along a radian near its axis: of an image its
    focal length in pixels, of a lidar the root of its points per steradian."""
    sensor = rig.sensor
    if isinstance(sensor, StereoCamera):
        return sensor.focal_px
    if isinstance(sensor, DepthCamera):
        return math.sqrt(sensor.fx_px * sensor.fy_px)
    return math.sqrt(sensor.points_per_sr)
