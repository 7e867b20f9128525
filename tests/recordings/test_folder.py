"""The plain folder: what is read from it, and the sentence for everything that can be wrong."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fieldgrid.core import CalibrationError, FieldgridError, GnssError, LackingError, RecordingError
from fieldgrid.geometry import Datum, Fix, LeverArm, Motion, Mount, StereoCamera, nose_heading_deg
from fieldgrid.recordings import (
    Columns,
    DriveOptions,
    Recording,
    open_drive,
    open_recording,
    stored,
)
from fieldgrid.recordings.frames import frame_table
from tests.conftest import TWO_LANES

SharedData = Callable[[str], Path]

START_S = 1_308_133_815
MOUNTING = {
    "camera_height_above_ground_m": 2.5,
    "camera_tilt_down_deg": 15.0,
    "camera_roll_deg": 1.0,
    "camera_yaw_deg": -2.0,
    "gnss_antenna_from_camera_mid_flu_m": [-0.5, 0.125, 0.25],
    "camera_mid_from_rear_axle_ground_flu_m": [1.5, 0, 2.5],
    "stereo_baseline_m": 0.2,
    "note": "painted green",
}
IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1]
K = [100, 0, 31.5, 0, 100, 23.5, 0, 0, 1]
P1 = [100, 0, 31.5, 0, 0, 100, 23.5, 0, 0, 0, 1, 0]
P2 = [100, 0, 31.5, -20, 0, 100, 23.5, 0, 0, 0, 1, 0]
OPENCV: dict[str, Any] = {
    "K1": K, "K2": K, "D1": [0] * 5, "D2": [0] * 5, "R": IDENTITY, "T": [-0.2, 0, 0],
    "R1": IDENTITY, "R2": IDENTITY, "P1": P1, "P2": P2,
}  # fmt: skip
SHAPES = {"K": (3, 3), "D": (1, 5), "R": (3, 3), "T": (3, 1), "P": (3, 4)}
CSV_LOG = "time_ns,lat_deg,lon_deg,height_m\n1308133815000000000,41.65,-4.72,787.4\n"
CSV_FIX = Fix(1_308_133_815_000_000_000, 41.65, -4.72, 787.4)


def opencv_yaml(matrices: dict[str, Any], size: tuple[int, int] | None = (64, 48)) -> str:
    lines = ["%YAML:1.0", "---"]
    if size is not None:
        lines += [f"image_width: {size[0]}", f"image_height: {size[1]}"]
    for key, data in matrices.items():
        rows, cols = SHAPES[key[0]]
        lines += [f"{key}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {cols}", "   dt: d"]
        lines += [f"   data: {data}"]
    return "\n".join(lines)


def ros_yaml(
    projection: list[float], *, k: list[float] = K, d: float = 0.0, width: int = 64
) -> str:
    return (
        f"image_width: {width}\nimage_height: 48\ncamera_name: left\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {k}\n"
        f"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [{d}, 0, 0, 0, 0]\n"
        f"projection_matrix:\n  rows: 3\n  cols: 4\n  data: {projection}\n"
    )


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A sound recording of three frames, a CSV log and an OpenCV calibration."""
    folder = tmp_path / "june-03"
    for name in ("left", "right", "calibration", "gnss"):
        (folder / name).mkdir(parents=True)
    rows = ["frame_id,timestamp_utc_s,left,right"]
    for k in range(3):
        for side in ("left", "right"):
            image = np.full((48, 64), 10 * k + len(side), dtype=np.uint8)
            assert cv2.imwrite(str(folder / side / f"{k}.png"), image)
        rows.append(f"f{k},{START_S + k}.1,left/{k}.png,right/{k}.png")
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    (folder / "calibration" / "stereo_opencv.yaml").write_text(opencv_yaml(OPENCV))
    (folder / "calibration" / "mounting.json").write_text(json.dumps(MOUNTING))
    (folder / "gnss" / "log.csv").write_text(CSV_LOG)
    return folder


def fails(drive: Path, match: str, kind: type[FieldgridError] = RecordingError) -> None:
    with pytest.raises(FieldgridError, match=match) as caught:
        open_recording(drive)
    assert type(caught.value) is kind


