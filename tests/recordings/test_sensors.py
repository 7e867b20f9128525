"""Plain folders of depth images, disparities and clouds: which sensor they are of."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from fieldgrid.core import CalibrationError, FieldgridError, RecordingError
from fieldgrid.geometry import DepthCamera, LeverArm, Lidar, Mount
from fieldgrid.recordings import CloudFrame, DepthFrame, StereoFrame, open_recording
from tests.recordings.test_folder import CSV_LOG, MOUNTING, OPENCV, START_S, opencv_yaml, ros_yaml
from tests.scenes import Ground, sweep

SIZE = (64, 48)
INFO = """image_width: 64
image_height: 48
camera_matrix: {{rows: 3, cols: 3, data: [{k}, 0, 31, 0, 110, 23, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [{p}, 0, 31.5, 0, 0, 120, 23.5, 0, 0, 0, 1, 0]}}
"""


def info(k: float = 90, p: float = 100) -> str:
    return INFO.format(k=k, p=p)


def folder(
    tmp_path: Path,
    kinds: tuple[str, ...] = ("depth",),
    calibration: dict[str, str] | None = None,
    settings: str = "",
    table: str | None = None,
) -> Path:
    drive = tmp_path / "june-03"
    for name in (*kinds, "gnss", "calibration"):
        (drive / name).mkdir(parents=True)
    for k in range(3):
        stem = f"{START_S + k}000000000"
        for kind in kinds:
            path = drive / kind / stem
            if kind == "clouds":
                np.save(path.with_suffix(".npy"), cloud())
            elif kind in ("left", "right"):
                cv2.imwrite(f"{path}.png", np.zeros(SIZE[::-1], np.uint8))
            else:
                cv2.imwrite(f"{path}.png", np.full(SIZE[::-1], 5000 + k, np.uint16))
    (drive / "gnss" / "log.csv").write_text(CSV_LOG)
    mounting = {key: MOUNTING[key] for key in MOUNTING if key != "stereo_baseline_m"}
    (drive / "calibration" / "mounting.json").write_text(json.dumps(mounting))
    for name, text in (calibration or {"depth_camera_info.yaml": info()}).items():
        (drive / "calibration" / name).write_text(text)
    if settings:
        (drive / "recording.toml").write_text(settings)
    if table is not None:
        (drive / "frames.csv").write_text(table)
    return drive


def cloud() -> np.ndarray:
    rdf = sweep(Mount(2.0, 0.0), [Ground()], 1.0)
    return np.stack([rdf[:, 2], -rdf[:, 0], -rdf[:, 1]], axis=1)


def fails(drive: Path, match: str, kind: type[FieldgridError] = RecordingError) -> None:
    with pytest.raises(kind, match=match):
        open_recording(drive)


# --- depths


def test_depth_images_with_their_camera_info(tmp_path: Path) -> None:
    with open_recording(folder(tmp_path)) as recording:
        assert recording.rig.sensor == DepthCamera(64, 48, 100.0, 120.0, 31.5, 23.5)
        assert recording.rig.antenna == LeverArm(-0.125, -0.5, 2.75)
        frames = list(recording.frames())
        assert [frame.time_ns for frame in frames] == recording.frame_times_ns().tolist()
        assert len(frames) == recording.frame_count == 3
        for k, frame in enumerate(frames):
            assert isinstance(frame, DepthFrame)
            assert frame.size_px == SIZE
            assert frame.source.read() == pytest.approx(np.full((48, 64), 5.0 + k / 1000.0))
            assert [source.name for source in frame.sources] == [frame.source.name]
        streams = {stream.name: stream for stream in recording.streams()}
        assert (streams["depth"].kind, streams["depth"].role) == ("image", "depth")


def test_without_a_projection_the_matrix_of_the_camera_is_taken(tmp_path: Path) -> None:
    drive = folder(tmp_path, calibration={"depth_camera_info.yaml": info(p=0)})
    assert open_recording(drive).rig.sensor == DepthCamera(64, 48, 90.0, 110.0, 31.0, 23.0)


def test_the_baseline_of_depths_can_be_told(tmp_path: Path) -> None:
    drive = folder(tmp_path, settings="[depth]\nscale_m = 0.01\nbaseline_m = 0.095\n")
    recording = open_recording(drive)
    assert recording.rig.sensor == DepthCamera(64, 48, 100.0, 120.0, 31.5, 23.5, 0.095)
    frame = next(recording.frames())
    assert isinstance(frame, DepthFrame)
    assert frame.source.read()[0, 0] == pytest.approx(50.0)


def test_depths_of_the_left_camera_of_a_pair(tmp_path: Path) -> None:
    drive = folder(tmp_path, calibration={"stereo_opencv.yaml": opencv_yaml(OPENCV)})
    recording = open_recording(drive)
    rig = recording.rig
    assert rig.sensor == DepthCamera(64, 48, 100.0, 100.0, 31.5, 23.5, 0.2)
    # The mounting is told from the middle of the baseline; the grid begins below the left lens,
    # which is 10 cm to the left of it, turned by a yaw of -2° and a roll of 1°.
    left = rig.mount.rotation() @ np.array([-0.1, 0.0, 0.0])
    assert rig.antenna.right_m == pytest.approx(-0.125 - left[0])
    assert rig.antenna.forward_m == pytest.approx(-0.5 - left[1])
    assert rig.antenna.up_m == 2.75
    assert rig.rear_axle_forward_m == pytest.approx(-1.5 - left[1])
    assert rig.mount.height_m == pytest.approx(2.5 + left[2])
    assert any("left camera of the calibrated pair" in note for note in recording.notes)


def test_disparities_are_depths_by_the_pair_s_calibration(tmp_path: Path) -> None:
    drive = folder(tmp_path, ("disparity",), {"stereo_opencv.yaml": opencv_yaml(OPENCV)})
    frame = next(open_recording(drive).frames())
    assert isinstance(frame, DepthFrame)
    assert frame.source.read()[0, 0] == pytest.approx(100.0 * 0.2 / (5000 / 256.0))


def test_disparities_with_a_baseline_that_is_told(tmp_path: Path) -> None:
    settings = "[disparity]\nscale_px = 0.0625\nbaseline_m = 0.1\n"
    frame = next(open_recording(folder(tmp_path, ("disparity",), settings=settings)).frames())
    assert isinstance(frame, DepthFrame)
    assert frame.source.read()[0, 0] == pytest.approx(100.0 * 0.1 / (5000 / 16.0))


def test_disparities_need_a_baseline(tmp_path: Path) -> None:
    fails(folder(tmp_path, ("disparity",)), "nothing says the baseline", CalibrationError)


def test_depths_need_a_calibration(tmp_path: Path) -> None:
    drive = folder(tmp_path)
    (drive / "calibration" / "depth_camera_info.yaml").unlink()
    fails(drive, "put the calibration", CalibrationError)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (info(k=0, p=100), "was never calibrated"),
        (info(k=100, p=1), "depth_camera_info.yaml: A focal length of 1"),
        ("image_width: 64\n", "image_height is None"),
        ("]", "is not YAML"),
    ],
)
def test_a_camera_info_that_cannot_be(text: str, match: str, tmp_path: Path) -> None:
    fails(folder(tmp_path, calibration={"depth_camera_info.yaml": text}), match, CalibrationError)


# --- clouds


def test_clouds(tmp_path: Path) -> None:
    with open_recording(folder(tmp_path, ("clouds",))) as recording:
        sensor = recording.rig.sensor
        assert isinstance(sensor, Lidar)
        assert sensor.points_per_sr == pytest.approx(np.radians(1.0) ** -2, rel=0.2)
        assert any("points in a steradian" in note for note in recording.notes)
        frames = list(recording.frames())
        assert len(frames) == 3
        assert isinstance(frames[0], CloudFrame)
        points = frames[0].source.read()
        assert (points[:, 1] > 0.0).all()  # the ground is below
        assert (points[:, 2] > 0.0).mean() > 0.99  # and ahead
        (stream, *_) = recording.streams()
        assert (stream.name, stream.kind, stream.role, stream.count) == ("cloud",) * 3 + (3,)


def test_what_is_told_of_clouds(tmp_path: Path) -> None:
    settings = '[cloud]\naxes = "rdf"\nscale_m = 0.5\npoints_per_sr = 12345\n'
    recording = open_recording(folder(tmp_path, ("clouds",), settings=settings))
    assert recording.rig.sensor == Lidar(12345.0)
    frame = next(recording.frames())
    assert isinstance(frame, CloudFrame)
    assert np.array_equal(frame.source.read(), 0.5 * cloud().astype(np.float32))
    assert not any("steradian" in note for note in recording.notes)


def test_clouds_of_few_points_say_nothing_of_the_lidar(tmp_path: Path) -> None:
    drive = folder(tmp_path, ("clouds",))
    np.save(drive / "clouds" / f"{START_S + 1}000000000.npy", np.ones((50, 3)))
    with open_recording(drive) as recording:  # by another cloud, then
        sensor = recording.rig.sensor
        assert isinstance(sensor, Lidar)
        assert sensor.points_per_sr == pytest.approx(np.radians(1.0) ** -2, rel=0.2)
        assert any(f"by clouds/{START_S}000000000.npy" in note for note in recording.notes)
    for k in (0, 2):
        np.save(drive / "clouds" / f"{START_S + k}000000000.npy", np.zeros((0, 3)))
    fails(drive, r"1308133816000000000\.npy: A cloud of 50 points", CalibrationError)


def test_a_cloud_whose_name_is_no_time(tmp_path: Path) -> None:
    drive = folder(tmp_path, ("clouds",))
    np.save(drive / "clouds" / "first.npy", cloud())
    fails(drive, r"first\.npy is no UTC time in s, ms, us or ns; rename")


# --- tables and several kinds


def test_a_table_names_the_files(tmp_path: Path) -> None:
    table = "frame_id,timestamp_utc_s,depth\n" + "".join(
        f"f{k},{START_S}.{k},depth/{START_S + k}000000000.png\n" for k in (2, 0, 1)
    )
    frames = list(open_recording(folder(tmp_path, table=table)).frames())
    assert [frame.frame_id for frame in frames] == ["f0", "f1", "f2"]
    assert [frame.time_ns % 10**9 for frame in frames] == [0, 10**8, 2 * 10**8]


@pytest.mark.parametrize(
    ("row", "match"),
    [
        ("f0,1308133815,../a.png", "leads out of the recording"),
        ("f0,1308133815,depth/none.png", "1 of 1 images are missing"),
        ("f0,1308133815,", "depth is empty"),
        ("", "june-03 has no depth image; a recording needs at least one"),
    ],
)
def test_a_table_that_is_wrong(row: str, match: str, tmp_path: Path) -> None:
    fails(folder(tmp_path, table=f"frame_id,timestamp_utc_s,depth\n{row}\n"), match)


def test_missing_clouds_are_called_so(tmp_path: Path) -> None:
    table = "frame_id,timestamp_utc_s,cloud\nf0,1308133815,clouds/none.ply\n"
    fails(folder(tmp_path, ("clouds",), table=table), "1 of 1 clouds are missing")


EVERYTHING = {"stereo_opencv.yaml": opencv_yaml(OPENCV), "depth_camera_info.yaml": info()}


def test_of_several_kinds_pairs_are_taken_and_the_others_named(tmp_path: Path) -> None:
    drive = folder(tmp_path, ("left", "right", "depth", "clouds"), EVERYTHING)
    recording = open_recording(drive)
    assert isinstance(next(recording.frames()), StereoFrame)
    (note,) = (note for note in recording.notes if "are there, too" in note)
    assert "depth and cloud are there, too" in note
    assert 'sensor = "depth"' in note


@pytest.mark.parametrize(
    ("sensor", "kind"), [("stereo", StereoFrame), ("depth", DepthFrame), ("cloud", CloudFrame)]
)
def test_the_settings_choose_the_sensor(sensor: str, kind: type, tmp_path: Path) -> None:
    kinds = ("left", "right", "depth", "clouds")
    drive = folder(tmp_path, kinds, EVERYTHING, f'sensor = "{sensor}"\n')
    recording = open_recording(drive)
    assert isinstance(next(recording.frames()), kind)
    assert not any("are there, too" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ('sensor = "radar"', "sensor is 'radar'; give one of stereo, depth, disparity, cloud"),
        ("[depth]\nscale_px = 2", "'scale_px' is not a setting; known are scale_m, baseline_m"),
        ("[depth]\nscale_m = -1", "scale_m is -1; give a number above 0"),
        ("[depth]\nscale_m = 0", "scale_m is 0; give a number above 0"),
        ("[depth]\nscale_m = 'x'", "scale_m is 'x', which is no number; give"),
        ("[depth]\nscale_m = 1\n[disparity]\nscale_px = 1", "both .depth. and .disparity."),
        (
            "[cloud]\naxes = 'fru'",
            "axes is 'fru', which .*; give where x, y and z of the",
        ),
        ("[cloud]\npoints_per_sr = nan", "points_per_sr is NaN, which is no number"),
        ("depth = 3", "give a table .depth."),
    ],
)
def test_settings_that_cannot_be(settings: str, match: str, tmp_path: Path) -> None:
    fails(folder(tmp_path, settings=settings), match)


def test_a_raw_pair_does_not_calibrate_depths(tmp_path: Path) -> None:
    raw = {"stereo_left_camera_info.yaml": ros_yaml([100, 0, 31.5, 0, 0, 100, 23.5, 0, 0, 0, 1, 0]),
           "stereo_right_camera_info.yaml":
               ros_yaml([100, 0, 31.5, -20, 0, 100, 23.5, 0, 0, 0, 1, 0])}  # fmt: skip
    drive = folder(tmp_path, calibration=raw, settings="[images]\nrectified = false\n")
    fails(drive, "of raw images|rectification_matrix", CalibrationError)
