"""The plain folder: images, frames.csv, calibration/, gnss/ and an optional recording.toml."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fieldgrid.core import LackingError, NoFramesError, RecordingError
from fieldgrid.recordings.calibration.loading import read_calibration
from fieldgrid.recordings.calibration.mounting import MOUNTING, Mounting, read_mounting
from fieldgrid.recordings.drive import Drive, Recording, as_recording, with_motion
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.frames.frame_table import TABLE
from fieldgrid.recordings.options import DriveOptions, mounted
from fieldgrid.recordings.readers.sensors import CALIBRATION, has_frames, read_seen
from fieldgrid.recordings.readers.settings_file import (
    SETTINGS,
    RecordingSettings,
    read_session_datum,
    read_settings,
)
from fieldgrid.recordings.stored import StoredFrames
from fieldgrid.recordings.tables.logs import find_log, with_log
from fieldgrid.recordings.tables.motion_files import AXES, read_motion

SESSION = "session.json"


def recognises(path: Path) -> bool:
    """Whether a folder is a plain recording, or holds at least the GNSS logs of a drive."""
    if (path / TABLE).is_file() or has_frames(path) or (path / "gnss").is_dir():
        return True
    return (path / SETTINGS).is_file() and read_settings(path / SETTINGS).frames is not None


def open_folder(path: Path, options: DriveOptions) -> Drive:
    """The drive in a plain folder, with frames or without. What the options say outranks the
    settings file."""
    options.refuse_topics(path)
    settings = read_settings(path / SETTINGS)
    bare = Drive(
        path=path,
        name=settings.name or path.resolve().name,
        datum_hint=settings.datum or read_session_datum(path / SESSION),
        pose_source=settings.poses,
    )
    try:
        drive = with_log(bare, path, find_log(path, options.gnss), settings, options)
    except RecordingError as problem:
        refusal = _with_frames(bare, settings, options).refusal
        if refusal is None or isinstance(refusal, NoFramesError):
            raise
        raise LackingError(refusal, problem) from problem
    return _with_frames(drive, settings, options)


def _with_frames(drive: Drive, settings: RecordingSettings, options: DriveOptions) -> Drive:
    """A drive with the frames of its folder; where it has none, it says why."""
    path = drive.path
    if not ((path / TABLE).is_file() or has_frames(path) or settings.frames is not None):
        return _without_frames(path, options, drive)

    def make(mounting: Mounting) -> Recording:
        offset_ns = options.offset_or(settings.image_time_offset_ns)
        seen = read_seen(path, settings, mounting, offset_ns, incomplete=options.incomplete)
        frames = StoredFrames(path, seen.shots, seen.kind)
        moving = with_motion(drive, *read_motion(path, mounting.imu_axes))
        return as_recording(moving, seen.rig, frames, seen.notes)

    usual = folder_mounting_path(path)
    found = mounted(drive, lambda: options.find_mounting(usual, path), make)
    return found if found.refusal is None else with_motion(found, *read_motion(path))


def _without_frames(path: Path, options: DriveOptions, drive: Drive) -> Drive:
    """A folder of logs; where it has a calibration, that tells what carried the antenna."""
    why = f"{path} is no recording with images"
    options.refuse(why, "mounting", "image_time_offset_ns")
    folder = path / CALIBRATION
    mounting = read_mounting(folder / MOUNTING) if folder.is_dir() else None
    return replace(
        with_motion(drive, *read_motion(path, AXES if mounting is None else mounting.imu_axes)),
        rig=None if mounting is None else mounting.rig(read_calibration(folder).camera),
        refusal=NoFramesError(
            f"{why}: it has neither {TABLE}, nor left/ and right/, depth/, disparity/ or clouds/; "
            "give one that has, or track its fixes alone."
        ),
    )


def folder_mounting_path(path: Path) -> Path:
    """Where the mounting of a plain folder is."""
    return path / CALIBRATION / MOUNTING


FORMAT = Format(
    "plain folder",
    f"{TABLE}, or left/ and right/, depth/, disparity/ or clouds/, or gnss/",
    recognises,
    open_folder,
    folder_mounting_path,
)