def rewrite(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


# --- what is read


def test_a_sound_folder_is_read_whole(drive: Path) -> None:
    with open_recording(drive) as recording:
        assert recording.name == "june-03"
        assert recording.rig.camera == StereoCamera(64, 48, 100.0, 31.5, 23.5, 0.2)
        assert recording.rig.mount == Mount(2.5, 15.0, 1.0, -2.0)
        assert recording.rig.antenna == LeverArm(right_m=-0.125, forward_m=-0.5, up_m=2.75)
        assert recording.rig.rear_axle_forward_m == -1.5
        assert recording.rig.image_time_offset_ns == 0
        assert recording.datum_hint is None
        assert list(recording.fixes()) == [CSV_FIX]
        assert recording.gnss_source == "gnss/log.csv"
        assert recording.notes == ("log.csv: no column quality; it is unknown.",)
        assert recording.frame_count == 3
        expected = [(START_S + k) * 1_000_000_000 + 100_000_000 for k in range(3)]
        assert recording.frame_times_ns().tolist() == expected
        frames = list(recording.frames())
        assert [(f.frame_id, f.time_ns) for f in frames] == [
            (f"f{k}", t) for k, t in enumerate(expected)
        ]
        left, right = frames[1].images()
        assert (left[0, 0], right[0, 0]) == (14, 15)


@pytest.mark.parametrize(("header", "names"), [("id", "f0 f1 f2"), ("frame_id,id", "a b c")])
def test_an_id_is_that_of_the_frame_where_nothing_else_is(
    drive: Path, header: str, names: str
) -> None:
    table = drive / "frames.csv"
    first, *rows = table.read_text(encoding="utf-8").splitlines()
    assert first.startswith("frame_id,")
    if "," in header:
        rows = [f"{name},{row}" for name, row in zip("abc", rows, strict=True)]
    lines = [first.replace("frame_id", header), *rows]
    table.write_text("\n".join(lines), encoding="utf-8")
    assert " ".join(frame.frame_id for frame in open_recording(drive).frames()) == names


def test_frames_are_sorted_by_time_and_times_are_exact(drive: Path) -> None:
    (drive / "frames.csv").write_text(
        "\ufefftime_ns, frame_id ,right,left,weather\r\n"
        "1308133817000000001,b,right/1.png,left/1.png,\r\n"
        "\r\n"
        "1308133816999999999,a,right/0.png,left/0.png,rain\r\n",
        encoding="utf-8",
    )
    recording = open_recording(drive)
    assert recording.frame_times_ns().tolist() == [1308133816999999999, 1308133817000000001]
    assert [Path(f.left.name).name for f in recording.frames()] == ["0.png", "1.png"]


@pytest.mark.parametrize(
    ("text", "fraction"),
    [("", 0), (".1", 100_000_000), (".123456789", 123_456_789), (".0000000019", 1)],
)
def test_decimal_seconds_lose_nothing(text: str, fraction: int, drive: Path) -> None:
    rewrite(drive / "frames.csv", f"{START_S}.1", f"{START_S}{text}")
    assert open_recording(drive).frame_times_ns()[0] == START_S * 1_000_000_000 + fraction


def test_without_a_table_the_names_give_pairs_and_times(drive: Path) -> None:
    (drive / "frames.csv").unlink()
    for side in ("left", "right"):
        for k in range(3):
            (drive / side / f"{k}.png").rename(drive / side / f"{START_S + k}000000007.png")
    (drive / "right" / f"{START_S + 1}000000007.png").unlink()
    recording = open_recording(drive)
    assert recording.frame_times_ns().tolist() == [
        START_S * 10**9 + 7,
        (START_S + 2) * 10**9 + 7,
    ]
    assert "1 image without a partner skipped." in recording.notes


def test_images_of_another_size_do_not_fit_the_calibration(drive: Path) -> None:
    for side in ("left", "right"):
        cv2.imwrite(str(drive / side / "0.png"), np.zeros((24, 32), dtype=np.uint8))
    with pytest.raises(CalibrationError, match="32 x 24 px, but the calibration is for 64 x 48"):
        next(open_recording(drive).frames()).images()


def test_the_settings_file_is_heard(drive: Path) -> None:
    (drive / "recording.toml").write_text(
        'name = "north block"\nimage_time_offset_s = -0.1234567\n'
        "[datum]\nlat_deg = 41.5\nlon_deg = -4\nheight_m = 780.25\n"
    )
    recording = open_recording(drive)
    assert recording.name == "north block"
    assert recording.rig.image_time_offset_ns == -123_456_700
    assert recording.datum_hint == Datum(41.5, -4.0, 780.25)


def test_fixes_are_moved_to_the_clock_of_the_images(drive: Path) -> None:
    """What is given outranks the settings; images and gyro stay."""
    shutil.copytree(TWO_LANES / "imu", drive / "imu")
    as_written, gyro = open_recording(drive), open_recording(drive).motion().gyro
    assert gyro is not None
    (drive / "recording.toml").write_text("gnss_time_offset_s = -18.25\n")
    by_file = open_drive(drive).recording()
    assert by_file.log.moved_ns == -18_250_000_000
    moved = by_file.fixes().time_ns - as_written.fixes().time_ns
    assert moved.tolist() == [-18_250_000_000] * len(moved)
    by_option = open_drive(drive, DriveOptions(gnss_offset_ns=1_500_000_000)).recording()
    moved = by_option.fixes().time_ns - as_written.fixes().time_ns
    assert set(moved.tolist()) == {1_500_000_000}
    for one in (by_file, by_option):
        assert one.frame_times_ns().tolist() == as_written.frame_times_ns().tolist()
        assert one.rig.image_time_offset_ns == 0
        same = one.motion().gyro
        assert same is not None
        assert same.time_ns.tolist() == gyro.time_ns.tolist()


def test_the_session_file_hints_at_the_datum_and_settings_outrank_it(drive: Path) -> None:
    origin = {"lat_deg": 41.65, "lon_deg": -4.72, "ellipsoid_height_m": 787.4}
    (drive / "session.json").write_text(json.dumps({"ltp_origin": origin}))
    assert open_recording(drive).datum_hint == Datum(41.65, -4.72, 787.4)
    (drive / "recording.toml").write_text("[datum]\nlat_deg = 1\nlon_deg = 2\nheight_m = 3\n")
    assert open_recording(drive).datum_hint == Datum(1.0, 2.0, 3.0)


@pytest.mark.parametrize("text", ["[]", "{}", '{"ltp_origin": null}'])
def test_a_session_file_of_something_else_is_left_alone(text: str, drive: Path) -> None:
    (drive / "session.json").write_text(text)
    assert open_recording(drive).datum_hint is None


def test_a_recording_without_gnss_opens_and_says_so(drive: Path) -> None:
    (drive / "gnss" / "log.csv").unlink()
    recording = open_recording(drive)
    assert list(recording.fixes()) == []
    assert recording.gnss_source == ""
    assert recording.notes == ("No GNSS log in gnss/.",)


def test_all_columns_of_a_csv_log_are_read(drive: Path) -> None:
    (drive / "gnss" / "log.csv").write_text(
        "timestamp_utc_s,lat_deg,lon_deg,height_m,quality,satellites,hdop,age_s,sigma_m,"
        "speed_mps,heading_deg,heading_sigma_deg\n"
        "1308133815.000000001,41.65,-4.72,787.4,4,14,0.7,1.5,0.012,1.25,-170.5,0.5\n"
        "1308133816,41.65,-4.72,787.4,5,,,,,,,\n"
    )
    first, second = open_recording(drive).fixes()
    assert first == Fix(
        1_308_133_815_000_000_001, 41.65, -4.72, 787.4, 4, 14, 0.7, 1.5, 0.012, 1.25, -170.5, 0.5
    )
    assert second == Fix(1_308_133_816_000_000_000, 41.65, -4.72, 787.4, 5)


def test_an_nmea_log_is_read_and_its_damage_noted(drive: Path) -> None:
    (drive / "gnss" / "log.csv").unlink()
    (drive / "gnss" / "a.NMEA").write_bytes(
        b"$GPRMC,103011.00,A,4139.022737,N,00443.214186,W,0.039,,150611,,,D*6A\r\n"
        b"$GPGGA,103011.00,4139.022737,N,00443.214186,W,2,08,1.0,737.921,M,52.4,M,3.4,0138*58\r\n"
        b"$GPGGA,103011.20,4139.0227\r\n"
    )
    recording = open_recording(drive)
    assert recording.fixes()[0].time_ns == 1_308_133_811_000_000_000
    assert recording.notes == ("a.NMEA: 1 damaged sentence skipped.",)


def test_the_log_is_picked_by_name_or_path(drive: Path, tmp_path: Path) -> None:
    for name, lat in (("a.csv", "41.1"), ("b.csv", "41.2")):
        (drive / "gnss" / name).write_text(CSV_LOG.replace("41.65", lat))
    elsewhere = tmp_path / "elsewhere.csv"
    elsewhere.write_text(CSV_LOG.replace("41.65", "41.3"))

    def lat_of(gnss: str | Path) -> tuple[str, float]:
        recording = open_recording(drive, gnss=gnss)
        return recording.gnss_source, recording.fixes()[0].lat_deg

    assert lat_of("a.csv") == ("gnss/a.csv", 41.1)
    assert lat_of("gnss/b.csv") == ("gnss/b.csv", 41.2)
    assert lat_of(drive / "gnss" / "b.csv") == ("gnss/b.csv", 41.2)
    assert lat_of(elsewhere) == ("elsewhere.csv", 41.3)


def test_which_log_is_meant_is_asked_with_all_else_that_is_missing(drive: Path) -> None:
    shutil.rmtree(drive / "calibration")
    (drive / "gnss" / "b.nmea").write_text("")
    with pytest.raises(LackingError) as caught, open_drive(drive):
        pass
    kinds = [type(problem) for problem in caught.value.problems]
    assert kinds == [CalibrationError, CalibrationError, RecordingError]
    assert "several GNSS logs" in str(caught.value.problems[-1])


def test_the_settings_name_the_columns_of_a_log(drive: Path) -> None:
    (drive / "gnss" / "log.csv").write_text("stamp,a,b\n1308133815,41.65,-4.72\n")
    (drive / "recording.toml").write_text('[gnss.columns]\nlat = "a"\nlon = "b"\n')
    (fix,) = open_recording(drive).fixes()
    assert fix == CSV_FIX._replace(height_m=0.0)
    (fix,) = open_recording(drive, columns=Columns({"lat": "b", "lon": "a"})).fixes()
    assert (fix.lat_deg, fix.lon_deg) == (-4.72, 41.65)


def test_a_mounting_declares_what_a_recorded_heading_means(drive: Path) -> None:
    said = {**MOUNTING, "heading_offset_deg": 90, "heading_convention": "ccw_east"}
    (drive / "calibration" / "mounting.json").write_text(json.dumps(said))
    rig = open_recording(drive).rig
    assert (rig.heading_offset_deg, rig.heading_convention) == (90.0, "ccw_east")
    assert nose_heading_deg(rig, [0.0, -90.0]).tolist() == [0.0, 90.0]
    assert np.isnan(nose_heading_deg(rig, [np.nan])).all()
    (drive / "calibration" / "mounting.json").write_text(json.dumps(MOUNTING))
    silent = open_recording(drive).rig
    assert (silent.heading_offset_deg, silent.heading_convention) == (None, "cw_north")
    assert nose_heading_deg(silent, [0.0, -90.0, 270.0]).tolist() == [0.0, -90.0, -90.0]


def test_a_recording_knows_its_own_motion(drive: Path) -> None:
    assert open_recording(drive).motion() == Motion()
    for name, column in (("imu", "gyro_z_rad_s"), ("odometry", "speed_mps")):
        (drive / name).mkdir()
        (drive / name / "a.csv").write_text(f"timestamp_utc_s,{column}\n1308133815.5,-0.25\n")
    motion = open_recording(drive).motion()
    assert motion.gyro is not None
    assert motion.wheels is not None
    assert motion.gyro.time_ns.tolist() == [1_308_133_815_500_000_000]
    assert (motion.gyro.rate_rad_s.tolist(), motion.wheels.speed_mps.tolist()) == ([0.25], [-0.25])


# --- calibrations


def calibrate(drive: Path, left: str | None = None, right: str | None = None) -> Recording:
    """The recording with ROS calibrations alone."""
    (drive / "calibration" / "stereo_opencv.yaml").unlink(missing_ok=True)
    for side, text in (("left", left), ("right", right)):
        if text is not None:
            (drive / "calibration" / f"stereo_{side}_camera_info.yaml").write_text(text)
    return open_recording(drive)


def test_ros_calibrations_are_read(drive: Path) -> None:
    recording = calibrate(drive, ros_yaml(P1), ros_yaml(P2))
    assert recording.rig.camera == StereoCamera(64, 48, 100.0, 31.5, 23.5, 0.2)


def test_principal_points_may_differ_along_the_row(drive: Path) -> None:
    shifted = [100, 0, 29.5, -20, *P2[4:]]
    camera = calibrate(drive, ros_yaml(P1), ros_yaml(shifted)).rig.camera
    assert camera.disparity_offset_px == 2.0


def test_opencv_matrices_of_a_rectified_pair_do_without_projections(drive: Path) -> None:
    path = drive / "calibration" / "stereo_opencv.yaml"
    path.write_text(opencv_yaml({k: v for k, v in OPENCV.items() if k[0] != "P"}))
    assert open_recording(drive).rig.camera == StereoCamera(64, 48, 100.0, 31.5, 23.5, 0.2)


def test_a_calibration_that_says_how_to_rectify_is_noted(drive: Path) -> None:
    path = drive / "calibration" / "stereo_opencv.yaml"
    path.write_text(opencv_yaml({**OPENCV, "D1": [-0.1, 0, 0, 0, 0]}))
    (drive / "gnss" / "log.csv").unlink()
    taken = (
        "describes how to rectify; the images are taken as rectified already; if they are raw, "
        "say so in recording.toml: [images] rectified = false."
    )
    assert open_recording(drive).notes[0] == f"stereo_opencv.yaml {taken}"
    notes = calibrate(drive, ros_yaml(P1, d=0.1), ros_yaml(P2)).notes
    assert notes[0] == f"stereo_left_camera_info.yaml {taken}"


TURNED = [1, 0, 0, 0, 0.9998, -0.02, 0, 0.02, 0.9998]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"P1": None, "P2": None, "R1": TURNED}, "lacks P1 as 3 x 4 numbers"),
        ({"P1": None, "P2": None, "T": None}, "lacks T as 3 x 1 numbers"),
        ({"P2": None}, "lacks P2 as 3 x 4 numbers"),
        ({"P1": [1, 2, 3]}, "lacks P1 as 3 x 4 numbers"),
        ({"P1": ["a"] * 12}, "lacks P1 as 3 x 4 numbers"),
        ({"P1": [".nan", *P1[1:]]}, "lacks P1 as 3 x 4 numbers"),
        ({"P1": [0] * 12}, "not calibrated"),
        ({"P1": [*P1[:5], 101, *P1[6:]]}, r"fx = 100\.0 and fy = 101\.0 px differ"),
        ({"P2": [*P2[:6], 25.5, *P2[7:]]}, "do not share focal length and rows"),
        ({"P2": [102, *P2[1:5], 102, *P2[6:]]}, "do not share focal length and rows"),
        ({"P2": [*P2[:3], 0, *P2[4:7], -20, *P2[8:]]}, "do not share focal length and rows"),
        ({"P2": [*P2[:3], 20, *P2[4:]]}, "baseline of -0.2 m"),
        ({"P2": [*P2[:3], -20_000, *P2[4:]]}, "baseline of 200.0 m"),
    ],
)
def test_an_opencv_calibration_that_cannot_be(
    changes: dict[str, Any], message: str, drive: Path
) -> None:
    matrices = {k: v for k, v in {**OPENCV, **changes}.items() if v is not None}
    text = opencv_yaml(matrices).replace("'", "")
    (drive / "calibration" / "stereo_opencv.yaml").write_text(text)
    fails(drive, rf"stereo_opencv\.yaml.*{message}", CalibrationError)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no calibration"),
        ("- 1\n- 2\n", "holds no calibration"),
        ("a: [1, 2", "is not YAML"),
        ("a: !!python/object/apply:os.system ['true']", "is not YAML"),
        ("a: !!opencv-matrix 5", "is not YAML"),
        ("[" * 5000, "is not YAML"),
        ("image_width: wide\nimage_height: 480", "images is .'wide', 480.; give image_width"),
        (opencv_yaml(OPENCV, (0, 48)), "images of 0 x 48 px"),
    ],
)
def test_a_calibration_file_that_is_none(text: str, message: str, drive: Path) -> None:
    (drive / "calibration" / "stereo_opencv.yaml").write_text(text)
    fails(drive, rf"stereo_opencv\.yaml.*{message}", CalibrationError)


