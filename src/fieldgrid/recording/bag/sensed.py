"""What of a bag the frames are: the sensor, where each frame comes from, and how it is made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.cloud import points_per_sr
from fieldgrid.errors import CalibrationError, RecordingError
from fieldgrid.recording.bag.cameras import depth_camera, disparity_camera, stereo_pair
from fieldgrid.recording.bag.clouds import MessageCloud
from fieldgrid.recording.bag.frames import Plan, Taken, plan_pairs, plan_single, read_frames
from fieldgrid.recording.bag.images import CompressedImage, DepthImage, DisparityImage, RawImage
from fieldgrid.recording.bag.mounts import SensorFrame, optical
from fieldgrid.recording.bag.opened import Opened
from fieldgrid.recording.bag.readings import Readings
from fieldgrid.recording.bag.topics import COMPRESSED, no_frames
from fieldgrid.recording.calibration import read_calibration
from fieldgrid.recording.pixels import BITS, significant_bits
from fieldgrid.recording.protocol import CloudFrame, DepthFrame, Frame, PairRectifier, StereoFrame
from fieldgrid.rig import DepthCamera, Lidar, Sensor, StereoCamera
from fieldgrid.ros import Bag, decode

_CALIBRATION = "calibration"
_SAMPLES = 5


class Sensed(NamedTuple):
    """The sensor of a bag: its frames and how they are made, once the mount is known."""

    sensor: Sensor | None
    frame: SensorFrame
    plan: Plan
    notes: tuple[str, ...] = ()
    rectifier: PairRectifier | None = None
    bits: int = BITS[-1]


def sense(opened: Opened) -> Sensed:
    """The sensor and the plan of its frames. Raises RecordingError for a bag that has none or
    leaves open which, CalibrationError where nothing tells the camera."""
    if opened.choice.problem is not None:
        raise opened.choice.problem
    if not opened.choice.kind:
        raise no_frames(opened.bag.topics, opened.path)
    kinds = {"stereo": _stereo, "disparity": _disparity, "depth": _depth, "cloud": _cloud}
    return kinds[opened.choice.kind](opened)


def _stereo(opened: Opened) -> Sensed:
    bag, roles, readings = opened.bag, opened.choice.roles, opened.readings
    plan = plan_pairs(bag, roles["left"], roles["right"])
    bits, notes = _bits(opened, plan)
    folder = opened.folder / _CALIBRATION
    without_info = not {"left_info", "right_info"} & readings.infos.keys()
    if without_info and (opened.settings.calibration is not None or folder.is_dir()):
        found = read_calibration(folder, opened.settings.calibration, opened.settings.rectified)
        # Without the rotation that rectifies, no transform tells where the rectified camera looks.
        frame = _pair_frame("", np.eye(3), found.camera)
        return Sensed(found.camera, frame, plan, (*found.notes, *notes), found.rectifier, bits)
    pair = stereo_pair(readings, roles, bag.topics, opened.path, opened.settings.rectified)
    name = readings.frame_ids["left_info"]
    frame = _pair_frame(name, pair.R_rect_left @ optical(name, readings), pair.camera)
    return Sensed(pair.camera, frame, plan, (*pair.notes, *notes), pair.rectifier, bits)


def _pair_frame(name: str, R: Float64, camera: StereoCamera) -> SensorFrame:
    middle_m = np.array([camera.baseline_m / 2.0, 0.0, 0.0])
    return SensorFrame(name, R, middle_m, middle_m)


def _disparity(opened: Opened) -> Sensed:
    bag, roles, readings = opened.bag, opened.choice.roles, opened.readings
    if opened.settings.baseline_m is not None:
        raise RecordingError(
            f"{opened.settings_path}: baseline_m is in every message with disparities, as T; "
            "leave it out."
        )
    plan = plan_single(bag, roles["disparity"])
    first = _first(bag, plan)
    camera = disparity_camera(first, readings, roles, bag.topics, opened.path)
    frame = _single_frame(first.header.frame_id, readings)
    middle_m = np.array([(camera.baseline_m or 0.0) / 2.0, 0.0, 0.0])
    return Sensed(camera, frame._replace(measured_m=middle_m), plan)


def _depth(opened: Opened) -> Sensed:
    bag, roles, readings = opened.bag, opened.choice.roles, opened.readings
    baseline_m = opened.settings.baseline_m
    camera = depth_camera(readings, roles, bag.topics, opened.path, baseline_m)
    plan = plan_single(bag, roles["depth"])
    return Sensed(camera, _single_frame(readings.frame_ids["depth_info"], readings), plan)


def _single_frame(name: str, readings: Readings) -> SensorFrame:
    return SensorFrame(name, optical(name, readings), np.zeros(3), np.zeros(3))


def _cloud(opened: Opened) -> Sensed:
    plan = plan_single(opened.bag, opened.choice.roles["cloud"])
    name = str(_first(opened.bag, plan).header.frame_id)
    R = optical(name, opened.readings, opened.settings.axes)
    return Sensed(None, SensorFrame(name, R, np.zeros(3), np.zeros(3)), plan)


def _first(bag: Bag, plan: Plan) -> Any:
    (taken,) = next(read_frames(bag, plan))
    return decode(taken.message)


def find_lidar(opened: Opened, plan: Plan, R: Float64) -> Lidar:
    """The lidar as the settings say it, else by the first clouds that have enough points."""
    if opened.settings.points_per_sr is not None:
        return Lidar(opened.settings.points_per_sr)
    bag = opened.bag
    problem: CalibrationError | None = None
    for (taken,) in islice(read_frames(bag, plan), _SAMPLES):
        points = MessageCloud(*taken, tuple(R.ravel().tolist())).read()
        try:
            return Lidar(points_per_sr(points))
        except CalibrationError as error:
            problem = CalibrationError(f"{bag.path}: {plan.topics[0]}: {error}")
    raise problem or RecordingError(f"{bag.path}: {plan.topics[0]} has no cloud; record it again.")


def _bits(opened: Opened, plan: Plan) -> tuple[int, tuple[str, ...]]:
    """How many of 16 bits the cameras fill, by what is said, else by some of the images."""
    if opened.settings.bits is not None:
        return opened.settings.bits, ()
    bag = opened.bag
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
        f"them; if that is wrong, say so in {opened.settings_path.name}: [images] bits = {bits}."
    )
    return bits, (note,)


def frame_maker(
    opened: Opened, sensed: Sensed, sensor: Sensor, R: Float64
) -> Callable[[int, int, tuple[Taken, ...]], Frame]:
    """What makes a frame of its number, its time and its messages."""
    bag, kind = opened.bag, opened.choice.kind
    if isinstance(sensor, StereoCamera):
        size_px = sensor.width_px, sensor.height_px
        compressed = [bag.topics[topic].type == COMPRESSED for topic in sensed.plan.topics]
        return partial(_stereo_frame, size_px, sensed.rectifier, compressed, sensed.bits)
    if isinstance(sensor, DepthCamera):
        size_px = sensor.width_px, sensor.height_px
        of = DisparityImage if kind == "disparity" else DepthImage
        return lambda k, time_ns, taken: DepthFrame(_frame_id(k), time_ns, of(*taken[0]), size_px)
    turn = tuple(R.ravel().tolist())
    return lambda k, time_ns, taken: CloudFrame(
        _frame_id(k), time_ns, MessageCloud(*taken[0], turn)
    )


def _stereo_frame(
    size_px: tuple[int, int],
    rectifier: PairRectifier | None,
    compressed: Sequence[bool],
    bits: int,
    k: int,
    time_ns: int,
    taken: tuple[Taken, ...],
) -> StereoFrame:
    left, right = (
        CompressedImage(*one) if packed else RawImage(*one, bits)
        for one, packed in zip(taken, compressed, strict=True)
    )
    return StereoFrame(_frame_id(k), time_ns, left, right, size_px, rectifier)


def _frame_id(k: int) -> str:
    return f"{k:06d}"
