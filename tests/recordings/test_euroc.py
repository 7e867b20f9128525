"""EuRoC folders: the same drive as a plain folder, and what can be wrong with one."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import yaml

from fieldgrid.core import RecordingError
from fieldgrid.geometry import Mount
from fieldgrid.recordings import Recording, open_recording
from fieldgrid.recordings.format import find_format
from tests.conftest import TWO_LANES
from tests.recordings.test_folder import change

Float64 = npt.NDArray[np.float64]
MakeDrive = Callable[..., Path]

FLU_FROM_RFU = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
FORWARD_LEFT_UP = np.eye(3)
AS_EUROC = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""An IMU whose x is up, y right and z forward: its axes in the vehicle's FLU, as columns."""
INTRINSICS = [905.4, 905.4, 316.2, 243.9]


def rigid(R: Float64, place: list[float]) -> list[float]:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, place
    return [float(v) for v in T.ravel()]


def sensor_yaml(T: list[float], **more: Any) -> str:
    # As EuRoC's own files: OpenCV's header before plain YAML.
    return "%YAML:1.0\n" + yaml.safe_dump({"T_BS": {"cols": 4, "rows": 4, "data": T}, **more})


def camera_yaml(T: list[float], **changes: Any) -> str:
    return sensor_yaml(
        T,
        **{
            "sensor_type": "camera",
            "rate_hz": 20,
            "resolution": [640, 480],
            "camera_model": "pinhole",
            "intrinsics": INTRINSICS,
            "distortion_model": "radial-tangential",
            "distortion_coefficients": [0.0, 0.0, 0.0, 0.0],
            **changes,
        },
    )


def table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def write_euroc(drive: Path, out: Path, R_flu_imu: Float64 = FORWARD_LEFT_UP) -> Path:
    """A plain folder with rectified images in EuRoC's layout; the body is an IMU turned so."""
    R_flu_camera = FLU_FROM_RFU @ Mount(2.65, 16.0).rotation()
    mav = out / "mav0"
    rows = table(drive / "frames.csv")
    for camera, side, left_m in (("cam0", "left", 0.09), ("cam1", "right", -0.09)):
        (mav / camera / "data").mkdir(parents=True)
        R = R_flu_imu.T @ R_flu_camera
        place = [float(v) for v in R_flu_imu.T @ [0.0, left_m, 0.0]]
        (mav / camera / "sensor.yaml").write_text(camera_yaml(rigid(R, place)))
        lines = ["#timestamp [ns],filename"]
        for row in rows:
            whole, fraction = row["timestamp_utc_s"].split(".")
            name = Path(row[side]).name
            lines.append(f"{whole}{fraction.ljust(9, '0')},{name}")
            shutil.copyfile(drive / row[side], mav / camera / "data" / name)
        (mav / camera / "data.csv").write_text("\r\n".join(lines) + "\r\n")
    (mav / "imu0").mkdir()
    (mav / "imu0" / "sensor.yaml").write_text(sensor_yaml(rigid(np.eye(3), [0.0, 0.0, 0.0])))
    turned = [
        f"{axis}_RS_S_{k} [{unit}]"
        for axis, unit in (("w", "rad s^-1"), ("a", "m s^-2"))
        for k in "xyz"
    ]
    lines = [",".join(["#timestamp [ns]", *turned])]
    for row in table(drive / "imu" / "imu_100hz.csv"):
        gyro = R_flu_imu.T @ [float(row[f"gyro_{k}_rad_s"]) for k in "xyz"]
        whole, fraction = row["timestamp_utc_s"].split(".")
        force = R_flu_imu.T @ [float(row[f"acc_{k}_m_s2"]) for k in "xyz"]
        values = [repr(float(v)) for v in (*gyro, *force)]
        lines.append(",".join([whole + fraction.ljust(9, "0"), *values]))
    (mav / "imu0" / "data.csv").write_text("\n".join(lines) + "\n")
    shutil.copyfile(drive / "calibration" / "mounting.json", out / "mounting.json")
    shutil.copytree(drive / "gnss", out / "gnss")
    origin = json.loads((drive / "session.json").read_text())["ltp_origin"]
    (out / "recording.toml").write_text(
        f"name = '{drive.name}'\n[datum]\nlat_deg = {origin['lat_deg']}\n"
        f"lon_deg = {origin['lon_deg']}\nheight_m = {origin['ellipsoid_height_m']}\n"
    )
    return out


