"""Gyro and wheels of a recording."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from fieldgrid.errors import RecordingError
from fieldgrid.recording.motion_files import MotionFiles, check_axes, read_motion

START_S = 1_717_243_200


def write(folder: Path, kind: str, header: str, rows: list[str], name: str = "a.csv") -> None:
    (folder / kind).mkdir(exist_ok=True)
    (folder / kind / name).write_text("\n".join([header, *rows]))


def rates(read: MotionFiles) -> list[float]:
    assert read.motion.gyro is not None
    return [round(float(rate), 9) for rate in read.motion.gyro.rate_rad_s]


def test_nothing_is_no_motion(tmp_path: Path) -> None:
    assert read_motion(tmp_path) == MotionFiles()


@pytest.mark.parametrize(
    ("axes", "rate"), [("flu", -0.3), ("frd", 0.3), ("rfu", -0.3), ("ufl", -0.1), ("rub", -0.2)]
)
def test_the_rate_is_clockwise_whatever_the_mounting(
    axes: str, rate: float, tmp_path: Path
) -> None:
    header = "timestamp_utc_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s"
    write(tmp_path, "imu", header, [f"{START_S}.01,0.1,0.2,0.3"])
    read = read_motion(tmp_path, check_axes(axes))
    assert (rates(read), read.notes) == ([rate], ())


@pytest.mark.parametrize("axes", ["", "flx", "fru", "ffu", "flud", "FLU"])
def test_axes_that_cannot_be(axes: str) -> None:
    with pytest.raises(ValueError, match="is not where the three axes of an IMU point"):
        check_axes(axes)


@pytest.mark.parametrize(
    ("column", "factor"),
    [("wz", 1.0), ("angular_velocity.z", 1.0), ("gyro_z_dps", math.radians(1)),
     ("w_RS_S_z [rad s^-1]", 1.0), ("GyroZ", 1.0)],
)  # fmt: skip
def test_other_names_of_a_gyro_are_said(column: str, factor: float, tmp_path: Path) -> None:
    write(tmp_path, "imu", f"#timestamp [ns],{column}", [f"{START_S}000000000,2"])
    read = read_motion(tmp_path)
    assert rates(read) == [round(-2 * factor, 9)]
    assert f"gyro from '{column}'" in " ".join(read.notes)


def test_rows_are_put_in_order_and_what_is_no_row_is_counted(tmp_path: Path) -> None:
    rows = [f"{START_S + s},{v}" for s, v in ((2, 0.2), (1, 0.1), (1, 0.7), (3, ""), (4, "nan"))]
    write(tmp_path, "imu", "timestamp_utc_s,gyro_z_rad_s", [*rows, ",0.5"])
    read = read_motion(tmp_path)
    assert rates(read) == [-0.1, -0.2]
    assert read.notes == ("a.csv: 4 rows without a time or value, or repeated, skipped.",)


def test_files_of_one_sensor_follow_each_other(tmp_path: Path) -> None:
    header = "timestamp_utc_s,gyro_z_rad_s"
    write(tmp_path, "imu", header, [f"{START_S + 5},0.5", f"{START_S + 6},0.6"], "a.csv")
    write(tmp_path, "imu", header, [f"{START_S},0.1"], "b.csv")
    write(tmp_path, "imu", "timestamp_utc_s,acc_z_m_s2", [f"{START_S},9.8"], "c.csv")
    read = read_motion(tmp_path)
    assert rates(read) == [-0.1, -0.5, -0.6]
    assert read.notes == ("c.csv: no column gyro_z_rad_s; it is not used.",)
    write(tmp_path, "imu", header, [f"{START_S + 5}.5,0.1"], "b.csv")
    with pytest.raises(RecordingError, match=r"a\.csv and .*b\.csv overlap in time"):
        read_motion(tmp_path)


@pytest.mark.parametrize(
    ("column", "speed", "notes"),
    [
        ("speed_mps", -1.8, 0),
        ("speed_kmh", -0.5, 1),
        ("twist.linear.x", -1.8, 1),
    ],
)
def test_wheels_keep_their_sign(column: str, speed: float, notes: int, tmp_path: Path) -> None:
    write(tmp_path, "odometry", f"time_ns,{column}", [f"{START_S}000000000,-1.8"])
    read = read_motion(tmp_path)
    assert read.motion.wheels is not None
    assert read.motion.wheels.speed_mps.tolist() == [pytest.approx(speed)]
    assert len(read.notes) == notes


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    write(tmp_path, "imu", "timestamp_utc_s,gyro_z_rad_s", [f"{START_S},fast"])
    with pytest.raises(RecordingError, match=r"a\.csv, line 2: gyro_z_rad_s 'fast' is not a num"):
        read_motion(tmp_path)
