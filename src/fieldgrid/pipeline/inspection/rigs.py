"""What is wrong with the rig: by itself, beside the ground that is seen, and beside the fixes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from fieldgrid.core import Figure, Finding, warning
from fieldgrid.geometry import DepthCamera, Lidar, Rig, Sensor, StereoCamera
from fieldgrid.pipeline.checks.camera_scale import CameraScale
from fieldgrid.pipeline.mounting.estimate import HEIGHT, ROLL, TILT, MountEstimate

LOWEST_M, HIGHEST_M = 0.3, 6.0

OFF_CENTRE_SHARE = 0.2
"""A principal point is seldom farther off the middle, as a share of the image's side."""

NARROWEST_DEG, WIDEST_DEG = 15.0, 150.0

HEIGHT_SHARE, LEAN_DEG = 0.08, 1.5
"""A mounting that is off by less than these costs no map: each frame finds its own ground."""

MOUNT_VALUES = {HEIGHT: ("height", " m"), TILT: ("tilt", "°"), ROLL: ("roll", "°")}
"""What is compared of a mounting here, by its key; the yaw has findings of its own."""


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


def mount_findings(
    seen: MountEstimate | None, scale_found: CameraScale | None
) -> Iterator[Finding]:
    """A mounting that is not that of these images. A wrong scale also makes a wrong height."""
    if seen is None:
        return
    by = scale_found.ratio if scale_found is not None and scale_found.is_off else 1.0
    height_m = seen.height_m._replace(value=seen.height_m.value / by)
    for one in replace(seen, height_m=height_m).compared():
        value, sigma = one.measured
        least = HEIGHT_SHARE * one.stated if one.key == HEIGHT else LEAN_DEG
        if one.key in MOUNT_VALUES and one.disagrees and abs(value - one.stated) > least:
            what, unit = MOUNT_VALUES[one.key]
            yield warning(
                f"mounting-{what}",
                f"By the {seen.method}, the camera's {what} is {value:.2f} ± {sigma:.2f}{unit}; "
                f"the mounting says {one.stated:.2f}{unit}.",
                f"Measure it with `fieldgrid mount`, or correct {one.key} in mounting.json.",
                Figure(value, "m" if one.key == HEIGHT else "deg"),
            )
