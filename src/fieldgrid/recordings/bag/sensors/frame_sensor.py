"""What of a bag the frames are: the sensor, where each frame comes from, and how it is made."""

from __future__ import annotations

import re
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64, RecordingError
from fieldgrid.geometry import DepthCamera, Lidar, Sensor, StereoCamera
from fieldgrid.perception import points_per_sr
from fieldgrid.recordings.bag.content import BagIndex
from fieldgrid.recordings.bag.sensors.cameras import depth_camera, disparity_camera, stereo_pair
from fieldgrid.recordings.bag.sensors.clouds import MessageCloud
from fieldgrid.recordings.bag.sensors.frames import (
    DepthMaker,
    FrameMaker,
    PairMaker,
    Plan,
    plan_pairs,
    plan_single,
    read_frames,
)
from fieldgrid.recordings.bag.sensors.images import DepthImage, DisparityImage, RawImage
from fieldgrid.recordings.bag.sensors.mounts import SensorFrame, optical
from fieldgrid.recordings.bag.sensors.packed_depth import PackedDepthImage
from fieldgrid.recordings.bag.topic_names import unit_topic
from fieldgrid.recordings.bag.topics import COMPRESSED, no_frames
from fieldgrid.recordings.calibration.loading import read_calibration
from fieldgrid.recordings.frames.pixels import BITS, significant_bits
from fieldgrid.recordings.ros.definitions import decode

_CALIBRATION = "calibration"
_SAMPLES = 5
_CORRECTED = re.compile(r"deskew|undistort|dedistort|corrected|compensated|registered")


class FrameSensor(NamedTuple):
    """The sensor of a bag, its frames and how they are made. Of a lidar neither `sensor` nor
    `maker` is known before its mount."""

    frame: SensorFrame
    plan: Plan
    sensor: StereoCamera | DepthCamera | None = None
    maker: FrameMaker | None = None
    notes: tuple[str, ...] = ()

    def fits(self, sensor: Sensor) -> bool:
        """Whether the frames can be of a sensor."""
        if self.sensor is None:
            return type(sensor) is Lidar
        mine = (self.sensor.width_px, self.sensor.height_px)
        return type(sensor) is type(self.sensor) and mine == (
            getattr(sensor, "width_px", 0), getattr(sensor, "height_px", 0)
        )  # fmt: skip


def sense(content: BagIndex) -> FrameSensor:
    """The sensor and the plan of its frames. Raises RecordingError for a bag that has none or
    leaves open which, CalibrationError where nothing tells the camera."""
    if content.choice.problem is not None:
        raise content.choice.problem
    if not content.choice.kind:
        raise no_frames(content.bag.topics, content.path)
    kinds = {"stereo": _stereo, "disparity": _disparity, "depth": _depth, "cloud": _cloud}
    return kinds[content.choice.kind](content)


def _stereo(content: BagIndex) -> FrameSensor:
    bag, roles, settings = content.bag, content.roles, content.settings
    plan = plan_pairs(bag, roles["left"], roles["right"])
    bits, notes = _bits(content, plan)
    compressed = tuple(bag.topics[topic].type == COMPRESSED for topic in plan.topics)
    folder = content.folder / _CALIBRATION
    infos = [content.readings.first(roles.get(role)) for role in ("left_info", "right_info")]
    if infos == [None, None] and (settings.calibration is not None or folder.is_dir()):
        found = read_calibration(folder, settings.calibration, settings.rectified)
        # Without the rotation that rectifies, no transform tells where the rectified camera looks.
        name, R, camera, rectifier = "", np.eye(3), found.camera, found.rectifier
        notes = found.notes + notes
    else:
        name = content.frame_id("left_info")
        camera, rectifier, R_rect_left = stereo_pair(content, settings.rectified)
        R = R_rect_left @ optical(name, content.transforms)
        if rectifier is not None:
            notes = ("The images are raw, and rectified by their camera_info.", *notes)
    middle_m = np.array([camera.baseline_m / 2.0, 0.0, 0.0])
    maker = PairMaker((camera.width_px, camera.height_px), rectifier, compressed, bits)
    return FrameSensor(SensorFrame(name, R, middle_m, middle_m), plan, camera, maker, notes)


