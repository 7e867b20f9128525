"""The plain folder: what is read from it, and the sentence for everything that can be wrong."""

from __future__ import annotations

import json
import re
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fieldgrid.core import CalibrationError, FieldgridError, LackingError, RecordingError
from fieldgrid.geometry import Datum, Fix, LeverArm, Motion, Mount, StereoCamera, nose_heading_deg
from fieldgrid.recordings import Columns, DriveOptions, open_drive, open_growing, open_recording
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


def refusal(drive: Path, **options: Any) -> FieldgridError:
    with pytest.raises(FieldgridError) as caught:
        open_recording(drive, **options)
    return caught.value


def change(path: Path, old: str | None, new: str | bytes | None) -> None:
    """Put something else, or nothing, in the place of what a file says, or of all of it."""
    if new is None:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    elif isinstance(new, bytes):
        path.write_bytes(new)
    elif old is None:
        path.write_text(new)
    else:
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new))


# --- what is read


def test_a_sound_folder_is_read_whole(drive: Path) -> None:
    with open_recording(drive) as recording:
        rig = recording.rig
        assert recording.name == "june-03"
        assert rig.camera == StereoCamera(64, 48, 100.0, 31.5, 23.5, 0.2)
        assert rig.mount == Mount(2.5, 15.0, 1.0, -2.0)
        assert rig.antenna == LeverArm(right_m=-0.125, forward_m=-0.5, up_m=2.75)
        assert (rig.rear_axle_forward_m, rig.image_time_offset_ns) == (-1.5, 0)
        assert (rig.heading_offset_deg, rig.heading_convention) == (None, "cw_north")
        assert recording.datum_hint is None
        assert list(recording.fixes()) == [CSV_FIX]
        assert recording.gnss_source == "gnss/log.csv"
        assert recording.notes == ("log.csv: no column quality; it is unknown.",)
        assert recording.motion() == Motion()
        expected = [(START_S + k) * 1_000_000_000 + 100_000_000 for k in range(3)]
        assert recording.frame_times_ns().tolist() == expected
        frames = list(recording.frames())
        assert [frame.frame_id for frame in frames] == ["f0", "f1", "f2"]
        left, right = frames[1].images()
        assert (left[0, 0], right[0, 0]) == (14, 15)


@pytest.mark.parametrize(("header", "names"), [("id", "f0 f1 f2"), ("frame_id,id", "a b c")])
def test_an_id_is_that_of_the_frame_where_nothing_else_is(
    drive: Path, header: str, names: str
) -> None:
    first, *rows = (drive / "frames.csv").read_text().splitlines()
    if "," in header:
        rows = [f"{name},{row}" for name, row in zip("abc", rows, strict=True)]
    (drive / "frames.csv").write_text("\n".join([first.replace("frame_id", header), *rows]))
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
    ("text", "fraction"), [("", 0), (".123456789", 123_456_789), (".0000000019", 1)]
)
def test_decimal_seconds_lose_nothing(text: str, fraction: int, drive: Path) -> None:
    change(drive / "frames.csv", f"{START_S}.1", f"{START_S}{text}")
    assert open_recording(drive).frame_times_ns()[0] == START_S * 1_000_000_000 + fraction


def test_without_a_table_the_names_give_pairs_and_times(drive: Path) -> None:
    (drive / "frames.csv").unlink()
    assert re.search(r"the image name \d\.png is no UTC time", str(refusal(drive)))
    for side in ("left", "right"):
        for k in range(3):
            (drive / side / f"{k}.png").rename(drive / side / f"{START_S + k}000000007.png")
    (drive / "right" / f"{START_S + 1}000000007.png").unlink()
    recording = open_recording(drive)
    expected = [START_S * 10**9 + 7, (START_S + 2) * 10**9 + 7]
    assert recording.frame_times_ns().tolist() == expected
    assert "1 image without a partner skipped." in recording.notes
    (drive / "left" / f"{START_S}000000007.jpg").write_bytes(b"")
    assert re.search(r"has both \d+\.jpg and \d+\.png", str(refusal(drive)))


def test_images_of_another_size_do_not_fit_the_calibration(drive: Path) -> None:
    for side in ("left", "right"):
        cv2.imwrite(str(drive / side / "0.png"), np.zeros((24, 32), dtype=np.uint8))
    with pytest.raises(CalibrationError, match="32 x 24 px, but the calibration is for 64 x 48"):
        next(open_recording(drive).frames()).images()


