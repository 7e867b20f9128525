"""EuRoC folders: the same drive as a plain folder, and what can be wrong with one."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import yaml

from fieldgrid.core import BuildSettings, FieldgridError
from fieldgrid.geometry import Mount
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import Recording, open_recording
from fieldgrid.recordings.format import find_format
from tests.conftest import TWO_LANES

pytestmark = pytest.mark.usefixtures("worked_out_once")

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


def content(path: Path) -> tuple[list[Any], Any]:
    """Everything of a map that comes from images, fixes and motion."""
    with open_map(path) as universal:
        (session,) = universal.sessions()
        frames = [
            (frame.pose, frame.grid().density.tobytes(), frame.quality)
            for frame in universal.frames(with_grid=True)
        ]
        inputs = {k: v.tobytes() for k, v in universal.session_inputs(session.name).items()}
        return frames, inputs


@pytest.mark.parametrize(
    "R_flu_imu", [pytest.param(FORWARD_LEFT_UP, marks=pytest.mark.long), AS_EUROC]
)
def test_the_same_drive_gives_the_same_bits(
    R_flu_imu: Float64, drive: Path, tmp_path: Path
) -> None:
    euroc = write_euroc(drive, tmp_path / "euroc", R_flu_imu)
    with open_recording(euroc) as ours, open_recording(drive) as wanted:
        assert ours.name == wanted.name
        assert ours.rig == wanted.rig
        assert ours.datum_hint == wanted.datum_hint
        assert ours.gnss_source == wanted.gnss_source
        assert list(ours.fixes()) == list(wanted.fixes())
        assert ours.frame_times_ns().tolist() == wanted.frame_times_ns().tolist()
        assert gyro_of(ours)[0] == gyro_of(wanted)[0]
        assert gyro_of(ours)[1].tobytes() == gyro_of(wanted)[1].tobytes()
        for one, other in zip(ours.frames(), wanted.frames(), strict=True):
            assert one.rectifier is None
            for image, same in zip(one.images(), other.images(), strict=True):
                assert (image == same).all()
    for folder in (euroc, drive):
        build_map([folder], tmp_path / f"{folder.name}.gpkg", BuildSettings())
    ours_built, wanted_built = (content(tmp_path / f"{f.name}.gpkg") for f in (euroc, drive))
    assert len(ours_built[0]) == 3
    assert ours_built == wanted_built


def test_the_folder_or_its_mav0_may_be_given(euroc: Path) -> None:
    for path in (euroc, euroc / "mav0"):
        assert find_format(path)
        recording = open_recording(path)
        assert recording.name == "drive"
        assert recording.frame_count == 3
        assert recording.gnss_source == "gnss/gnss_rtk.nmea"
        assert recording.notes == ()
    assert find_format(euroc / "mav0" / "cam0") is None


def test_sensors_without_a_mav0_above_them(euroc: Path, tmp_path: Path) -> None:
    shutil.move(euroc / "mav0", tmp_path / "flat")
    for name in ("mounting.json", "gnss", "recording.toml"):
        shutil.move(euroc / name, tmp_path / "flat" / name)
    recording = open_recording(tmp_path / "flat")
    assert recording.frame_count == 3
    assert len(recording.fixes()) > 0
    assert next(iter(recording.frames())).sources[0].sha256()


TABLE = "time_ns,lat_deg,lon_deg,height_m\n1308133815000000000,41.65,-4.72,787.4\n"


@pytest.mark.parametrize("place", ["mav0/gnss/log.csv", "mav0/gps0/data.csv", "gnss/log.csv"])
def test_places_of_a_gnss_log(place: str, euroc: Path) -> None:
    shutil.rmtree(euroc / "gnss")
    (euroc / place).parent.mkdir(parents=True)
    (euroc / place).write_text(TABLE)
    recording = open_recording(euroc)
    assert recording.gnss_source == place
    (fix,) = recording.fixes()
    assert fix.lat_deg == 41.65


def test_another_log_or_none(euroc: Path, tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text(TABLE)
    assert len(open_recording(euroc, tmp_path / "own.csv").fixes()) == 1
    shutil.rmtree(euroc / "gnss")
    recording = open_recording(euroc)
    assert recording.gnss_source == ""
    assert "No GNSS log in gnss/." in recording.notes


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


def test_a_gyro_that_stands_askew(drive: Path, tmp_path: Path) -> None:
    """The rate about the vertical comes from all three axes."""
    angle = np.radians(30.0)
    R = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    euroc = write_euroc(drive, tmp_path / "euroc", R)
    ours, wanted = (gyro_of(open_recording(f))[1] for f in (euroc, drive))
    assert np.abs(ours - wanted).max() < 1e-8


def test_without_a_sensor_file_the_imu_is_the_body(euroc: Path) -> None:
    before = gyro_of(open_recording(euroc))[1]
    (euroc / "mav0" / "imu0" / "sensor.yaml").unlink()
    assert (gyro_of(open_recording(euroc))[1] == before).all()


def test_an_imu_is_not_needed(euroc: Path) -> None:
    shutil.rmtree(euroc / "mav0" / "imu0")
    recording = open_recording(euroc)
    assert recording.motion().gyro is None
    assert recording.notes == ()


def test_an_imu_without_a_gyro_and_broken_rows_are_noted(euroc: Path) -> None:
    path = euroc / "mav0" / "imu0" / "data.csv"
    text = path.read_text()
    path.write_text(text.replace("w_RS_S_", "rotation_"))
    recording = open_recording(euroc)
    assert recording.motion().gyro is None
    assert recording.notes == ("data.csv: no column gyro_z_rad_s; it is not used.",)
    lines = text.splitlines()
    path.write_text("\n".join([*lines[:10], lines[9], lines[11].replace(",", ",nan,", 1)]))
    recording = open_recording(euroc)
    assert len(gyro_of(recording)[0]) == 9
    assert recording.notes == ("data.csv: 2 rows without a time or value, or repeated, skipped.",)


def test_images_of_one_camera_alone_are_skipped(euroc: Path) -> None:
    path = euroc / "mav0" / "cam1" / "data.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:-1]))
    recording = open_recording(euroc)
    assert recording.frame_count == 2
    assert recording.notes == ("1 image without a partner of the same time skipped.",)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


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
        ("cam1/sensor.yaml", "data:", "data: [1,2]\n  x:", "lacks T_BS as 4 x 4 numbers"),
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
    edit(euroc / "mav0" / file, old, new)
    with pytest.raises(FieldgridError, match=message) as caught:
        open_recording(euroc)
    assert caught.value.__class__.__name__ in ("RecordingError", "CalibrationError")
