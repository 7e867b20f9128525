"""What is wrong with the rig: by itself, beside the ground that is seen, and beside the fixes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.geometry import DepthCamera, Lidar, Mount, Rig, Sensor, StereoCamera
from fieldgrid.perception import FrameGround
from fieldgrid.pipeline.checks.camera_scale import CameraScale
from fieldgrid.pipeline.inspection.findings import Finding, info, warning

LOWEST_M, HIGHEST_M = 0.3, 6.0

OFF_CENTRE_SHARE = 0.2
"""A principal point is seldom farther off the middle, as a share of the image's side."""

NARROWEST_DEG, WIDEST_DEG = 15.0, 150.0

HEIGHT_SHARE, LEAN_DEG, CLEAR_SIGMAS = 0.08, 1.5, 4.0
"""A mounting disagrees with the ground when height, tilt or roll is off by more than these, and
by more than `CLEAR_SIGMAS` errors of the mean: the ground ahead is not the one under the wheels."""

FEWEST_GROUNDS = 5


class GroundSeen(NamedTuple):
    """The mount as the ground ahead shows it: medians over the frames, and their 1-sigma errors."""

    height_m: float
    height_sigma_m: float
    tilt_deg: float
    tilt_sigma_deg: float
    roll_deg: float
    roll_sigma_deg: float
    frames: int


def rig_findings(rig: Rig) -> Iterator[Finding]:
    """What is strange about a rig by itself."""
    lever, height_m = rig.antenna, rig.mount.height_m
    at_camera = math.hypot(lever.right_m, lever.forward_m) < 1e-3
    if at_camera and abs(lever.up_m - height_m) < 1e-3:
        yield warning(
            "lever-arm-zero",
            "The mounting has a zero lever arm: the antenna is in the middle of the camera.",
            "Measure gnss_antenna_from_camera_mid_flu_m, [forward, left, up] in metres: an error "
            "shifts the whole map.",
        )
    elif lever.up_m < 0.2:
        yield warning(
            "lever-arm-low",
            f"The mounting puts the antenna {lever.up_m:.2f} m above the ground.",
            "Check the third number of gnss_antenna_from_camera_mid_flu_m, metres up.",
        )
    if not LOWEST_M <= height_m <= HIGHEST_M:
        yield warning(
            "camera-height",
            f"A camera height of {height_m:g} m above ground is unusual.",
            "Check camera_height_above_ground_m in mounting.json; it is in metres.",
        )
    if rig.rear_axle_forward_m is None:
        yield info(
            "axle-unknown",
            "The mounting does not name the non-steering axle; it is assumed below the antenna.",
            "Add camera_mid_from_rear_axle_ground_flu_m; an error of a metre turns headings by 11° "
            "at a turning radius of 5 m.",
        )
    yield from _lens_findings(rig.sensor)


def _lens_findings(sensor: Sensor) -> Iterator[Finding]:
    if isinstance(sensor, Lidar):
        return
    focal_px = sensor.focal_px if isinstance(sensor, StereoCamera) else sensor.fx_px
    sides = (("cx", sensor.cx_px, sensor.width_px), ("cy", sensor.cy_px, sensor.height_px))
    for name, centre_px, size_px in sides:
        if abs(centre_px / size_px - 0.5) > OFF_CENTRE_SHARE:
            yield warning(
                "principal-point",
                f"The calibration has its principal point {name} = {centre_px:.1f} px in an image "
                f"of {size_px} px, far from the middle.",
                "Check that it is for this image size, and not for a rotated or cropped image.",
            )
    view_deg = math.degrees(2.0 * math.atan(sensor.width_px / (2.0 * focal_px)))
    if not NARROWEST_DEG <= view_deg <= WIDEST_DEG:
        yield warning(
            "focal-length",
            f"The calibration gives a view of {view_deg:.0f}° across, by a focal length of "
            f"{focal_px:.0f} px in an image {sensor.width_px} px wide.",
            "Check that it is for this image size; the focal length is in pixels.",
        )


def describe_sensor(sensor: Sensor) -> str:
    """A sensor in a few words."""
    if isinstance(sensor, StereoCamera):
        return (
            f"{sensor.width_px} x {sensor.height_px} px, f {sensor.focal_px:.1f} px, baseline "
            f"{sensor.baseline_m:.3f} m"
        )
    if isinstance(sensor, DepthCamera):
        return f"depth, {sensor.width_px} x {sensor.height_px} px, f {sensor.fx_px:.1f} px"
    return f"lidar, {sensor.points_per_sr:.0f} points/sr"


def ground_seen(grounds: Sequence[FrameGround], mount: Mount) -> GroundSeen | None:
    """The mount as the ground shows it; None where it was found in too few frames."""
    found = [ground for ground in grounds if ground.refined]
    if len(found) < FEWEST_GROUNDS:
        return None
    height_m = np.array([ground.camera_height_m for ground in found])
    # Ground that seems to rise ahead is seen by a camera that looks farther down than it says.
    tilt_deg = mount.tilt_deg + np.array([ground.pitch_deg for ground in found])
    roll_deg = mount.roll_deg + np.array([ground.roll_deg for ground in found])
    return GroundSeen(
        height_m=float(np.median(height_m)),
        height_sigma_m=_error(height_m),
        tilt_deg=float(np.median(tilt_deg)),
        tilt_sigma_deg=_error(tilt_deg),
        roll_deg=float(np.median(roll_deg)),
        roll_sigma_deg=_error(roll_deg),
        frames=len(found),
    )


def mount_findings(
    seen: GroundSeen | None, mount: Mount, scale_found: CameraScale | None
) -> Iterator[Finding]:
    """A mounting that is not that of these images. A wrong scale also makes a wrong height."""
    if seen is None:
        return
    by = scale_found.ratio if scale_found is not None and scale_found.is_off else 1.0
    remedy = "Measure it with `fieldgrid mount`, or correct {} in mounting.json."
    height_m = seen.height_m / by
    off_m = height_m - mount.height_m
    if abs(off_m) > max(HEIGHT_SHARE * mount.height_m, CLEAR_SIGMAS * seen.height_sigma_m):
        yield warning(
            "mounting-height",
            f"The ground is {height_m:.2f} ± {seen.height_sigma_m:.2f} m below the camera in "
            f"{seen.frames} frames; the mounting says {mount.height_m:.2f} m.",
            remedy.format("camera_height_above_ground_m"),
        )
    for what, seen_deg, sigma_deg, said_deg, key in (
        ("tilt", seen.tilt_deg, seen.tilt_sigma_deg, mount.tilt_deg, "camera_tilt_down_deg"),
        ("roll", seen.roll_deg, seen.roll_sigma_deg, mount.roll_deg, "camera_roll_deg"),
    ):
        if abs(seen_deg - said_deg) > max(LEAN_DEG, CLEAR_SIGMAS * sigma_deg):
            yield warning(
                f"mounting-{what}",
                f"From the ground, the camera's {what} is {seen_deg:.1f} ± {sigma_deg:.1f}° in "
                f"{seen.frames} frames; the mounting says {said_deg:.1f}°.",
                remedy.format(key),
            )


def _error(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    """The 1-sigma error of a median."""
    return 1.25 * float(np.std(values)) / math.sqrt(len(values))
