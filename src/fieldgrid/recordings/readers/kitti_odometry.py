"""KITTI odometry: `sequences/NN` with rectified pairs, `calib.txt` and times from 0.

It has no GNSS. Its poses can stand in for one, once it is said where and when they start.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import replace
from pathlib import Path

import numpy as np

from fieldgrid.core import Float64, Quality, RecordingError
from fieldgrid.geometry import Datum, FixColumns, LeverArm, Mount, Rig, StereoCamera, wrap_deg
from fieldgrid.perception import camera_from_projections
from fieldgrid.recordings.calibration.mounting import MOUNTING
from fieldgrid.recordings.drive import Drive, Recording, as_recording, with_frames
from fieldgrid.recordings.files import read_lines
from fieldgrid.recordings.format import Format
from fieldgrid.recordings.frames.images import SUFFIXES, ImageFile
from fieldgrid.recordings.options import NO_MOUNTING, DriveOptions
from fieldgrid.recordings.readers.kitti_calibration import (
    CAMERA_HEIGHT_M,
    floats,
    numbers,
    read_entries,
)
from fieldgrid.recordings.readers.settings_file import (
    SETTINGS,
    RecordingSettings,
    Start,
    read_settings,
)
from fieldgrid.recordings.stored import PairKind, Shot, StoredFrames, checked_shots
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.logs import find_log, with_log

_CALIBRATION, _TIMES, _POSES = "calib.txt", "times.txt", "poses.txt"
_SIDES = (("0", "1"), ("2", "3"))
_SIGMA_M, _SIGMA_DEG = 0.1, 0.2  # what KITTI says of its RTK and INS, roughly


def recognises(path: Path) -> bool:
    """Whether a path is a sequence."""
    if not all((path / name).is_file() for name in (_CALIBRATION, _TIMES)):
        return False
    return any(all((path / f"image_{number}").is_dir() for number in pair) for pair in _SIDES)


def open_sequence(path: Path, options: DriveOptions) -> Drive:
    """The sequence at a path: fixes of a log that is given, else of its own poses."""
    options.refuse_of_bags(path)
    settings = read_settings(path / SETTINGS)
    if settings.start is None:
        raise RecordingError(
            f"{path / _TIMES} counts from 0, and nothing says when it was driven; add {SETTINGS} "
            "with [start] utc_s = seconds since 1970 of its first image, and [datum] lat_deg, "
            "lon_deg and height_m = where that was taken, unless --gnss or --frame-origin says it."
        )
    times_ns = _times_ns(path / _TIMES, settings.start)
    log_path = find_log(path, options.gnss)
    drive = Drive(
        path=path,
        name=settings.name or path.resolve().name,
        datum_hint=settings.datum,
        pose_source=settings.poses,
    )
    left, right = next(s for s in _SIDES if all((path / f"image_{n}").is_dir() for n in s))
    offset_ns = options.offset_or(settings.image_time_offset_ns)
    if log_path is not None:
        drive = with_log(drive, path, log_path, settings, options)

        def make(drive: Drive) -> Recording:
            camera, frames = _frames(path, left, right, times_ns)
            mounting = options.find_mounting(path / MOUNTING, path)
            rig = mounting.rig(camera, offset_ns)
            return as_recording(drive, rig, frames, is_mounted=mounting is not NO_MOUNTING)

        return with_frames(drive, make)
    options.refuse("The poses of a KITTI sequence are no table", "columns")
    camera, frames = _frames(path, left, right, times_ns)
    mount, notes = _own_mount(path, options)
    log = _poses_as_fixes(path, times_ns, settings, mount)
    source = _POSES if len(log.fixes) else ""
    drive = replace(
        drive,
        log=log,
        gnss_source=source,
        gnss_path=path / source if source else None,
        notes=log.notes,
    )
    antenna = _first_camera(_projection(path, left), camera, mount)
    rig = Rig(camera, mount, antenna, image_time_offset_ns=offset_ns, heading_offset_deg=0.0)
    return as_recording(drive, rig, frames, notes)


def _frames(
    path: Path, left: str, right: str, times_ns: list[int]
) -> tuple[StereoCamera, StoredFrames]:
    listings = [
        sorted(p.name for p in (path / f"image_{n}").iterdir() if p.suffix.lower() in SUFFIXES)
        for n in (left, right)
    ]
    if not len(listings[0]) == len(listings[1]) == len(times_ns):
        raise RecordingError(
            f"{path} has {len(listings[0])} left and {len(listings[1])} right images for "
            f"{len(times_ns)} times; unpack the sequence again."
        )
    shots = checked_shots(
        [
            Shot(time_ns, Path(a).stem, (f"image_{left}/{a}", f"image_{right}/{b}"))
            for time_ns, a, b in zip(times_ns, *listings, strict=True)
        ],
        path,
    )
    matrices = _projection(path, left), _projection(path, right)
    size_px = ImageFile(path / shots[0].files[0]).size_px()
    camera = camera_from_projections(*matrices, size_px, str(path / _CALIBRATION))
    return camera, StoredFrames(path, shots, PairKind((camera.width_px, camera.height_px)))


def _numbers(path: Path) -> array[float]:
    """All numbers of a text."""
    numbers = array("d")
    for _, line in read_lines(path):
        numbers.extend(floats(line, path))
    return numbers


def _times_ns(path: Path, start: Start) -> list[int]:
    times_s = _numbers(path)
    if not all(0.0 <= time_s < 1e6 for time_s in times_s):
        raise RecordingError(f"{path} holds a time that is no second from the start; restore it.")
    return [start.time_ns + round(time_s * 1e9) for time_s in times_s]


def _projection(path: Path, number: str) -> Float64:
    file = path / _CALIBRATION
    return numbers(read_entries(file), f"P{number}", 12, file).reshape(3, 4)


def _own_mount(path: Path, options: DriveOptions) -> tuple[Mount, tuple[str, ...]]:
    """How the cameras sit, by a mounting that is given, else as KITTI's; and a remark."""
    if options.mounting is not None or (path / MOUNTING).exists():
        return options.find_mounting(path / MOUNTING, path).mount, ()
    note = (
        f"The camera height of {CAMERA_HEIGHT_M} m is KITTI's published value; no file of the "
        "sequence gives it."
    )
    return Mount(CAMERA_HEIGHT_M, 0.0), (note,)


