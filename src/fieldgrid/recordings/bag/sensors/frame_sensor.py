"""What of a bag the frames are: the sensor, where each frame comes from, and how it is made."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64, NoFramesError, RecordingError, quoted
from fieldgrid.geometry import DepthCamera, Lidar, Sensor
from fieldgrid.perception import points_per_sr
from fieldgrid.recordings.bag.content import BagIndex, folder_of
from fieldgrid.recordings.bag.sensors.clouds import MessageCloud
from fieldgrid.recordings.bag.sensors.frames import BagFrames, Plan, plan_frames, read_frames
from fieldgrid.recordings.bag.sensors.images import (
    DepthImage,
    DisparityImage,
    MessageSource,
    PackedDepthImage,
    RawImage,
    image_source,
)
from fieldgrid.recordings.bag.topic_names import COMPRESSED, INFO, is_rectified, unit_topic
from fieldgrid.recordings.bag.topics import listing
from fieldgrid.recordings.bag.transforms import optical
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, Calibration, Entries
from fieldgrid.recordings.calibration.loading import read_calibration
from fieldgrid.recordings.calibration.ros import check_calibrated, depth_camera
from fieldgrid.recordings.frames.frames import CloudFrame, DepthFrame, StereoFrame
from fieldgrid.recordings.frames.pixels import BITS, significant_bits
from fieldgrid.recordings.ros.definitions import decode
from fieldgrid.recordings.ros.model import Message

_CALIBRATION = "calibration"
_SAMPLES = 5
_MOST_NUMBERS = 64
"""More than any matrix of a camera_info has."""

_CORRECTED = re.compile(r"deskew|undistort|dedistort|corrected|compensated|registered")


class FrameSensor(NamedTuple):
    """The sensor of a bag, which of its messages the frames are of, and how they are made.

    Their data are in the frame `name`, whose directions `R` turns into the sensor frame's (right,
    down, forward). In the latter, `origin_m` is the point above the grid origin: of a pair the
    middle of the baseline; and `measured_m` the point that a mounting.json counts from, which is
    the middle of a pair even where its left camera alone gives the depths. Of a lidar the `sensor`
    is not known before its mount.
    """

    name: str
    R: Float64
    frames: BagFrames
    sensor: Sensor | None = None
    origin_m: Float64 = np.zeros(3)
    measured_m: Float64 = np.zeros(3)
    notes: tuple[str, ...] = ()


def sense(content: BagIndex) -> FrameSensor:
    """The sensor and the plan of its frames. Raises RecordingError for a bag that has none or
    leaves open which, CalibrationError where nothing tells the camera."""
    if content.choice.problem is not None:
        raise content.choice.problem
    kinds = {"stereo": _stereo, "disparity": _disparity, "depth": _depth, "cloud": _cloud}
    if not content.choice.kind:
        raise NoFramesError(
            f"{content.path} has no pair of a left and a right image, and neither disparity, depth "
            "image with its camera_info, nor point cloud; it has "
            f"{listing(content.readings.bag.topics.values())}; name the images with --topic "
            "left=NAME --topic right=NAME, or --topic depth=NAME."
        )
    return kinds[content.choice.kind](content)


def _stereo(content: BagIndex) -> FrameSensor:
    roles, settings, transforms = content.roles, content.settings, content.transforms
    bag = content.readings.bag
    plan = plan_frames(bag, roles["left"], roles["right"])
    bits, notes = _bits(content, plan)
    folder = folder_of(content.path) / _CALIBRATION
    has_info = {"left_info", "right_info"} & roles.keys()
    if not has_info and (settings.calibration is not None or folder.is_dir()):
        found = read_calibration(folder, settings.calibration, settings.rectified)
        # Without the rotation that rectifies, no transform tells where the rectified camera looks.
        name, R = "", np.eye(3)
    else:
        found = _calibrated_pair(content, settings.rectified)
        name = content.frame_id("left_info")
        R = found.R_rect_left @ optical(name, transforms)
    camera = found.camera
    middle_m = np.array([camera.baseline_m / 2.0, 0.0, 0.0])
    common = (camera.width_px, camera.height_px), found.rectifier
    sources = (partial(image_source, bits=bits),) * 2
    frames = BagFrames(bag, plan, StereoFrame, ("left", "right"), sources, common)
    notes = (*plan.notes, *found.notes, *notes)
    return FrameSensor(name, R, frames, camera, middle_m, middle_m, notes)


def _disparity(content: BagIndex) -> FrameSensor:
    if content.settings.baseline_m is not None:
        raise RecordingError(
            f"{content.settings_path}: baseline_m is in every message with disparities, as T; "
            "leave it out."
        )
    plan = plan_frames(content.readings.bag, content.roles["disparity"])
    first = _first(content, plan)
    camera = _disparity_camera(content, first)
    middle_m = np.array([(camera.baseline_m or 0.0) / 2.0, 0.0, 0.0])
    found = _depth_sensor(content, first.header.frame_id, plan, camera, DisparityImage)
    return found._replace(measured_m=middle_m)


def _depth(content: BagIndex) -> FrameSensor:
    topic, topics = content.roles["depth"], content.readings.bag.topics
    camera = depth_camera(_info(content, "depth_info"), content.settings.baseline_m)
    said = content.readings.first(unit_topic(topic))
    unit_m = 0.001 if said is None else float(said.data)
    if not 1e-6 < unit_m < 1.0:
        raise CalibrationError(
            f"{content.path}: {unit_topic(topic)} says that depths are in units of {unit_m} m, "
            "which no camera uses; record again."
        )
    is_packed = topics[topic].type == COMPRESSED
    source = PackedDepthImage if is_packed else partial(DepthImage, unit_m=unit_m)
    plan = plan_frames(content.readings.bag, topic)
    return _depth_sensor(content, content.frame_id("depth_info"), plan, camera, source)


def _depth_sensor(
    content: BagIndex,
    name: str,
    plan: Plan,
    camera: DepthCamera,
    source: Callable[[Message, int], MessageSource],
) -> FrameSensor:
    size_px = camera.width_px, camera.height_px
    frames = BagFrames(content.readings.bag, plan, DepthFrame, ("depth",), (source,), (size_px,))
    R = optical(name, content.transforms)
    return FrameSensor(name, R, frames, camera, notes=plan.notes)


def _cloud(content: BagIndex) -> FrameSensor:
    plan = plan_frames(content.readings.bag, content.roles["cloud"])
    name = str(_first(content, plan).header.frame_id)
    R = optical(name, content.transforms, content.settings.axes)
    frames = BagFrames(content.readings.bag, plan, CloudFrame, ("cloud",), (MessageCloud,))
    return FrameSensor(name, R, frames, notes=plan.notes)


def lidar(content: BagIndex, sensed: FrameSensor) -> FrameSensor:
    """The sensor of clouds, once it is known how they are turned: the one that the bag says, else
    as the settings say it, else by the first clouds that have enough points."""
    topic, settings = sensed.frames.plan.topics[0], content.settings
    corrected = settings.corrected  # whether points were carried to one instant already
    if corrected is None:
        corrected = _CORRECTED.search(topic.lower()) is not None
    source = partial(MessageCloud, R=tuple(sensed.R.ravel().tolist()), corrected=corrected)
    sensed = sensed._replace(frames=replace(sensed.frames, sources=(source,)))
    if sensed.sensor is not None:
        return sensed
    if settings.points_per_sr is not None:
        return sensed._replace(sensor=Lidar(settings.points_per_sr))
    problem: CalibrationError | None = None
    for (taken,) in islice(read_frames(content.readings.bag, sensed.frames.plan), _SAMPLES):
        try:
            return sensed._replace(sensor=Lidar(points_per_sr(source(*taken).read())))
        except CalibrationError as error:
            problem = CalibrationError(f"{content.path}: {topic}: {error}")
    raise problem or RecordingError(f"{content.path}: {topic} has no cloud; record it again.")


def _first(content: BagIndex, plan: Plan) -> Any:
    ((message, _),) = next(read_frames(content.readings.bag, plan))
    return decode(message)


def _bits(content: BagIndex, plan: Plan) -> tuple[int, tuple[str, ...]]:
    """How many of 16 bits the cameras fill, by what is said, else by some of the images."""
    if content.settings.bits is not None:
        return content.settings.bits, ()
    pairs = islice(read_frames(content.readings.bag, plan), _SAMPLES)
    images = [image_source(*one) for taken in pairs for one in taken]
    pixels = [image.pixels()[0] for image in images if isinstance(image, RawImage)]
    samples = [one for one in pixels if one.dtype == np.uint16]
    bits = significant_bits(samples)
    if bits == BITS[-1]:
        return bits, ()
    note = (
        f"Of the 16 bits of the images the lower {bits} are taken as filled, by {len(samples)} of "
        f"them; if that is wrong, say so in {content.settings_path.name}: [images] bits = {bits}."
    )
    return bits, (note,)


def _calibrated_pair(content: BagIndex, said: bool | None) -> Calibration:
    """The camera of the pair, and how raw images are rectified, by its two calibrations. Raises
    CalibrationError.

    Whether the images are rectified is `said`, or by None told by the names of their topics.
    """
    left, right = _info(content, "left_info"), _info(content, "right_info")
    topics = content.roles["left"], content.roles["right"]
    named = {is_rectified(topic) for topic in topics}
    if said is None and len(named) > 1:
        raise CalibrationError(
            f"{content.path}: of {topics[0]} and {topics[1]} one is rectified and one is not; "
            "choose two alike with --topic left= and --topic right=."
        )
    between = Entries({}, left.path)
    if not (left.has("P") or right.has("P")):
        frames = content.frame_id("left_info"), content.frame_id("right_info")
        placed = content.transforms.place(*frames)
        if placed is None:
            raise CalibrationError(
                f"{left.path} and {right.path} have no P, and no static transform joins their "
                f"frames {quoted(frames[0])} and {quoted(frames[1])}; calibrate the pair."
            )
        between = Entries({"R": _matrix(placed.R), "T": _matrix(placed.at_m)}, left.path)
    pair = CalibratedPair(left.path, left, right, between)
    found = pair.calibration(named.pop() if said is None else said)
    return found._replace(R_rect_left=left.get("R")) if left.has("R") else found


def _disparity_camera(content: BagIndex, image: Any) -> DepthCamera:
    """The camera of disparity images, of which the first is given: f and T are its own."""
    info = _info(content, "left_info")
    P = info.get("P")
    P[0, 0] = P[1, 1] = float(image.f)
    return depth_camera(info._replace(document={"P": _matrix(P)}), float(image.t))


def _info(content: BagIndex, role: str) -> Entries:
    """The calibration of a camera by a sensor_msgs/CameraInfo of either ROS. CalibrationError for
    one that is missing, or not of whole images."""
    path, roles, topics = content.path, content.roles, content.readings.bag.topics
    message = content.readings.first(roles.get(role))
    if message is None:
        infos = [topic for topic in topics.values() if topic.type == INFO]
        raise CalibrationError(
            f"{path} has no readable camera_info for {role}; record that of the camera, or name "
            f"it with --topic {role}=NAME, of {listing(infos or topics.values())}."
        )
    source = Path(f"{path.name}: {roles[role]}")
    if message.binning_x > 1 or message.binning_y > 1 or message.roi.width or message.roi.height:
        raise CalibrationError(
            f"{source}: binning or a region of interest is set, which is not read; record whole "
            "images with the calibration of their size."
        )
    numbers = {key: getattr(message, key.lower())[: _MOST_NUMBERS + 1] for key in "KDRP"}
    used = "KDRP" if numbers["P"].any() else "KD"
    if not numbers["R"].any():
        numbers["R"] = np.eye(3)
    document = {key: _matrix(numbers[key]) for key in used}
    size_px = int(message.width), int(message.height)
    info = Entries(document, source, size_px, model=str(message.distortion_model))
    return check_calibrated(info)


def _matrix(values: Any) -> dict[str, list[float]]:
    """Numbers as files of calibrations have them."""
    return {"data": np.asarray(values, dtype=np.float64).ravel().tolist()}
