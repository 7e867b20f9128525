"""A bag as a drive: frames as a stream, the rest heard once while it opens; and how its sensor is
mounted: by its mounting, else by static transforms."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldgrid.core import CalibrationError, LackingError, RecordingError, quoted
from fieldgrid.geometry import LeverArm, Lidar, Mount
from fieldgrid.recordings.bag.content import BagIndex, Readings, as_drive, read_content
from fieldgrid.recordings.bag.motion import find_motion
from fieldgrid.recordings.bag.sensors.frame_sensor import FrameSensor, lidar, sense
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
            sensed, mounting = find_mounting(content, options, _sensed(content, options))
            if content.choice.kind == "cloud":
                sensed = lidar(content, sensed)
            assert sensed.sensor is not None
            rig = mounting.rig(
                sensed.sensor, options.offset_or(content.settings.image_time_offset_ns)
            )
            is_mounted = mounting is not NO_MOUNTING
            drive = as_recording(drive, rig, sensed.frames, sensed.notes, is_mounted=is_mounted)
            imu_axes = mounting.imu_axes
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


def mounting_path(path: Path) -> Path:
    """The mounting beside a bag that is one file, which has its name unless another is there; of a
    folder, in it."""
    if path.is_dir():
        return path / MOUNTING
    shared, own = path.with_name(MOUNTING), path.with_name(f"{path.stem}.{MOUNTING}")
    return shared if shared.exists() and not own.exists() else own


def find_mounting(
    content: BagIndex, options: DriveOptions, sensed: FrameSensor
) -> tuple[FrameSensor, Mounting]:
    """The mounting that is given or lies beside the bag, else that of the rig that the bag says
    exactly, else that of its static transforms; and the sensor with what these say of it. Raises
    CalibrationError when nothing tells the mounting."""
    usual = mounting_path(content.path)
    if options.mounting is not None or usual.exists():
        return sensed, _moved(options.find_mounting(usual, content.path), sensed)
    message = content.readings.first(RIG)
    rig = None if message is None else rig_of(message)
    kind = Lidar if sensed.sensor is None else type(sensed.sensor)
    if rig is not None and isinstance(rig.sensor, kind):
        mounting = Mounting(
            rig.mount,
            rig.antenna,
            rig.rear_axle_forward_m,
            rig.heading_offset_deg,
            rig.heading_convention,
            source=RIG,
        )
        notes = (*sensed.notes, f"Mount and antenna by {RIG}.")
        return sensed._replace(sensor=rig.sensor, notes=notes), mounting
    try:
        return _by_transforms(content, usual, sensed)
    except CalibrationError:
        if not options.unmounted:
            raise
        return sensed, NO_MOUNTING


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


def _by_transforms(
    content: BagIndex, usual: Path, sensed: FrameSensor
) -> tuple[FrameSensor, Mounting]:
    """The mounting by places below the ground's frame: of the sensor, the antenna, the axle. A
    lidar may look anywhere; what a mount cannot say is done to its points."""
    path, transforms = content.path, content.transforms
    antenna = content.frame_id("nmea") or content.frame_id("fix")
    placed, at_antenna = transforms.place(sensed.name, GROUND), transforms.place(antenna, GROUND)
    if placed is None and transforms.place(sensed.name, BASE) is None:
        raise missing_mounting(usual, path)
    if placed is None:
        raise CalibrationError(
            f"{path}: its static transforms place the sensor ({quoted(sensed.name)}) on {BASE}, "
            f"but do not say how high that is above the ground; record the transform from {GROUND} "
            f"to {BASE}, or write {usual} ({estimating(path)} estimates it)."
        )
    if at_antenna is None:
        raise CalibrationError(
            f"{path}: its static transforms place the sensor ({quoted(sensed.name)}) above "
            f"{GROUND}, but not the antenna ({quoted(antenna or 'no frame_id')}), and a forgotten "
            f"lever arm misplaces the whole map; record the antenna's transform, or write {usual} "
            f"({estimating(path)} does)."
        )
    R = R_VEHICLE_FLU @ placed.R @ sensed.R.T
    origin = R_VEHICLE_FLU @ (placed.at_m + placed.R @ sensed.R.T @ sensed.origin_m)
    below = np.array([origin[0], origin[1], 0.0])
    height_m = _rounded(origin[2])
    notes = [f"Mount and antenna by static transforms below {GROUND}."]
    try:
        mount = Mount(height_m, *map(_rounded, mount_angles_deg(R)))
    except CalibrationError:
        if sensed.sensor is not None:
            raise
        mount = Mount(height_m, 0.0)
        sensed = sensed._replace(R=mount.rotation().T @ R @ sensed.R)
        notes.append(f"The points of {sensed.name} are turned to look ahead.")
    try:
        arm = LeverArm(*map(_rounded, R_VEHICLE_FLU @ at_antenna.at_m - below))
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem
    axle = transforms.place(AXLE, GROUND)
    axle_m = None if axle is None else _rounded((R_VEHICLE_FLU @ axle.at_m - below)[1])
    mounting = Mounting(mount, arm, axle_m, source=f"{path.name}: /tf_static")
    return sensed._replace(notes=(*sensed.notes, *notes)), mounting


def _rounded(value: float) -> float:
    return round(float(value), _DIGITS) + 0.0  # and no -0
