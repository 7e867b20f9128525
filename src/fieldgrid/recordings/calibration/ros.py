"""A pair of ROS's camera_info files, as camera_calibration writes them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64
from fieldgrid.geometry import DepthCamera, RawCamera, lens_model, raw_camera
from fieldgrid.perception import camera_from_projections, rectify_by_projections
from fieldgrid.recordings.calibration.calibrated import (
    Calibration,
    rectified_here,
    taken_as_rectified,
)
from fieldgrid.recordings.calibration.yaml_text import image_size, load_yaml, matrix

_INTRINSICS = ((0, 0), (1, 1), (0, 2), (1, 2))  # fx, fy, cx, cy
_STRAIGHT_DEG = 0.01
"""A rotation below it moves no pixel by a quarter of its side."""


def read_ros(left: Path, right: Path, rectified: bool | None) -> Calibration:
    """The calibration in two files. Images are rectified unless the contrary is said. Where it is
    said that they are, a rotation to rectify them contradicts it: CalibrationError."""
    infos = _Info.read(left), _Info.read(right)
    if infos[0].size_px != infos[1].size_px:
        raise CalibrationError(
            f"{left} is for images of {infos[0].size_px} px, {right} for {infos[1].size_px} px; "
            "give the calibration of one pair."
        )
    P_left, P_right = (info.matrix("projection_matrix", (3, 4)) for info in infos)
    if rectified is False:
        R_left, R_right = (info.matrix("rectification_matrix", (3, 3)) for info in infos)
        first, second = (info.camera() for info in infos)
        found = rectify_by_projections(
            first, second, (R_left, R_right), (P_left, P_right), str(right)
        )
        return rectified_here(found, left)
    for info in infos:
        if rectified and info.turn_deg > _STRAIGHT_DEG:
            raise CalibrationError(
                f"{info.path}: rectification_matrix turns the camera by {info.turn_deg:.2f} "
                "degrees, and recording.toml says that the images are rectified; give the "
                "calibration of the rectified pair (the identity there, and in camera_matrix what "
                "is in projection_matrix), or leave `rectified` out."
            )
    camera = camera_from_projections(P_left, P_right, infos[0].size_px, str(right))
    told = rectified is True or not any(info.distortion.any() for info in infos)
    return Calibration(camera, () if told else (taken_as_rectified(left),))


def read_ros_camera(path: Path) -> tuple[DepthCamera, tuple[str, ...]]:
    """The camera of one file, of which the images are rectified, and remarks."""
    info = _Info.read(path)
    P = info.matrix("projection_matrix", (3, 4))
    used = P if P[0, 0] else info.matrix("camera_matrix", (3, 3))
    try:
        camera = DepthCamera(*info.size_px, *(float(used[i]) for i in _INTRINSICS))
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem
    return camera, ()


class _Info(NamedTuple):
    """One file; its camera has been calibrated."""

    path: Path
    document: Mapping[str, Any]
    size_px: tuple[int, int]

    @classmethod
    def read(cls, path: Path) -> _Info:
        document = load_yaml(path)
        info = cls(path, document, image_size(document, path))
        if info.matrix("camera_matrix", (3, 3))[0, 0] == 0.0:
            raise CalibrationError(
                f"{path}: K[0] = 0 means that the camera was never calibrated; calibrate it."
            )
        return info

    def matrix(self, key: str, shape: tuple[int, int] | None) -> Float64:
        return matrix(self.document, key, shape, self.path)

    @property
    def turn_deg(self) -> float:
        """By which angle the images are turned to rectify them; 0 where the file has none."""
        if "rectification_matrix" not in self.document:
            return 0.0
        trace = np.trace(self.matrix("rectification_matrix", (3, 3)))
        return float(np.degrees(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))))

    @property
    def distortion(self) -> Float64:
        key = "distortion_coefficients"
        return self.matrix(key, None) if key in self.document else np.zeros(0)

    def camera(self) -> RawCamera:
        model = lens_model(str(self.document.get("distortion_model", "")), str(self.path))
        K = self.matrix("camera_matrix", (3, 3))
        return raw_camera(self.size_px, K, self.distortion, model, str(self.path))