def test_calibrations_that_are_missing_or_at_odds(drive: Path) -> None:
    with pytest.raises(CalibrationError, match=r"K\[0\] = 0 means that the camera was never"):
        calibrate(drive, ros_yaml(P1, k=[0.0] * 9), ros_yaml(P2))
    with pytest.raises(CalibrationError, match=r"is for images of \(64, 48\) px, .* \(32, 48\)"):
        calibrate(drive, ros_yaml(P1), ros_yaml(P2, width=32))
    (drive / "calibration" / "stereo_right_camera_info.yaml").unlink()
    fails(drive, "stereo_right_camera_info.yaml cannot be read: No such file", CalibrationError)
    (drive / "calibration" / "stereo_left_camera_info.yaml").unlink()
    fails(drive, "neither stereo_opencv.yaml nor stereo_left_camera_info", CalibrationError)


def test_two_calibrations_must_agree(drive: Path) -> None:
    for side, projection in (("left", P1), ("right", [*P2[:3], -20.1, *P2[4:]])):
        path = drive / "calibration" / f"stereo_{side}_camera_info.yaml"
        path.write_text(ros_yaml(projection))
    fails(drive, r"disagree in f·b, 20 and 20\.1 px·m", CalibrationError)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera_height_above_ground_m": None}, "lacks camera_height_above_ground_m"),
        ({"camera_tilt_down_deg": None}, "lacks camera_tilt_down_deg"),
        ({"gnss_antenna_from_camera_mid_flu_m": None}, "a forgotten lever arm misplaces"),
        (
            {"gnss_antenna_from_camera_mid_flu_m": [1, 2]},
            r"is \[1, 2\]; measure it and give",
        ),
        (
            {"gnss_antenna_from_camera_mid_flu_m": [1, 2, "3"]},
            "is '3', which is no",
        ),
        ({"gnss_antenna_from_camera_mid_flu_m": [450, 0, 0]}, "beyond 30 m"),
        ({"camera_height_above_ground_m": 265}, "camera height of 265"),
        (
            {"camera_height_above_ground_m": float("nan")},
            "is nan, which is no number; measure",
        ),
        ({"camera_tilt_down_deg": True}, "is True, which is no number"),
        ({"camera_roll_deg": 90}, "camera roll of 90"),
        (
            {"camera_tilt_deg": 15.0},
            "'camera_tilt_deg' is not a setting; known are camera_h.*; for remarks",
        ),
        ({"heading_offset_deg": 700}, "heading offset of 700.0° is beyond 360°"),
        ({"heading_offset_deg": None, "heading_convention": "ccw"}, "heading_convention is 'ccw'"),
        ({"imu_axes": "fru"}, "imu_axes is 'fru', which .* give where x, y and z of the IMU point"),
        ({"imu_axes": 3}, "imu_axes is 3, which"),
        ({"stereo_baseline_m": 0.203}, r"stereo_baseline_m is 0\.203, but the calibration says"),
    ],
)
def test_a_mounting_that_cannot_be(changes: dict[str, Any], message: str, drive: Path) -> None:
    mounting = {k: v for k, v in {**MOUNTING, **changes}.items() if v is not None}
    (drive / "calibration" / "mounting.json").write_text(json.dumps(mounting))
    fails(drive, rf"mounting\.json.*{message}", CalibrationError)