def _disparity(content: BagIndex) -> FrameSensor:
    if content.settings.baseline_m is not None:
        raise RecordingError(
            f"{content.settings_path}: baseline_m is in every message with disparities, as T; "
            "leave it out."
        )
    plan = plan_single(content.bag, content.roles["disparity"])
    first = _first(content, plan)
    camera = disparity_camera(content, first)
    frame = _single_frame(str(first.header.frame_id), content)
    middle_m = np.array([(camera.baseline_m or 0.0) / 2.0, 0.0, 0.0])
    maker = DepthMaker(DisparityImage, (camera.width_px, camera.height_px))
    return FrameSensor(frame._replace(measured_m=middle_m), plan, camera, maker)


def _depth(content: BagIndex) -> FrameSensor:
    camera = depth_camera(content, content.settings.baseline_m)
    plan = plan_single(content.bag, content.roles["depth"])
    frame = _single_frame(content.frame_id("depth_info"), content)
    topic, size_px = content.roles["depth"], (camera.width_px, camera.height_px)
    if content.bag.topics[topic].type == COMPRESSED:
        return FrameSensor(frame, plan, camera, DepthMaker(PackedDepthImage, size_px))
    said = content.readings.first(unit_topic(topic))
    unit_m = 0.001 if said is None else float(said.data)
    if not 1e-6 < unit_m < 1.0:
        raise CalibrationError(
            f"{content.path}: {unit_topic(topic)} says that depths are in units of {unit_m} m, "
            "which no camera uses; record again."
        )
    kind = partial(DepthImage, unit_m=unit_m)
    return FrameSensor(frame, plan, camera, DepthMaker(kind, size_px))


def _cloud(content: BagIndex) -> FrameSensor:
    plan = plan_single(content.bag, content.roles["cloud"])
    name = str(_first(content, plan).header.frame_id)
    return FrameSensor(_single_frame(name, content, content.settings.axes), plan)


def are_corrected(content: BagIndex) -> bool:
    """Whether the points of the clouds were carried to one instant by who recorded them: as the
    settings say, else by the name of their topic."""
    if content.settings.corrected is not None:
        return content.settings.corrected
    return _CORRECTED.search(content.roles.get("cloud", "").lower()) is not None


def _single_frame(name: str, content: BagIndex, axes: str | None = None) -> SensorFrame:
    return SensorFrame(name, optical(name, content.transforms, axes), np.zeros(3), np.zeros(3))


def _first(content: BagIndex, plan: Plan) -> Any:
    (taken,) = next(read_frames(content.bag, plan))
    return decode(taken.message)


def find_lidar(content: BagIndex, plan: Plan, R: Float64) -> Lidar:
    """The lidar as the settings say it, else by the first clouds that have enough points."""
    if content.settings.points_per_sr is not None:
        return Lidar(content.settings.points_per_sr)
    path, topic = content.path, plan.topics[0]
    problem: CalibrationError | None = None
    for (taken,) in islice(read_frames(content.bag, plan), _SAMPLES):
        points = MessageCloud(*taken, tuple(R.ravel().tolist())).read()
        try:
            return Lidar(points_per_sr(points))
        except CalibrationError as error:
            problem = CalibrationError(f"{path}: {topic}: {error}")
    raise problem or RecordingError(f"{path}: {topic} has no cloud; record it again.")


def _bits(content: BagIndex, plan: Plan) -> tuple[int, tuple[str, ...]]:
    """How many of 16 bits the cameras fill, by what is said, else by some of the images."""
    if content.settings.bits is not None:
        return content.settings.bits, ()
    bag = content.bag
    if any(bag.topics[topic].type == COMPRESSED for topic in plan.topics):
        return BITS[-1], ()
    samples = []
    for taken in islice(read_frames(bag, plan), _SAMPLES):
        for one in taken:
            pixels = RawImage(*one).deep_pixels()
            if pixels is None:
                return BITS[-1], ()
            samples.append(pixels)
    bits = significant_bits(samples)
    if bits == BITS[-1]:
        return bits, ()
    note = (
        f"Of the 16 bits of the images the lower {bits} are taken as filled, by {len(samples)} of "
        f"them; if that is wrong, say so in {content.settings_path.name}: [images] bits = {bits}."
    )
    return bits, (note,)
