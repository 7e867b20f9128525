"""KITTI odometry: `sequences/NN` with rectified pairs, `calib.txt` and times from 0.

It has no GNSS. Its poses can stand in for one, once it is said where and when they start.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldgrid.core import Float64, LackingError, Quality, RecordingError
from fieldgrid.geometry import Datum, FixColumns, LeverArm, Mount, StereoCamera, wrap_deg
from fieldgrid.perception import camera_from_projections
from fieldgrid.recordings.calibration.mounting import MOUNTING, Mounting, missing_mounting
from fieldgrid.recordings.drive import Drive, Recording, as_recording, no_fixes, with_frames
from fieldgrid.recordings.files import read_text
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.frames.images import ImageFile
from fieldgrid.recordings.options import NO_MOUNTING, DriveOptions, together
from fieldgrid.recordings.poses.pose_files import BodyPoses, read_pose_file
from fieldgrid.recordings.readers.kitti_calibration import (
    CAMERA_HEIGHT_M,
    HEIGHT_NOTE,
    floats,
    image_folders,
    numbers,
    paired_shots,
    read_entries,
)
from fieldgrid.recordings.readers.settings_file import SETTINGS, RecordingSettings, read_settings
from fieldgrid.recordings.stored import PairKind, StoredFrames
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.logs import find_log, with_log

_CALIBRATION, _TIMES, _POSES = "calib.txt", "times.txt", "poses.txt"
_SIDES = (("image_0", "image_1"), ("image_2", "image_3"))
_SIGMA_M, _SIGMA_DEG = 0.1, 0.2  # what KITTI says of its RTK and INS, roughly


def recognises(path: Path) -> bool:
    """Whether a path is a sequence."""
    named = all((path / name).is_file() for name in (_CALIBRATION, _TIMES))
    return named and image_folders(path, _SIDES) is not None


def open_sequence(path: Path, options: DriveOptions) -> Drive:
    """The sequence at a path: fixes of a log that is given, else of its own poses."""
    options.refuse_of_bags(path)
    settings = read_settings(path / SETTINGS)
    log_path, poses_path = find_log(path, options.gnss), _find_poses(path)
    usual = path / MOUNTING
    is_mounted = options.mounting is not None or usual.exists()
    if settings.start is None:
        problems: list[RecordingError] = [
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
            problems.append(no_fixes(path))
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
        drive = _with_own_poses(drive, poses_path, times_ns, settings, find_mounting().mount)

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
            antenna = _first_camera(P_left, camera, mounting.mount)
            rig = replace(rig, antenna=antenna, heading_offset_deg=0.0)
        notes = () if log_path is not None or is_mounted else (HEIGHT_NOTE,)
        frames = StoredFrames(path, shots, PairKind(size_px))
        return as_recording(drive, rig, frames, notes, is_mounted=mounting is not NO_MOUNTING)

    return with_frames(drive, lambda _: together(find_mounting, NO_MOUNTING, make))


def _find_poses(path: Path) -> Path | None:
    """The poses in the sequence, or where KITTI unpacks them."""
    name = path.resolve().name
    places = (path / _POSES, path.resolve().parent.parent / "poses" / f"{name}.txt")
    return next((p for p in places if p.is_file()), None)


def _with_own_poses(
    drive: Drive, file: Path | None, times_ns: list[int], settings: RecordingSettings, mount: Mount
) -> Drive:
    """The drive with the fixes that its poses come to; or a note on what is missing for them."""
    if file is None:
        return replace(drive, notes=(f"No GNSS: neither a log nor {_POSES}; give --gnss FILE.",))
    if settings.datum is None:
        missing = f"No GNSS: for {file.name} to stand in for it, add [datum] to {SETTINGS}."
        return replace(drive, notes=(missing,))
    poses = read_pose_file(file)
    if poses.time_ns is not None or len(poses.R) != len(times_ns):
        raise RecordingError(
            f"{file} has {len(poses.R)} poses, not one of KITTI for each of {len(times_ns)} times; "
            "restore it."
        )
    start_deg = None if settings.start is None else settings.start.heading_deg
    log = FixLog(_fixes(poses, times_ns, settings.datum, start_deg or 0.0, mount))
    notes = [
        f"The fixes are the poses of {file.name}, taken as good to {_SIGMA_M} m and {_SIGMA_DEG}°."
    ]
    if start_deg is None:
        notes.append("Nothing says where the vehicle heads at first; that is taken as north.")
    source = drive.path / _POSES
    return replace(drive, log=log, gnss_source=_POSES, gnss_path=source, notes=tuple(notes))


def _first_camera(left_projection: Float64, camera: StereoCamera, mount: Mount) -> LeverArm:
    """The optical centre of camera 0, of which the poses are."""
    left_from_first_m = -float(left_projection[0, 3]) / camera.focal_px
    aside_m = np.array([-left_from_first_m - camera.baseline_m / 2.0, 0.0, 0.0])
    right, forward, up = (mount.rotation() @ aside_m).tolist()
    return LeverArm(right, forward, mount.height_m + up)


def _fixes(
    poses: BodyPoses, times_ns: list[int], datum: Datum, start_deg: float, mount: Mount
) -> FixColumns:
    """The fixes of camera 0 and the headings of the nose, the vehicle being level at first."""
    R_vehicle_camera = mount.rotation()
    right_m, forward_m, up_m = R_vehicle_camera @ poses.position_m.T
    noses = R_vehicle_camera @ poses.R @ R_vehicle_camera.T
    headings = wrap_deg(start_deg + np.degrees(np.arctan2(noses[:, 0, 1], noses[:, 1, 1])))
    cos, sin = math.cos(math.radians(start_deg)), math.sin(math.radians(start_deg))
    lat, lon, height = datum.to_geodetic(
        right_m * cos + forward_m * sin, forward_m * cos - right_m * sin, mount.height_m + up_m
    )
    return FixColumns.of(
        times_ns,
        lat_deg=lat,
        lon_deg=lon,
        height_m=height,
        quality=Quality.RTK_FIXED,
        sigma_m=_SIGMA_M,
        heading_deg=headings,
        heading_sigma_deg=_SIGMA_DEG,
    )


FORMAT = Format(
    "KITTI odometry",
    "a KITTI sequence with calib.txt, times.txt, image_0 and image_1",
    recognises,
    open_sequence,
)
