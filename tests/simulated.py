"""Simulated drives: a vehicle with an unsteered axle, integrated in small steps.

Speed and curvature follow their commands no faster than a tractor can, so gears change through
a standstill and turns begin gradually. Of the package only its records are used.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.geometry import Datum, FixColumns, Gyro, LeverArm, Steps, wrap_deg

_Float64 = npt.NDArray[np.float64]

STEP_S = 0.01
ACCELERATION_MPS2 = 1.0
STEERING_PER_M_S = 0.4


class Command(NamedTuple):
    """For some seconds: a speed, negative in reverse, and a curvature, positive to the right
    when driven forward."""

    seconds: float
    speed_mps: float
    curvature_per_m: float = 0.0


class Drive(NamedTuple):
    """The middle of the unsteered axle and the nose, length n; headings are not wrapped."""

    time_s: _Float64
    east_m: _Float64
    north_m: _Float64
    heading_rad: _Float64
    speed_mps: _Float64
    curvature_per_m: _Float64

    def at(self, time_s: npt.ArrayLike) -> Drive:
        """The drive at other instants."""
        times = np.asarray(time_s, dtype=np.float64)
        return Drive(times, *(np.interp(times, self.time_s, column) for column in self[1:]))

    def every(self, period_s: float) -> Drive:
        """The drive at the instants of a receiver."""
        return self.at(np.arange(0.0, self.time_s[-1] + 1e-9, period_s))

    def point(self, right_m: float, ahead_m: float) -> _Float64:
        """East and north [n, 2] of a point of the vehicle."""
        sin, cos = np.sin(self.heading_rad), np.cos(self.heading_rad)
        east = self.east_m + right_m * cos + ahead_m * sin
        north = self.north_m - right_m * sin + ahead_m * cos
        return np.stack([east, north], axis=1)

    def gear(self) -> npt.NDArray[np.int64]:
        """The sign of the speed."""
        return np.sign(self.speed_mps).astype(np.int64)


def simulate(
    commands: Sequence[Command], heading_deg: float = 0.0, *, speed_mps: float = 0.0
) -> Drive:
    """The drive that some commands lead to, from the origin; its columns cannot be written."""
    return _simulated(tuple(commands), heading_deg, speed_mps)


@lru_cache(maxsize=100)
def _simulated(commands: tuple[Command, ...], heading_deg: float, speed_mps: float) -> Drive:
    rows = [(0.0, 0.0, 0.0, np.radians(heading_deg), speed_mps, commands[0].curvature_per_m)]
    for command in commands:
        for _ in range(round(command.seconds / STEP_S)):
            time, east, north, phi, v, kappa = rows[-1]
            most_v, most_kappa = ACCELERATION_MPS2 * STEP_S, STEERING_PER_M_S * STEP_S
            # np.clip takes longer than all the rest.
            new_v = v + min(max(command.speed_mps - v, -most_v), most_v)
            change = min(max(command.curvature_per_m - kappa, -most_kappa), most_kappa)
            way, bend = STEP_S * (v + new_v) / 2.0, kappa + change / 2.0
            middle = phi + way * bend / 2.0
            rows.append(
                (
                    time + STEP_S,
                    east + way * float(np.sin(middle)),
                    north + way * float(np.cos(middle)),
                    phi + way * bend,
                    new_v,
                    kappa + change,
                )
            )
    columns = np.array(rows).T
    columns.setflags(write=False)
    return Drive(*columns)


def pivoting(seed: int) -> Drive:
    """A robot that drives straight, turns on the spot, and drives on forward or back."""
    random = np.random.default_rng(seed)
    heading, rows, at = 0.3, [(0.0, 0.0, 0.3, 0.0)], np.zeros(2)
    for _ in range(12):
        turn = random.uniform(60.0, 180.0) * random.choice([-1.0, 1.0])
        speed = 0.8 if random.uniform() > 0.25 else -0.8
        for share in np.minimum(
            np.minimum(np.arange(2000) / 50.0, 1.0), np.arange(2000, 0, -1) / 50.0
        ):
            at = at + 0.01 * speed * share * np.array([np.sin(heading), np.cos(heading)])
            rows.append((*at, heading, speed * share))
        spin = np.r_[np.zeros(100), np.full(int(abs(turn) / 0.3), np.radians(np.sign(turn) * 0.3))]
        for step in np.r_[spin, np.zeros(100)]:
            heading += step
            rows.append((*at, heading, 0.0))
    east, north, heading_rad, speed_mps = np.array(rows).T
    time_s = 0.01 * np.arange(len(rows))
    return Drive(time_s, east, north, heading_rad, speed_mps, 0.0 * time_s)


CIRCLE = [Command(40.0, 1.5, 0.2)]
SLALOM = [Command(5.0, 1.5)] + [Command(4.0, 1.5, 0.15 * (-1) ** k) for k in range(8)]
K_TURN = [
    Command(15.0, 1.5),
    Command(4.5, 1.2, 0.25),
    Command(6.0, -1.0, -0.25),
    Command(4.5, 1.2, 0.25),
    Command(15.0, 1.5),
]
"""Half a turn at the end of a row: forward to the right, back to the left, forward."""

STOP = [Command(15.0, 1.5), Command(12.0, 0.0), Command(15.0, 1.5)]


# --- what a drive's sensors would have recorded

SECOND = 1_000_000_000
START = 1_308_139_200 * SECOND
DATUM = Datum(39.5, -1.1, 700.0)
AT_AXLE = LeverArm(0.0, 0.0, 2.0)


def time_ns(time_s: _Float64) -> npt.NDArray[np.int64]:
    """Instants of a drive as a receiver stamps them."""
    return START + np.round(time_s * 1e9).astype(np.int64)


def fixes_of(
    drive: Drive,
    period_s: float = 0.2,
    noise_m: float = 0.0,
    *,
    seed: int = 0,
    antenna: LeverArm = AT_AXLE,
    quality: int = 4,
    speed: bool = False,
    heading_sigma_deg: float | None = None,
) -> FixColumns:
    """The fixes of an antenna, placed from the axle, with white noise.

    With a `heading_sigma_deg` they have recorded headings, with an error of that size.
    """
    random = np.random.default_rng(seed)
    sampled = drive.every(period_s)
    n = len(sampled.time_s)
    east, north = (sampled.point(antenna.right_m, antenna.forward_m)).T
    noise = random.normal(0.0, 1.0, (2, n)) * noise_m
    lat, lon, height = DATUM.to_geodetic(
        east + noise[0], north + noise[1], np.full(n, antenna.up_m)
    )
    heading = np.degrees(sampled.heading_rad)
    if heading_sigma_deg is not None:
        heading = heading + random.normal(0.0, heading_sigma_deg, n)
    return FixColumns.of(
        time_ns(sampled.time_s),
        lat_deg=lat,
        lon_deg=lon,
        height_m=height,
        quality=quality,
        satellites=12,
        hdop=0.8,
        age_s=1.0,
        speed_mps=np.abs(sampled.speed_mps) if speed else np.nan,
        heading_deg=np.nan if heading_sigma_deg is None else wrap_deg(heading),
        heading_sigma_deg=np.nan if heading_sigma_deg is None else heading_sigma_deg,
    )


def gyro_of(
    drive: Drive,
    rate_hz: float = 50.0,
    bias_dps: float = 0.0,
    noise_dps: float = 0.0,
    seed: int = 0,
) -> Gyro:
    """What a gyro would have measured: the rate of turn, its bias, white noise."""
    times = np.arange(0.0, drive.time_s[-1], 1.0 / rate_hz)
    rate = np.gradient(drive.heading_rad, drive.time_s)
    noise = np.random.default_rng(seed).normal(bias_dps, noise_dps, len(times))
    return Gyro(time_ns(times), np.interp(times, drive.time_s, rate) + np.radians(noise))


def steps_of(
    drive: Drive,
    period_s: float = 0.5,
    ahead_m: float = 0.0,
    *,
    sigma_m: float = 0.01,
    sigma_deg: float = 0.1,
    noise: float = 0.0,
    late_s: float = 0.0,
    seed: int = 0,
) -> Steps:
    """The relative motions that a camera would have seen of a point ahead of the axle.

    `noise` is the share of the stated sigmas that they really err by. Their stamps are late by
    `late_s`.
    """
    random = np.random.default_rng(seed)
    times = np.arange(0.0, drive.time_s[-1] + 1e-9, period_s)
    seen = drive.at(times)
    where = seen.point(0.0, ahead_m)
    moved, phi = np.diff(where, axis=0), seen.heading_rad
    sin, cos = np.sin(phi[:-1]), np.cos(phi[:-1])
    n = len(moved)
    stamps = time_ns(times + late_s)
    return Steps(
        stamps[:-1],
        stamps[1:],
        moved[:, 0] * sin + moved[:, 1] * cos + noise * random.normal(0.0, sigma_m, n),
        moved[:, 0] * cos - moved[:, 1] * sin + noise * random.normal(0.0, sigma_m, n),
        np.degrees(np.diff(phi)) + noise * random.normal(0.0, sigma_deg, n),
        np.full(n, sigma_m),
        np.full(n, sigma_deg),
        *np.zeros((3, n)),
        np.full(n, sigma_deg),
    )
