"""A bag as a drive: frames as a stream, the rest heard once while it opens."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from fieldgrid.core import CalibrationError, LackingError
from fieldgrid.recordings.bag.content import BagIndex, as_drive, find_motion, read_content
from fieldgrid.recordings.bag.readings import Readings
from fieldgrid.recordings.bag.sensors.frame_sensor import are_corrected, find_lidar, sense
from fieldgrid.recordings.bag.sensors.frames import BagFrames, CloudMaker
from fieldgrid.recordings.bag.sensors.mounts import exactly, find_mounting, mounting_path
from fieldgrid.recordings.bag.topics import short
from fieldgrid.recordings.calibration.mounting import missing_mounting
from fieldgrid.recordings.drive import (
    Drive,
    Recording,
    Stream,
    as_recording,
    with_frames,
    with_motion,
)
from fieldgrid.recordings.options import NO_MOUNTING, DriveOptions
from fieldgrid.recordings.ros.bag import open_bag


def open_bag_drive(path: Path, options: DriveOptions) -> Drive:
    """The drive in a bag, which is held open. Without frames, or a rig that they can be used with,
    it says why."""
    with ExitStack() as stack:
        gnss = None if options.gnss is None else str(options.gnss)
        readings = Readings(options.topics, gnss)
        bag = stack.enter_context(open_bag(path, readings.listen, options.epoch_ns))
        content = read_content(bag, path, options, readings)
        drive = with_frames(as_drive(content), lambda drive: _recording(drive, content, options))
        if drive.refusal is not None:
            drive = with_motion(drive, *find_motion(content))
        role_of = {topic: role for role, topic in content.roles.items()}
        topics = tuple(
            Stream(name, short(topic.type), role_of.get(name, ""), topic.count, *bag.stamps(name))
            for name, topic in bag.topics.items()
        )
        losses = (bag.damage,) if bag.damage else ()
        # The bag is open from here on for the drive.
        return replace(drive, topics=topics, losses=losses, stack=stack.pop_all())


def _recording(drive: Drive, content: BagIndex, options: DriveOptions) -> Recording:
    """Raises RecordingError for a bag that has nothing to make frames of, and CalibrationError
    where nothing tells the rig."""
    usual = mounting_path(content.path)
    is_said = options.mounting is not None or usual.exists()
    exact = None if is_said else content.readings.rig()
    try:
        sensed = sense(content)
    except CalibrationError as problem:
        may_be_told = any("TFMessage" in topic.type for topic in content.bag.topics.values())
        if is_said or options.unmounted or exact is not None or may_be_told:
            raise
        raise LackingError(problem, missing_mounting(usual, content.path)) from problem
    if exact is not None and sensed.fits(exact.sensor):
        mounted = exactly(exact)
    else:
        antenna = content.readings.frame_id(content.fixes.topic)
        mounted = find_mounting(content.path, options, content.transforms, sensed.frame, antenna)
    R = mounted.R_sensor @ sensed.frame.R
    sensor = mounted.sensor or sensed.sensor or find_lidar(content, sensed.plan, R)
    maker = sensed.maker or CloudMaker(tuple(R.ravel().tolist()), are_corrected(content))
    frames = BagFrames(content.bag, sensed.plan, maker)
    moving = with_motion(drive, *find_motion(content, mounted.mounting.imu_axes))
    offset_ns = options.offset_or(content.settings.image_time_offset_ns)
    rig, is_mounted = mounted.mounting.rig(sensor, offset_ns), mounted.mounting is not NO_MOUNTING
    more = (*sensed.plan.notes, *sensed.notes, *mounted.notes)
    notes = (*drive.notes, *more, *moving.notes[len(drive.notes) :])
    return replace(as_recording(moving, rig, frames, is_mounted=is_mounted), notes=notes)
