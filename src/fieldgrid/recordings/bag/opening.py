"""A bag as a drive: frames as a stream, the rest heard once while it opens."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from fieldgrid.core import CalibrationError, LackingError, RecordingError
from fieldgrid.recordings.bag.content import BagIndex, as_drive, read_content
from fieldgrid.recordings.bag.motion import find_motion
from fieldgrid.recordings.bag.readings import Readings
from fieldgrid.recordings.bag.sensors.frame_sensor import FrameSensor, lidar, sense
from fieldgrid.recordings.bag.sensors.frames import BagFrames
from fieldgrid.recordings.bag.sensors.mounts import find_mounting, mounting_path
from fieldgrid.recordings.bag.topics import short
from fieldgrid.recordings.calibration.mounting import missing_mounting
from fieldgrid.recordings.drive import Drive, Stream, as_recording, with_motion
from fieldgrid.recordings.options import NO_MOUNTING, DriveOptions
from fieldgrid.recordings.ros.gnss_messages import RIG
from fieldgrid.recordings.tables.motion_files import AXES


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
