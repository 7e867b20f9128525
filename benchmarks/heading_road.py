"""KITTI's cars, by positions and with their gyro, beside the heading of their inertial unit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.heading_scores import DATA, numbers, percent, poses_at, table
from fieldgrid.core import GnssError, PoseSettings, Quality
from fieldgrid.geometry import Datum, FixColumns, Gyro, Motion, heading_from_yaw_rad, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.fused import conditioned

FOLDER = DATA / "kitti_oxts"
RTK = ("2011_09_26_drive_0001", "2011_09_26_drive_0018", "2011_09_30_drive_0020")
"""The drives with a fixed solution that move; drive 0017 stands."""

QUALITY_OF_POSMODE = {-1: 6, 2: 1, 3: 1, 4: 2, 5: 5, 6: 4, 7: 9, 8: 2, 9: 2}
MOVING_MPS, HARD_TURN_DPS = 0.2, 15.0

_Float64 = npt.NDArray[np.float64]
_Bool = npt.NDArray[np.bool_]


class Log(NamedTuple):
    """Rows of a drive; `rate_rad_s` is the turn that its gyro tells, clockwise."""

    name: str
    fixes: FixColumns
    truth_deg: _Float64
    moving: _Bool
    turning: _Bool
    rate_rad_s: _Float64


class Errors(NamedTuple):
    """n epochs: the error, degrees, and what they are."""

    error_deg: _Float64
    sigma_deg: _Float64
    accepted: _Bool
    moving: _Bool
    turning: _Bool


TOLD = ("with quality", "lat, lon, alt", "lat, lon alone")
"""How much of a log is given: without quality and sigma, and without the height too."""


def read_log(path: Path, told: str) -> Log:
    names = ("lat", "lon", "alt", "yaw", "vf", "wz", "wu", "pos_accuracy", "posmode")
    text = table(path, ("timestamp", *names))
    stamps = np.array([t.replace(" ", "T") for t in text["timestamp"]], dtype="datetime64[ns]")
    value = {name: numbers(text[name]) for name in names}
    with_quality = told == TOLD[0]
    qualities = [QUALITY_OF_POSMODE.get(int(mode), 0) for mode in value["posmode"]]
    fixes = FixColumns.of(
        stamps.astype(np.int64),
        lat_deg=value["lat"],
        lon_deg=value["lon"],
        height_m=value["alt"] if told != TOLD[2] else 0.0,
        quality=qualities if with_quality else Quality.UNKNOWN,
        sigma_m=value["pos_accuracy"] if with_quality else np.nan,
    )
    return Log(
        path.stem,
        fixes,
        np.asarray(heading_from_yaw_rad(value["yaw"])),
        np.abs(value["vf"]) > MOVING_MPS,
        np.degrees(np.abs(value["wz"])) > HARD_TURN_DPS,
        -value["wu"],
    )


GYROS = {"gyro": 1.0, "10 % small": 0.9, "10 % large": 1.1, "upside down": -1.0}
"""What the rates of the car's gyro are multiplied by."""


def measure(log: Log, motion: Motion | None = None) -> Errors:
    times = log.fixes.time_ns
    try:
        poses = poses_at(estimate_poses(log.fixes, motion=motion).trajectory, times)
    except GnssError:
        unknown = np.full(len(times), np.nan)
        return Errors(unknown, unknown, unknown > 0.0, log.moving, log.turning)
    off = np.asarray(wrap_deg(poses.heading_deg - log.truth_deg))
    return Errors(off, poses.sigma_deg, poses.accepted, log.moving, log.turning)


