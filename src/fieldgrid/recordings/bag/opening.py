"""A bag as a drive: frames as a stream, the rest heard once while it opens; and how its sensor is
mounted: by its mounting, else by static transforms."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64, LackingError, RecordingError
from fieldgrid.geometry import LeverArm, Mount, Sensor
from fieldgrid.recordings.bag.content import BagIndex, Readings, as_drive, read_content
from fieldgrid.recordings.bag.motion import find_motion
from fieldgrid.recordings.bag.sensors.frame_sensor import FrameSensor, lidar, sense
from fieldgrid.recordings.bag.sensors.frames import BagFrames
from fieldgrid.recordings.bag.topics import short
from fieldgrid.recordings.bag.transforms import BASE, GROUND
from fieldgrid.recordings.calibration.kitti import mount_angles_deg
from fieldgrid.recordings.calibration.mounting import (
    MOUNTING,
    Mounting,
    estimating,
    missing_mounting,
)
from fieldgrid.recordings.drive import Drive, Stream, as_recording, with_motion
from fieldgrid.recordings.options import NO_MOUNTING, DriveOptions
from fieldgrid.recordings.ros.gnss_messages import RIG, rig_of
from fieldgrid.recordings.tables.motion_files import AXES, R_VEHICLE_FLU

AXLE = "rear_axle"
"""The frame of the axle that does not steer; ROS has no convention for it."""

_DIGITS = 9
"""A nanometre and less than a microradian; beyond are the rounding errors of quaternions."""


def open_bag_drive(path: Path, options: DriveOptions) -> Drive:
    """The drive in a bag, which is held open. Without frames, or a rig that they can be used with,
    it says why."""
    with ExitStack() as stack:
        readings = Readings(path, options)
        bag = stack.enter_context(readings.bag)
        content = read_content(path, options, readings)
        drive, imu_axes = as_drive(content), AXES
        try:
            sensed = _sensed(content, options)
            mounted = find_mounting(content, options, sensed)
            if sensed.maker is None:
                R = mounted.R_sensor @ sensed.R
                sensed = lidar(content, sensed, R, mounted.sensor)
            sensor = mounted.sensor or sensed.sensor
            assert sensor is not None
            assert sensed.maker is not None
            offset_ns = options.offset_or(content.settings.image_time_offset_ns)
            drive = as_recording(
                drive,
                mounted.mounting.rig(sensor, offset_ns),
                BagFrames(bag, sensed.plan, sensed.maker),
                (*sensed.notes, *mounted.notes),
                is_mounted=mounted.mounting is not NO_MOUNTING,
            )
            imu_axes = mounted.mounting.imu_axes
        except RecordingError as problem:
            drive = replace(drive, refusal=problem)
        drive = with_motion(drive, *find_motion(content, imu_axes))
        role_of = {topic: role for role, topic in content.roles.items()}
        topics = tuple(
            Stream(name, short(topic.type), role_of.get(name, ""), topic.count, *bag.stamps(name))
            for name, topic in bag.topics.items()
        )
        losses = (bag.damage,) if bag.damage else ()
        # The bag is open from here on for the drive.
        return replace(drive, topics=topics, losses=losses, stack=stack.pop_all())


def _sensed(content: BagIndex, options: DriveOptions) -> FrameSensor:
    """What the frames are; where nothing tells the camera, a mounting that lacks, too, is told."""
    usual = mounting_path(content.path)
    try:
        return sense(content)
    except CalibrationError as problem:
        topics = content.readings.bag.topics
        may_be_told = RIG in topics or any("TFMessage" in topic.type for topic in topics.values())
        is_said = options.mounting is not None or options.unmounted or usual.exists()
        if is_said or may_be_told:
            raise
        raise LackingError(problem, missing_mounting(usual, content.path)) from problem


class SensorMounting(NamedTuple):
    """The mounting of a sensor, the turn of points that it does not tell, remarks, and the sensor
    itself where the bag says it exactly."""

    mounting: Mounting
    R_sensor: Float64 = np.eye(3)
    notes: tuple[str, ...] = ()
    sensor: Sensor | None = None


def mounting_path(path: Path) -> Path:
    """The mounting beside a bag that is one file, which has its name unless another is there; of a
    folder, in it."""
    if path.is_dir():
        return path / MOUNTING
    shared, own = path.with_name(MOUNTING), path.with_name(f"{path.stem}.{MOUNTING}")
    return shared if shared.exists() and not own.exists() else own


def find_mounting(content: BagIndex, options: DriveOptions, sensed: FrameSensor) -> SensorMounting:
    """The mounting that is given or lies beside the bag, else that of the rig that the bag says
    exactly, else that of its static transforms. Raises CalibrationError when nothing tells it."""
    usual = mounting_path(content.path)
    if options.mounting is not None or usual.exists():
        return SensorMounting(_moved(options.find_mounting(usual, content.path), sensed))
    message = content.readings.first(RIG)
    rig = None if message is None else rig_of(message)
    if rig is not None and sensed.fits(rig.sensor):
        mounting = Mounting(
            rig.mount,
            rig.antenna,
            rig.rear_axle_forward_m,
            rig.heading_offset_deg,
            rig.heading_convention,
            source=RIG,
        )
        notes = (f"Mount and antenna by {RIG}.",)
        return SensorMounting(mounting, notes=notes, sensor=rig.sensor)
    try:
        return _by_transforms(content, usual, sensed)
    except CalibrationError:
        if not options.unmounted:
            raise
        return SensorMounting(NO_MOUNTING)


def _moved(mounting: Mounting, sensed: FrameSensor) -> Mounting:
    """The mounting of the grid origin by that of the point that it was measured from."""
    apart_m = sensed.measured_m - sensed.origin_m
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


def _by_transforms(content: BagIndex, usual: Path, sensed: FrameSensor) -> SensorMounting:
    """The mounting by places below the ground's frame: of the sensor, the antenna, the axle."""
    path, transforms = content.path, content.transforms
    antenna = content.frame_id("nmea") or content.frame_id("fix")
    placed, at_antenna = transforms.place(sensed.name, GROUND), transforms.place(antenna, GROUND)
    if placed is None and transforms.place(sensed.name, BASE) is None:
        raise missing_mounting(usual, path)
    if placed is None:
        raise CalibrationError(
            f"{path}: its static transforms place the sensor ({sensed.name!r}) on {BASE}, but do "
            f"not say how high that is above the ground; record the transform from {GROUND} to "
            f"{BASE}, or write {usual} ({estimating(path)} estimates it)."
        )
    if at_antenna is None:
        raise CalibrationError(
            f"{path}: its static transforms place the sensor ({sensed.name!r}) above {GROUND}, but "
            f"not the antenna ({antenna or 'no frame_id'!r}), and a forgotten lever arm misplaces "
            f"the whole map; record the antenna's transform, or write {usual} ({estimating(path)} "
            "does)."
        )
    R = R_VEHICLE_FLU @ placed.R @ sensed.R.T
    origin = R_VEHICLE_FLU @ (placed.at_m + placed.R @ sensed.R.T @ sensed.origin_m)
    below = np.array([origin[0], origin[1], 0.0])
    height_m = _rounded(origin[2])
    R_sensor, notes = np.eye(3), [f"Mount and antenna by static transforms below {GROUND}."]
    try:
        mount = Mount(height_m, *map(_rounded, mount_angles_deg(R)))
    except CalibrationError:
        if sensed.sensor is not None:
            raise
        # A lidar may look anywhere; what a mount cannot say is done to its points.
        mount, R_sensor = Mount(height_m, 0.0), Mount(1.0, 0.0).rotation().T @ R
        notes.append(f"The points of {sensed.name} are turned to look ahead.")
    try:
        arm = LeverArm(*map(_rounded, R_VEHICLE_FLU @ at_antenna.at_m - below))
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem
    axle = transforms.place(AXLE, GROUND)
    axle_m = None if axle is None else _rounded((R_VEHICLE_FLU @ axle.at_m - below)[1])
    mounting = Mounting(mount, arm, axle_m, source=f"{path.name}: /tf_static")
    return SensorMounting(mounting, R_sensor, tuple(notes))


def _rounded(value: float) -> float:
    return round(float(value), _DIGITS) + 0.0  # and no -0
