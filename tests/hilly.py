"""Simulated drives over hills: ground, a vehicle that leans with it, and what its sensors record.

The vehicle's axle follows a drive of :mod:`tests.simulated`; the ground's height and slope under
it, and a sway of its springs, give height, roll and pitch. Of the package only its records and the
conventions of `geometry.rotations` are used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from fieldgrid.geometry import (
    FixColumns,
    Gyro,
    Inertial,
    Motion,
    R_enu_level,
    R_level_vehicle,
    RecordedTilt,
    Steps,
    from_vectors,
    heading_rad,
    roll_pitch_deg,
    to_vectors,
)
from tests.simulated import DATUM, Command, Drive, simulate, time_ns

_Float64 = npt.NDArray[np.float64]
Ground = Callable[[_Float64, _Float64], _Float64]
"""Heights of the ground at east and north, metres."""

GRAVITY_MPS2, DOWN = 9.80665, np.array([0.0, 0.0, -1.0])


def slope(degrees: float, downhill_deg: float = 0.0) -> Ground:
    """An even slope that falls toward a direction."""
    fall, toward = np.tan(np.radians(degrees)), np.radians(downhill_deg)
    return lambda e, n: -fall * (e * np.sin(toward) + n * np.cos(toward))


def hills(degrees: float, length_m: float = 60.0, seed: int = 0) -> Ground:
    """Waves of several lengths and directions, whose slopes reach about `degrees`."""
    random = np.random.default_rng(seed)
    toward, phase = random.uniform(0.0, 2.0 * np.pi, (2, 4))
    k = 2.0 * np.pi / (length_m * np.array([1.0, 0.7, 0.45, 0.2]))
    high = np.tan(np.radians(degrees)) / k * np.array([0.6, 0.4, 0.25, 0.08])

    def height(e: _Float64, n: _Float64) -> _Float64:
        at = k * (e[..., None] * np.sin(toward) + n[..., None] * np.cos(toward)) + phase
        return np.asarray((high * np.sin(at)).sum(axis=-1))

    return height


def rows(lanes: int = 4, length_m: float = 40.0, speed_mps: float = 1.4) -> list[Command]:
    """Up and down the rows of a field, with a turn of 180° to alternate sides between them."""
    commands = [Command(3.0, 0.0)]
    for k in range(lanes):
        commands.append(Command(length_m / speed_mps, speed_mps))
        if k < lanes - 1:
            side = 0.5 if k % 2 == 0 else -0.5
            commands.append(Command(np.pi / abs(side) / 1.0, 1.0, side))
    return [*commands, Command(3.0, 0.0)]


class Hike(NamedTuple):
    """A drive over ground: n instants with the sensor's place [n, 3], axes and the drive below."""

    drive: Drive
    sensor_m: _Float64
    R: _Float64

    def at(self, time_s: npt.ArrayLike) -> Hike:
        """The same at other instants, at most a hundredth of a second from simulated ones."""
        k = np.searchsorted(self.drive.time_s, np.asarray(time_s) - 1e-9)
        k = np.minimum(k, len(self.drive.time_s) - 1)
        return Hike(Drive(*(column[k] for column in self.drive)), self.sensor_m[k], self.R[k])

    def roll_pitch_deg(self) -> tuple[_Float64, _Float64]:
        return roll_pitch_deg(self.R)


def hike(
    ground: Ground,
    commands: list[Command],
    heading_deg: float = 30.0,
    *,
    sensor_m: tuple[float, float, float] = (0.0, 1.4, 2.5),
    sway_deg: float = 0.35,
    seed: int = 0,
) -> Hike:
    """A vehicle over ground; the sensor is `sensor_m` (right, forward, up) from the axle."""
    drive = simulate(commands, heading_deg)
    east, north = drive.east_m, drive.north_m
    sin, cos = np.sin(drive.heading_rad), np.cos(drive.heading_rad)
    # The wheels: what lies 1.2 m behind and before the axle, 0.75 m to its sides.
    ahead = ground(east + 1.2 * sin, north + 1.2 * cos) - ground(
        east - 1.2 * sin, north - 1.2 * cos
    )
    aside = ground(east + 0.75 * cos, north - 0.75 * sin) - ground(
        east - 0.75 * cos, north + 0.75 * sin
    )
    swaying = _sway(len(east), np.random.default_rng(seed)) * sway_deg
    # On the spot nothing sways.
    swaying *= np.minimum(np.abs(drive.speed_mps), 1.0)
    pitch = np.degrees(np.arctan2(ahead, 2.4)) + swaying[0]
    # The roll that lays the axis to the right along the ground, seen with the nose up or down.
    roll = np.degrees(np.arctan2(-aside, 1.5) * np.cos(np.radians(pitch))) + swaying[1]
    R = R_enu_level(np.degrees(drive.heading_rad)) @ R_level_vehicle(roll, pitch)
    axle = np.stack([east, north, ground(east, north)], axis=1)
    return Hike(drive, axle + R @ np.array(sensor_m), R)