def report() -> Iterator[str]:
    yield (
        f"{'':<40}{'moving':>8}{'used':>8}{'mean':>8}{'95 %':>8}{'bias':>8}{'in turns':>10}"
        f"{'of':>6}{'3 sigma':>9}{'sigma/err':>10}{'used > 30°':>12}"
    )
    yield (
        f"{'asked of the RTK drives; of 0093':<40}{'':>8}{'':>8}{'<= .20°':>8}{'':>8}{'':>8}"
        f"{'<= 1.5°':>10}{'':>6}{'':>9}{'':>10}{'0':>12}"
    )
    for what in TOLD:
        found = {path.stem: measure(read_log(path, what)) for path in sorted(FOLDER.glob("*.csv"))}
        for name, one in found.items():
            yield _line(f"{name.removeprefix('2011_')}, {what}", one)
        together = [found[name] for name in RTK if name in found]
        columns = (np.concatenate(column) for column in zip(*together, strict=True))
        yield _line(f"RTK drives pooled, {what}", Errors(*columns))
    yield from _slides()
    for what, size in GYROS.items():
        for path in sorted(FOLDER.glob("*.csv")):
            log = read_log(path, TOLD[0])
            gyro = Gyro(log.fixes.time_ns, size * log.rate_rad_s)
            name = f"{log.name.removeprefix('2011_')}, {what}"
            yield _line(name, measure(log, Motion(gyro=gyro)))


SLIDES_S = 2.0


def _slides() -> Iterator[str]:
    """How fast positions slide over :data:`SLIDES_S` beside the velocity of the inertial unit, and
    the noise from fix to fix and within a second, by which a log alone would have to show it."""
    for path in sorted(FOLDER.glob("*.csv")):
        log = read_log(path, TOLD[2])
        if not log.moving.any():
            continue
        try:
            fixes = conditioned(log.fixes, PoseSettings()).accepted
        except GnssError:
            continue
        text = table(path, ("timestamp", "ve", "vn"))
        velocity = np.stack([numbers(text["ve"]), numbers(text["vn"])], axis=1)
        datum = Datum(log.fixes.lat_deg[0], log.fixes.lon_deg[0], 0.0)
        place = np.stack(
            datum.to_enu(log.fixes.lat_deg, log.fixes.lon_deg, np.zeros(len(velocity)))
        )
        time_s = (log.fixes.time_ns - log.fixes.time_ns[0]) / 1e9
        driven = (velocity[1:] + velocity[:-1]) / 2.0 * np.diff(time_s)[:, None]
        slid = np.cumsum(np.diff(place[:2].T, axis=0) - driven, axis=0)
        later = np.searchsorted(time_s[1:], time_s[1:] + SLIDES_S)
        later = later[later < len(slid)]
        slide_mps = np.hypot(*(slid[later] - slid[: len(later)]).T) / SLIDES_S
        noise_mm = 1e3 * np.median([fixes.noise.across_m, fixes.noise.second_m], axis=1)
        yield (
            f"{path.stem.removeprefix('2011_')}: positions slide by {np.median(slide_mps):.2f} m/s "
            f"({slide_mps.max():.2f} at most), {np.hypot(*np.ptp(slid, axis=0)):.1f} m in "
            f"{time_s[-1]:.0f} s; noise from fix to fix {noise_mm[0]:.1f} mm, within a second "
            f"{noise_mm[1]:.0f} mm"
        )


def _line(name: str, one: Errors) -> str:
    used = one.accepted & one.moving
    wrong = int((np.abs(one.error_deg[one.accepted]) > 30.0).sum())
    start = f"{name:<40}{one.moving.sum():>8}"
    if not used.any():
        return f"{start}{'0 %':>8}{'':>67}{wrong:>12}"
    error = np.abs(one.error_deg[used])
    turn = np.abs(one.error_deg[used & one.turning])
    share = used.sum() / one.moving.sum()
    honest = np.mean(error <= 3.0 * one.sigma_deg[used])
    in_turns = f"{turn.mean():.2f}°" if turn.size else "-"
    return (
        f"{start}{percent(share, 1):>8}{error.mean():>7.2f}°{np.percentile(error, 95):>7.2f}°"
        f"{np.median(one.error_deg[used]):>7.2f}°{in_turns:>10}{turn.size:>6}"
        f"{percent(honest, 1):>9}{np.median(one.sigma_deg[used]) / np.median(error):>10.2f}"
        f"{wrong:>12}"
    )
