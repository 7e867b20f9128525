"""What one frame shows of the ground, and what odometry needs of it: points of any sensor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float32, Float64, Index, UInt8
from fieldgrid.build.perception import checked_depth_m
from fieldgrid.errors import RecordingError
from fieldgrid.mounting.passed import REACH_M, Patches
from fieldgrid.mounting.plane import (
    PATCH_M,
    SPARSE_PATCH_M,
    Plane,
    low_patches,
    refined_plane,
    rough_plane,
)
from fieldgrid.odometry import Features, features
from fieldgrid.recording import CloudFrame, DepthFrame, Frame
from fieldgrid.recording.protocol import pair_of
from fieldgrid.rig import DepthCamera, Lidar, Rig, StereoCamera
from fieldgrid.settings import StereoSettings
from fieldgrid.stereo import SUBPIXELS, StereoMatcher, whole_image

STEP_PX = 4
"""Every fourth pixel of every fourth row is enough for the ground."""

NEAREST_M = 2.0
"""Nothing nearer is searched for."""

RANGE_M, MOST_RANGE_SIGMA_M = 25.0, 1.0
"""Points farther off, or less sure, say nothing about the ground near the vehicle."""

DEPTH_SHARE, LIDAR_SIGMA_M = 0.01, 0.03
"""Errors of a depth, as a share of it, where nothing is known of its making; and of a lidar."""


class Look(NamedTuple):
    """One frame: the plane ahead and the patches of ground, None and none where there was no
    ground to be seen; `features` of a stereo pair."""

    time_ns: int
    ahead: Plane | None
    patches: Patches
    features: Features | None


class Looker:
    """Looks at the frames of one rig, of whose mount it knows nothing; safe in threads."""

    def __init__(self, rig: Rig, stereo: StereoSettings | None = None) -> None:
        self._sensor = rig.sensor
        self._sigma_px = (stereo or StereoSettings()).disparity_sigma_px
        if isinstance(self._sensor, StereoCamera):
            self._matcher = _matcher(self._sensor, stereo or StereoSettings())

    def __call__(self, frame: Frame) -> Look:
        """Everything that is needed of a frame; reads its images."""
        seen: Features | None = None
        if isinstance(self._sensor, StereoCamera):
            left, right = pair_of(frame).images()
            seen = features(self._sensor, left, right)
            points_m, sigma_m = self._of_pair(self._sensor, left, right)
        elif isinstance(self._sensor, DepthCamera) and isinstance(frame, DepthFrame):
            points_m, sigma_m = self._of_depth(self._sensor, checked_depth_m(frame))
        else:
            points_m, sigma_m = _of_cloud(frame)
        range_m = np.linalg.norm(points_m, axis=1)
        usable = (range_m > 0.2) & (range_m < RANGE_M) & (sigma_m < MOST_RANGE_SIGMA_M)
        patch_m = SPARSE_PATCH_M if isinstance(self._sensor, Lidar) else PATCH_M
        plane, patches = _ground(points_m[usable], sigma_m[usable], patch_m)
        return Look(frame.time_ns, plane, patches, seen)

    def _of_pair(self, camera: StereoCamera, left: UInt8, right: UInt8) -> tuple[Float64, Float64]:
        disparity = self._matcher.disparity(left, right).values[::STEP_PX, ::STEP_PX]
        row, column = np.nonzero(disparity > 0)
        shift_px = disparity[row, column] / SUBPIXELS - camera.disparity_offset_px
        far = shift_px > 0.5
        row, column, shift_px = row[far], column[far], shift_px[far]
        depth_m = camera.focal_baseline_px_m / shift_px
        focal_px = camera.focal_px
        points_m = _unprojected(column, row, depth_m, camera, (focal_px, focal_px))
        points_m[:, 0] -= camera.baseline_m / 2.0  # seen from the middle of the baseline
        return points_m, camera.range_sigma_m(depth_m, self._sigma_px)

    def _of_depth(self, camera: DepthCamera, depth_m: Float32) -> tuple[Float64, Float64]:
        depth = depth_m[::STEP_PX, ::STEP_PX].astype(np.float64)
        row, column = np.nonzero(np.isfinite(depth) & (depth > 0.0) & (depth < RANGE_M))
        z = depth[row, column]
        points_m = _unprojected(column, row, z, camera, (camera.fx_px, camera.fy_px))
        if camera.baseline_m is None:
            return points_m, DEPTH_SHARE * z
        return points_m, z * z * self._sigma_px / (camera.fx_px * camera.baseline_m)


def _matcher(camera: StereoCamera, settings: StereoSettings) -> StereoMatcher:
    nearest_px = camera.focal_baseline_px_m / NEAREST_M + camera.disparity_offset_px
    searched = min(nearest_px, camera.width_px / 4.0)
    number = max(16, 16 * round(searched / 16.0))
    return StereoMatcher(camera, settings, whole_image(camera, number))


def _unprojected(
    column: Index,
    row: Index,
    depth_m: Float64,
    camera: StereoCamera | DepthCamera,
    focal_px: tuple[float, float],
) -> Float64:
    """Points [n, 3] of the camera's frame, of pixels among those that are taken."""
    x = (column * STEP_PX - camera.cx_px) / focal_px[0]
    y = (row * STEP_PX - camera.cy_px) / focal_px[1]
    return np.column_stack([x * depth_m, y * depth_m, depth_m])


def _of_cloud(frame: Frame) -> tuple[Float64, Float64]:
    if not isinstance(frame, CloudFrame):
        raise RecordingError(
            f"Frame {frame.frame_id} does not fit the rig's sensor; give a recording of one sensor."
        )
    points_m = frame.cloud.read().astype(np.float64)
    return points_m, np.full(len(points_m), LIDAR_SIGMA_M)


def _ground(points_m: Float64, sigma_m: Float64, patch_m: float) -> tuple[Plane | None, Patches]:
    nothing = Patches(np.zeros((0, 3)), np.zeros(0))
    rough = rough_plane(points_m, sigma_m)
    plane = rough and refined_plane(rough, points_m, sigma_m, patch_m)
    if plane is None:
        return None, nothing
    x, y, z, sigma = low_patches(plane, points_m, sigma_m, patch_m).T
    near = np.hypot(x, y) < REACH_M
    level = np.column_stack([x, y, z - plane.height_m])[near]
    return plane, Patches(level @ plane.rotation(), sigma[near])