def _sway(n: int, random: np.random.Generator) -> _Float64:
    """Two unit signals [2, n] at 100 Hz, between about 0.3 and 2 Hz."""
    spectrum = np.fft.rfft(random.normal(size=(2, n)))
    hertz = np.fft.rfftfreq(n, 0.01)
    signal = np.fft.irfft(spectrum * np.exp(-((hertz / 1.2) ** 4)) * (hertz > 0.3), n)
    return np.asarray(signal / signal.std(axis=1, keepdims=True))


def antenna_fixes(
    way: Hike,
    antenna_m: npt.ArrayLike,
    period_s: float = 0.2,
    noise_m: float = 0.012,
    wander_m: float = 0.01,
    seed: int = 0,
) -> tuple[npt.NDArray[np.int64], _Float64]:
    """Times and places [n, 3] of an antenna seen from the sensor; heights err twice as much."""
    random = np.random.default_rng(seed)
    seen = way.at(np.arange(0.0, way.drive.time_s[-1], period_s))
    n = len(seen.R)
    slow = np.cumsum(random.normal(size=(n, 3)), axis=0) * np.sqrt(2.0 * period_s / 300.0)
    error = (random.normal(size=(n, 3)) * noise_m + slow * wander_m) * [1.0, 1.0, 2.0]
    return time_ns(seen.drive.time_s), seen.sensor_m + seen.R @ np.asarray(antenna_m) + error


def fixes_over(
    way: Hike,
    antenna_m: npt.ArrayLike,
    period_s: float = 0.2,
    noise_m: float = 0.012,
    wander_m: float = 0.01,
    **stated: npt.ArrayLike,
) -> FixColumns:
    """The fixes of such an antenna, as a log holds them, with what they state besides."""
    times, enu = antenna_fixes(way, antenna_m, period_s, noise_m, wander_m)
    lat, lon, height = DATUM.to_geodetic(*enu.T)
    return FixColumns.of(
        times,
        lat_deg=lat,
        lon_deg=lon,
        height_m=height,
        satellites=12,
        hdop=0.8,
        age_s=1.0,
        **{"quality": 4, **stated},
    )


def inertial(
    way: Hike,
    rate_hz: float = 100.0,
    *,
    gyro_bias_dps: npt.ArrayLike = (0.2, -0.15, 0.2),
    force_bias_mps2: npt.ArrayLike = (0.02, -0.03, -0.06),
    gyro_noise_dps: float = 0.1,
    force_noise_mps2: float = 0.05,
    seed: int = 0,
) -> Inertial:
    """What an IMU at the sensor records. Differences over 20 ms, as its own filter would."""
    random = np.random.default_rng(seed)
    h = way.drive.time_s[1] - way.drive.time_s[0]
    place, R = way.sensor_m, way.R
    acceleration = np.gradient(np.gradient(place, h, axis=0), h, axis=0)
    acceleration[:2] = acceleration[-2:] = 0.0
    force = np.einsum("nji,nj->ni", R, acceleration - GRAVITY_MPS2 * DOWN)
    rate = np.zeros_like(force)
    rate[1:-1] = to_vectors(R[:-2].swapaxes(1, 2) @ R[2:]) / (2.0 * h)
    at = np.arange(0, len(R), max(round(1.0 / rate_hz / h), 1))
    n = len(at)
    return Inertial(
        time_ns(way.drive.time_s[at]),
        rate[at] + np.radians(gyro_bias_dps + random.normal(size=(n, 3)) * gyro_noise_dps),
        force[at] + force_bias_mps2 + random.normal(size=(n, 3)) * force_noise_mps2,
    )


