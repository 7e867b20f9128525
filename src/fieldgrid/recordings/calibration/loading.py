"""The stereo calibration of a folder: which of its files says it, and what they say together."""

from __future__ import annotations

from pathlib import Path

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import SAME
from fieldgrid.recordings.calibration.calibrated import CalibratedPair, Calibration
from fieldgrid.recordings.calibration.depthai import read_depthai
from fieldgrid.recordings.calibration.kalibr import read_kalibr
from fieldgrid.recordings.calibration.opencv import read_opencv
from fieldgrid.recordings.calibration.ros import read_ros
from fieldgrid.recordings.calibration.yaml_text import load_yaml
from fieldgrid.recordings.calibration.zed import read_zed
from fieldgrid.recordings.files import read_text

_OPENCV = "stereo_opencv.yaml"
_ROS_LEFT, _ROS_RIGHT = "stereo_left_camera_info.yaml", "stereo_right_camera_info.yaml"
_OTHERS = ("left.yaml", "intrinsics.yml", "*camchain*.yaml", "SN*.conf", "*.json")
"""Taken where none of those is: as ROS's calibrator, OpenCV's stereo_calib, Kalibr, a ZED and
DepthAI call them."""


def read_calibration(
    folder: Path,
    named: str | None = None,
    rectified: bool | None = None,
    size_px: tuple[int, int] | None = None,
) -> Calibration:
    """The camera by the files of `calibration/`; when there are OpenCV's and ROS's, they must
    agree. Where there is no other, the first of the other kinds is read.

    `named` is the file to take, in the folder or in the recording around it. `rectified` is
    whether the images are rectified, None when that is not said: then the files decide. `size_px`
    is the (width, height) of the images, for files that do not say it or are of several.
    """
    if named is not None:
        places = (folder / named, folder.parent / named)
        path = next((place for place in places if place.exists()), places[0])
        return _pair(path, rectified, size_px).calibration(rectified)
    own = [folder / name for name in (_OPENCV, _ROS_LEFT) if (folder / name).exists()]
    paths = own or [_other(folder)]
    found = [_pair(path, rectified, size_px).calibration(rectified) for path in paths]
    products = [calibration.camera.focal_baseline_px_m for calibration in found]
    if abs(products[-1] - products[0]) > SAME * products[0]:
        raise CalibrationError(
            f"{folder}: {_OPENCV} and {_ROS_RIGHT} disagree in f·b, {products[0]:g} and "
            f"{products[-1]:g} px·m; remove the one that is out of date."
        )
    return found[0]


def _other(folder: Path) -> Path:
    """The one file of another kind."""
    for pattern in _OTHERS:
        present = [path for path in sorted(folder.glob(pattern)) if _may_be_one(path)]
        if len(present) > 1:
            names = ", ".join(path.name for path in present)
            raise CalibrationError(
                f"{folder} has several calibrations of one kind: {names[:300]}; name one in "
                'recording.toml: calibration = "...".'
            )
        if present:
            return present[0]
    others = ", ".join(sorted(path.name for path in folder.glob("*.y*ml")))
    named = (
        f"; of {others[:300]}, name the one with both cameras in recording.toml: "
        'calibration = "...", or put the calibration of the pair there under such a name.'
        if others
        else "; put the calibration of the pair there."
    )
    raise CalibrationError(
        f"{folder} has neither {_OPENCV} nor {_ROS_LEFT} with {_ROS_RIGHT} nor *camchain*.yaml "
        f"nor the camera's own SN*.conf or JSON{named}"
    )


def _may_be_one(path: Path) -> bool:
    """Whether a file is not of something else, which may have such a name, too."""
    if path.suffix == ".json":
        return '"cameraData"' in read_text(path, error=CalibrationError)
    return path.name != "left.yaml" or path.with_name("right.yaml").exists()


def _pair(path: Path, rectified: bool | None, size_px: tuple[int, int] | None) -> CalibratedPair:
    """The pair in a file, whose kind its name and content tell."""
    if path.suffix == ".conf":
        return read_zed(path, size_px)
    if path.suffix == ".json":
        return read_depthai(path, size_px)
    document = load_yaml(path)
    if "cam0" in document or "camchain" in path.name:
        return read_kalibr(path)
    if "camera_matrix" not in document and path.name != _ROS_LEFT:
        return read_opencv(path, size_px)
    if "left" not in path.name:
        raise CalibrationError(
            f"{path} is ROS's camera_info of one camera; name that of the left one, which has "
            "'left' in its name, with 'right' instead in that of the other."
        )
    return read_ros(path, path.with_name(path.name.replace("left", "right")), rectified)
