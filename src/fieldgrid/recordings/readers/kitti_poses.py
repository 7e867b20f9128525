"""Poses of a KITTI sequence as fixes, once it is said where and when they start."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fieldgrid.core import Float64, Int64, Quality, RecordingError
from fieldgrid.geometry import Datum, FixColumns, LeverArm, Mount, StereoCamera, wrap_deg
from fieldgrid.recordings.drive import Drive
from fieldgrid.recordings.poses.pose_files import BodyPoses, read_pose_file
from fieldgrid.recordings.readers.settings_file import SETTINGS, RecordingSettings
from fieldgrid.recordings.tables.fix_log import FixLog

POSES = "poses.txt"
_SIGMA_M, _SIGMA_DEG = 0.1, 0.2  # what KITTI says of its RTK and INS, roughly


def with_own_poses(
    drive: Drive, times_ns: Int64 | None, settings: RecordingSettings, mount: Mount
) -> Drive:
    """The drive with the fixes that its poses, in the sequence or where KITTI unpacks them, come
    to; or a note on what is missing for them."""
    sequence = drive.path.resolve()
    places = (drive.path / POSES, sequence.parent.parent / "poses" / f"{sequence.name}.txt")
    file = next((place for place in places if place.is_file()), None)
    if file is None or times_ns is None or settings.datum is None:
        missing = f"No GNSS: neither a log nor {POSES}; give --gnss FILE."
        if file is not None:
            needs = "[datum]" if settings.datum is None else "[start]"
            missing = f"No GNSS: for {file.name} to stand in for it, add {needs} to {SETTINGS}."
        return replace(drive, log=FixLog(FixColumns.of([]), (missing,)), notes=(missing,))
    poses = read_pose_file(file)
    if poses.time_ns is not None or len(poses.R) != len(times_ns):
        raise RecordingError(
            f"{file} has {len(poses.R)} poses, not one of KITTI for each of {len(times_ns)} times; "
            "restore it."
        )
    start_deg = None if settings.start is None else settings.start.heading_deg
    fixes = _fixes(poses, times_ns, settings.datum, start_deg or 0.0, mount)
    notes = [
        f"The fixes are the poses of {file.name}, taken as good to {_SIGMA_M} m and {_SIGMA_DEG}°."
    ]
    if start_deg is None:
        notes.append("Nothing says where the vehicle heads at first; that is taken as north.")
    log = FixLog(fixes, tuple(notes))
    return replace(drive, log=log, gnss_source=POSES, gnss_path=file, notes=log.notes)


def first_camera(left_projection: Float64, camera: StereoCamera, mount: Mount) -> LeverArm:
    """The optical centre of camera 0, of which the poses are."""
    left_from_first_m = -float(left_projection[0, 3]) / camera.focal_px
    aside_m = np.array([-left_from_first_m - camera.baseline_m / 2.0, 0.0, 0.0])
    right, forward, up = (mount.rotation() @ aside_m).tolist()
    return LeverArm(right, forward, mount.height_m + up)


def _fixes(
    poses: BodyPoses, times_ns: Int64, datum: Datum, start_deg: float, mount: Mount
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
