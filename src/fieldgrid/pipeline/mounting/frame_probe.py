"""What one frame shows of the ground, and what odometry needs of it: points of any sensor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float32, Float64, StereoSettings, UInt8
from fieldgrid.geometry import DepthCamera, Lidar, Rig, StereoCamera
from fieldgrid.perception import SUBPIXELS, Features, StereoMatcher, Sweep, features, whole_image
from fieldgrid.pipeline.mounting.ground_under_vehicle import REACH_M, Patches
from fieldgrid.pipeline.mounting.plane import (
    PATCH_M,
    SPARSE_PATCH_M,
    SensorGround,
    low_patches,
    refined_plane,
    rough_plane,
)
from fieldgrid.recordings import Frame

STEP_PX = 4
"""Every fourth pixel of every fourth row is enough for the ground."""

NEAREST_M = 2.0
"""Nothing nearer is searched for."""

RANGE_M, MOST_RANGE_SIGMA_M = 25.0, 1.0
"""Points farther off, or less sure, say nothing about the ground near the vehicle."""

DEPTH_SHARE, LIDAR_SIGMA_M = 0.01, 0.03
"""Errors of a depth, as a share of it, where nothing is known of its making; and of a lidar."""


class FrameSample(NamedTuple):
    """One frame: the plane ahead and the patches of ground, None and none where there was no
    ground to be seen; `features` of a stereo pair."""

    time_ns: int
    ahead: SensorGround | None
    patches: Patches
    features: Features | None


SensorPoints = tuple[Float64, Float64, Features | None]
"""Points [n, 3] of the sensor's frame, their sigma [n], and the features of a pair."""


class FrameProbe:
    """Looks at the frames of one rig, of whose mount it knows nothing; safe in threads."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._settings = rig, StereoSettings()
        self._patch_m = SPARSE_PATCH_M if isinstance(rig.sensor, Lidar) else PATCH_M
        if isinstance(rig.sensor, StereoCamera):
            self._matcher = _matcher(rig.sensor, self._settings)

    def __call__(self, frame: Frame) -> FrameSample:
        """Everything that is needed of a frame; reads its images."""
        points_m, sigma_m, seen = frame.read(self)
        range_m = np.linalg.norm(points_m, axis=1)
        usable = (range_m > 0.2) & (range_m < RANGE_M) & (sigma_m < MOST_RANGE_SIGMA_M)
        points_m, sigma_m = points_m[usable], sigma_m[usable]
        rough = rough_plane(points_m, sigma_m)
        plane = rough and refined_plane(rough, points_m, sigma_m, self._patch_m)
        if plane is None:
            return FrameSample(frame.time_ns, None, Patches(np.zeros((0, 3)), np.zeros(0)), seen)
        x, y, z, sigma = low_patches(plane, points_m, sigma_m, self._patch_m).T
        near = np.hypot(x, y) < REACH_M
        level = np.column_stack([x, y, z - plane.height_m])[near]
        return FrameSample(
            frame.time_ns, plane, Patches(level @ plane.rotation(), sigma[near]), seen
        )

    def pair(self, left: UInt8, right: UInt8) -> SensorPoints:
        """What a pair shows, seen from the middle of the baseline."""
        camera, sigma_px = self._rig.camera, self._settings.disparity_sigma_px
        disparity = self._matcher.disparity(left, right).values[::STEP_PX, ::STEP_PX]
        shift_px = disparity / SUBPIXELS - camera.disparity_offset_px
        is_seen = (disparity > 0) & (shift_px > 0.5)
        depth_m = np.where(is_seen, camera.focal_baseline_px_m / np.maximum(shift_px, 0.5), np.nan)
        points_m = _unprojected(depth_m, camera, (camera.focal_px, camera.focal_px))
        points_m[:, 0] -= camera.baseline_m / 2.0
        sigma_m = camera.range_sigma_m(points_m[:, 2], sigma_px)
        return points_m, sigma_m, features(camera, left, right)

    def depth(self, depth_m: Float32) -> SensorPoints:
        """What an image of depths shows."""
        camera, sigma_px = self._rig.depth_camera, self._settings.disparity_sigma_px
        depth = depth_m[::STEP_PX, ::STEP_PX].astype(np.float64)
        points_m = _unprojected(depth, camera, (camera.fx_px, camera.fy_px))
        z = points_m[:, 2]
        sigma_m = DEPTH_SHARE * z
        if camera.baseline_m is not None:
            sigma_m = z * z * sigma_px / (camera.fx_px * camera.baseline_m)
        return points_m, sigma_m, None

    def cloud(self, sweep: Sweep) -> SensorPoints:
        """What a cloud shows, as it was seen."""
        points_m = sweep.points_m.astype(np.float64)
        return points_m, np.full(len(points_m), LIDAR_SIGMA_M), None


def _matcher(camera: StereoCamera, settings: StereoSettings) -> StereoMatcher:
    nearest_px = camera.focal_baseline_px_m / NEAREST_M + camera.disparity_offset_px
    number = max(16, 16 * round(min(nearest_px, camera.width_px / 4.0) / 16.0))
    return StereoMatcher(camera, settings, whole_image(camera, number))


def _unprojected(
    depth_m: Float64, camera: StereoCamera | DepthCamera, focal_px: tuple[float, float]
) -> Float64:
    """Points [n, 3] of the camera's frame, of the pixels that are taken whose depths [row, column]
    are known."""
    row, column = np.nonzero((depth_m > 0.0) & (depth_m < np.inf))
    z = depth_m[row, column]
    x = (column * STEP_PX - camera.cx_px) / focal_px[0]
    y = (row * STEP_PX - camera.cy_px) / focal_px[1]
    return np.column_stack([x * z, y * z, z])