def test_what_a_mounting_may_leave_out(drive: Path) -> None:
    kept = dict(list(MOUNTING.items())[:2])
    kept["gnss_antenna_from_camera_mid_flu_m"] = [0, 0, 0]
    (drive / "calibration" / "mounting.json").write_text(json.dumps(kept))
    rig = open_recording(drive).rig
    assert (rig.mount.roll_deg, rig.mount.yaw_deg, rig.rear_axle_forward_m) == (0.0, 0.0, None)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "[1]", '{"a": 1e}'])
def test_a_mounting_file_that_is_none(text: str, drive: Path) -> None:
    (drive / "calibration" / "mounting.json").write_text(text)
    fails(
        drive,
        r"mounting\.json (is not JSON|holds .* give a table)",
        CalibrationError,
    )


# --- frames


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("frame_id", "ids", "has no column frame_id"),
        (f"{START_S}.1", "1.308e9", r"line 2: timestamp_utc_s '1\.308e9' is no UTC time"),
        (f"{START_S}.1", "", "line 2: timestamp_utc_s '' is no UTC time"),
        (f"{START_S}.1", "-5", "line 2: timestamp_utc_s '-5' is no UTC time"),
        (f"{START_S}.1", "55.5", "line 2: timestamp_utc_s '55.5' is no UTC time"),
        (f"{START_S}.1", f"{START_S + 1}.1", "Frames f0 and f1 .* have the same time"),
        ("f1,", "f0,", "frame_id 'f0' occurs twice"),
        ("f1,", ",", "line 3: frame_id is empty"),
        ("left/1.png", "", "line 3: left is empty"),
        ("left/1.png", "../../etc/passwd", r"'\.\./\.\./etc/passwd' leads out of the recording"),
        ("left/1.png", "left/../../x.png", "leads out of the recording"),
        ("left/1.png", "/etc/passwd", "'/etc/passwd' leads out of the recording"),
        ("left/1.png", "left/9.png", r"1 of 6 images are missing .* First: .*left/9\.png cannot"),
        ("left/1.png", "left", "1 of 6 images are missing .* First: .*left is not a regular file"),
    ],
)
def test_a_frame_table_that_cannot_be(old: str, new: str, message: str, drive: Path) -> None:
    rewrite(drive / "frames.csv", old, new)
    fails(drive, message)


