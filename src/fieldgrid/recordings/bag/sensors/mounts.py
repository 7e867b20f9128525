"""How things sit on the vehicle of a bag: by its mounting, else by static transforms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64, quoted
from fieldgrid.geometry import LeverArm, Mount, Rig, Sensor
from fieldgrid.recordings.bag.sensors.clouds import R_OPTICAL_FLU
from fieldgrid.recordings.bag.transforms import FrameTransform, Transforms
from fieldgrid.recordings.calibration.kitti import mount_angles_deg
from fieldgrid.recordings.calibration.mounting import (
    MOUNTING,
    Mounting,
    estimating,
    missing_mounting,
)
from fieldgrid.recordings.options import NO_MOUNTING, DriveOptions
from fieldgrid.recordings.ros.gnss_messages import RIG
from fieldgrid.recordings.tables.motion_files import directions

GROUND, BASE = "base_footprint", "base_link"
"""Frames by the convention of ROS: on the ground below the vehicle, and on the vehicle."""

AXLE = "rear_axle"
"""The frame of the axle that does not steer; ROS has no convention for it."""

_VEHICLE_FROM_FLU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_SAME = 1e-9
_DIGITS = 9
"""A nanometre and less than a microradian; beyond are the rounding errors of quaternions."""


class SensorMounting(NamedTuple):
    """The mounting of a sensor, the turn of points that it does not tell, remarks, and the sensor
    itself where the bag says it exactly."""

    mounting: Mounting
    R_sensor: Float64
    notes: tuple[str, ...] = ()
    sensor: Sensor | None = None


class SensorFrame(NamedTuple):
    """Which frame a sensor's data are in: `R` turns its directions into the sensor frame's
    (right, down, forward). In the latter, `origin_m` is the point above the grid origin: of a
    pair the middle of the baseline; and `measured_m` the point that a mounting.json counts from,
    which is the middle of a pair even where its left camera alone gives the depths."""

    name: str
    R: Float64
    origin_m: Float64
    measured_m: Float64


def mounting_path(path: Path) -> Path:
    """The mounting beside a bag that is one file, which has its name unless another is there; of a
    folder, in it."""
    if path.is_dir():
        return path / MOUNTING
    shared, own = path.with_name(MOUNTING), path.with_name(f"{path.stem}.{MOUNTING}")
    return shared if shared.exists() and not own.exists() else own


def find_mounting(
    path: Path, options: DriveOptions, transforms: Transforms, sensor: SensorFrame, antenna: str
) -> SensorMounting:
    """The mounting that is given or lies beside the bag, else that of its static transforms.

    `antenna` is the frame of the fixes. Raises CalibrationError when nothing tells it.
    """
    usual = mounting_path(path)
    if options.mounting is not None or usual.exists():
        return SensorMounting(_moved(options.find_mounting(usual, path), sensor), np.eye(3))
    try:
        return _by_transforms(path, usual, transforms, sensor, antenna)
    except CalibrationError:
        if not options.unmounted:
            raise
        return SensorMounting(NO_MOUNTING, np.eye(3))


def exactly(rig: Rig) -> SensorMounting:
    """The mounting and the sensor of a rig that the bag itself says."""
    mounting = Mounting(
        rig.mount,
        rig.antenna,
        rig.rear_axle_forward_m,
        rig.heading_offset_deg,
        rig.heading_convention,
        source=RIG,
    )
    return SensorMounting(mounting, np.eye(3), (f"Mount and antenna by {RIG}.",), rig.sensor)


def _by_transforms(
    path: Path, usual: Path, transforms: Transforms, sensor: SensorFrame, antenna: str
) -> SensorMounting:
    placed = transforms.place(sensor.name, GROUND)
    if placed is None and transforms.place(sensor.name, BASE) is not None:
        raise CalibrationError(
            f"{path}: its static transforms place the sensor ({quoted(sensor.name)}) on {BASE}, "
            f"but do not say how high that is above the ground; record the transform from {GROUND} "
            f"to {BASE}, or write {usual} ({estimating(path)} estimates it)."
        )
    if placed is None:
        raise missing_mounting(usual, path)
    at_antenna = transforms.place(antenna, GROUND)
    if at_antenna is None:
        raise CalibrationError(
            f"{path}: its static transforms place the sensor ({quoted(sensor.name)}) above "
            f"{GROUND}, but not the antenna ({quoted(antenna or 'no frame_id')}), and a forgotten "
            f"lever arm misplaces the whole map; record the antenna's transform, or write {usual} "
            f"({estimating(path)} does)."
        )
    axle = transforms.place(AXLE, GROUND)
    return _mounted(path, placed, at_antenna, axle, sensor)


def _moved(mounting: Mounting, sensor: SensorFrame) -> Mounting:
    """The mounting of the grid origin by that of the point that it was measured from."""
    apart_m = sensor.measured_m - sensor.origin_m
    if not apart_m.any():
        return mounting
    right, forward, up = (mounting.mount.rotation() @ apart_m).tolist()
    arm, axle_m = mounting.antenna, mounting.rear_axle_forward_m
    return replace(
        mounting,
        mount=replace(mounting.mount, height_m=mounting.mount.height_m - up),
        antenna=LeverArm(arm.right_m + right, arm.forward_m + forward, arm.up_m),
        rear_axle_forward_m=None if axle_m is None else axle_m + forward,
    )


def _mounted(
    path: Path,
    placed: FrameTransform,
    antenna: FrameTransform,
    axle: FrameTransform | None,
    sensor: SensorFrame,
) -> SensorMounting:
    """The mounting by places below the ground's frame: of the sensor, the antenna, the axle."""
    R = _VEHICLE_FROM_FLU @ placed.R @ sensor.R.T
    origin = _VEHICLE_FROM_FLU @ (placed.at_m + placed.R @ sensor.R.T @ sensor.origin_m)
    below = np.array([origin[0], origin[1], 0.0])
    height_m = _rounded(origin[2])
    R_sensor, notes = np.eye(3), [f"Mount and antenna by static transforms below {GROUND}."]
    try:
        mount = Mount(height_m, *map(_rounded, mount_angles_deg(R)))
    except CalibrationError:
        if sensor.origin_m.any():
            raise
        # A lidar may look anywhere; what a mount cannot say is done to its points.
        mount, R_sensor = Mount(height_m, 0.0), Mount(1.0, 0.0).rotation().T @ R
        notes.append(f"The points of {sensor.name} are turned to look ahead.")
    try:
        arm = LeverArm(*map(_rounded, _VEHICLE_FROM_FLU @ antenna.at_m - below))
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem
    axle_m = None if axle is None else _rounded((_VEHICLE_FROM_FLU @ axle.at_m - below)[1])
    source = f"{path.name}: /tf_static"
    return SensorMounting(Mounting(mount, arm, axle_m, source=source), R_sensor, tuple(notes))


