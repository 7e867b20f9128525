"""A pair of ROS's camera_info files, as camera_calibration writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import DepthCamera
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, Entries
from fieldgrid.recordings.calibration.yaml_text import image_size, load_yaml

_NAMES = {
    "K": "camera_matrix",
    "D": "distortion_coefficients",
    "R": "rectification_matrix",
    "P": "projection_matrix",
}
_STRAIGHT_DEG = 0.01
"""A rotation below it moves no pixel by a quarter of its side."""


def read_ros(left: Path, right: Path, rectified: bool | None) -> CalibratedPair:
    """The pair in two files. Where it is said that the images are rectified, a rotation to rectify
    them contradicts it: CalibrationError."""
    first, second = _read(left), _read(right)
    for info in (first, second):
        info.get("P")
        if not rectified or not info.has("R"):
            continue
        turn_deg = np.degrees(np.arccos(np.clip((np.trace(info.get("R")) - 1.0) / 2.0, -1.0, 1.0)))
        if turn_deg > _STRAIGHT_DEG:
            raise CalibrationError(
                f"{info.path}: rectification_matrix turns the camera by {turn_deg:.2f} "
                "degrees, and recording.toml says that the images are rectified; give the "
                "calibration of the rectified pair (the identity there, and in camera_matrix what "
                "is in projection_matrix), or leave `rectified` out."
            )
    return CalibratedPair(left, first, second, Entries({}, right))


def read_ros_camera(path: Path) -> DepthCamera:
    """The camera of one file, of which the images are rectified."""
    info = _read(path)
    info.get("P")
    return depth_camera(info)


def depth_camera(info: Entries, baseline_m: float | None = None) -> DepthCamera:
    """The camera of rectified depths by its projection, if it has one, else by K; `baseline_m` is
    that of the pair they come from, metres."""
    used = info.get("P") if info.has("P") else np.zeros((3, 4))
    used = used if used[0, 0] else info.get("K")
    fx, fy, cx, cy = (float(used[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    try:
        return DepthCamera(*info.size_px, fx, fy, cx, cy, baseline_m)
    except CalibrationError as problem:
        raise CalibrationError(f"{info.path}: {problem}") from problem


def check_calibrated(info: Entries) -> Entries:
    """The entries of a camera, once it is sure that it has been calibrated."""
    if info.get("K")[0, 0] == 0.0:
        raise CalibrationError(
            f"{info.path}: K[0] = 0 means that the camera was never calibrated; calibrate it."
        )
    return info


def _read(path: Path) -> Entries:
    """The entries of one file, whose camera has been calibrated."""
    document = load_yaml(path)
    model = str(document.get("distortion_model", ""))
    return check_calibrated(Entries(document, path, image_size(document, path), _NAMES, model))