@pytest.fixture
def drive(make_drive: MakeDrive) -> Path:
    """Three frames of the example with its gyro. The baseline is that of T, as in EuRoC's files:
    by P2 it is another number, if only in the last bit."""
    folder = make_drive()
    for path in (folder / "calibration").glob("*.yaml"):
        text = path.read_text()
        path.unlink()
        if path.name == "stereo_opencv.yaml":
            path.write_text(re.sub(r"^[PQ]\d?:.*\n(?: .*\n)*", "", text, flags=re.MULTILINE))
    (folder / "imu").mkdir()
    lines = (TWO_LANES / "imu" / "imu_100hz.csv").read_text().splitlines(keepends=True)
    (folder / "imu" / "imu_100hz.csv").write_text("".join(lines[:2500]))
    return folder


@pytest.fixture
def euroc(drive: Path, tmp_path: Path) -> Path:
    return write_euroc(drive, tmp_path / "euroc")


def gyro_of(recording: Recording) -> tuple[list[int], Float64]:
    gyro = recording.motion().gyro
    assert gyro is not None
    return gyro.time_ns.tolist(), gyro.rate_rad_s


def turned(degrees: float) -> Float64:
    """An IMU that stands askew: the rate about the vertical comes from two of its axes."""
    return np.asarray(cv2.Rodrigues(np.array([np.radians(degrees), 0.0, 0.0]))[0])


@pytest.mark.parametrize(
    ("R_flu_imu", "most_rad_s"), [(FORWARD_LEFT_UP, 0.0), (AS_EUROC, 0.0), (turned(30.0), 1e-8)]
)
def test_the_same_drive_gives_the_same_bits(
    R_flu_imu: Float64, most_rad_s: float, drive: Path, tmp_path: Path
) -> None:
    euroc = write_euroc(drive, tmp_path / "euroc", R_flu_imu)
    with open_recording(euroc) as ours, open_recording(drive) as wanted:
        assert ours.name == wanted.name
        assert ours.rig == wanted.rig
        assert ours.datum_hint == wanted.datum_hint
        assert ours.gnss_source == wanted.gnss_source
        assert ours.notes == ()
        assert list(ours.fixes()) == list(wanted.fixes())
        assert ours.frame_times_ns().tolist() == wanted.frame_times_ns().tolist()
        assert gyro_of(ours)[0] == gyro_of(wanted)[0]
        assert np.abs(gyro_of(ours)[1] - gyro_of(wanted)[1]).max() <= most_rad_s
        for one, other in zip(ours.frames(), wanted.frames(), strict=True):
            assert one.rectifier is None
            for image, same in zip(one.images(), other.images(), strict=True):
                assert (image == same).all()


def test_the_folder_its_mav0_or_the_sensors_alone_may_be_given(euroc: Path, tmp_path: Path) -> None:
    assert open_recording(euroc / "mav0").gnss_source == "gnss/gnss_rtk.nmea"
    assert find_format(euroc / "mav0" / "cam0") is None
    shutil.move(euroc / "mav0", tmp_path / "flat")
    for name in ("mounting.json", "gnss", "recording.toml"):
        shutil.move(euroc / name, tmp_path / "flat" / name)
    recording = open_recording(tmp_path / "flat")
    assert (recording.name, recording.frame_count) == ("drive", 3)
    assert len(recording.fixes()) > 0
    assert next(iter(recording.frames())).sources[0].sha256()


TABLE = "time_ns,lat_deg,lon_deg,height_m\n1308133815000000000,41.65,-4.72,787.4\n"