def test_the_settings_file_is_heard_and_outranks_that_of_the_session(drive: Path) -> None:
    for text in ("[]", "{}", '{"ltp_origin": null}'):  # of another program
        (drive / "session.json").write_text(text)
        assert open_recording(drive).datum_hint is None
    origin = {"lat_deg": 41.65, "lon_deg": -4.72, "ellipsoid_height_m": 787.4, "source": "RTK"}
    (drive / "session.json").write_text(json.dumps({"ltp_origin": origin}))
    assert open_recording(drive).datum_hint == Datum(41.65, -4.72, 787.4)
    (drive / "gnss" / "log.csv").write_text("stamp,a,b\n1308133815,41.65,-4.72\n")
    (drive / "recording.toml").write_text(
        'name = "north block"\nimage_time_offset_s = -0.1234567\n'
        "[datum]\nlat_deg = 41.5\nlon_deg = -4\nheight_m = 780.25\n"
        '[gnss.columns]\nlat = "a"\nlon = "b"\n'
    )
    recording = open_recording(drive)
    assert recording.name == "north block"
    assert recording.rig.image_time_offset_ns == -123_456_700
    assert recording.datum_hint == Datum(41.5, -4.0, 780.25)
    assert list(recording.fixes()) == [CSV_FIX._replace(height_m=0.0)]
    (fix,) = open_recording(drive, columns=Columns({"lat": "b", "lon": "a"})).fixes()
    assert (fix.lat_deg, fix.lon_deg) == (-4.72, 41.65)


def test_fixes_are_moved_to_the_clock_of_the_images(drive: Path) -> None:
    """What is given outranks the settings; images and gyro stay."""
    shutil.copytree(TWO_LANES / "imu", drive / "imu")
    as_written = open_recording(drive)
    (drive / "recording.toml").write_text("gnss_time_offset_s = -18.25\n")
    for options, moved_ns in (
        (DriveOptions(), -18_250_000_000),
        (DriveOptions(gnss_offset_ns=1_500_000_000), 1_500_000_000),
    ):
        one = open_drive(drive, options).recording()
        assert one.log.moved_ns == moved_ns
        moved = one.fixes().time_ns - as_written.fixes().time_ns
        assert set(moved.tolist()) == {moved_ns}
        assert one.frame_times_ns().tolist() == as_written.frame_times_ns().tolist()
        assert one.rig.image_time_offset_ns == 0
        before, after = as_written.motion().gyro, one.motion().gyro
        assert before is not None
        assert after is not None
        assert after.time_ns.tolist() == before.time_ns.tolist()


def test_a_recording_knows_its_own_motion(drive: Path) -> None:
    for name, column in (("imu", "gyro_z_rad_s"), ("odometry", "speed_mps")):
        (drive / name).mkdir()
        (drive / name / "a.csv").write_text(f"timestamp_utc_s,{column}\n1308133815.5,-0.25\n")
    motion = open_recording(drive).motion()
    assert motion.gyro is not None
    assert motion.wheels is not None
    assert motion.gyro.time_ns.tolist() == [1_308_133_815_500_000_000]
    assert (motion.gyro.rate_rad_s.tolist(), motion.wheels.speed_mps.tolist()) == ([0.25], [-0.25])
    shutil.rmtree(drive / "calibration")  # then it is no recording, and moves all the same
    assert open_drive(drive).motion().gyro is not None


def test_a_mounting_declares_what_a_recorded_heading_means(drive: Path) -> None:
    said = {**MOUNTING, "heading_offset_deg": 90, "heading_convention": "ccw_east"}
    assert nose_heading_deg(open_recording(drive).rig, [0.0, 270.0]).tolist() == [0.0, -90.0]
    (drive / "calibration" / "mounting.json").write_text(json.dumps(said))
    rig = open_recording(drive).rig
    assert nose_heading_deg(rig, [0.0, -90.0]).tolist() == [0.0, 90.0]
    assert np.isnan(nose_heading_deg(rig, [np.nan])).all()


# --- logs


def test_the_log_is_picked_by_name_or_path(drive: Path, tmp_path: Path) -> None:
    places = {"a.csv": "gnss/a.csv", "gnss/b.csv": "gnss/b.csv", "../own.csv": "own.csv"}
    for k, place in enumerate(("gnss/a.csv", "gnss/b.csv", "../own.csv")):
        (drive / place).write_text(CSV_LOG.replace("41.65", f"41.{k}"))
    wanted = [*places, drive / "gnss" / "b.csv", tmp_path / "own.csv"]
    found = [open_recording(drive, gnss=one) for one in wanted]
    assert [one.fixes()[0].lat_deg for one in found] == [41.0, 41.1, 41.2, 41.1, 41.2]
    assert [Path(one.gnss_source).name for one in found[3:]] == ["b.csv", "own.csv"]
    assert found[0].gnss_source == "gnss/a.csv"
    several = r"several GNSS logs: a\.csv, b\.csv, log\.csv; give --gnss NAME"
    assert re.search(several, str(refusal(drive)))
    missing = r"'rtk\.nmea' is neither in .* has: a\.csv, b\.csv, log\.csv"
    assert re.search(missing, str(refusal(drive, gnss="rtk.nmea")))


