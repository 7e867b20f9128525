"""KITTI raw: a small drive of our own for the rules, the real one for the geometry."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import CalibrationError, ConfigError, RecordingError
from fieldgrid.geometry import LeverArm, Mount
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.recordings import Recording, open_recording
from fieldgrid.recordings.calibration.kitti import mount_angles_deg
from tests.recordings.test_folder import change

SharedData = Callable[[str], Path]
Matrix = npt.NDArray[np.float64]

KITTI = "kitti_2011_09_30_drive_0020"
DRIVE = "2011_09_30_drive_0020_sync"

# Camera axes (x right, y down, z forward) in those of a lidar (x forward, y left, z up).
CAM_OF_VELO = "0 -1 0 0 0 -1 1 0 0"
CALIBRATION = {
    "calib_cam_to_cam.txt": (
        "calib_time: 09-Jan-2012 13:57:47\n"
        "S_rect_00: 6.4e+01 4.8e+01\n"
        "R_rect_00: 1 0 0 0 1 0 0 0 1\n"
        "P_rect_00: 100 0 31.5 0 0 100 23.5 0 0 0 1 0\n"
        "P_rect_01: 100 0 31.5 -50 0 100 23.5 0 0 0 1 0\n"
        "S_rect_02: 6.4e+01 4.8e+01\n"
        "P_rect_02: 100 0 31.5 6 0 100 23.5 0 0 0 1 0\n"
        "P_rect_03: 100 0 31.5 -46 0 100 23.5 0 0 0 1 0\n"
    ),
    # The camera is 0.3 m ahead of the lidar and 0.1 m below it.
    "calib_velo_to_cam.txt": f"R: {CAM_OF_VELO}\nT: 0 -0.1 -0.3\n",
    # The IMU is 0.8 m behind the lidar, 0.2 m left of it and 0.9 m below.
    "calib_imu_to_velo.txt": "R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.2 -0.9\n",
}


@pytest.fixture
def date_folder(tmp_path: Path) -> Path:
    return write_kitti(tmp_path)


def write_kitti(out: Path) -> Path:
    """A folder of a date with its calibration and one drive of two grey pairs."""
    folder = out / "2011_09_30"
    drive = folder / DRIVE
    folder.mkdir(parents=True)
    for name, text in CALIBRATION.items():
        (folder / name).write_text(text)
    for number in ("00", "01"):
        add_camera(drive, number)
    (drive / "oxts" / "data").mkdir(parents=True)
    stamps = []
    for k, posmode in enumerate((-1, 6, 5, 4, 2, 0, 42)):
        values = [49.0, 8.4, 113.0, 0, 0, math.pi / 2, 0, 0, 3.0, 4.0, *[0] * 13]
        values += [0.0135, 0.01, 4, 10 if k else -1, posmode, posmode, posmode]
        (drive / "oxts" / "data" / f"{k:010}.txt").write_text(" ".join(map(str, values)))
        stamps.append(f"2011-09-30 12:08:2{k}.123456789")
    (drive / "oxts" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    return folder


def add_camera(drive: Path, number: str) -> None:
    folder = drive / f"image_{number}"
    (folder / "data").mkdir(parents=True)
    for k in range(2):
        image = np.full((48, 64), 10 * k + int(number), dtype=np.uint8)
        assert cv2.imwrite(str(folder / "data" / f"{k:010}.png"), image)
    (folder / "timestamps.txt").write_text(
        "2011-09-30 12:08:26.399641520\n2011-09-30 12:08:26.503629564\n"
    )


def test_a_drive_is_read_from_every_folder_above_it(date_folder: Path) -> None:
    for path in (date_folder / DRIVE, date_folder, date_folder.parent):
        assert open_recording(path).name == DRIVE
    recording = open_recording(date_folder, gnss="oxts")
    assert recording.frame_times_ns().tolist() == [1317384506399641520, 1317384506503629564]
    frames = list(recording.frames())
    assert [frame.frame_id for frame in frames] == ["0000000000", "0000000001"]
    left, right = frames[1].images()
    assert (left[0, 0], right[0, 0]) == (10, 11)
    fixes = recording.fixes()
    assert [fix.quality for fix in fixes] == [6, 4, 5, 2, 1, 0, 0]
    assert fixes[1].time_ns == 1317384501123456789
    assert fixes[1][1:4] == (49.0, 8.4, 113.0)
    assert (fixes[0].satellites, fixes[1].satellites) == (None, 10)
    assert (fixes[1].sigma_m, fixes[1].heading_sigma_deg, fixes[1].hdop) == (0.0135, 0.1, None)
    assert fixes[1].speed_mps == pytest.approx(5.0)
    assert fixes[1].heading_deg == pytest.approx(0.0)  # a yaw of 90 degrees from east
    assert (recording.gnss_source, recording.datum_hint) == ("oxts", None)
    assert any("1.65 m" in note for note in recording.notes)
    for name in CALIBRATION:  # which may lie in the drive, too
        (date_folder / name).rename(date_folder / DRIVE / name)
    assert open_recording(date_folder).rig == recording.rig


def test_the_rig_is_the_chain_from_imu_to_rectified_camera(date_folder: Path) -> None:
    rig = open_recording(date_folder).rig
    assert (rig.camera.focal_px, rig.camera.baseline_m) == (100.0, 0.5)
    mount, antenna = rig.mount, rig.antenna
    found = [mount.height_m, mount.tilt_deg, mount.roll_deg, mount.yaw_deg]
    assert found == pytest.approx([1.65, 0.0, 0.0, 0.0], abs=1e-9)
    # The camera is 0.3 + 0.8 m ahead of the IMU; the middle of the baseline 0.25 m right of
    # the camera, which is 0.2 m right of the IMU; and -0.1 + 0.9 m above the IMU.
    found = [antenna.right_m, antenna.forward_m, antenna.up_m]
    assert found == pytest.approx([-0.45, -1.1, 1.65 - 0.8], abs=1e-9)
    s, c = math.sin(math.radians(10.0)), math.cos(math.radians(10.0))
    # Rows are the camera's axes in those of the lidar: right, down, forward.
    text = f"R: 0 -1 0 {-s} 0 {-c} {c} 0 {-s}\nT: 0 0 0\n"
    (date_folder / "calib_velo_to_cam.txt").write_text(text)
    assert open_recording(date_folder).rig.mount.tilt_deg == pytest.approx(10.0)
    own: dict[str, object] = {"camera_height_above_ground_m": 2.0, "camera_tilt_down_deg": 5.0}
    own["gnss_antenna_from_camera_mid_flu_m"] = [0.0, 0.0, 1.0]
    (date_folder / DRIVE / "mounting.json").write_text(json.dumps(own))
    rig = open_recording(date_folder).rig
    assert (rig.mount, rig.antenna) == (Mount(2.0, 5.0), LeverArm(0.0, 0.0, 3.0))


@given(st.floats(-9, 74), st.floats(-19, 19), st.floats(-44, 44))
def test_mount_angles_are_the_inverse_of_the_rotation(tilt: float, roll: float, yaw: float) -> None:
    angles = mount_angles_deg(Mount(1.0, tilt, roll, yaw).rotation())
    assert angles == pytest.approx((tilt, roll, yaw), abs=1e-9)


def test_the_colour_pair_serves_without_the_grey_one(date_folder: Path) -> None:
    for number in ("02", "03"):
        add_camera(date_folder / DRIVE, number)
    grey = open_recording(date_folder)
    assert next(grey.frames()).images()[0][0, 0] == 0
    (date_folder / DRIVE / "image_00").rename(date_folder / "unused")
    colour = open_recording(date_folder)
    assert next(colour.frames()).images()[0][0, 0] == 2
    assert colour.rig.camera.baseline_m == pytest.approx(0.52)
    # Camera 2 is 0.06 m left of camera 0, so the middle is at (-0.06 + 0.46) / 2 of it.
    shift_m = colour.rig.antenna.right_m - grey.rig.antenna.right_m
    assert shift_m == pytest.approx(0.25 - 0.2)


CAM = "calib_cam_to_cam.txt"
OXTS = f"{DRIVE}/oxts/data/0000000003.txt"
STAMPS = f"{DRIVE}/image_00/timestamps.txt"
YAW = f"0 0 {math.pi / 2}"


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (f"{DRIVE}/image_01", None, None, "neither image_00 and image_01 nor image_02 and image"),
        (f"{DRIVE}/image_01/data/0000000001.png", None, None, r"0000000001\.png is only in one"),
        (STAMPS, "\n2011-09-30 12:08:26.503629564", "", "has 1 times for 2 images"),
        (STAMPS, None, None, r"timestamps\.txt cannot be read: No such file"),
        (STAMPS, "2011-09-30 12:08:26.3", "yesterday", "'yesterday.*' is no time like 2011"),
        (STAMPS, "2011-09-30 12:08:26.3", "2011-13-30 12:08:26.3", "is no time like 2011"),
        (f"{DRIVE}/oxts/timestamps.txt", ":26.", ":26x", "is no time like 2011"),
        (f"{DRIVE}/oxts/timestamps.txt", None, "2011-09-30 12:08:26.3", "1 times .* for 7 rows"),
        (OXTS, None, "", r"0000000003\.txt is no row of 30 finite numbers"),
        (OXTS, None, "49 " * 29 + "nan", r"0000000003\.txt is no row of 30 finite numbers"),
        (OXTS, None, "49 " * 31, r"0000000003\.txt is no row of 30 finite numbers"),
        (OXTS, None, "here " * 30, r"0000000003\.txt is no row of 30 finite numbers"),
        (OXTS, None, None, r"has 7 times in timestamps\.txt for 6 rows"),
        (OXTS, YAW, "-7.5 0 0", "Row 4 of oxts has a roll of -7.5, which is no angle"),
        (OXTS, YAW, "0 -7.5 0", "Row 4 of oxts has a pitch of -7.5, which is no angle"),
        (OXTS, YAW, "0 0 -7.5", "Row 4 of oxts has a yaw of -7.5, which is no angle"),
        *((name, None, "nothing: 0\n", f"{name} lacks R") for name in CALIBRATION),
        *((name, None, None, f"{name} is neither in .*2011_09_30 nor in") for name in CALIBRATION),
        (CAM, "R_rect_00: 1 0", "R_rect_00: 2 0", "R_rect_00 is no rotation"),
        (CAM, "R_rect_00: 1 0", "R_rect_00: -1 0", "R_rect_00 is no rotation"),
        (CAM, "S_rect_00: 6.4e+01 4.8e+01", "S_rect_00: nan 48", "lacks S_rect_00 as 2 numbers"),
        (CAM, "S_rect_00: 6.4e+01", "S_rect_00: 0", "images of 0 x 48 px"),
        (CAM, "31.5 -50 0 100", "31.5 -50 0 120", "do not share focal length"),
        (CAM, "31.5 -50", "31.5 50", "baseline of -0.5 m"),
        (CAM, "P_rect_00: 100", "P_rect_00: 0", "is not calibrated"),
    ],
)
def test_what_is_broken(
    file: str, old: str | None, new: str | None, message: str, date_folder: Path
) -> None:
    change(date_folder / file, old, new)
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(date_folder)
    assert type(caught.value) is (CalibrationError if file in CALIBRATION else RecordingError)


def test_one_drive_and_its_own_fixes(date_folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"and not in rtk\.nmea; leave --gnss out"):
        open_recording(date_folder, gnss="rtk.nmea")
    for name in ("image_00", "oxts"):
        (date_folder / "2011_09_30_drive_0021_sync" / name).mkdir(parents=True)
    two = f"holds 2 KITTI drives: {DRIVE}, 2011_09_30_drive_0021_sync; give one"
    with pytest.raises(RecordingError, match=two):
        open_recording(date_folder)


# --- the real drive


def test_interpolated_rows_of_the_real_drive_are_rejected(shared_data: SharedData) -> None:
    recording = open_recording(shared_data(KITTI))
    assert (recording.name, recording.frame_count) == (DRIVE, 51)
    left, right = next(recording.frames()).images()
    assert left.shape == right.shape == (370, 1226)
    verdicts = condition(recording.fixes())
    rejected = np.flatnonzero(~verdicts.ok).tolist()
    assert rejected == list(range(12))
    assert {verdicts.reason[k] for k in rejected} == {"quality 6 (estimated) is not allowed"}


def test_fixes_and_rig_reproduce_the_camera_poses_of_kitti(shared_data: SharedData) -> None:
    folder = shared_data(KITTI)
    recording = open_recording(folder)
    truth = np.loadtxt(folder / "native_poses.txt").reshape(-1, 3, 4)
    reference = 13
    attitude = np.loadtxt(next(folder.glob(f"*/{DRIVE}/oxts/data/{reference:010}.txt")))[
        3:6
    ]  # roll, pitch, yaw
    frames, camera_enu = camera_positions(recording, attitude)
    R_enu_camera = enu_from_flu(*attitude) @ FLU_FROM_VEHICLE @ recording.rig.mount.rotation()

    at = list(frames).index(reference)
    found = (camera_enu - camera_enu[at]) @ R_enu_camera
    expected = (truth[frames, :, 3] - truth[reference, :, 3]) @ truth[reference, :, :3]
    assert len(frames) > 35
    assert np.linalg.norm(expected, axis=1).max() > 40.0
    error_m = np.linalg.norm(found - expected, axis=1)
    assert error_m.mean() < 0.02
    assert error_m.max() < 0.05


FLU_FROM_VEHICLE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def camera_positions(recording: Recording, attitude: Matrix) -> tuple[Matrix, Matrix]:
    """Frames between accepted fixes, and their camera positions by the fixes and the rig."""
    fixes = recording.fixes()[condition(recording.fixes()).ok]
    imu = kitti_metres(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    times = fixes.time_ns
    images = recording.frame_times_ns()
    frames = np.flatnonzero((images >= times[0]) & (images <= times[-1]))
    since = times[0]
    at_images = np.column_stack(
        [np.interp(images[frames] - since, times - since, axis) for axis in imu.T]
    )
    headings = np.interp(
        images[frames] - since, times - since, [fix.heading_deg or math.nan for fix in fixes]
    )
    antenna, height_m = recording.rig.antenna, recording.rig.mount.height_m
    camera_vehicle = -np.array([antenna.right_m, antenna.forward_m, antenna.up_m - height_m])
    lever = [
        enu_from_flu(*attitude[:2], math.radians(90.0 - heading)) @ FLU_FROM_VEHICLE
        @ camera_vehicle
        for heading in headings
    ]  # fmt: skip
    return frames, at_images + np.array(lever)


def kitti_metres(lat_deg: Matrix, lon_deg: Matrix, height_m: Matrix) -> Matrix:
    """Metres as KITTI made its poses: a sphere's Mercator, 0.2 % short going east here."""
    radius_m = 6378137.0
    scale = math.cos(math.radians(lat_deg[0]))
    east = scale * radius_m * np.radians(lon_deg)
    north = scale * radius_m * np.log(np.tan(np.radians(90.0 + lat_deg) / 2.0))
    return np.column_stack([east, north, height_m])


def enu_from_flu(roll: float, pitch: float, yaw: float) -> Matrix:
    """R_enu_imu of the angles of oxts."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    turned = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pitched = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rolled = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return turned @ pitched @ rolled
