"""KITTI odometry: `sequences/NN` with rectified pairs, `calib.txt` and times from 0.

It has no GNSS. Its poses can stand in for one, once it is said where and when they start.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fieldgrid.core import RecordingError
from fieldgrid.geometry import LeverArm, Mount
from fieldgrid.perception import camera_from_projections
from fieldgrid.recordings.calibration.kitti import CAMERA_HEIGHT_M, HEIGHT_NOTE, read_entries
from fieldgrid.recordings.calibration.mounting import MOUNTING, Mounting
from fieldgrid.recordings.calibration.yaml_text import numbers
from fieldgrid.recordings.drive import Drive, Recording, as_recording
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.frames.images import ImageFile
from fieldgrid.recordings.options import DriveOptions, mounted
from fieldgrid.recordings.poses.pose_files import read_time_file
from fieldgrid.recordings.readers.kitti_poses import first_camera, with_own_poses
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
    options.refuse_topics(path)
    settings = read_settings(path / SETTINGS)
    log_path, usual = find_log(path, options.gnss), path / MOUNTING
    is_mounted = options.mounting is not None or usual.exists()
    times_ns = None
    if settings.start is not None:
        times_ns = read_time_file(path / _TIMES, settings.start.time_ns)
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
        options.refuse("The poses of a KITTI sequence are no log", "columns", "epoch_ns")
        drive = with_own_poses(drive, times_ns, settings, find_mounting().mount)

    def make(mounting: Mounting) -> Recording:
        if times_ns is None:
            raise RecordingError(
                f"{path / _TIMES} counts from 0, and nothing says when it was driven; add "
                f"{SETTINGS} with [start] utc_s = seconds since 1970 of its first image, and "
                "[datum] lat_deg, lon_deg and height_m = where that was taken, unless --gnss or "
                "--frame-origin says it."
            )
        sides = image_folders(path, _SIDES)
        assert sides is not None
        file = path / _CALIBRATION
        table = read_entries(file)
        P_left, P_right = (numbers(table, f"P{side[-1]}", (3, 4), file) for side in sides)
        shots = paired_shots(path, sides, times_ns.tolist(), incomplete=options.incomplete)
        size_px = ImageFile(path / shots[0].files[0]).size_px()
        camera = camera_from_projections(P_left, P_right, size_px, str(file))
        rig = mounting.rig(camera, options.offset_or(settings.image_time_offset_ns))
        if log_path is None:
            antenna = first_camera(P_left, camera, mounting.mount)
            rig = replace(
                rig, antenna=antenna, heading_offset_deg=0.0, heading_convention="cw_north"
            )
        notes = () if log_path is not None or is_mounted else (HEIGHT_NOTE,)
        return as_recording(drive, rig, StoredFrames(path, shots, PairKind(size_px)), notes)

    return mounted(drive, find_mounting, make)


FORMAT = Format(
    "KITTI odometry",
    "a KITTI sequence with calib.txt, times.txt, image_0 and image_1",
    recognises,
    open_sequence,
)