def gyro_and(sensed: Inertial) -> Motion:
    """What an IMU measured, with its gyro about the vertical axis."""
    return Motion(gyro=Gyro(sensed.time_ns, -sensed.rate_rad_s[:, 2]), inertial=sensed)


def mounted(sensed: Inertial, left_deg: float) -> Inertial:
    """The same of an IMU that is turned to the left against what is declared."""
    sin, cos = np.sin(np.radians(left_deg)), np.cos(np.radians(left_deg))
    R_imu_vehicle = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return sensed._replace(
        rate_rad_s=(sensed.rate_rad_s @ R_imu_vehicle.T).astype(np.float32),
        force_mps2=(sensed.force_mps2 @ R_imu_vehicle.T).astype(np.float32),
    )


def camera_steps(
    way: Hike,
    period_s: float = 1.0,
    *,
    sigma_m: float = 0.004,
    tilt_sigma_deg: float = 0.04,
    lean_deg: float = 0.0,
    seed: int = 0,
) -> Steps:
    """The motions that a camera sees from frame to frame; `lean_deg` by how much its nose is
    higher than its mounting says."""
    random = np.random.default_rng(seed)
    seen = way.at(np.arange(0.5, way.drive.time_s[-1] - 0.5, period_s))
    tip = from_vectors(np.radians([lean_deg, 0.0, 0.0]))
    R = seen.R @ tip
    n = len(R) - 1
    noise = from_vectors(np.radians(random.normal(size=(n, 3)) * tilt_sigma_deg))
    turned = R[:-1].swapaxes(1, 2) @ R[1:] @ noise
    moved = np.einsum("nji,nj->ni", R[:-1], np.diff(seen.sensor_m, axis=0))
    moved += random.normal(size=(n, 3)) * sigma_m
    roll, pitch = roll_pitch_deg(turned)
    stamps = time_ns(seen.drive.time_s)
    return Steps(
        stamps[:-1],
        stamps[1:],
        moved[:, 1],
        moved[:, 0],
        np.degrees(heading_rad(turned)),
        np.full(n, sigma_m),
        np.full(n, tilt_sigma_deg),
        moved[:, 2],
        roll,
        pitch,
        np.full(n, tilt_sigma_deg),
    )


def recorded_tilt(
    way: Hike, period_s: float = 0.1, sigma_deg: float = 0.1, seed: int = 0
) -> RecordedTilt:
    """Roll and pitch as an inertial system states them: one error for a minute."""
    seen = way.at(np.arange(0.0, way.drive.time_s[-1], period_s))
    off = np.random.default_rng(seed).normal(size=2) * sigma_deg
    roll, pitch = seen.roll_pitch_deg()
    return RecordedTilt(
        time_ns(seen.drive.time_s), roll + off[0], pitch + off[1], np.full(len(roll), sigma_deg)
    )


def axis_rises(
    way: Hike,
    toward_deg: float,
    period_s: float = 0.2,
    *,
    noise_deg: float = 0.3,
    mount_deg: float = 0.0,
    frame_deg: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> tuple[npt.NDArray[np.int64], _Float64]:
    """Times and rises, degrees, of an axis that points `toward_deg` clockwise from the nose,
    `mount_deg` higher than it should be, in a frame that leans by `frame_deg` east and north."""
    seen = way.at(np.arange(0.0, way.drive.time_s[-1], period_s))
    toward = np.radians(toward_deg)
    up = np.array([*np.radians(frame_deg), 1.0])
    sine = seen.R @ np.array([np.sin(toward), np.cos(toward), 0.0]) @ (up / np.linalg.norm(up))
    noise = np.random.default_rng(seed).normal(size=len(sine)) * noise_deg
    return time_ns(seen.drive.time_s), np.degrees(np.arcsin(sine)) + mount_deg + noise


def slowly(n: int, period_s: float, lasting_s: float, sigma: float, seed: int = 0) -> _Float64:
    """An error [n] that stays about the same for a while: an Ornstein-Uhlenbeck process."""
    noise = np.random.default_rng(seed).normal(size=n) * sigma
    kept = np.exp(-period_s / lasting_s)
    noise[1:] *= np.sqrt(1.0 - kept**2)
    return np.asarray(lfilter([1.0], [1.0, -kept], noise))
