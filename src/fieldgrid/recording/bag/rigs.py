"""The rig of a bag: its sensor by camera_info, its mount by mounting.json or static transforms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import CalibrationError
from fieldgrid.recording.bag.clouds import R_OPTICAL_FLU
from fieldgrid.recording.bag.images import baseline_m
from fieldgrid.recording.bag.messages import field
from fieldgrid.recording.bag.readings import Readings
from fieldgrid.recording.bag.topics import INFO, is_rectified, listing
from fieldgrid.recording.bag.transforms import Place, Transforms
from fieldgrid.recording.kitti_calibration import mount_angles_deg
from fieldgrid.recording.motion_files import directions
from fieldgrid.recording.mounting import Mounting, estimating, missing_mounting
from fieldgrid.recording.options import Options
from fieldgrid.recording.places import mounting_place
from fieldgrid.rectify import (
    Rectifier,
    camera_from_projections,
    lens_model,
    raw_camera,
    rectify_by_projections,
)
from fieldgrid.rig import DepthCamera, LeverArm, Mount, StereoCamera
from fieldgrid.ros import Topic

_Float64 = npt.NDArray[np.float64]

GROUND, BASE = "base_footprint", "base_link"
"""Frames by the convention of ROS: on the ground below the vehicle, and on the vehicle."""

AXLE = "rear_axle"
"""The frame of the axle that does not steer; ROS has no convention for it."""

_VEHICLE_FROM_FLU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_SAME = 1e-9
_DIGITS = 9
"""A nanometre and less than a microradian; beyond are the rounding errors of quaternions."""

_MOST_COEFFICIENTS = 64


class Pair(NamedTuple):
    """A stereo camera, how raw pairs become rectified ones (None where they are), the rotation
    from the frame of the raw left camera to the rectified one's, and remarks."""

    camera: StereoCamera
    rectifier: Rectifier | None
    R_rect_left: _Float64
    notes: tuple[str, ...]


class _Info(NamedTuple):
    """A sensor_msgs/CameraInfo of either ROS; `source` is what errors call it."""

    size_px: tuple[int, int]
    K: _Float64
    D: _Float64
    R: _Float64
    P: _Float64
    model: str
    source: str


def stereo_pair(
    readings: Readings,
    roles: Mapping[str, str],
    topics: Mapping[str, Topic],
    path: Path,
    said: bool | None,
) -> Pair:
    """The camera of the pair by its two calibrations. Raises CalibrationError.

    Whether the images are rectified is `said`, or by None told by the names of their topics.
    """
    left = _info(readings, "left_info", roles, topics, path)
    right = _info(readings, "right_info", roles, topics, path)
    if left.size_px != right.size_px:
        raise CalibrationError(
            f"{left.source} is for images of {left.size_px} px, {right.source} for "
            f"{right.size_px} px; give the calibration of one pair."
        )
    named = is_rectified(roles["left"]), is_rectified(roles["right"])
    if said is None and named[0] != named[1]:
        raise CalibrationError(
            f"{path}: of {roles['left']} and {roles['right']} one is rectified and one is not; "
            "choose two alike with --topic left= and --topic right=."
        )
    if named[0] if said is None else said:
        camera = camera_from_projections(left.P, right.P, left.size_px, right.source)
        return Pair(camera, None, left.R, ())
    first, second = (
        raw_camera(one.size_px, one.K, one.D, lens_model(one.model, one.source), one.source)
        for one in (left, right)
    )
    found = rectify_by_projections(
        first, second, (left.R, right.R), (left.P, right.P), right.source
    )
    if found.rectifier is None:
        return Pair(found.camera, None, found.R_rect_left, ())
    note = f"The images are raw, and rectified by {left.source} and {right.source}."
    return Pair(found.camera, found.rectifier, found.R_rect_left, (note,))


def depth_camera(
    readings: Readings,
    roles: Mapping[str, str],
    topics: Mapping[str, Topic],
    path: Path,
    baseline: float | None,
) -> DepthCamera:
    """The camera of depth images by their calibration; `baseline` is that of the pair they come
    from, metres, None where nobody says it."""
    info = _info(readings, "depth_info", roles, topics, path)
    return _depth_camera(info, info.P if info.P[0, 0] > 0.0 else info.K, baseline)


def disparity_camera(
    image: Any,
    readings: Readings,
    roles: Mapping[str, str],
    topics: Mapping[str, Topic],
    path: Path,
) -> DepthCamera:
    """The camera of disparity images, of which the first is given: f and T are its own."""
    info = _info(readings, "left_info", roles, topics, path)
    P = info.P.copy()
    P[0, 0] = P[1, 1] = float(image.f)
    return _depth_camera(info, P, baseline_m(image))


def _depth_camera(info: _Info, P: _Float64, baseline: float | None) -> DepthCamera:
    values = (float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]))
    try:
        return DepthCamera(*info.size_px, *values, baseline)
    except CalibrationError as problem:
        raise CalibrationError(f"{info.source}: {problem}") from problem


