"""EuRoC (ASL) folders: `mav0/cam0`, `cam1` and `imu0`, each with `sensor.yaml` and `data.csv`.

A sensor's T_BS takes points from its frame to that of the body, which is the IMU as a rule.
"""

from __future__ import annotations

from pathlib import Path, PurePath

import numpy as np

from fieldgrid.core import CalibrationError, Float64, RecordingError, counted
from fieldgrid.geometry import Motion
from fieldgrid.perception import is_rotation
from fieldgrid.recordings.calibration.calibrated import Calibration, raw_pair
from fieldgrid.recordings.calibration.kalibr import pinhole
from fieldgrid.recordings.calibration.mounting import MOUNTING, Mounting
from fieldgrid.recordings.calibration.yaml_text import load_yaml, matrix
from fieldgrid.recordings.drive import Drive, Recording, as_recording, with_frames, with_motion
from fieldgrid.recordings.files import is_inside, parse_time_ns, read_table
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.frames.frame_table import MAX_FRAMES
from fieldgrid.recordings.frames.image_format import image_format
from fieldgrid.recordings.options import NO_MOUNTING, DriveOptions, together
from fieldgrid.recordings.readers.settings_file import SETTINGS, read_settings
from fieldgrid.recordings.stored import PairKind, Shot, StoredFrames, checked_shots
from fieldgrid.recordings.tables.logs import find_log, with_log
from fieldgrid.recordings.tables.motion_files import read_imu

_LOOKS_FOR = "mav0 with cam0 and cam1"
_TOP = "mav0"
_LEFT, _RIGHT, _IMU = "cam0", "cam1", "imu0"
_DATA, _SENSOR = "data.csv", "sensor.yaml"
_MAX_AWAY_M = 100.0


def mounting_path(path: Path) -> Path:
    """The mounting of a recording, or where one would be: in calibration/, in mav0 or beside it."""
    folder, mav = _folders(path)
    inside = folder / "calibration" / MOUNTING
    return inside if inside.exists() else _beside(folder, mav, MOUNTING)


def open_euroc(path: Path, options: DriveOptions) -> Drive:
    """The recording at a path; what EuRoC's format has no place for lies beside or in mav0:
    `mounting.json`, `gnss/`, `recording.toml`."""
    options.refuse_of_bags(path)
    folder, mav = _folders(path)
    settings = read_settings(_beside(folder, mav, SETTINGS))
    log_path: Path | None = mav / "gps0" / _DATA
    if options.gnss is not None or not (mav / "gps0" / _DATA).is_file():
        log_path = find_log(mav if (mav / "gnss").is_dir() else folder, options.gnss)
    drive = with_log(
        Drive(
            path=path,
            name=settings.name or folder.resolve().name,
            datum_hint=settings.datum,
            pose_source=settings.poses,
        ),
        folder,
        log_path,
        settings,
        options,
    )

    def make(drive: Drive) -> Recording:
        def mounted(mounting: Mounting) -> Recording:
            calibration = _calibration(mav)
            camera = calibration.camera
            shots, frame_notes = _shots(folder, mav, options.incomplete)
            stored, image_notes = image_format(folder, shots, settings)
            size_px = (camera.width_px, camera.height_px)
            return as_recording(
                with_motion(drive, *_turning(mav, mounting, calibration.R_rect_left)),
                mounting.rig(camera, options.offset_or(settings.image_time_offset_ns)),
                StoredFrames(folder, shots, PairKind(size_px, calibration.rectifier, stored)),
                frame_notes + image_notes,
                is_mounted=mounting is not NO_MOUNTING,
            )

        usual = mounting_path(path)
        return together(lambda: options.find_mounting(usual, path), NO_MOUNTING, mounted)

    return with_frames(drive, make)


def _calibration(mav: Path) -> Calibration:
    """The pair of cam0 and cam1, whose images are raw."""
    sensors = mav / _LEFT / _SENSOR, mav / _RIGHT / _SENSOR
    left, right = (
        pinhole(load_yaml(path), path, path.parent.name, "distortion_coefficients")
        for path in sensors
    )
    T_body_left, T_body_right = (_pose(path) for path in sensors)
    return raw_pair(mav, left, right, np.linalg.inv(T_body_right) @ T_body_left).calibration(None)


def _mav(path: Path) -> Path | None:
    """The folder that holds the sensors."""
    for mav in (path / _TOP, path):
        if all((mav / camera / _DATA).is_file() for camera in (_LEFT, _RIGHT)):
            return mav
    return None


