"""KITTI odometry: `sequences/NN` with rectified pairs, `calib.txt` and times from 0.

It has no GNSS. Its poses can stand in for one, once it is said where and when they start.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fieldgrid.core import FieldgridError, LackingError, RecordingError
from fieldgrid.geometry import LeverArm, Mount
from fieldgrid.perception import camera_from_projections
from fieldgrid.recordings.calibration.kitti import (
    CAMERA_HEIGHT_M,
    HEIGHT_NOTE,
    floats,
    numbers,
    read_entries,
)
from fieldgrid.recordings.calibration.mounting import MOUNTING, Mounting, missing_mounting
from fieldgrid.recordings.drive import Drive, Recording, as_recording, no_fixes
from fieldgrid.recordings.files import read_text
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.frames.images import ImageFile
from fieldgrid.recordings.options import DriveOptions, mounted
from fieldgrid.recordings.readers.kitti_poses import find_poses, first_camera, with_own_poses
from fieldgrid.recordings.readers.settings_file import SETTINGS, read_settings
from fieldgrid.recordings.stored import PairKind, StoredFrames, image_folders, paired_shots
from fieldgrid.recordings.tables.logs import find_log, with_log

_CALIBRATION, _TIMES = "calib.txt", "times.txt"
_SIDES = (("image_0", "image_1"), ("image_2", "image_3"))


def recognises(path: Path) -> bool:
    """Whether a path is a sequence."""
    named = all((path / name).is_file() for name in (_CALIBRATION, _TIMES))
    return named and image_folders(path, _SIDES) is not None


def open_sequence(path: Path, options: DriveOptions) -> Drive:
    """The sequence at a path: fixes of a log that is given, else of its own poses."""
    options.refuse_of_bags(path)
    settings = read_settings(path / SETTINGS)
    log_path, poses_path = find_log(path, options.gnss), find_poses(path)
    usual = path / MOUNTING
    is_mounted = options.mounting is not None or usual.exists()
    if settings.start is None:
        problems: list[FieldgridError] = [
            RecordingError(
                f"{path / _TIMES} counts from 0, and nothing says when it was driven; add "
                f"{SETTINGS} with [start] utc_s = seconds since 1970 of its first image, and "
                "[datum] lat_deg, lon_deg and height_m = where that was taken, unless --gnss or "
                "--frame-origin says it."
            )
        ]
        if log_path is not None and not (is_mounted or options.unmounted):
            problems.append(missing_mounting(usual, path))
        if log_path is None and poses_path is None and options.poses is None:
            problems.append(no_fixes(path.name))
        raise problems[0] if len(problems) == 1 else LackingError(*problems)
    times_s = floats(read_text(path / _TIMES), path / _TIMES)
    if not all(0.0 <= time_s < 1e6 for time_s in times_s):
        raise RecordingError(
            f"{path / _TIMES} holds a time that is no second from the start; restore it."
        )
    times_ns = [settings.start.time_ns + round(time_s * 1e9) for time_s in times_s]
    drive = Drive(
        path=path,
        name=settings.name or path.resolve().name,
        datum_hint=settings.datum,
        pose_source=settings.poses,
    )

    def find_mounting() -> Mounting:
        if log_path is not None or is_mounted:
            return options.find_mounting(usual, path)
        return Mounting(Mount(CAMERA_HEIGHT_M, 0.0), LeverArm(0.0, 0.0, 0.0))

    if log_path is not None:
        drive = with_log(drive, path, log_path, settings, options)
    else:
        options.refuse("The poses of a KITTI sequence are no table", "columns")
        drive = with_own_poses(drive, poses_path, times_ns, settings, find_mounting().mount)

    def make(mounting: Mounting) -> Recording:
        sides = image_folders(path, _SIDES)
        assert sides is not None
        file = path / _CALIBRATION
        table = read_entries(file)
        P_left, P_right = (numbers(table, f"P{side[-1]}", 12, file).reshape(3, 4) for side in sides)
        shots = paired_shots(path, sides, times_ns, incomplete=options.incomplete)
        size_px = ImageFile(path / shots[0].files[0]).size_px()
        camera = camera_from_projections(P_left, P_right, size_px, str(file))
        rig = mounting.rig(camera, options.offset_or(settings.image_time_offset_ns))
        if log_path is None:
            antenna = first_camera(P_left, camera, mounting.mount)
            rig = replace(
                rig, antenna=antenna, heading_offset_deg=0.0, heading_convention="cw_north"
            )
        notes = () if log_path is not None or is_mounted else (HEIGHT_NOTE,)
        frames = StoredFrames(path, shots, PairKind(size_px))
        return as_recording(drive, rig, frames, notes)

    return mounted(drive, find_mounting, make)


FORMAT = Format(
    "KITTI odometry",
    "a KITTI sequence with calib.txt, times.txt, image_0 and image_1",
    recognises,
    open_sequence,
)