def test_which_log_is_meant_is_asked_with_all_else_that_is_missing(drive: Path) -> None:
    shutil.rmtree(drive / "calibration")
    (drive / "gnss" / "b.nmea").write_text("")
    with pytest.raises(LackingError) as caught, open_drive(drive):
        pass
    kinds = [type(problem) for problem in caught.value.problems]
    assert kinds == [CalibrationError, CalibrationError, RecordingError]
    assert "several GNSS logs" in str(caught.value.problems[-1])


def test_a_recording_without_gnss_opens_and_names_what_is_passed_over(drive: Path) -> None:
    (drive / "gnss" / "log.csv").rename(drive / "gnss" / "log.rtcm3")
    assert list(open_recording(drive, gnss="log.rtcm3").fixes()) == [CSV_FIX]
    assert open_recording(drive).notes == (
        "No GNSS log in gnss/; passed over: log.rtcm3 (name it with --gnss if it is one).",
    )
    (drive / "gnss" / "log.rtcm3").unlink()
    recording = open_recording(drive)
    assert (list(recording.fixes()), recording.gnss_source) == ([], "")
    assert recording.notes == ("No GNSS log in gnss/.",)


# --- what is wrong

TIME = f"{START_S}.1"
HEADER = b"frame_id,timestamp_utc_s,left,right\n"
MISSING = "\n".join(
    ["frame_id,timestamp_utc_s,left,right", *(f"{k},{START_S + k},l,r" for k in range(600))]
)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("frames.csv", "frame_id", "ids", "has no column frame_id"),
        ("frames.csv", TIME, "1.308e9", r"line 2: timestamp_utc_s '1\.308e9' is no UTC time"),
        ("frames.csv", TIME, "", "line 2: timestamp_utc_s '' is no UTC time"),
        ("frames.csv", TIME, "-5", "line 2: timestamp_utc_s '-5' is no UTC time"),
        ("frames.csv", TIME, "55.5", "line 2: timestamp_utc_s '55.5' is no UTC time"),
        ("frames.csv", TIME, f"{START_S + 1}.1", "Frames f0 and f1 .* have the same time"),
        ("frames.csv", "timestamp_utc_s", "time_ns", "time_ns '.*' is no UTC .* in nanoseconds"),
        ("frames.csv", "f1,", "f0,", "frame_id 'f0' occurs twice"),
        ("frames.csv", "f1,", ",", "line 3: frame_id is empty"),
        ("frames.csv", "left/1.png", "", "line 3: left is empty"),
        ("frames.csv", "left/1.png", "../../etc/passwd", r"'\.\./\.\./etc/passwd' leads out of"),
        ("frames.csv", "left/1.png", "left/../../x.png", "leads out of the recording"),
        ("frames.csv", "left/1.png", "/etc/passwd", "'/etc/passwd' leads out of the recording"),
        ("frames.csv", "left/1.png", "left/9.png", r"1 of 6 .* First: .*left/9\.png cannot"),
        ("frames.csv", "left/1.png", "left", "1 of 6 .* First: .*left is not a regular file"),
        ("frames.csv", None, "", "has no column frame_id"),
        ("frames.csv", None, "frame_id,time_ns,left,right\n", "has no stereo pair"),
        ("frames.csv", None, "a,b\n" + "x" * 200_000, r"frames\.csv (has no column|is not a CSV)"),
        ("frames.csv", None, b"\xff\xfe\x00", r"frames\.csv is not UTF-8 text"),
        ("frames.csv", None, MISSING, "1000 or more of 1200 images are missing"),
        ("right", None, None, r"3 of 6 images are missing from .*--skip-bad.*right/0\.png cannot"),
        ("calibration/stereo_opencv.yaml", None, None, "neither stereo_opencv.yaml nor stereo_l"),
        ("calibration/mounting.json", "0.2,", "0.203,", r"is 0\.203, but the calibration says"),
        ("recording.toml", None, "speed = 3", "'speed' is not a setting"),
        ("session.json", None, "{", "is not JSON"),
        ("session.json", None, '{"ltp_origin": {"lat_deg": 1}}', "ltp_origin lacks lon_deg; give"),
        (
            "session.json",
            None,
            '{"ltp_origin": {"lat_deg": 1, "lon_deg": 999, "ellipsoid_height_m": 3}}',
            r"session\.json.*are not on Earth",
        ),
    ],
)
def test_what_is_broken(
    file: str, old: str | None, new: str | bytes | None, message: str, drive: Path
) -> None:
    change(drive / file, old, new)
    problem = refusal(drive)
    assert re.search(message, str(problem))
    assert type(problem) is (CalibrationError if "calibration/" in file else RecordingError)
    assert "\n" not in str(problem)


