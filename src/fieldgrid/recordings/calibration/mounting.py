"""`mounting.json`: where the camera sits on the vehicle, and where the antenna."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import BeforeValidator, Field

from fieldgrid.core import CalibrationError, replacing
from fieldgrid.geometry import (
    HeadingConvention,
    LeverArm,
    Mount,
    Rig,
    Sensor,
    StereoCamera,
    check_offset,
)
from fieldgrid.recordings.readers.entries import EntryTable, Number, entry, fitted, read_document
from fieldgrid.recordings.tables.motion_files import AXES, check_axes

MOUNTING = "mounting.json"

# What people write for other people. Nothing of it is read, so that it cannot be wrong.
_REMARKS = (
    *("name", "vehicle", "vehicle_frame", "camera", "camera_mid_point", "gnss_antenna", "imu"),
    *("left_camera_from_camera_mid_flu_m", "right_camera_from_camera_mid_flu_m"),
    *("note", "notes", "comment", "description", "date", "measured_by"),
)
_BASELINE = "stereo_baseline_m"
_METRES, _DEGREES = "measure it and give a number in metres", "measure it and give degrees"
_POINT = "give [forward, left, up] in metres"


_Point = Annotated[list[Number], Field(min_length=3, max_length=3)]


class _File(EntryTable):
    """The keys of a mounting; points are [forward, left, up] (FLU)."""

    camera_height_above_ground_m: Number = entry(_METRES)
    camera_tilt_down_deg: Number = entry(_DEGREES)
    camera_roll_deg: Number = entry(_DEGREES, 0.0)
    camera_yaw_deg: Number = entry(_DEGREES, 0.0)
    stereo_baseline_m: Number | None = entry(_METRES, None)
    gnss_antenna_from_camera_mid_flu_m: _Point = entry(
        f"measure it and {_POINT}, since a forgotten lever arm misplaces the whole map"
    )
    camera_mid_from_rear_axle_ground_flu_m: _Point | None = entry(_POINT, None)
    heading_offset_deg: Number | None = entry(_DEGREES, None)
    heading_convention: HeadingConvention = entry(
        f"give one of {', '.join(get_args(HeadingConvention))}", "cw_north"
    )
    imu_axes: Annotated[str, BeforeValidator(lambda value: check_axes(str(value)))] = entry(
        "give where x, y and z of the IMU point, like flu", AXES
    )


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
        if (
            isinstance(sensor, StereoCamera)
            and said_m is not None
            and abs(said_m - sensor.baseline_m) > 0.01 * sensor.baseline_m
        ):
            raise CalibrationError(
                f"{self.source}: {_BASELINE} is {said_m}, but the calibration says "
                f"{sensor.baseline_m:g} m; correct the one that is wrong."
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
    _, said = _read(path)
    height_m = said.camera_height_above_ground_m
    forward, left, up = said.gnss_antenna_from_camera_mid_flu_m
    axle = said.camera_mid_from_rear_axle_ground_flu_m
    try:
        check_offset(said.heading_offset_deg)
        return Mounting(
            Mount(height_m, said.camera_tilt_down_deg, said.camera_roll_deg, said.camera_yaw_deg),
            LeverArm(right_m=-left, forward_m=forward, up_m=height_m + up),
            # The axle's point is the middle of the baseline seen from it, on the ground.
            None if axle is None else -axle[0],
            heading_offset_deg=said.heading_offset_deg,
            heading_convention=said.heading_convention,
            imu_axes=said.imu_axes,
            baseline_m=said.stereo_baseline_m,
            source=str(path),
        )
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem


def write_mounting(path: Path, mounting: Mounting) -> None:
    """Write a mounting where :func:`read_mounting` finds it again.

    A file that is there keeps its remarks, and is replaced at once or not at all. Raises
    CalibrationError when it is no mounting, MapWriteError when the disk does not take it.
    """
    document = _read(path)[0] if path.exists() else {}
    mount, antenna, axle_m = mounting.mount, mounting.antenna, mounting.rear_axle_forward_m
    # Rounded to micrometres: the height was added when it was read.
    up_m = round(antenna.up_m - mount.height_m, 6)
    _, left_m, _ = document.get("camera_mid_from_rear_axle_ground_flu_m") or (0.0, 0.0, 0.0)
    said = _File(
        camera_height_above_ground_m=mount.height_m,
        camera_tilt_down_deg=mount.tilt_deg,
        camera_roll_deg=mount.roll_deg,
        camera_yaw_deg=mount.yaw_deg,
        stereo_baseline_m=mounting.baseline_m,
        gnss_antenna_from_camera_mid_flu_m=[antenna.forward_m, -antenna.right_m + 0.0, up_m],
        camera_mid_from_rear_axle_ground_flu_m=(
            None if axle_m is None else [-axle_m, left_m, mount.height_m]
        ),
        heading_offset_deg=mounting.heading_offset_deg,
        heading_convention=mounting.heading_convention,
        imu_axes=mounting.imu_axes,
    )
    usual = ("heading_convention", "imu_axes")  # said only where the file says them, or they differ
    for key, value in said.model_dump().items():
        if value is None:
            document.pop(key, None)
        elif key not in usual or key in document or value != _File.model_fields[key].default:
            document[key] = value
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as draft:
        draft.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _read(path: Path) -> tuple[dict[str, Any], _File]:
    """All that a file holds, remarks included, and what it says."""
    document = read_document(path, "JSON", CalibrationError)
    return document, fitted(_File, document, str(path), CalibrationError, _REMARKS)
