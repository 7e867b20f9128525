"""EuRoC (ASL) folders: `mav0/cam0`, `cam1` and `imu0`, each with `sensor.yaml` and `data.csv`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fieldgrid.core import Float64, RecordingError, counted
from fieldgrid.geometry import Motion
from fieldgrid.recordings.calibration.kalibr import body_pose, read_euroc
from fieldgrid.recordings.calibration.mounting import MOUNTING, Mounting
from fieldgrid.recordings.drive import Drive, Recording, as_recording, with_motion
from fieldgrid.recordings.files import read_table
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.frames.frame_table import MAX_FRAMES, FrameLayout, shot_of_row
from fieldgrid.recordings.frames.image_format import image_format
from fieldgrid.recordings.frames.images import SUFFIXES
from fieldgrid.recordings.options import DriveOptions, mounted
from fieldgrid.recordings.readers.settings_file import SETTINGS, read_settings
from fieldgrid.recordings.stored import PairKind, Shot, StoredFrames, checked_shots
from fieldgrid.recordings.tables.logs import find_log, with_log
from fieldgrid.recordings.tables.motion_files import read_imu

_LOOKS_FOR = "mav0 with cam0 and cam1"
_TOP = "mav0"
_LEFT, _RIGHT, _IMU = "cam0", "cam1", "imu0"
_DATA, _SENSOR = "data.csv", "sensor.yaml"
_ROWS = FrameLayout(("file",), ("data",), SUFFIXES, "image")


def mounting_path(path: Path) -> Path:
    """The mounting of a recording, or where one would be: in calibration/, in mav0 or beside it."""
    folder, mav = _folders(path)
    inside = folder / "calibration" / MOUNTING
    return inside if inside.exists() else _beside(folder, mav, MOUNTING)


def open_euroc(path: Path, options: DriveOptions) -> Drive:
    """The recording at a path; what EuRoC's format has no place for lies beside or in mav0:
    `mounting.json`, `gnss/`, `recording.toml`."""
    options.refuse_topics(path)
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

    def make(mounting: Mounting) -> Recording:
        calibration = read_euroc(*sensors).calibration(None)
        camera = calibration.camera
        shots, frame_notes = _shots(folder, mav, options.incomplete)
        stored, image_notes = image_format(folder, shots, settings)
        size_px = (camera.width_px, camera.height_px)
        R_rect_body = calibration.R_rect_left @ body_pose(sensors[0])[:3, :3].T
        return as_recording(
            with_motion(drive, *_turning(mav / _IMU, mounting.mount.rotation() @ R_rect_body)),
            mounting.rig(camera, options.offset_or(settings.image_time_offset_ns)),
            StoredFrames(folder, shots, PairKind(size_px, calibration.rectifier, stored)),
            frame_notes + image_notes,
        )

    sensors = mav / _LEFT / _SENSOR, mav / _RIGHT / _SENSOR
    usual = mounting_path(path)
    return mounted(drive, lambda: options.find_mounting(usual, path), make)


def _mav(path: Path) -> Path | None:
    """The folder that holds the sensors."""
    for mav in (path / _TOP, path):
        if all((mav / camera / _DATA).is_file() for camera in (_LEFT, _RIGHT)):
            return mav
    return None


def _folders(path: Path) -> tuple[Path, Path]:
    """The folder of the recording, and that of the sensors in it, which may be the same."""
    mav = _mav(path)
    assert mav is not None, f"{path} has no {_LOOKS_FOR}"
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
    shots: list[Shot] = []
    for number, row in read_table(path, (), named=lambda _: ["time_ns", "file"]):
        row["frame_id"] = f"{row['time_ns']} ({row['file']})"
        shots.append(shot_of_row(row, f"{path}, line {number}", _ROWS, str))
        if len(shots) > MAX_FRAMES:
            raise RecordingError(
                f"{path} lists more than {MAX_FRAMES} images; split the recording."
            )
    checked = checked_shots(shots, camera, "image", incomplete=True)
    return {shot.time_ns: shot.files[0] for shot in checked}


def _turning(imu: Path, R_vehicle_body: Float64) -> tuple[Motion, tuple[str, ...]]:
    """The IMU in the vehicle's axes, as the cameras give them."""
    if not (imu / _DATA).is_file():
        return Motion(), ()
    sensor = imu / _SENSOR
    R_body_imu = body_pose(sensor)[:3, :3] if sensor.is_file() else np.eye(3)
    notes: list[str] = []
    # Far below what can be calibrated; axes that are meant to be parallel are so to the bit.
    R_vehicle_imu = np.round(R_vehicle_body @ R_body_imu, 9)
    return read_imu([imu / _DATA], R_vehicle_imu, notes, guessed=[]), tuple(notes)


FORMAT = Format(
    "EuRoC",
    _LOOKS_FOR,
    lambda path: _mav(path) is not None,
    open_euroc,
    mounting_path,
)