@pytest.mark.parametrize("place", ["mav0/gnss/log.csv", "mav0/gps0/data.csv", "gnss/log.csv"])
def test_places_of_a_gnss_log(place: str, euroc: Path, tmp_path: Path) -> None:
    shutil.rmtree(euroc / "gnss")
    assert open_recording(euroc).notes == ("No GNSS log in gnss/.",)
    for path in (euroc / place, tmp_path / "own.csv"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(TABLE)
    for gnss, source in ((None, place), (tmp_path / "own.csv", "own.csv")):
        recording = open_recording(euroc, gnss)
        assert recording.gnss_source == source
        assert recording.fixes().lat_deg.tolist() == [41.65]


def test_raw_images_are_rectified(euroc: Path) -> None:
    for camera in ("cam0", "cam1"):
        path = euroc / "mav0" / camera / "sensor.yaml"
        document = yaml.safe_load(path.read_text().partition("\n")[2])
        changes = {"distortion_coefficients": [-0.28, 0.07, 0.0002, 1.8e-5]}
        path.write_text(camera_yaml(document["T_BS"]["data"], **changes))
    frame = next(iter(open_recording(euroc).frames()))
    assert frame.rectifier is not None
    raw = frame.left.read(), frame.right.read()
    images = frame.images()
    assert all((image != one).mean() > 0.5 for image, one in zip(images, raw, strict=True))
    assert all(image.shape == (480, 640) for image in images)


def test_an_imu_is_not_needed_nor_is_all_of_it(euroc: Path) -> None:
    before, imu = gyro_of(open_recording(euroc))[1], euroc / "mav0" / "imu0"
    (imu / "sensor.yaml").unlink()  # then it is the body
    assert (gyro_of(open_recording(euroc))[1] == before).all()
    text = (imu / "data.csv").read_text()
    lines = text.splitlines()
    broken = "\n".join([*lines[:10], lines[9], lines[11].replace(",", ",nan,", 1)])
    for content, rows, notes in (
        (broken, 9, ("data.csv: 2 rows without a time or value, or repeated, skipped.",)),
        (text.replace("w_R", "r_"), 0, ("data.csv: no column gyro_z_rad_s; it is not used.",)),
        (None, 0, ()),
    ):
        change(imu / "data.csv", None, content)
        recording = open_recording(euroc)
        gyro = recording.motion().gyro
        assert (0 if gyro is None else len(gyro.time_ns)) == rows
        assert recording.notes == notes


def test_images_of_one_camera_alone_are_skipped(euroc: Path) -> None:
    path = euroc / "mav0" / "cam1" / "data.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]))
    recording = open_recording(euroc)
    assert recording.frame_count == 2
    assert recording.notes == ("1 image without a partner of the same time skipped.",)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("cam0/sensor.yaml", "pinhole", "omni", "camera_model of cam0 is 'omni'"),
        ("cam1/sensor.yaml", "radial-tangential", "atan", "cam1: the distortion model 'atan' is"),
        ("cam0/sensor.yaml", "distortion_coefficients", "D", "lacks distortion_coefficients"),
        ("cam0/sensor.yaml", "resolution", "size", "the size of its images is .None, None.; give"),
        ("cam0/sensor.yaml", "- 640", "- 320", "both must be of one size"),
        ("cam0/sensor.yaml", "T_BS", "T", "lacks T_BS as 4 x 4 numbers"),
        ("cam0/sensor.yaml", "0.09", "-0.19", "swap left and right"),
        ("cam0/sensor.yaml", "0.09", ".nan", "lacks T_BS as 4 x 4 numbers"),
        ("imu0/sensor.yaml", "- 1.0", "- 3.0", "T_BS is no rigid transformation"),
        ("cam0/sensor.yaml", "%YAML:1.0", "[", "is not YAML"),
        ("cam0/data.csv", "13081338", "x", "line 2: time_ns 'x"),
        ("cam0/data.csv", "000003.jpg", "../000003.jpg", "leads out of the recording"),
        ("cam0/data.csv", ",000003.jpg", "", "line 2: file is empty"),
        ("cam0/data.csv", "000003.jpg", "none.jpg", "1 of 6 images are missing"),
        ("cam0/data.csv", "13081338", "13081339", "no image of cam0 has the time of one of cam1"),
        (
            "cam0/data.csv",
            "filename",
            "filename\n1308133820000000000,a\n1308133820000000000,b",
            r"\(a\) and .* \(b\) .* have the same time",
        ),
        ("imu0/data.csv", "0.00", "x.00", r"imu0/data\.csv, line \d+: w_RS_S_. .* is not a number"),
    ],
)
def test_a_folder_that_is_broken(file: str, old: str, new: str, message: str, euroc: Path) -> None:
    change(euroc / "mav0" / file, old, new)
    with pytest.raises(RecordingError, match=message):
        open_recording(euroc)
