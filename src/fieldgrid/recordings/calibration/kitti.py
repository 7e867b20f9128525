"""KITTI's calibration files: three transformations and the rectified cameras to a rig.

Their frames are the IMU (x forward, y left, z up), the lidar, and camera 0 before and after
rectification (x right, y down, z forward).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from fieldgrid.core import CalibrationError, Float64
from fieldgrid.geometry import LeverArm, Mount, Rig
from fieldgrid.perception import camera_from_projections, is_rotation
from fieldgrid.recordings.calibration.yaml_text import numbers
from fieldgrid.recordings.files import read_text
from fieldgrid.recordings.tables.motion_files import R_VEHICLE_FLU

CAMERA_HEIGHT_M = 1.65
"""Height of the cameras above the road: in KITTI's paper and drawing, in none of its files."""

HEIGHT_NOTE = (
    f"The camera height of {CAMERA_HEIGHT_M} m is KITTI's published value; no file gives it."
)

_FILES = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")
_MAX_BYTES = 1 << 20


def mount_angles_deg(R_vehicle_camera: Float64) -> tuple[float, float, float]:
    """Tilt, roll and yaw in degrees: the inverse of `Mount.rotation`."""
    R = R_vehicle_camera
    tilt = math.atan2(-R[2, 2], -R[2, 1])
    roll = -math.asin(max(-1.0, min(1.0, float(R[2, 0]))))
    yaw = math.atan2(-R[1, 0], R[0, 0])
    return math.degrees(tilt), math.degrees(roll), math.degrees(yaw)


def read_kitti_rig(drive: Path, left: str, right: str) -> Rig:
    """The rig of cameras `left` and `right`, like "00" and "01"; the vehicle is level when its IMU
    is."""
    date = drive.resolve().parent
    files = [
        next((p for p in (date / name, drive / name) if p.is_file()), date / name)
        for name in _FILES
    ]
    if missing := [file.name for file in files if not file.is_file()]:
        raise CalibrationError(
            f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} neither in {date} nor "
            f"in {drive}; unpack KITTI's calibration of that day."
        )
    path, table = files[0], read_entries(files[0])
    T_rect_cam, T_cam_velo, T_velo_imu = np.eye(4), np.eye(4), np.eye(4)
    T_rect_cam[:3, :3] = _rotation(table, "R_rect_00", path)
    for file, T in zip(files[1:], (T_cam_velo, T_velo_imu), strict=True):
        moved = read_entries(file)
        T[:3, :3], T[:3, 3] = _rotation(moved, "R", file), numbers(moved, "T", (3,), file)
    T_rect_imu = T_rect_cam @ T_cam_velo @ T_velo_imu
    width, height = numbers(table, f"S_rect_{left}", (2,), path)
    # From rectified camera 0 to pixels.
    P_left, P_right = (numbers(table, f"P_rect_{side}", (3, 4), path) for side in (left, right))
    camera = camera_from_projections(P_left, P_right, (int(width), int(height)), str(path))
    # Optical centres in the frame of rectified camera 0, metres.
    left_m, right_m = (-np.linalg.solve(P[:, :3], P[:, 3]) for P in (P_left, P_right))
    R_imu_rect = T_rect_imu[:3, :3].T
    middle_imu = R_imu_rect @ ((left_m + right_m) / 2.0 - T_rect_imu[:3, 3])
    try:
        mount = Mount(CAMERA_HEIGHT_M, *mount_angles_deg(R_VEHICLE_FLU @ R_imu_rect))
        # What oxts positions is the IMU itself.
        right_m, forward_m, up_m = (R_VEHICLE_FLU @ -middle_imu).tolist()
        antenna = LeverArm(right_m, forward_m, up_m + CAMERA_HEIGHT_M)
    except CalibrationError as problem:
        raise CalibrationError(f"{path}: {problem}") from problem
    return Rig(camera, mount, antenna)


def read_entries(path: Path) -> dict[str, str]:
    """Lines `key: values` of a calibration file."""
    text = read_text(path, _MAX_BYTES, CalibrationError)
    lines = (line.partition(":") for line in text.splitlines())
    return {key.strip(): values for key, _, values in lines}


def _rotation(table: dict[str, str], key: str, path: Path) -> Float64:
    R = numbers(table, key, (3, 3), path)
    if not is_rotation(R):
        raise CalibrationError(f"{path}: {key} is no rotation; restore the file.")
    return R
