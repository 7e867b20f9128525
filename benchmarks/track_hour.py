"""How long `fieldgrid track` takes for an hour's drive: `python -m benchmarks.track_hour`.

The drive is made up: rows with headland turns, every other one with reversing, as NMEA (GGA, RMC
and GST at 10 Hz) and a gyro at 100 Hz. What is timed is what the command calls, by stage. Then the
command itself over four hours without a gyro and GST, 144,000 fixes: its processor time and memory.
And the estimate of an hour whose gyro is upside down, where antenna and stamps are tried, too.
"""

from __future__ import annotations

import datetime
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from benchmarks.peak import used_by
from benchmarks.sentences import checksum
from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Datum, LeverArm
from fieldgrid.poses import estimate_poses, summarise_track, write_track
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.recordings import open_drive
from fieldgrid.recordings.tables.logs import read_fix_log
from fieldgrid.recordings.tables.motion_files import read_motion
from tests.scenes import paper_rig

_Float64 = npt.NDArray[np.float64]
_T = TypeVar("_T")

DATUM = Datum(41.65, -4.72, 787.4)
START_NS = 1_308_133_811_000_000_000
IMU_HZ, GNSS_HZ = 100, 10
SPEED_MPS, REVERSE_MPS, RADIUS_M, ROW_M, SPACING_M = 1.8, -0.9, 3.5, 120.0, 3.0
GYRO_BIAS, GYRO_NOISE, FIX_NOISE_M = 0.003, 0.004, 0.012
"""Rad/s, rad/s a sample, metres along each axis."""


class Leg(NamedTuple):
    """A stretch of constant speed and rate of turn, clockwise."""

    seconds: float
    speed_mps: float
    turn_rad_s: float


class Stage(NamedTuple):
    """One part of the work and how long it took."""

    name: str
    seconds: float


def measure_track(hours: float = 1.0, repeats: int = 3) -> tuple[Stage, ...]:
    """The stages of the command over a made-up drive, each the best of its repeats."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_drive(folder, hours)
        runs = [_stages(folder) for _ in range(repeats)]
    return tuple(min(stages, key=lambda stage: stage.seconds) for stages in zip(*runs, strict=True))


def measure_upside_down(hours: float = 1.0) -> float:
    """Seconds of the estimate where the gyro is upside down and the antenna's place declared, so
    that it is tried whether that excuses the gyro."""
    rig = paper_rig(antenna=LeverArm(0.0, 0.0, 0.0), rear_axle_forward_m=0.0)
    with tempfile.TemporaryDirectory() as place:
        write_drive(Path(place), hours)
        drive = open_drive(Path(place))
        fixes, motion = drive.fixes(), drive.motion()
        assert motion.gyro is not None
        wrong = motion.gyro._replace(rate_rad_s=-motion.gyro.rate_rad_s)
        return _timed(lambda: estimate_poses(fixes, rig, motion=motion._replace(gyro=wrong)))[1]


def measure_fixes(hours: float = 4.0) -> tuple[float, float]:
    """Processor time, seconds, and the most memory, MB, of `fieldgrid track` over fixes alone."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_drive(folder, hours)
        log = folder / "drive.nmea"
        lines = (folder / "gnss" / "rtk.nmea").read_bytes().splitlines(keepends=True)
        log.write_bytes(b"".join(line for line in lines if b"GST" not in line))
        out = ["-o", str(folder / "track.csv"), "--overwrite", "-q"]
        track = ["-m", "fieldgrid", "track", str(log), *out]
        used_by(track)  # the first compiles
        used = used_by(track)
        assert not used.said, used.said
        return used.cpu_s, used.peak_mb


def _stages(folder: Path) -> tuple[Stage, ...]:
    """The command's own calls are `read`, `estimate`, `write` and `sum up`; the others show
    what parts of them take, and are not added again."""
    log = folder / "gnss" / "rtk.nmea"
    _, parse_s = _timed(lambda: read_fix_log(log))
    _, imu_s = _timed(lambda: read_motion(folder))
    drive, read_s = _timed(lambda: open_drive(folder))
    _, condition_s = _timed(lambda: condition(drive.fixes(), PoseSettings().gnss))
    estimate, estimate_s = _timed(lambda: estimate_poses(drive.fixes(), motion=drive.motion()))
    _, write_s = _timed(lambda: write_track(estimate, folder / "track.csv"))
    _, sum_s = _timed(lambda: summarise_track(estimate))
    return (
        Stage("read", read_s),
        Stage("  of which NMEA", parse_s),
        Stage("  of which gyro", imu_s),
        Stage("estimate", estimate_s),
        Stage("  of which conditioning", condition_s),
        Stage("write", write_s),
        Stage("sum up", sum_s),
    )


def _timed(work: Callable[[], _T]) -> tuple[_T, float]:
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