def test_a_frame_table_in_nanoseconds_must_be_in_nanoseconds(drive: Path) -> None:
    (drive / "frames.csv").write_text(f"frame_id,time_ns,left,right\na,{START_S},l,r\n")
    fails(drive, f"line 2: time_ns '{START_S}' is no UTC time after 1980 in nanoseconds")


@pytest.mark.parametrize("text", ["", "frame_id,timestamp_utc_s,left,right\n"])
def test_an_empty_frame_table(text: str, drive: Path) -> None:
    (drive / "frames.csv").write_text(text)
    fails(drive, "has no column frame_id|has no stereo pair")


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"frame_id,left,right\n" + b"x" * 200_000])
def test_a_frame_table_that_is_none(content: bytes, drive: Path) -> None:
    (drive / "frames.csv").write_bytes(content)
    fails(drive, r"frames\.csv is not (UTF-8 text|a CSV file)")


def test_missing_images_are_counted(drive: Path) -> None:
    for path in (drive / "right").iterdir():
        path.unlink()
    fails(drive, r"3 of 6 images are missing from .*june-03; .*--skip-bad.*right/0\.png cannot")


def test_names_without_a_time_ask_for_the_table(drive: Path) -> None:
    (drive / "frames.csv").unlink()
    fails(drive, r"has no frames\.csv, and the image name \d\.png is no UTC time")