def _first_camera(left_projection: Float64, camera: StereoCamera, mount: Mount) -> LeverArm:
    """The optical centre of camera 0, of which the poses are."""
    left_from_first_m = -float(left_projection[0, 3]) / camera.focal_px
    aside_m = np.array([-left_from_first_m - camera.baseline_m / 2.0, 0.0, 0.0])
    right, forward, up = (mount.rotation() @ aside_m).tolist()
    return LeverArm(right, forward, mount.height_m + up)


def _poses_as_fixes(
    path: Path, times_ns: list[int], settings: RecordingSettings, mount: Mount
) -> FixLog:
    """The fixes that the poses come to; none, and what is missing for them."""
    name = path.resolve().name
    places = (path / _POSES, path.resolve().parent.parent / "poses" / f"{name}.txt")
    file = next((p for p in places if p.is_file()), None)
    if file is None:
        return FixLog(
            FixColumns.of([]), (f"No GNSS: neither a log nor {_POSES}; give --gnss FILE.",)
        )
    if settings.datum is None:
        missing = f"No GNSS: for {file.name} to stand in for it, add [datum] to {SETTINGS}."
        return FixLog(FixColumns.of([]), (missing,))
    assert settings.start is not None
    poses = _poses(file, len(times_ns))
    fixes = _fixes(poses, times_ns, settings.datum, settings.start.heading_deg or 0.0, mount)
    notes = [
        f"The fixes are the poses of {file.name}, taken as good to {_SIGMA_M} m and {_SIGMA_DEG}°.",
    ]
    if settings.start.heading_deg is None:
        notes.append("Nothing says where the vehicle heads at first; that is taken as north.")
    return FixLog(fixes, tuple(notes))


def _poses(path: Path, count: int) -> Float64:
    """Camera 0 in the frame of its first image (x right, y down, z forward), [n, 3, 4]."""
    values = np.array(_numbers(path))
    if values.size != 12 * count or not (np.abs(values) < 1e7).all():
        raise RecordingError(
            f"{path} has {values.size} numbers, not 12 for each of {count} images; restore it."
        )
    poses = values.reshape(count, 3, 4)
    turns = poses[:, :, :3]
    if np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0) > 1e-2:
        raise RecordingError(f"{path} holds a matrix that is no rotation; restore it.")
    return poses


def _fixes(
    poses: Float64, times_ns: list[int], datum: Datum, start_deg: float, mount: Mount
) -> FixColumns:
    """The fixes of camera 0 and the headings of the nose, the vehicle being level at first."""
    R_vehicle_camera = mount.rotation()
    right_m, forward_m, up_m = R_vehicle_camera @ poses[:, :, 3].T
    noses = R_vehicle_camera @ poses[:, :, :3] @ R_vehicle_camera.T
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
