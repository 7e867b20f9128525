"""The stereo calibration of a folder: which of its files says it, and what they say together."""

from __future__ import annotations

from pathlib import Path

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import SAME
from fieldgrid.recordings.calibration.calibrated import Calibration
from fieldgrid.recordings.calibration.kalibr import read_kalibr
from fieldgrid.recordings.calibration.opencv import read_opencv
from fieldgrid.recordings.calibration.ros import read_ros
from fieldgrid.recordings.calibration.yaml_text import load_yaml
from fieldgrid.recordings.files import read_text

__all__ = ["Calibration", "read_calibration"]

_OPENCV = "stereo_opencv.yaml"
_ROS_LEFT, _ROS_RIGHT = "stereo_left_camera_info.yaml", "stereo_right_camera_info.yaml"
_ROS_OWN = "left.yaml", "right.yaml"
"""As ROS's calibrator writes them."""
_TWO_OPENCV = "intrinsics.yml", "extrinsics.yml"
"""As OpenCV's stereo_calib writes them."""
_KALIBR = "*camchain*.yaml"
_NOT_READ = (
    ("*.json", '"cameraData"', "DepthAI's calibration of an OAK camera"),
    ("*.conf", "[STEREO]", "a ZED's factory calibration"),
)
"""Files of makers: how they are called, what is in them, what they are."""


def read_calibration(
    folder: Path,
    named: str | None = None,
    rectified: bool | None = None,
    size_px: tuple[int, int] | None = None,
) -> Calibration:
    """The camera by the files of `calibration/`; when there are OpenCV's and ROS's, they must
    agree. Where there is no other, left.yaml and right.yaml of ROS are read, else intrinsics.yml
    with extrinsics.yml of OpenCV, else Kalibr's.

    `named` is the file to take, in the folder or in the recording around it. `rectified` is
    whether the images are rectified, None when that is not said: then the files decide. `size_px`
    is the (width, height) of the images, for OpenCV's files that do not say it.
    """
    if named is not None:
        return _read_named(folder, named, rectified, size_px)
    found = []
    if (folder / _OPENCV).exists():
        found.append(read_opencv(folder / _OPENCV, rectified, size_px))
    if (folder / _ROS_LEFT).exists() or (folder / _ROS_RIGHT).exists():
        found.append(read_ros(folder / _ROS_LEFT, folder / _ROS_RIGHT, rectified))
    own = [folder / name for name in _ROS_OWN]
    if not found and all(path.exists() for path in own):
        return read_ros(own[0], own[1], rectified)
    lenses, places = (folder / name for name in _TWO_OPENCV)
    if not found and (lenses.exists() or places.exists()):
        return read_opencv(lenses, rectified, size_px, places)
    if not found:
        return read_kalibr(_camchain(folder), rectified)
    products = [calibration.camera.focal_baseline_px_m for calibration in found]
    if abs(products[-1] - products[0]) > SAME * products[0]:
        raise CalibrationError(
            f"{folder}: {_OPENCV} and {_ROS_RIGHT} disagree in f·b, {products[0]:g} and "
            f"{products[-1]:g} px·m; remove the one that is out of date."
        )
    return found[0]


def _camchain(folder: Path) -> Path:
    present = sorted(folder.glob(_KALIBR))
    if not present:
        for pattern, words, what in _NOT_READ:
            for path in sorted(folder.glob(pattern)):
                if words in read_text(path, error=CalibrationError):
                    raise CalibrationError(
                        f"{path} is {what}, and not read; write what it says into {_OPENCV}: K1, "
                        "D1, K2, D2, R and T (metres), image_width and image_height."
                    )
        others = sorted(path.name for path in folder.glob("*.y*ml"))
        named = (
            f"; of {', '.join(others)[:300]}, name the one with both cameras in recording.toml: "
            'calibration = "...", or put the calibration of the pair there under such a name.'
            if others
            else "; put the calibration of the pair there."
        )
        raise CalibrationError(
            f"{folder} has neither {_OPENCV} nor {_ROS_LEFT} with {_ROS_RIGHT} nor {_KALIBR}{named}"
        )
    if len(present) > 1:
        names = ", ".join(path.name for path in present)
        raise CalibrationError(
            f"{folder} has several calibrations of Kalibr: {names}; name one in recording.toml: "
            'calibration = "...".'
        )
    return present[0]


def _read_named(
    folder: Path, named: str, rectified: bool | None, size_px: tuple[int, int] | None
) -> Calibration:
    """The calibration in a file of any kind, which its content tells."""
    path = next((p for p in (folder / named, folder.parent / named) if p.exists()), folder / named)
    document = load_yaml(path)
    if "cam0" in document:
        return read_kalibr(path, rectified)
    if "camera_matrix" not in document:
        places = path.with_name(path.name.replace("intrinsics", "extrinsics"))
        # A file with P2 is whole; without it, what is missing is in the other one.
        apart = "R" not in document and places != path
        of_two = apart and (places.exists() or "P2" not in document)
        return read_opencv(path, rectified, size_px, places if of_two else None)
    if "left" not in path.name:
        raise CalibrationError(
            f"{path} is ROS's camera_info of one camera; name that of the left one, which has "
            "'left' in its name, with 'right' instead in that of the other."
        )
    return read_ros(path, path.with_name(path.name.replace("left", "right")), rectified)