def test_two_images_of_one_name_are_ambiguous(drive: Path) -> None:
    (drive / "frames.csv").unlink()
    (drive / "left" / "0.jpg").write_bytes(b"")
    fails(drive, r"has both 0\.jpg and 0\.png")


# --- GNSS


def test_several_logs_ask_for_one(drive: Path) -> None:
    (drive / "gnss" / "b.nmea").write_text("")
    fails(drive, r"several GNSS logs: b\.nmea, log\.csv; give --gnss NAME")


def test_a_log_that_is_not_there(drive: Path) -> None:
    with pytest.raises(RecordingError, match=r"'rtk\.nmea' is neither in .* has: log\.csv"):
        open_recording(drive, gnss="rtk.nmea")


def test_what_is_passed_over_is_named(drive: Path) -> None:
    (drive / "gnss" / "log.csv").rename(drive / "gnss" / "log.rtcm3")
    assert open_recording(drive).notes[-1] == (
        "No GNSS log in gnss/; passed over: log.rtcm3 (name it with --gnss if it is one)."
    )
    assert list(open_recording(drive, gnss="log.rtcm3").fixes()) == [CSV_FIX]


def test_an_nmea_log_without_a_date_is_named(drive: Path) -> None:
    (drive / "gnss" / "log.csv").unlink()
    (drive / "gnss" / "a.nmea").write_bytes(
        b"$GPGGA,103011.00,4139.022737,N,00443.214186,W,2,08,1.0,737.921,M,52.4,M,3.4,0138*58\r\n"
    )
    fails(drive, r"a\.nmea: The log has 1 positions but no valid RMC", GnssError)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("lat_deg", "y", "has no column lat_deg, and none whose name is known"),
        (
            "time_ns",
            "when",
            r"has no column with UTC times; name it: time = .COLUMN. in \[gnss.columns\]",
        ),
        ("41.65", "north", r"line 2: lat_deg 'north' is not a number"),
        ("787.4", "high", r"line 2: height_m 'high' is not a number"),
        (
            "1308133815000000000",
            "soon",
            r"has no column with UTC times \(time_ns 'soon' can not be read",
        ),
    ],
)
def test_a_csv_log_that_cannot_be(old: str, new: str, message: str, drive: Path) -> None:
    rewrite(drive / "gnss" / "log.csv", old, new)
    fails(drive, rf"log\.csv.*{message}")


