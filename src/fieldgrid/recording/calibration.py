"""Stereo calibrations: OpenCV's and ROS's files, projection matrices to a rectified camera."""

from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import yaml

from fieldgrid.errors import CalibrationError
from fieldgrid.recording.files import read_text
from fieldgrid.rig import StereoCamera

_Float64 = npt.NDArray[np.float64]

_OPENCV = "stereo_opencv.yaml"
_ROS_LEFT, _ROS_RIGHT = "stereo_left_camera_info.yaml", "stereo_right_camera_info.yaml"

_MAX_BYTES = 1 << 20
_SAME = 1e-3  # relative; what two focal lengths or f·b may differ by
_RECTIFY = "rectified images are required: rectify them and give the P1, P2 of that rectification"


class Calibration(NamedTuple):
    """The camera that a calibration folder describes, and remarks on it."""

    camera: StereoCamera
    notes: tuple[str, ...] = ()


def camera_from_projections(
    left: _Float64, right: _Float64, size_px: tuple[int, int], source: str
) -> StereoCamera:
    """The camera of a rectified pair with projection matrices `left` and `right`, 3 x 4 px.

    `source` is what errors call the file. Both must share focal length and rows; the right
    camera's P[0, 3] less the left's is -f·b.
    """
    fx, fy = float(left[0, 0]), float(left[1, 1])
    if not (np.isfinite(left).all() and np.isfinite(right).all() and fx > 0.0):
        raise CalibrationError(
            f"{source}: a projection matrix starts with {fx}, so this camera is not calibrated; "
            "calibrate it."
        )
    if abs(fx - fy) > _SAME * fx:
        raise CalibrationError(
            f"{source}: the focal lengths fx = {fx} and fy = {fy} px differ by more than 0.1 %; "
            f"{_RECTIFY}."
        )
    apart_px = np.abs(right[:2, :3] - left[:2, :3])
    apart_px[0, 2] = 0.0  # the principal points may differ along the row
    if apart_px.max() > _SAME * fx or abs(right[1, 3] - left[1, 3]) > 0.01 * abs(right[0, 3]):
        raise CalibrationError(
            f"{source}: the two projection matrices do not share focal length and rows "
            f"({left.tolist()} and {right.tolist()}); {_RECTIFY}."
        )
    baseline_m = float(left[0, 3] - right[0, 3]) / fx
    cx, cx_right = float(left[0, 2]), float(right[0, 2])
    try:
        return StereoCamera(
            *size_px, fx, cx, float(left[1, 2]), baseline_m, None if cx == cx_right else cx_right
        )
    except CalibrationError as problem:
        raise CalibrationError(f"{source}: {problem}") from problem


def read_calibration(folder: Path) -> Calibration:
    """The camera by the files of `calibration/`; when there are two kinds, they must agree."""
    found = []
    if (folder / _OPENCV).exists():
        found.append(_read_opencv(folder / _OPENCV))
    if (folder / _ROS_LEFT).exists() or (folder / _ROS_RIGHT).exists():
        found.append(_read_ros(folder / _ROS_LEFT, folder / _ROS_RIGHT))
    if not found:
        raise CalibrationError(
            f"{folder} has neither {_OPENCV} nor {_ROS_LEFT} with {_ROS_RIGHT}; "
            "put the calibration of the rectified pair there."
        )
    products = [camera.focal_baseline_px_m for camera, _ in found]
    if abs(products[-1] - products[0]) > _SAME * products[0]:
        raise CalibrationError(
            f"{folder}: {_OPENCV} and {_ROS_RIGHT} disagree in f·b, {products[0]:g} and "
            f"{products[-1]:g} px·m; remove the one that is out of date."
        )
    return found[0]