def _info(
    readings: Readings,
    role: str,
    roles: Mapping[str, str],
    topics: Mapping[str, Topic],
    path: Path,
) -> _Info:
    message = readings.infos.get(role)
    if message is None:
        infos = [topic for topic in topics.values() if topic.type == INFO]
        raise CalibrationError(
            f"{path} has no readable camera_info for {role}; record that of the camera, or name "
            f"it with --topic {role}=NAME, of {listing(infos or topics.values())}."
        )
    source = f"{path.name}: {roles[role]}"
    info = _Info(
        (int(message.width), int(message.height)),
        _matrix(message, "k", (3, 3), source),
        _matrix(message, "d", (-1,), source),
        _matrix(message, "r", (3, 3), source),
        _matrix(message, "p", (3, 4), source),
        str(message.distortion_model),
        source,
    )
    if info.K[0, 0] == 0.0:
        raise CalibrationError(
            f"{source}: K[0] = 0 means that the camera was never calibrated; calibrate it."
        )
    if message.binning_x > 1 or message.binning_y > 1 or message.roi.width or message.roi.height:
        raise CalibrationError(
            f"{source}: binning or a region of interest is set, which is not read; record whole "
            "images with the calibration of their size."
        )
    return info if info.R.any() else info._replace(R=np.eye(3))


def _matrix(message: Any, name: str, shape: tuple[int, ...], source: str) -> _Float64:
    matrix = np.asarray(field(message, name), dtype=np.float64)
    fits = matrix.size <= _MOST_COEFFICIENTS if -1 in shape else matrix.size == math.prod(shape)
    if not (fits and np.isfinite(matrix).all()):
        raise CalibrationError(
            f"{source}: {name.upper()} is no matrix of numbers; calibrate the camera again."
        )
    return matrix.reshape(shape)


class Mounted(NamedTuple):
    """The mounting of a sensor, the turn of points that it does not tell, and remarks."""

    mounting: Mounting
    R_sensor: _Float64
    notes: tuple[str, ...] = ()


class SensorFrame(NamedTuple):
    """Which frame a sensor's data are in: `R` turns its directions into the sensor frame's
    (right, down, forward). In the latter, `origin_m` is the point above the grid origin: of a
    pair the middle of the baseline; and `measured_m` the point that a mounting.json counts from,
    which is the middle of a pair even where its left camera alone gives the depths."""

    name: str
    R: _Float64
    origin_m: _Float64
    measured_m: _Float64


def find_mounting(
    path: Path, options: Options, readings: Readings, sensor: SensorFrame, antenna: str
) -> Mounted:
    """The mounting that is given or lies beside the bag, else that of its static transforms.

    `antenna` is the frame of the fixes. Raises CalibrationError when nothing tells it.
    """
    usual = mounting_place(path)
    if options.mounting is not None or usual.exists():
        return Mounted(_moved(options.find_mounting(usual, path), sensor), np.eye(3))
    placed = _place(readings.transforms, sensor.name, GROUND)
    if placed is None and _place(readings.transforms, sensor.name, BASE) is not None:
        raise CalibrationError(
            f"{path}: its static transforms place the sensor ({sensor.name!r}) on {BASE}, but do "
            f"not say how high that is above the ground; record the transform from {GROUND} to "
            f"{BASE}, or write {usual} ({estimating(path)} estimates it)."
        )
    if placed is None:
        raise missing_mounting(usual, path)
    at_antenna = _place(readings.transforms, antenna, GROUND)
    if at_antenna is None:
        raise CalibrationError(
            f"{path}: its static transforms place the sensor ({sensor.name!r}) above {GROUND}, but "
            f"not the antenna ({antenna or 'no frame_id'!r}), and a forgotten lever arm misplaces "
            f"the whole map; record the antenna's transform, or write {usual} ({estimating(path)} "
            "does)."
        )
    axle = _place(readings.transforms, AXLE, GROUND)
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
    path: Path, placed: Place, antenna: Place, axle: Place | None, sensor: SensorFrame
) -> Mounted:
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
    return Mounted(Mounting(mount, arm, axle_m, source=source), R_sensor, tuple(notes))


def _rounded(value: float) -> float:
    return round(float(value), _DIGITS) + 0.0  # and no -0


def _place(transforms: Transforms, frame: str, base: str) -> Place | None:
    return transforms.place(frame, base) if frame and transforms.has(frame) else None


def optical(frame: str, readings: Readings, axes: str | None = None) -> _Float64:
    """Turns directions of a sensor's frame into right, down, forward.

    `axes` are where its x, y and z point, when that is said. Else frames whose name says so are
    optical, and others are taken as forward, left, up, unless the static transforms show their x
    axis to point right and their z axis not up.
    """
    if axes is not None:
        return R_OPTICAL_FLU @ np.array(directions(axes), dtype=np.float64).T
    if "optical" in frame.lower():
        return np.eye(3)
    for base in (GROUND, BASE):
        placed = _place(readings.transforms, frame, base)
        if placed is not None and placed.R[1, 0] < -0.5 and placed.R[2, 2] < 0.5:
            return np.eye(3)
    return R_OPTICAL_FLU


def vertical_row(imu_frame: str, readings: Readings) -> _Float64 | None:
    """What of an IMU's three rates is the rate about the vehicle's vertical, upwards: a row of
    three numbers; None where no static transform tells it."""
    for base in (BASE, GROUND):
        placed = _place(readings.transforms, imu_frame, base)
        if placed is not None:
            row, whole = placed.R[2], np.round(placed.R[2])
            return np.asarray(whole if np.abs(whole - row).max() < _SAME else row)
    return None
