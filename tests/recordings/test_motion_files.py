"""Gyro and wheels of a recording."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import RecordingError
from fieldgrid.recordings import MotionFiles, MotionSeries, check_axes, inertial_of
from fieldgrid.recordings.tables.motion_files import read_motion

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
     ("angular_velocity_z [deg/s]", math.radians(1)),
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


SENSED = "timestamp_utc_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2"


@pytest.mark.parametrize(
    ("axes", "sample"),
    [
        ("flu", "0.1,0.2,0.3,0.5,-0.7,9.8"),
        ("frd", "0.1,-0.2,-0.3,0.5,0.7,-9.8"),
        ("rfu", "-0.2,0.1,0.3,0.7,0.5,9.8"),
    ],
)
def test_all_axes_of_an_imu_are_those_of_the_vehicle(
    axes: str, sample: str, tmp_path: Path
) -> None:
    write(tmp_path, "imu", SENSED, [f"{START_S}.5,{sample}", f"{START_S}.6,{sample}"])
    read = read_motion(tmp_path, axes)
    assert read.notes == ()
    sensed = read.motion.inertial
    assert sensed is not None
    np.testing.assert_allclose(sensed.rate_rad_s, [[-0.2, 0.1, 0.3]] * 2, rtol=1e-6)
    np.testing.assert_allclose(sensed.force_mps2, [[0.7, 0.5, 9.8]] * 2, rtol=1e-6)
    assert read.motion.gyro is not None
    np.testing.assert_allclose(read.motion.gyro.rate_rad_s, -0.3)


def test_an_accelerometer_in_g_is_known_by_its_size(tmp_path: Path) -> None:
    write(tmp_path, "imu", SENSED, [f"{START_S}.{k},0,0,0,0.1,0,0.99" for k in range(5)])
    read = read_motion(tmp_path)
    assert read.motion.inertial is not None
    np.testing.assert_allclose(read.motion.inertial.force_mps2[0], [0, 0.980665, 9.7085835])
    assert read.notes == ("The accelerometer is taken to be in g.",)


@pytest.mark.parametrize("sample", ["0,0,-9.8", "9.8,0,0", "0,0,5.0", "0,0,981"])
def test_an_accelerometer_that_does_not_see_gravity_upward_is_not_used(
    sample: str, tmp_path: Path
) -> None:
    write(tmp_path, "imu", SENSED, [f"{START_S}.{k},0,0,0.1,{sample}" for k in range(5)])
    read = read_motion(tmp_path)
    sensed = read.motion.inertial
    assert sensed is not None
    assert np.isnan(sensed.force_mps2).all()
    assert np.isfinite(sensed.rate_rad_s).all()
    assert "correct imu_axes in mounting.json" in read.notes[0]


def test_samples_without_their_force_are_left_out_of_the_imu_alone(tmp_path: Path) -> None:
    rows = [f"{START_S}.{k},0,0,0.1,0,0,{'' if k == 3 else 9.8}" for k in range(9)]
    write(tmp_path, "imu", SENSED, rows)
    read = read_motion(tmp_path)
    motion = read.motion
    assert motion.gyro is not None
    assert motion.inertial is not None
    assert (len(motion.gyro.time_ns), len(motion.inertial.time_ns)) == (9, 8)
    assert read.notes == (
        "The accelerometer says nothing in 1 of 9 samples; those are left out of the IMU.",
    )
    assert np.isfinite(motion.inertial.force_mps2).all()
    write(tmp_path, "imu", SENSED, [f"{START_S}.{k},0,0,0.1,,," for k in range(9)])
    motion = read_motion(tmp_path).motion
    assert motion.inertial is not None
    assert len(motion.inertial.time_ns) == 9
    assert np.isnan(motion.inertial.force_mps2).all()


def test_an_accelerometer_of_few_samples_is_dropped_with_a_note(tmp_path: Path) -> None:
    rows = [f"{START_S}.{k},0,0,0.1,0,0,{9.8 if k < 3 else ''}" for k in range(9)]
    write(tmp_path, "imu", SENSED, rows)
    read = read_motion(tmp_path)
    assert read.motion.inertial is not None
    assert np.isnan(read.motion.inertial.force_mps2).all()
    assert len(read.motion.inertial.time_ns) == 9
    assert read.notes == ("The accelerometer says nothing in 6 of 9 samples; it is not used.",)


def test_an_imu_without_samples_is_none() -> None:
    notes: list[str] = []
    assert inertial_of(MotionSeries(np.zeros(0, np.int64), np.zeros((0, 6))), notes) is None
    assert notes == []


def test_a_gyro_of_one_axis_is_no_inertial_unit(tmp_path: Path) -> None:
    write(tmp_path, "imu", "timestamp_utc_s,gyro_z_rad_s", [f"{START_S}.5,0.1"])
    motion = read_motion(tmp_path).motion
    assert motion.inertial is None
    assert motion.gyro is not None


def test_samples_that_no_sensor_gives_are_none() -> None:
    values = np.tile([0.0, 0.0, 0.1, 0.0, 0.0, 9.81], (5, 1))
    values[2, 4], values[3, 0] = 1e300, -1e39
    found = inertial_of(MotionSeries(np.arange(5, dtype=np.int64), values), [])
    assert found is not None
    assert found.time_ns.tolist() == [0, 1, 4]
    assert np.isfinite(found.force_mps2).all()
