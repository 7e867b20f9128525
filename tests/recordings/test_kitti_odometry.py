"""KITTI odometry sequences: their poses as fixes, a log beside them, and what they must be told."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from fieldgrid.core import CalibrationError, ConfigError, LackingError, RecordingError
from fieldgrid.geometry import Datum, LeverArm, Mount, StereoCamera
from fieldgrid.recordings import Columns, DriveOptions, open_drive, open_recording
from tests.recordings.test_folder import change

START_S = 1_317_384_506
DATUM = Datum(49.0, 8.4, 110.0)
P0 = "707.1 0 60.5 0 0 707.1 20.5 0 0 0 1 0"
P1 = "707.1 0 60.5 -381.834 0 707.1 20.5 0 0 0 1 0"
P2 = "707.1 0 60.5 42.426 0 707.1 20.5 0 0 0 1 0"
P3 = "707.1 0 60.5 -339.408 0 707.1 20.5 0 0 0 1 0"
SETTINGS = f"""
[start]
utc_s = {START_S}.25
heading_deg = 30.0
[datum]
lat_deg = {DATUM.lat_deg}
lon_deg = {DATUM.lon_deg}
height_m = {DATUM.height_m}
"""
TABLE = f"time_ns,lat_deg,lon_deg,height_m\n{START_S}000000000,49.0,8.4,112.0\n"
MOUNTING = {
    "camera_height_above_ground_m": 1.7,
    "camera_tilt_down_deg": 10.0,
    "gnss_antenna_from_camera_mid_flu_m": [-1.0, 0.0, 0.3],
}


def pose(turn_deg: float, right_m: float, down_m: float, ahead_m: float) -> str:
    """A row: turned clockwise by so much, at a place seen from the first image."""
    c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    return f"{c} 0 {s} {right_m} 0 1 0 {down_m} {-s} 0 {c} {ahead_m}"


POSES = (pose(0, 0, 0, 0), pose(10, 0.1, -0.2, 1.5), pose(-20, -0.3, -0.1, 3.0))


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    return write_sequence(tmp_path)


def write_sequence(out: Path) -> Path:
    """Sequence 06 with three frames and its poses where KITTI puts them."""
    folder = out / "dataset" / "sequences" / "06"
    for side in ("image_0", "image_1"):
        (folder / side).mkdir(parents=True)
        for k in range(3):
            image = np.full((40, 120), 10 * k + len(side), dtype=np.uint8)
            assert cv2.imwrite(str(folder / side / f"{k:06d}.png"), image)
    (folder / "calib.txt").write_text(f"P0: {P0}\nP1: {P1}\nP2: {P2}\nP3: {P3}\nTr: {P0}\n")
    (folder / "times.txt").write_text("0.000000e+00\n1.036224e-01\n2.072000e-01\n")
    (folder / "recording.toml").write_text(SETTINGS)
    (out / "dataset" / "poses").mkdir()
    (out / "dataset" / "poses" / "06.txt").write_text("\n".join(POSES) + "\n")
    return folder


def test_poses_are_fixes_from_the_start_that_is_declared(sequence: Path) -> None:
    recording = open_recording(sequence)
    start_ns = START_S * 10**9 + 250_000_000
    times_ns = [start_ns, start_ns + 103_622_400, start_ns + 207_200_000]
    assert recording.frame_times_ns().tolist() == times_ns
    assert [fix.time_ns for fix in recording.fixes()] == times_ns
    assert recording.gnss_source == "poses.txt"
    assert recording.datum_hint == DATUM
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    places = [(0.0, 0.0, 0.0), (0.1, 1.5, 0.2), (-0.3, 3.0, 0.1)]  # right, ahead, up
    headings = [30.0, 40.0, 10.0]
    for fix, (right, ahead, up), heading in zip(recording.fixes(), places, headings, strict=True):
        enu = [float(v) for v in DATUM.to_enu(fix.lat_deg, fix.lon_deg, fix.height_m)]
        expected = [right * c + ahead * s, ahead * c - right * s, 1.65 + up]
        assert enu == pytest.approx(expected, abs=1e-6)
        assert fix.heading_deg == pytest.approx(heading)
        assert (fix.quality, fix.sigma_m, fix.heading_sigma_deg) == (4, 0.1, 0.2)
    assert recording.notes == (
        "The camera height of 1.65 m is KITTI's published value; no file gives it.",
        "The fixes are the poses of 06.txt, taken as good to 0.1 m and 0.2°.",
    )


def test_the_rig_is_kittis(sequence: Path) -> None:
    """The poses are those of camera 0, whichever pair there is."""
    baseline_m = 381.834 / 707.1
    rig = open_recording(sequence).rig
    assert rig.camera == StereoCamera(120, 40, 707.1, 60.5, 20.5, baseline_m)
    assert rig.mount == Mount(1.65, 0.0)
    assert rig.antenna == LeverArm(-baseline_m / 2, 0.0, 1.65)
    assert rig.heading_offset_deg == 0.0
    (sequence / "image_0").rename(sequence / "image_2")
    (sequence / "image_1").rename(sequence / "image_3")
    rig = open_recording(sequence).rig
    assert rig.camera.baseline_m == pytest.approx(0.54)
    # Camera 2 is 0.06 m to the left of camera 0, and half a baseline to the left of the middle.
    assert rig.antenna.right_m == pytest.approx(0.06 - 0.27)


def test_a_tilted_camera_climbs_no_hill(sequence: Path) -> None:
    (sequence / "mounting.json").write_text(json.dumps(MOUNTING))
    s, c = math.sin(math.radians(10)), math.cos(math.radians(10))
    # 2 m level ahead is up in a camera that looks down.
    (sequence / "poses.txt").write_text("\n".join([POSES[0], *[pose(0, 0, -2 * s, 2 * c)] * 2]))
    recording = open_recording(sequence)
    assert recording.rig.mount == Mount(1.7, 10.0)
    assert recording.rig.antenna.up_m == pytest.approx(1.7)
    assert not any("1.65 m" in note for note in recording.notes)
    fixes = recording.fixes()
    enu = np.stack(DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m))
    moved = [2 * math.sin(math.pi / 6), 2 * math.cos(math.pi / 6), 0.0]
    assert enu[:, 1] - enu[:, 0] == pytest.approx(moved, abs=1e-6)


def test_what_need_not_be_said(sequence: Path) -> None:
    """A heading, for which north is taken; and a datum or poses, without which no fix is known."""
    settings = sequence / "recording.toml"
    settings.write_text(SETTINGS.replace("heading_deg = 30.0\n", ""))
    recording = open_recording(sequence)
    assert recording.fixes()[0].heading_deg == 0.0
    assert recording.notes[-1].startswith("Nothing says where the vehicle heads at first; that is")
    settings.write_text(f"[start]\nutc_s = {START_S}\n")
    recording = open_recording(sequence)
    assert (recording.frame_count, len(recording.fixes()), recording.gnss_source) == (3, 0, "")
    assert recording.notes[-1] == (
        "No GNSS: for 06.txt to stand in for it, add [datum] to recording.toml."
    )
    (sequence.parents[1] / "poses" / "06.txt").unlink()
    assert open_recording(sequence).notes[-1] == (
        "No GNSS: neither a log nor poses.txt; give --gnss FILE."
    )


def test_a_log_outranks_the_poses_and_needs_a_mounting(sequence: Path) -> None:
    log = sequence.parent / "own.csv"
    log.write_text(TABLE)
    with pytest.raises(CalibrationError, match=r"there is no mounting\.json"):
        open_recording(sequence, log)
    (sequence / "mounting.json").write_text(json.dumps(MOUNTING))
    recording = open_recording(sequence, log)
    assert [fix.height_m for fix in recording.fixes()] == [112.0]
    assert (recording.gnss_source, recording.rig.antenna.forward_m) == ("own.csv", -1.0)
    (sequence / "gnss").mkdir()
    log.rename(sequence / "gnss" / "own.csv")
    assert open_recording(sequence).gnss_source == "gnss/own.csv"


def test_without_a_start_a_log_alone_can_be_followed(sequence: Path, tmp_path: Path) -> None:
    (sequence / "recording.toml").unlink()
    (tmp_path / "own.csv").write_text(TABLE)
    with open_drive(sequence, DriveOptions(tmp_path / "own.csv")) as drive:
        assert len(drive.fixes()) == 1
        with pytest.raises(LackingError, match=r"\[start\] utc_s.* Also: .*no mounting\.json"):
            drive.recording()


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("recording.toml", "", r"counts from 0, .* add recording\.toml with \[start\] utc_s"),
        ("recording.toml", "[start]\nutc_s = 5\n", "utc_s is 5; give the UTC of the first frame"),
        ("times.txt", "0\n1\n", "2 times"),
        ("times.txt", "0\nnan\n2\n", "line 2: .* a time below 0, or a number"),
        ("times.txt", "0\n1\n-2\n", "line 3: .* a time below 0, or a number"),
        ("times.txt", "0\n1\nx\n", r"times\.txt: no number: 'x'"),
        ("times.txt", "0\n1\n1\n", "have the same time"),
        ("calib.txt", f"P0: {P0}\n", "lacks P1 as 3 x 4 numbers"),
        ("calib.txt", f"P0: {P0}\nP1: {P2}\n", r"baseline of -0\.06"),
        ("image_1/000002.png", None, r"not hold the same files, 000002\.png is only in one"),
        ("poses.txt", POSES[0], "has 1 poses, not one of KITTI for each of 3 times"),
        ("poses.txt", "\n".join([*POSES[:2], "nan " * 12]), "line 3: it holds NaN"),
        ("poses.txt", "\n".join([*POSES[:2], "0 " * 12]), "line 3: its first three columns are no"),
    ],
)
def test_what_is_broken(file: str, text: str | None, message: str, sequence: Path) -> None:
    change(sequence / file, None, text)
    with pytest.raises(RecordingError, match=message):
        open_recording(sequence)


def test_columns_of_poses_cannot_be_said(sequence: Path) -> None:
    with pytest.raises(ConfigError, match="poses of a KITTI sequence are no log"):
        open_recording(sequence, columns=Columns({"time": "t"}))