def _rounded(value: float) -> float:
    return round(float(value), _DIGITS) + 0.0  # and no -0


def is_optical(frame: str) -> bool:
    """Whether a frame is named as one whose axes point right, down and forward."""
    return "optical" in frame.lower()


def optical(frame: str, transforms: Transforms, axes: str | None = None) -> Float64:
    """Turns directions of a sensor's frame into right, down, forward.

    `axes` are where its x, y and z point, when that is said. Else frames whose name says so are
    optical, and others are taken as forward, left, up, unless the static transforms show their x
    axis to point right and their z axis not up.
    """
    if axes is not None:
        return R_OPTICAL_FLU @ np.array(directions(axes), dtype=np.float64).T
    if is_optical(frame):
        return np.eye(3)
    for base in (GROUND, BASE):
        placed = transforms.place(frame, base)
        if placed is not None and placed.R[1, 0] < -0.5 and placed.R[2, 2] < 0.5:
            return np.eye(3)
    return R_OPTICAL_FLU


def imu_rotation(imu_frame: str, transforms: Transforms) -> Float64 | None:
    """From an IMU's axes to those of the vehicle, forward, left, up [3, 3]; None where no static
    transform tells it."""
    for base in (BASE, GROUND):
        placed = transforms.place(imu_frame, base)
        if placed is not None:
            whole = np.round(placed.R)
            return np.asarray(whole if np.abs(whole - placed.R).max() < _SAME else placed.R)
    return None