@pytest.mark.parametrize(
    ("kind", "sentences"),
    [
        ("depth", ["neither stereo_opencv.yaml", "has no depth image", "no mounting.json"]),
        ("clouds", ["has no cloud", "no mounting.json"]),
    ],
)
def test_all_that_other_frames_lack_is_told_at_once(
    kind: str, sentences: list[str], drive: Path
) -> None:
    for name in ("left", "calibration", "frames.csv"):
        change(drive / name, None, None)
    (drive / kind).mkdir()
    problem = refusal(drive)
    assert isinstance(problem, LackingError)
    for said, sentence in zip(map(str, problem.problems), sentences, strict=True):
        assert sentence in said


def test_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    (tmp_path / "a.mp4").write_bytes(bytes(range(32)))
    looked_for = r"looked for one KITTI drive \*_sync .* frames\.csv, or left/ and right/"
    for path, message in (
        (tmp_path / "nowhere", "nowhere does not exist; give the folder of a recording"),
        (tmp_path, f"is no recording; {looked_for}"),
        (tmp_path / "a.mp4", "is no bag and no GNSS log that is known"),
    ):
        assert re.search(message, str(refusal(path)))


def test_a_table_of_many_frames_is_bounded(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = drive / "frames.csv"
    header, *rows = table.read_text().splitlines()
    lines = [f"{k:06d}{rows[0][rows[0].index(',') :]}" for k in range(20_000)]
    table.write_text("\n".join([header, *lines]))
    monkeypatch.setattr(frame_table, "MAX_FRAMES", 10_000)
    tracemalloc.start()
    try:
        assert "lists more than 10000 frames; split it into several" in str(refusal(drive))
        assert tracemalloc.get_traced_memory()[1] < 600 * 10_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (b"a,b\nf0,f1\n", "line 2 is no header with at least frame_id, left, right"),
        (HEADER + b"f0,\xff\n", "line 2: .* can't decode byte 0xff .*; correct it"),
        (HEADER + b"f0,soon,left/0.png,right/0.png\n", "line 2: timestamp_utc_s 'soon' is no UTC"),
        (HEADER + b"f0,1308133815,/etc/passwd,right/0.png\n", "line 2: .* leads out of"),
        (HEADER + b"x\n" * 2000, "has 1000 more new rows or names that are no frames"),
        (HEADER + b"x" * (4 << 20), "has a line of more than 4 MiB"),
    ],
)
def test_what_is_wrong_with_a_table_that_grows(table: bytes, message: str, drive: Path) -> None:
    """It is told of a row, and the rows after it are read, but for a line without an end."""
    (drive / "frames.csv").unlink()
    folder = open_growing(drive)
    (drive / "frames.csv").write_bytes(table)
    if len(table) > 4 << 20:
        with pytest.raises(RecordingError, match=message):
            folder.new_shots()
        return
    shots, problems = folder.new_shots()
    assert shots == []
    assert re.search(message, str(problems[-1]))
    with (drive / "frames.csv").open("ab") as file:
        file.write(b"" if table.startswith(HEADER) else HEADER)
        file.write(f"f9,{START_S}.1,left/0.png,right/0.png\nf10,{START_S}.2".encode())
    (shot,), problems = folder.new_shots()
    assert (shot.frame_id, problems) == ("f9", [])


def test_fixes_that_arrive_live_are_not_moved(drive: Path) -> None:
    (drive / "recording.toml").write_text("gnss_time_offset_s = 1\n")
    with pytest.raises(RecordingError, match="leave gnss_time_offset_s out of"):
        open_growing(drive)


# --- real data


def test_the_reference_example_is_read(shared_data: SharedData) -> None:
    recording = open_recording(shared_data("vineyard_two_lanes"), gnss="gnss_rtk.nmea")
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