def write_drive(folder: Path, hours: float) -> None:
    """`gnss/rtk.nmea` and `imu/imu.csv` of rows driven for some hours."""
    speed, turn = _motion(round(hours * 3600 * IMU_HZ))
    east, north, heading = _way(speed, turn)
    noise = np.random.default_rng(7)
    (folder / "imu").mkdir()
    gyro = -turn + GYRO_BIAS + noise.normal(0.0, GYRO_NOISE, len(turn))
    _write_imu(folder / "imu" / "imu.csv", gyro)
    every = IMU_HZ // GNSS_HZ
    fixes = np.stack([east[::every], north[::every]])
    fixes += noise.normal(0.0, FIX_NOISE_M, fixes.shape)
    (folder / "gnss").mkdir()
    course = np.degrees(heading[::every]) + np.where(speed[::every] < 0.0, 180.0, 0.0)
    _write_nmea(folder / "gnss" / "rtk.nmea", fixes, np.abs(speed[::every]), course % 360.0)


def _motion(samples: int) -> tuple[_Float64, _Float64]:
    """Signed speed and clockwise rate of turn of each sample; speed ramps, as masses do."""
    speed, turn = [], []
    total, row = 0, 0
    while total < samples:
        for leg in _row(row):
            count = round(leg.seconds * IMU_HZ)
            speed.append(np.full(count, leg.speed_mps))
            turn.append(np.full(count, leg.turn_rad_s))
            total += count
        row += 1
    ramp = np.ones(IMU_HZ) / IMU_HZ
    return tuple(  # type: ignore[return-value]
        np.convolve(np.concatenate(parts)[:samples], ramp, mode="same") for parts in (speed, turn)
    )


def _row(row: int) -> list[Leg]:
    """One row and the turn after it, to the right and to the left by turns."""
    side = 1.0 if row % 2 == 0 else -1.0
    rate = SPEED_MPS / RADIUS_M
    quarter = Leg(np.pi / 2.0 / rate, SPEED_MPS, side * rate)
    straight, rest = Leg(ROW_M / SPEED_MPS, SPEED_MPS, 0.0), Leg(2.0, 0.0, 0.0)
    if row % 4 < 2:
        return [straight, quarter, quarter]
    back = Leg((2.0 * RADIUS_M - SPACING_M) / -REVERSE_MPS, REVERSE_MPS, 0.0)
    return [straight, quarter, rest, back, rest, quarter]


def _way(speed: _Float64, turn: _Float64) -> tuple[_Float64, _Float64, _Float64]:
    heading = np.radians(37.0) + np.cumsum(turn) / IMU_HZ
    east = np.cumsum(speed * np.sin(heading)) / IMU_HZ
    north = np.cumsum(speed * np.cos(heading)) / IMU_HZ
    return east, north, heading


def _write_imu(path: Path, gyro_z: _Float64) -> None:
    first_s = START_NS // 1_000_000_000
    with path.open("w", encoding="ascii") as file:
        file.write("timestamp_utc_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s\n")
        file.writelines(
            f"{first_s + k // IMU_HZ}.{k % IMU_HZ:02}0,0.001,-0.002,{rate:.6f}\n"
            for k, rate in enumerate(gyro_z.tolist())
        )


def _write_nmea(path: Path, fixes: _Float64, speed_mps: _Float64, course_deg: _Float64) -> None:
    lat, lon, height = DATUM.to_geodetic(fixes[0], fixes[1], np.zeros(fixes.shape[1]))
    columns = (lat, lon, height, speed_mps, course_deg)
    start = datetime.datetime.fromtimestamp(START_NS // 10**9, datetime.UTC)
    with path.open("wb") as file:
        for k, row in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
            moment = start + datetime.timedelta(seconds=k / GNSS_HZ)
            file.write(_epoch(moment, *row))


def _epoch(
    at: datetime.datetime, lat: float, lon: float, height_m: float, mps: float, course_deg: float
) -> bytes:
    clock = f"{at:%H%M%S}.{at.microsecond // 10_000:02}"
    place = f"{_ddmm(lat, 2)},{'NS'[lat < 0]},{_ddmm(lon, 3)},{'EW'[lon < 0]}"
    bodies = (
        f"GNGGA,{clock},{place},4,14,0.7,{height_m - 52.4:.3f},M,52.4,M,1.0,0138",
        f"GNRMC,{clock},A,{place},{mps / 1852 * 3600:.3f},{course_deg:.2f},{at:%d%m%y},,,R",
        f"GNGST,{clock},0.4,0.3,0.2,7.6,0.012,0.012,0.030",
    )
    return b"".join(b"$%b*%02X\r\n" % (b, checksum(b)) for b in (s.encode() for s in bodies))


def _ddmm(angle_deg: float, digits: int) -> str:
    whole, part = divmod(abs(angle_deg), 1.0)
    return f"{int(whole):0{digits}}{part * 60.0:010.7f}"


def main() -> None:
    """Measure and print."""
    stages = measure_track()
    for name, seconds in stages:
        print(f"{name:26}{seconds:6.2f} s")
    total = sum(stage.seconds for stage in stages if not stage.name.startswith(" "))
    print(f"{'total':26}{total:6.2f} s")
    print(f"{'estimate, gyro upside down':26}{measure_upside_down():6.2f} s")
    used_s, most_mb = measure_fixes()
    print(f"{'track of 144,000 fixes':26}{used_s:6.2f} s of processor time, {most_mb:.0f} MB")


if __name__ == "__main__":
    main()