def _read_opencv(path: Path) -> Calibration:
    document = _load_yaml(path)
    size_px = _size(document, path)
    straight = _is_undistorted(document, path)
    if "P1" in document or "P2" in document:
        left, right = (_matrix(document, key, (3, 4), path) for key in ("P1", "P2"))
        camera = camera_from_projections(left, right, size_px, str(path))
        return Calibration(camera, () if straight else (_taken_as_rectified(path),))
    if not straight:
        raise CalibrationError(
            f"{path} has lens distortion or a rotation between the cameras, and no P1 and P2; "
            f"{_RECTIFY}."
        )
    k_left, k_right = (_matrix(document, key, (3, 3), path) for key in ("K1", "K2"))
    shift = _matrix(document, "T", (3, 1), path)
    left, right = np.hstack([k_left, np.zeros((3, 1))]), np.hstack([k_right, k_right @ shift])
    return Calibration(camera_from_projections(left, right, size_px, str(path)))


def _is_undistorted(document: dict[str, Any], path: Path) -> bool:
    """Whether the matrices of the file say that raw images are rectified as they are."""
    turns = [_matrix(document, k, (3, 3), path) for k in ("R", "R1", "R2") if k in document]
    lenses = [_matrix(document, k, None, path) for k in ("D1", "D2") if k in document]
    turned = any(np.abs(turn - np.eye(3)).max() > 1e-6 for turn in turns)
    return not turned and all(not lens.any() for lens in lenses)


def _read_ros(left: Path, right: Path) -> Calibration:
    projections, sizes, straight = [], [], True
    for path in (left, right):
        document = _load_yaml(path)
        intrinsics = _matrix(document, "camera_matrix", (3, 3), path)
        if intrinsics[0, 0] == 0.0:
            raise CalibrationError(
                f"{path}: K[0] = 0 means that the camera was never calibrated; calibrate it."
            )
        if "distortion_coefficients" in document:
            straight &= not _matrix(document, "distortion_coefficients", None, path).any()
        projections.append(_matrix(document, "projection_matrix", (3, 4), path))
        sizes.append(_size(document, path))
    if sizes[0] != sizes[1]:
        raise CalibrationError(
            f"{left} is for images of {sizes[0]} px, {right} for {sizes[1]} px; {_RECTIFY}."
        )
    camera = camera_from_projections(projections[0], projections[1], sizes[0], str(right))
    return Calibration(camera, () if straight else (_taken_as_rectified(left),))


def _taken_as_rectified(path: Path) -> str:
    return f"{path.name} describes how to rectify; the images are taken as rectified already."


class _Loader(yaml.SafeLoader):
    """Plain YAML, and OpenCV's tag for a matrix as the mapping that it is."""


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Hashable, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def _load_yaml(path: Path) -> dict[str, Any]:
    # OpenCV's own reader of this format is not made for files from strangers.
    text = read_text(path, _MAX_BYTES, CalibrationError)
    if text.startswith("%YAML:1.0"):  # OpenCV's header, which is no YAML
        text = text.partition("\n")[2]
    try:
        document = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as problem:
        raise CalibrationError(f"{path} is not YAML: {problem}; correct it.") from problem
    if not isinstance(document, dict):
        raise CalibrationError(f"{path} holds no calibration; write it again.")
    return document


def _size(document: dict[str, Any], path: Path) -> tuple[int, int]:
    sizes = []
    for key in ("image_width", "image_height"):
        value = document.get(key)
        if not isinstance(value, int):
            raise CalibrationError(f"{path}: {key} is {value!r}; add the image size in pixels.")
        sizes.append(value)
    return sizes[0], sizes[1]


def _matrix(
    document: dict[str, Any], key: str, shape: tuple[int, int] | None, path: Path
) -> _Float64:
    """The matrix `key`, of `shape` or of any."""
    entry = document.get(key)
    data = entry.get("data") if isinstance(entry, dict) else None
    try:
        values = np.array([float(v) for v in data or ()], dtype=np.float64)
    except (TypeError, ValueError):
        values = np.array([math.nan])
    size = values.size if shape is None else shape[0] * shape[1]
    if values.size != size or not np.isfinite(values).all():
        wanted = "a matrix" if shape is None else f"a matrix of {shape[0]} x {shape[1]}"
        raise CalibrationError(f"{path} lacks {key} as {wanted} of numbers; add its data.")
    return values if shape is None else values.reshape(shape)
