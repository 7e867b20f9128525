"""`mounting.json`: where the camera sits on the vehicle, and where the antenna."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from fieldgrid.errors import CalibrationError
from fieldgrid.recording.files import read_text
from fieldgrid.rig import LeverArm, Mount, Rig, StereoCamera

_HEIGHT = "camera_height_above_ground_m"
_TILT = "camera_tilt_down_deg"
_ANTENNA = "gnss_antenna_from_camera_mid_flu_m"
_AXLE = "camera_mid_from_rear_axle_ground_flu_m"
_MAX_BYTES = 1 << 20


def read_mounting(path: Path, camera: StereoCamera, image_time_offset_ns: int = 0) -> Rig:
    """The rig with this camera. Keys that are not known are left to others.

    Points are [forward, left, up] in metres from the middle of the stereo baseline (FLU). Roll
    and yaw are 0 when absent; height, tilt and antenna have no usual value and must be there.
    """
    document = _load(path)
    baseline_m = _number(document, "stereo_baseline_m", path, camera.baseline_m)
    if abs(baseline_m - camera.baseline_m) > 0.01 * camera.baseline_m:
        raise CalibrationError(
            f"{path}: stereo_baseline_m is {baseline_m}, but the calibration says "
            f"{camera.baseline_m:g} m; correct the one that is wrong."
        )
    height_m, tilt_deg = _number(document, _HEIGHT, path), _number(document, _TILT, path)
    roll_deg = _number(document, "camera_roll_deg", path, 0.0)
    yaw_deg = _number(document, "camera_yaw_deg", path, 0.0)
    forward, left, up = _point(document, _ANTENNA, path)
    # The axle's point is the middle of the baseline seen from it, on the ground.
    axle_forward_m = -_point(document, _AXLE, path)[0] if _AXLE in document else None
    try:
        mount = Mount(height_m, tilt_deg, roll_deg, yaw_deg)
        antenna = LeverArm(right_m=-left, forward_m=forward, up_m=height_m + up)
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem
    return Rig(camera, mount, antenna, axle_forward_m, image_time_offset_ns)


def _load(path: Path) -> dict[str, Any]:
    text = read_text(path, _MAX_BYTES, CalibrationError)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as problem:
        raise CalibrationError(f"{path} is not JSON: {problem}; correct it.") from problem
    if not isinstance(document, dict):
        raise CalibrationError(f"{path} does not hold a JSON object with {_HEIGHT}; add one.")
    return document


def _number(document: dict[str, Any], key: str, path: Path, default: float | None = None) -> float:
    if key not in document:
        if default is None:
            raise CalibrationError(f"{path} lacks {key}; measure it and add it.")
        return default
    return _finite(document[key], key, path)


def _point(document: dict[str, Any], key: str, path: Path) -> tuple[float, float, float]:
    """Metres forward, left, up."""
    if key not in document:
        raise CalibrationError(
            f"{path} lacks {key}, [forward, left, up] in metres; measure it, since a forgotten "
            "lever arm misplaces the whole map."
        )
    value = document[key]
    if not isinstance(value, list) or len(value) != 3:
        raise CalibrationError(f"{path}: {key} is {value!r}, not [forward, left, up] in metres.")
    forward, left, up = (_finite(v, key, path) for v in value)
    return forward, left, up


def _finite(value: object, key: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e9:
        raise CalibrationError(f"{path}: {key} is {value!r}; give a number in metres or degrees.")
    return float(value)