def _folders(path: Path) -> tuple[Path, Path]:
    """The folder of the recording, and that of the sensors in it, which may be the same."""
    mav = _mav(path)
    if mav is None:
        raise RecordingError(f"{path} has no {_LOOKS_FOR}; give the folder that holds them.")
    return mav.parent if mav.name == _TOP else mav, mav


def _beside(folder: Path, mav: Path, name: str) -> Path:
    """A file in mav0 or beside it."""
    return mav / name if (mav / name).exists() else folder / name


def _shots(folder: Path, mav: Path, incomplete: bool) -> tuple[tuple[Shot, ...], tuple[str, ...]]:
    """The images that both cameras took at the same time."""
    left, right = (_images(mav / camera) for camera in (_LEFT, _RIGHT))
    common = sorted(left.keys() & right.keys())
    if not common:
        raise RecordingError(
            f"{mav}: no image of {_LEFT} has the time of one of {_RIGHT}; both cameras must be "
            "triggered together and stamped alike."
        )
    top = mav.relative_to(folder)
    left_folder, right_folder = (
        f"{(top / camera / 'data').as_posix()}/" for camera in (_LEFT, _RIGHT)
    )
    shots = [
        Shot(time_ns, str(time_ns), (left_folder + left[time_ns], right_folder + right[time_ns]))
        for time_ns in common
    ]
    alone = len(left) + len(right) - 2 * len(common)
    notes = (
        (f"{counted(alone, 'image')} without a partner of the same time skipped.",) if alone else ()
    )
    return checked_shots(shots, folder, incomplete=incomplete), notes


def _images(camera: Path) -> dict[int, str]:
    """The names of the images of a camera by their times, UTC nanoseconds."""
    path = camera / _DATA
    images: dict[int, str] = {}
    for number, row in read_table(path, (), named=lambda _: ["time_ns", "file"]):
        name = row["file"]
        if not is_inside(name) or len(PurePath(name).parts) != 1:
            raise RecordingError(
                f"{path}, line {number}: {name[:40]!r} is no name of a file in {camera.name}/data; "
                "give rows of a time in nanoseconds and a file name."
            )
        try:
            time_ns = parse_time_ns(row)
        except ValueError as problem:
            raise RecordingError(f"{path}, line {number}: {problem}; correct it.") from problem
        if len(images) == MAX_FRAMES:
            raise RecordingError(
                f"{path} lists more than {MAX_FRAMES} images; split the recording."
            )
        if time_ns in images:
            raise RecordingError(
                f"{path}, line {number}: {images[time_ns]} and {name} have the same time {time_ns} "
                "ns; correct the time stamps."
            )
        images[time_ns] = name
    return images


def _pose(path: Path) -> Float64:
    """T_BS, once it is sure to be a rigid motion."""
    T = matrix(load_yaml(path), "T_BS", (4, 4), path)
    is_near = bool((np.abs(T[:3, 3]) < _MAX_AWAY_M).all())
    if not (is_rotation(T[:3, :3]) and is_near and (T[3] == (0, 0, 0, 1)).all()):
        raise CalibrationError(f"{path}: T_BS is no rigid transformation; restore the file.")
    return T


def _turning(mav: Path, mounting: Mounting, R_rect_left: Float64) -> tuple[Motion, tuple[str, ...]]:
    """The IMU in the vehicle's axes, as the cameras give them, and the clockwise rate about its
    vertical."""
    path = mav / _IMU / _DATA
    if not path.is_file():
        return Motion(), ()
    R_body_imu = (
        _pose(mav / _IMU / _SENSOR)[:3, :3] if (mav / _IMU / _SENSOR).is_file() else np.eye(3)
    )
    R_rect_body = R_rect_left @ _pose(mav / _LEFT / _SENSOR)[:3, :3].T
    # Far below what can be calibrated; axes that are meant to be parallel are so to the bit.
    R_vehicle_imu = np.round(mounting.mount.rotation() @ R_rect_body @ R_body_imu, 9)
    notes: list[str] = []
    return read_imu([path], R_vehicle_imu, notes, guessed=[]), tuple(notes)


FORMAT = Format(
    "EuRoC",
    _LOOKS_FOR,
    lambda path: _mav(path) is not None,
    open_euroc,
    mounting_path,
)
