"""`mounting.json`: where the camera sits on the vehicle, and where the antenna."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from fieldgrid.errors import CalibrationError
from fieldgrid.publish import replacing
from fieldgrid.recording.files import read_text
from fieldgrid.recording.motion_files import AXES, check_axes
from fieldgrid.rig import (
    HeadingConvention,
    LeverArm,
    Mount,
    Rig,
    Sensor,
    StereoCamera,
    check_offset,
)

MOUNTING = "mounting.json"

_HEIGHT = "camera_height_above_ground_m"
_TILT = "camera_tilt_down_deg"
_ANTENNA = "gnss_antenna_from_camera_mid_flu_m"
_AXLE = "camera_mid_from_rear_axle_ground_flu_m"
_ROLL, _YAW, _BASELINE = "camera_roll_deg", "camera_yaw_deg", "stereo_baseline_m"
_OFFSET, _CONVENTION, _AXES = "heading_offset_deg", "heading_convention", "imu_axes"
_MEANT = (
    *(_HEIGHT, _TILT, _ROLL, _YAW, _BASELINE, _ANTENNA, _AXLE),
    *(_OFFSET, _CONVENTION, _AXES),
)
# What people write for other people. Nothing of it is read, so that it cannot be wrong.
_REMARKS = (
    *("name", "vehicle", "vehicle_frame", "camera", "camera_mid_point", "gnss_antenna", "imu"),
    *("left_camera_from_camera_mid_flu_m", "right_camera_from_camera_mid_flu_m"),
    *("note", "notes", "comment", "description", "date", "measured_by"),
)
_MAX_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Mounting:
    """Everything of a rig but its sensor, and where the axes of the IMU point (three of f b l r
    u d). `baseline_m` is what the mounting says of the stereo pair, None when nothing;
    `source` is what errors call it."""

    mount: Mount
    antenna: LeverArm
    rear_axle_forward_m: float | None = None
    heading_offset_deg: float | None = None
    heading_convention: HeadingConvention = "cw_north"
    imu_axes: str = AXES
    baseline_m: float | None = None
    source: str = "the mounting"

    def rig(self, sensor: Sensor, image_time_offset_ns: int = 0) -> Rig:
        """The rig with this sensor; CalibrationError when the two disagree in the baseline."""
        said_m = self.baseline_m
        if isinstance(sensor, StereoCamera) and said_m is not None:
            baseline_m = sensor.baseline_m
            if abs(said_m - baseline_m) > 0.01 * baseline_m:
                raise CalibrationError(
                    f"{self.source}: {_BASELINE} is {said_m}, but the calibration says "
                    f"{baseline_m:g} m; correct the one that is wrong."
                )
        return Rig(
            sensor,
            self.mount,
            self.antenna,
            self.rear_axle_forward_m,
            image_time_offset_ns,
            self.heading_offset_deg,
            self.heading_convention,
        )


def missing_mounting(path: Path, recording: Path) -> CalibrationError:
    """The error of a recording that has no mounting where `path` would be."""
    return CalibrationError(
        f"{recording} does not say how its sensor is mounted: there is no {path.name}, and without "
        f"height and tilt nothing can be placed; run {estimating(recording)} to estimate them, or "
        f"write {path}."
    )


def estimating(recording: Path) -> str:
    """The command that estimates a mounting and writes it; no drive tells where the antenna is."""
    return f"`fieldgrid mount {recording} --write --antenna FORWARD LEFT UP`"


def read_mounting(path: Path) -> Mounting:
    """The mounting in a file.

    Points are [forward, left, up] in metres from the middle of the stereo baseline (FLU). Roll
    and yaw are 0 when absent; height, tilt and antenna have no usual value and must be there.
    A key that is neither known nor one of the remarks is an error: it may be a misspelt one.
    """
    document = _load(path)
    _refuse_unknown(document, path)
    height_m, tilt_deg = _number(document, _HEIGHT, path), _number(document, _TILT, path)
    roll_deg = _number(document, _ROLL, path, 0.0)
    yaw_deg = _number(document, _YAW, path, 0.0)
    forward, left, up = _point(document, _ANTENNA, path)
    # The axle's point is the middle of the baseline seen from it, on the ground.
    axle_forward_m = -_point(document, _AXLE, path)[0] if _AXLE in document else None
    convention = _convention(document, path)
    offset_deg = _number(document, _OFFSET, path) if _OFFSET in document else None
    baseline_m = _number(document, _BASELINE, path) if _BASELINE in document else None
    imu_axes = _imu_axes(document, path)
    try:
        check_offset(offset_deg)
        return Mounting(
            Mount(height_m, tilt_deg, roll_deg, yaw_deg),
            LeverArm(right_m=-left, forward_m=forward, up_m=height_m + up),
            axle_forward_m,
            heading_offset_deg=offset_deg,
            heading_convention=convention,
            imu_axes=imu_axes,
            baseline_m=baseline_m,
            source=str(path),
        )
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem


def write_mounting(path: Path, mounting: Mounting) -> None:
    """Write a mounting where :func:`read_mounting` finds it again.

    A file that is there keeps its remarks, and is replaced at once or not at all. Raises
    CalibrationError when it is no mounting, MapWriteError when the disk does not take it.
    """
    document: dict[str, Any] = {}
    if path.exists():
        read_mounting(path)
        document = _load(path)
    mount, antenna = mounting.mount, mounting.antenna
    document[_HEIGHT], document[_TILT] = mount.height_m, mount.tilt_deg
    document[_ROLL], document[_YAW] = mount.roll_deg, mount.yaw_deg
    # Rounded to micrometres: the height was added when it was read.
    up_m = round(antenna.up_m - mount.height_m, 6)
    document[_ANTENNA] = [antenna.forward_m, -antenna.right_m + 0.0, up_m]
    axle_m = mounting.rear_axle_forward_m
    if axle_m is None:
        document.pop(_AXLE, None)
    else:
        left_m = document[_AXLE][1] if _AXLE in document else 0.0
        document[_AXLE] = [-axle_m, left_m, mount.height_m]
    _put(document, _BASELINE, mounting.baseline_m, None)
    _put(document, _OFFSET, mounting.heading_offset_deg, None)
    _put(document, _CONVENTION, mounting.heading_convention, "cw_north")
    _put(document, _AXES, mounting.imu_axes, AXES)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as draft:
        draft.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _put(document: dict[str, Any], key: str, value: object, usual: object) -> None:
    """Set a key, or leave it out where it would say what is usual and nothing says it yet."""
    if value != usual:
        document[key] = value
    elif usual is None:
        document.pop(key, None)
    elif key in document:
        document[key] = usual


def _refuse_unknown(document: dict[str, Any], path: Path) -> None:
    unknown = sorted(document.keys() - {*_MEANT, *_REMARKS})
    if unknown:
        raise CalibrationError(
            f"{path}: {unknown[0]!r} is no key of a mounting; known are {', '.join(_MEANT)}, and "
            f"for remarks {', '.join(_REMARKS)}."
        )


def _convention(document: dict[str, Any], path: Path) -> HeadingConvention:
    said = document.get(_CONVENTION, "cw_north")
    known: tuple[HeadingConvention, ...] = get_args(HeadingConvention)
    for convention in known:
        if said == convention:
            return convention
    raise CalibrationError(f"{path}: {_CONVENTION} is {said!r}; give one of {', '.join(known)}.")


def _imu_axes(document: dict[str, Any], path: Path) -> str:
    try:
        return check_axes(str(document.get(_AXES, AXES)))
    except ValueError as problem:
        raise CalibrationError(f"{path}: {_AXES} {problem}.") from problem


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
