"""What the frames of a plain folder are, and the sensor that they are of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import DepthCamera, LeverArm, Lidar, Rig
from fieldgrid.perception import points_per_sr
from fieldgrid.recordings.calibration.loading import read_calibration
from fieldgrid.recordings.calibration.mounting import Mounting
from fieldgrid.recordings.calibration.ros import read_ros_camera
from fieldgrid.recordings.files import read_table
from fieldgrid.recordings.frames.cloud_files import AXES, CLOUDS, CloudFile, CloudKind
from fieldgrid.recordings.frames.depth_files import DEPTHS, DISPARITIES, DepthFormat, DepthKind
from fieldgrid.recordings.frames.frame_table import (
    PAIRS,
    TABLE,
    FrameLayout,
    frame_columns,
    read_frames,
)
from fieldgrid.recordings.frames.image_format import image_format, stored_size_px
from fieldgrid.recordings.options import together
from fieldgrid.recordings.readers.settings_file import RecordingSettings
from fieldgrid.recordings.stored import FrameKind, PairKind, Shot

CALIBRATION = "calibration"
DEPTH_INFO = "depth_camera_info.yaml"

_MEASURED_AT = (0.5, 0.25, 0.75)
"""Parts of the way through a drive at which clouds tell how dense they are."""

_LAYOUTS = {"stereo": PAIRS, "depth": DEPTHS, "disparity": DISPARITIES, "cloud": CLOUDS}


class SensorFrames(NamedTuple):
    """The frames of a recording, the rig that saw them, and remarks."""

    rig: Rig
    shots: tuple[Shot, ...]
    kind: FrameKind
    notes: tuple[str, ...]
    layout: FrameLayout


_Seen = tuple[Rig, FrameKind, tuple[str, ...]]
"""The rig, what its frames are, and remarks."""

_Shots = tuple[tuple[Shot, ...], tuple[str, ...]]
"""Frames and remarks on them."""

_Reader = Callable[
    [Path, RecordingSettings, Mounting, int, FrameLayout, tuple[Shot, ...]],
    _Seen,
]


def has_frames(path: Path) -> bool:
    """Whether a folder has the folders of some kind of frames."""
    return any(layout.is_in(path) for layout in _LAYOUTS.values())


def read_seen(
    path: Path,
    settings: RecordingSettings,
    mounting: Mounting,
    offset_ns: int,
    *,
    incomplete: bool = False,
    growing: bool = False,
) -> SensorFrames:
    """The frames of the recording in a folder.

    Where there are several kinds, the settings say which, or else the first of pairs, depths,
    disparities and clouds is taken. With `incomplete`, files of frames may be missing. With
    `growing` all frames are still to come, and none is looked for.
    """
    found = _kinds(path, settings)
    sensor = settings.sensor or next(iter(found), "stereo")
    layout = _LAYOUTS[sensor]._replace(incomplete=incomplete, growing=growing)
    read: dict[str, _Reader] = {
        "stereo": _pairs,
        "depth": _depths,
        "disparity": _depths,
        "cloud": _clouds,
    }

    def made(frames: _Shots) -> SensorFrames:
        shots, notes = frames
        rig, kind, more = read[sensor](path, settings, mounting, offset_ns, layout, shots)
        return SensorFrames(rig, shots, kind, (*more, *notes), layout)

    none: _Shots = (), ()
    seen = together(lambda: read_frames(path, settings.frames, layout), none, made)
    others = [other for other in found if other != sensor]
    if settings.sensor is None and others:
        note = (
            f"The frames are those of {sensor}; {' and '.join(others)} are there, too: say which "
            f'in recording.toml, like sensor = "{others[0]}".'
        )
        return seen._replace(notes=(*seen.notes, note))
    return seen


def _kinds(path: Path, settings: RecordingSettings) -> list[str]:
    """The kinds of frames that the table has columns for, or without rows there are folders for."""
    table = path / (settings.frames or TABLE)
    if settings.frames is not None or table.exists():
        for _, row in read_table(table, ("frame_id",), named=frame_columns):
            return [kind for kind, layout in _LAYOUTS.items() if row.keys() >= set(layout.columns)]
    return [kind for kind, layout in _LAYOUTS.items() if layout.is_in(path)]


def _pairs(
    path: Path,
    settings: RecordingSettings,
    mounting: Mounting,
    offset_ns: int,
    layout: FrameLayout,
    shots: tuple[Shot, ...],
) -> _Seen:
    size_px = stored_size_px(path, shots)
    calibration = read_calibration(
        path / CALIBRATION, settings.calibration, settings.rectified, size_px
    )
    camera = calibration.camera
    stored, notes = image_format(path, shots, settings)
    kind = PairKind((camera.width_px, camera.height_px), calibration.rectifier, stored)
    return mounting.rig(camera, offset_ns), kind, (*calibration.notes, *notes)


def _depths(
    path: Path,
    settings: RecordingSettings,
    mounting: Mounting,
    offset_ns: int,
    layout: FrameLayout,
    shots: tuple[Shot, ...],
) -> _Seen:
    rig, offset_px, notes = _depth_rig(path, settings, mounting, offset_ns)
    camera = rig.sensor
    assert isinstance(camera, DepthCamera)
    if layout.columns == DEPTHS.columns:
        stated = DepthFormat("depth", settings.scale)
    elif camera.baseline_m is None:
        raise CalibrationError(
            f"{path} has disparities, and nothing says the baseline of their pair; add it to "
            "recording.toml: [disparity] baseline_m, or give the calibration of the pair."
        )
    else:
        product = camera.fx_px * camera.baseline_m
        stated = DepthFormat("disparity", settings.scale, product, offset_px)
    return rig, DepthKind((camera.width_px, camera.height_px), stated), notes


def _depth_rig(
    path: Path, settings: RecordingSettings, mounting: Mounting, offset_ns: int
) -> tuple[Rig, float, tuple[str, ...]]:
    """The rig of a depth camera, the disparity at infinity of its pair, and remarks."""
    info = path / CALIBRATION / (settings.calibration or DEPTH_INFO)
    if info.exists() and (settings.calibration is None or info.name == DEPTH_INFO):
        baseline_m = settings.baseline_m or mounting.baseline_m
        camera = replace(read_ros_camera(info), baseline_m=baseline_m)
        return mounting.rig(camera, offset_ns), 0.0, ()
    calibration = read_calibration(path / CALIBRATION, settings.calibration, settings.rectified)
    if calibration.rectifier is not None:
        raise CalibrationError(
            f"The calibration in {path / CALIBRATION} is of raw images, and depths are of "
            f"rectified ones; give theirs as {DEPTH_INFO}."
        )
    pair = calibration.camera
    f, baseline_m = pair.focal_px, settings.baseline_m or pair.baseline_m
    size_px = (pair.width_px, pair.height_px)
    depth_camera = DepthCamera(*size_px, f, f, pair.cx_px, pair.cy_px, baseline_m)
    rig = mounting.rig(pair, offset_ns)  # which compares the baselines
    note = "The depths are taken to be of the left camera of the calibrated pair."
    left = rig.mount.rotation() @ np.array([-rig.camera.baseline_m / 2.0, 0.0, 0.0])
    right_m, forward_m = float(left[0]), float(left[1])
    antenna, axle_m = rig.antenna, rig.rear_axle_forward_m
    return (
        replace(
            rig,
            sensor=depth_camera,
            mount=replace(rig.mount, height_m=rig.mount.height_m + float(left[2])),
            antenna=LeverArm(
                antenna.right_m - right_m, antenna.forward_m - forward_m, antenna.up_m
            ),
            rear_axle_forward_m=None if axle_m is None else axle_m - forward_m,
        ),
        pair.disparity_offset_px,
        (*calibration.notes, note),
    )


def _clouds(
    path: Path,
    settings: RecordingSettings,
    mounting: Mounting,
    offset_ns: int,
    layout: FrameLayout,
    shots: tuple[Shot, ...],
) -> _Seen:
    kind = CloudKind(settings.axes or AXES, bool(settings.corrected), settings.cloud_scale_m)
    density, note = settings.points_per_sr, ""
    if density is None and layout.growing:
        raise CalibrationError(
            f"Nothing says how dense the clouds of {path} are, and none is there to measure it; "
            "add it to recording.toml: [cloud] points_per_sr."
        )
    if density is None and shots:
        density, name = _measured_density(path, shots, kind)
        note = f"The lidar takes {density:.0f} points in a steradian, by {name}."
    # Without any cloud, the error is that there is none.
    return mounting.rig(Lidar(density or 1.0), offset_ns), kind, (note,) if note else ()


def _measured_density(path: Path, shots: tuple[Shot, ...], kind: CloudKind) -> tuple[float, str]:
    """Points per steradian of the middle cloud, or of another where that one is next to empty;
    and the name of its file."""
    refusal: CalibrationError | None = None
    for part in _MEASURED_AT:
        (name,) = shots[int(part * len(shots))].files
        source = CloudFile(path / name, kind)
        try:
            return points_per_sr(source.read()), name
        except CalibrationError as problem:
            refusal = refusal or CalibrationError(f"{source.name}: {problem}")
    assert refusal is not None
    raise refusal
