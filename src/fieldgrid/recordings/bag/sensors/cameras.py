"""The camera of a bag, by camera_info."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64, quoted
from fieldgrid.geometry import DepthCamera, lens_model, raw_camera
from fieldgrid.perception import (
    Rectification,
    camera_from_projections,
    rectify_by_pose,
    rectify_by_projections,
)
from fieldgrid.recordings.bag.content import BagIndex
from fieldgrid.recordings.bag.topic_names import is_rectified
from fieldgrid.recordings.bag.topics import INFO, listing

_MOST_COEFFICIENTS = 64


class _Info(NamedTuple):
    """A sensor_msgs/CameraInfo of either ROS; `source` is what errors call it."""

    size_px: tuple[int, int]
    K: Float64
    D: Float64
    R: Float64
    P: Float64
    model: str
    source: str


def stereo_pair(content: BagIndex, said: bool | None) -> Rectification:
    """The camera of the pair, and how raw images are rectified, by its two calibrations. Raises
    CalibrationError.

    Whether the images are rectified is `said`, or by None told by the names of their topics.
    """
    roles, path = content.roles, content.path
    left, right = _info(content, "left_info"), _info(content, "right_info")
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
        return Rectification(camera, None, left.R)
    first, second = (
        raw_camera(one.size_px, one.K, one.D, lens_model(one.model, one.source), one.source)
        for one in (left, right)
    )
    if left.P.any() or right.P.any():
        turns, projections = (left.R, right.R), (left.P, right.P)
        return rectify_by_projections(first, second, turns, projections, right.source)
    frames = content.frame_id("left_info"), content.frame_id("right_info")
    placed = content.transforms.place(*frames)
    if placed is None:
        raise CalibrationError(
            f"{left.source} and {right.source} have no P, and no static transform joins their "
            f"frames {quoted(frames[0])} and {quoted(frames[1])}; calibrate the pair."
        )
    return rectify_by_pose(first, second, placed.R, placed.at_m, path.name)


def depth_camera(content: BagIndex, baseline: float | None) -> DepthCamera:
    """The camera of depth images by their calibration; `baseline` is that of the pair they come
    from, metres, None where nobody says it."""
    info = _info(content, "depth_info")
    return _depth_camera(info, info.P if info.P[0, 0] > 0.0 else info.K, baseline)


def disparity_camera(content: BagIndex, image: Any) -> DepthCamera:
    """The camera of disparity images, of which the first is given: f and T are its own."""
    info = _info(content, "left_info")
    P = info.P.copy()
    P[0, 0] = P[1, 1] = float(image.f)
    return _depth_camera(info, P, float(image.t))


def _depth_camera(info: _Info, P: Float64, baseline: float | None) -> DepthCamera:
    values = (float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]))
    try:
        return DepthCamera(*info.size_px, *values, baseline)
    except CalibrationError as problem:
        raise CalibrationError(f"{info.source}: {problem}") from problem


def _info(content: BagIndex, role: str) -> _Info:
    path, roles, topics = content.path, content.roles, content.bag.topics
    message = content.readings.first(roles.get(role))
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


def _matrix(message: Any, name: str, shape: tuple[int, ...], source: str) -> Float64:
    matrix = np.asarray(getattr(message, name), dtype=np.float64)
    fits = matrix.size <= _MOST_COEFFICIENTS if -1 in shape else matrix.size == math.prod(shape)
    if not (fits and np.isfinite(matrix).all()):
        raise CalibrationError(
            f"{source}: {name.upper()} is no matrix of numbers; calibrate the camera again."
        )
    return matrix.reshape(shape)