# --- settings


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "is not TOML"),
        (
            "speed = 3",
            "'speed' is not a setting; known are name, image_time_offset_s, gnss_time_off",
        ),
        ("name = 3", "name is 3; give a text"),
        ("gnss = 3", r"gnss is 3; give a table \[gnss\]"),
        ("[gnss]\ncolumns = 3", r"columns is 3; give a table \[gnss\.columns\]"),
        ("[gnss]\nlog = 'a'", "'log' is not a setting; known are columns"),
        ("[gnss.columns]\nlat = 3", "Columns: lat is 3; give a column name"),
        ("[gnss.columns]\nlatt = 'a'", "Columns: 'latt' cannot be mapped; known are time, lat"),
        ("image_time_offset_s = '1'", "image_time_offset_s is '1', which is no number"),
        ("image_time_offset_s = nan", "image_time_offset_s is NaN, which is no number; give"),
        ("image_time_offset_s = true", "image_time_offset_s is True, which is no number"),
        (
            "image_time_offset_s = 1300000000",
            "image_time_offset_s is 1300000000; give .* at most 40 years",
        ),
        ("datum = 3", r"datum is 3; give a table \[datum\]"),
        ("[datum]\nlat_deg = 1\nlon_deg = 2", "lacks height_m; give the height above"),
        ("[datum]\nlat_deg=1\nlon_deg=2\nheight_m=3\nh=1", "'h' is not a setting"),
        ("[datum]\nlat_deg=99\nlon_deg=2\nheight_m=3", "99.0 and longitude 2.0 are not on Earth"),
        (
            "[datum]\nlat_deg='a'\nlon_deg=2\nheight_m=3",
            "lat_deg is .a., which is no number",
        ),
    ],
)
def test_settings_that_cannot_be(text: str, message: str, drive: Path) -> None:
    (drive / "recording.toml").write_text(text)
    fails(drive, rf"recording\.toml.*{message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ('{"ltp_origin": {"lat_deg": 1}}', "ltp_origin lacks lon_deg; give"),
        (
            '{"ltp_origin": {"lat_deg": 1, "lon_deg": 999, "ellipsoid_height_m": 3}}',
            "are not on Earth",
        ),
    ],
)
def test_a_session_file_that_cannot_be(text: str, message: str, drive: Path) -> None:
    (drive / "session.json").write_text(text)
    fails(drive, rf"session\.json.*{message}")


