"""Whether the camera measures as many metres as are driven.

Its way over that of the poses, which is that of the fixes: the smoother leaves the camera's scale
free. A baseline or a focal length that is not that of the images, or pairs that were shifted
sideways since they were calibrated, make all distances of the grids longer or shorter.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, StopCode, error, warning
from fieldgrid.geometry import DepthCamera, FixColumns, Rig, Status, Steps, StereoCamera, Trajectory

SCALE_WARN, SCALE_ERROR, CLEAR_SIGMAS = 0.03, 0.05, 4.0
"""How far the camera's way may be off that of the fixes before it is told, and before it stops a
build; and by how many sigmas it is."""

LEAST_WAY_M, LEAST_STEP_M, PARTS = 10.0, 0.1, 8

CALIBRATION_SHARE = 0.005
"""Disparities that are off by a tenth of a pixel, where most points are, make half a per cent."""

CLIMB_OVER_M = 16.0
"""The way over which a slope is taken from heights, so that their noise makes none."""

FLAT_SHARE = 0.02
"""The share by which a slope of 11 degrees, which nothing tells without heights, makes the camera's
way longer than its plan. Four times this share is a slope of 22 degrees."""


class CameraScale(NamedTuple):
    """The way by the camera over the way by the fixes, its 1-sigma error, and the length of the way
    in metres."""

    ratio: float
    sigma: float
    distance_m: float

    @property
    def is_off(self) -> bool:
        """Whether it is certainly not 1."""
        return abs(self.ratio - 1.0) > max(SCALE_WARN, CLEAR_SIGMAS * self.sigma)

    @property
    def stops(self) -> bool:
        """Whether it certainly differs from 1 by more than `SCALE_ERROR`: the map would be
        wrong."""
        return self.is_off and abs(self.ratio - 1.0) > SCALE_ERROR


def tells_heights(fixes: FixColumns) -> bool:
    """Whether fixes have heights; where a log has none they are all 0."""
    return len(fixes) > 0 and bool(np.ptp(fixes.height_m) > 0.0)


def camera_scale(
    steps: Steps | None, trajectory: Trajectory, offset_ns: int = 0, *, heights_told: bool
) -> CameraScale | None:
    """The camera's way beside that of the poses, projected on the nose, so that noise does not
    lengthen it, and along the slope where heights are told; None where too little can be compared.
    `offset_ns` is added to the steps' times."""
    if steps is None or not trajectory.accepted.any():
        return None
    camera_m, plan_m, place_m = [], [], []
    times = zip(steps.start_ns.tolist(), steps.stop_ns.tolist(), strict=True)
    for k, (start_ns, stop_ns) in enumerate(times):
        one, other = trajectory.at(start_ns + offset_ns), trajectory.at(stop_ns + offset_ns)
        forward_m = float(steps.forward_m[k])
        if Status.REJECTED in (one.status, other.status) or abs(forward_m) < LEAST_STEP_M:
            continue
        nose = math.radians(one.heading_deg)
        east_m, north_m = other.east_m - one.east_m, other.north_m - one.north_m
        distance_m = east_m * math.sin(nose) + north_m * math.cos(nose)
        camera_m.append(abs(forward_m))
        plan_m.append(math.copysign(1.0, forward_m) * distance_m)
        place_m.append((one.east_m, one.north_m, (one.up_m + other.up_m) / 2.0))
    by_camera, by_fixes = np.array(camera_m), np.array(plan_m)
    if by_fixes.sum() < LEAST_WAY_M or len(by_fixes) < PARTS:
        return None
    if heights_told:
        by_fixes = by_fixes * np.hypot(1.0, _slope(np.array(place_m)))
    parts = np.array_split(np.arange(len(by_camera)), PARTS)
    rest = np.array(
        [
            (by_camera.sum() - by_camera[part].sum()) / (by_fixes.sum() - by_fixes[part].sum())
            for part in parts
        ]
    )
    scatter = math.sqrt((PARTS - 1) / PARTS * float(((rest - rest.mean()) ** 2).sum()))
    way_m = float(by_fixes.sum())
    # What all parts share: calibration, slopes that nothing tells, and fixes that are off at both
    # ends of the way.
    ends_m = math.sqrt(2.0) * float(np.median(trajectory.position_sigma_m[trajectory.accepted]))
    slope = 0.0 if heights_told else FLAT_SHARE
    sigma = math.hypot(scatter, CALIBRATION_SHARE, slope, ends_m / way_m)
    return CameraScale(float(by_camera.sum()) / way_m, sigma, way_m)


def _slope(place_m: Float64) -> Float64:
    """How steeply the way goes up at some places [n, 3] in order, metres a metre."""
    apart_m = np.hypot(*np.diff(place_m[:, :2], axis=0).T)
    way_m = np.concatenate([[0.0], np.cumsum(apart_m)])
    ends_m = np.clip(way_m + np.array([[-0.5], [0.5]]) * CLIMB_OVER_M, 0.0, way_m[-1])
    before_m, after_m = (np.interp(end, way_m, place_m[:, 2]) for end in ends_m)
    return np.asarray((after_m - before_m) / np.maximum(ends_m[1] - ends_m[0], CLIMB_OVER_M / 2.0))


def scale_findings(scale: CameraScale | None, rig: Rig) -> Iterator[Finding]:
    """That the camera's way is certainly not that of the fixes, and with it the distances of the
    grids."""
    sensor = rig.sensor
    if scale is None or not scale.is_off or not isinstance(sensor, StereoCamera | DepthCamera):
        return
    remedy = "Check the unit of the depth images and the focal length of the camera."
    if isinstance(sensor, StereoCamera):
        remedy = (
            f"A baseline of {sensor.baseline_m / scale.ratio:.4f} m instead of "
            f"{sensor.baseline_m:.4f} m would agree: check it (P[3] = -f·b of the right camera, "
            "stereo_baseline_m) and the focal length, or calibrate the pair again if the cameras "
            "have moved relative to each other."
        )
    yield (error if scale.stops else warning)(
        StopCode.SCALE.value,
        f"The camera measures {scale.ratio:.3f} ± {scale.sigma:.3f} times the distance of the "
        f"fixes (over {scale.distance_m:.0f} m), and so do the grids.",
        remedy,
        Figure(scale.ratio, "times"),
    )