# --- no recording


def test_what_is_no_recording(tmp_path: Path) -> None:
    fails(tmp_path / "nowhere", "nowhere does not exist; give the folder of a recording")
    fails(
        tmp_path,
        r"is no recording; looked for one KITTI drive \*_sync .* frames\.csv, or left/ and right/",
    )
    (tmp_path / "left").mkdir()
    fails(tmp_path, "is no recording")
    (tmp_path / "a.mp4").write_bytes(bytes(range(32)))
    with pytest.raises(GnssError, match="is no bag and no GNSS log that is known"):
        open_recording(tmp_path / "a.mp4")


# --- real data


def test_the_reference_example_is_read(shared_data: SharedData) -> None:
    folder = shared_data("vineyard_two_lanes")
    with pytest.raises(RecordingError, match=r"gnss_rtk\.nmea, gnss_sf1\.nmea; give --gnss NAME"):
        open_recording(folder)
    recording = open_recording(folder, gnss="gnss_rtk.nmea")
    assert recording.name == "vineyard_two_lanes"
    assert recording.frame_count == 50
    assert len(recording.fixes()) == 437
    assert recording.datum_hint == Datum(41.65, -4.72, 787.4)
    assert recording.rig.camera.focal_baseline_px_m == pytest.approx(162.972)
    assert recording.rig.antenna == LeverArm(right_m=-0.12, forward_m=-0.45, up_m=3.0)
    assert recording.rig.rear_axle_forward_m == -1.4
    assert recording.notes == ()
    left, right = next(recording.frames()).images()
    assert left.shape == right.shape == (480, 640)


def test_a_table_of_many_frames_is_bounded(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = drive / "frames.csv"
    header, *rows = table.read_text().splitlines()
    lines = [f"{k:06d}{rows[0][rows[0].index(',') :]}" for k in range(20_000)]
    table.write_text("\n".join([header, *lines]))
    monkeypatch.setattr(frame_table, "MAX_FRAMES", 10_000)
    tracemalloc.start()
    try:
        fails(drive, r"frames\.csv lists more than 10000 frames; split it into several")
        assert tracemalloc.get_traced_memory()[1] < 600 * 10_000
    finally:
        tracemalloc.stop()


def test_missing_images_are_counted_up_to_a_limit(
    drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.rmtree(drive / "right")
    fails(drive, r"\d+ of \d+ images are missing")
    monkeypatch.setattr(stored, "_MOST_MISSING", 2)
    fails(drive, r"2 or more of \d+ images are missing")
