"""Receivers that drift smoothly within seconds and state decimetres, on simulated drives with gyro.

The velocity of the drift is random and lasts for some seconds; the error itself is drawn back to
zero within 20 s, so that it stays of the stated size. No two fixes show it: they scatter by 5 mm.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from benchmarks.heading_gyro import DRIVES, SEEDS
from benchmarks.heading_scores import percent
from fieldgrid.core import GnssError, PoseSettings, Quality
from fieldgrid.geometry import Carrier, FixColumns, Motion, wrap_deg
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM, Command, Drive, fixes_of, gyro_of, simulate

TOWN = [
    *(Command(8.0, 4.0), Command(6.0, 4.0, 0.08), Command(5.0, 3.5, -0.1), Command(8.0, 5.0)),
    *(Command(5.0, 4.0, -0.15), Command(8.0, 5.0, 0.02)),
]
PERIOD_S, NOISE_M, BACK_S = 0.1, 0.005, 20.0


class Receiver(NamedTuple):
    """How fast it drifts, for how long it drifts one way, and what it states."""

    drift_mps: float
    lasts_s: float
    accuracy_m: float


RECEIVERS = (
    *(Receiver(0.0, 3.0, 0.4), Receiver(0.05, 3.0, 0.4), Receiver(0.15, 3.0, 0.4)),
    *(Receiver(0.15, 8.0, 0.8), Receiver(0.3, 3.0, 0.8)),
)
GYROS = (0.95, 1.0, 1.05)


def drifted(fixes: FixColumns, receiver: Receiver, seed: int) -> FixColumns:
    """The same fixes by a receiver that drifts."""
    random = np.random.default_rng(99 + seed)
    step_s = np.diff(fixes.time_ns, prepend=fixes.time_ns[:1]) / 1e9
    velocity, away = receiver.drift_mps * random.normal(size=2), np.zeros(2)
    added = np.empty((len(fixes), 2))
    for k, (passed_s, fresh) in enumerate(
        zip(step_s.tolist(), random.normal(size=(len(fixes), 2)), strict=True)
    ):
        fading = np.exp(-passed_s / receiver.lasts_s)
        velocity = fading * velocity + receiver.drift_mps * np.sqrt(1.0 - fading**2) * fresh
        away = np.exp(-passed_s / BACK_S) * (away + passed_s * velocity)
        added[k] = away
    east, north, up = DATUM.to_enu(fixes.lat_deg, fixes.lon_deg, fixes.height_m)
    lat, lon, _ = DATUM.to_geodetic(east + added[:, 0], north + added[:, 1], up)
    return fixes.replace(lat_deg=lat, lon_deg=lon)


def score(drive: Drive, receiver: Receiver, size: float, seed: int) -> tuple[float, float]:
    """The share of accepted poses, and that of their headings within three sigma, NaN for none;
    the gyro's rates are multiplied by `size`."""
    fixes = drifted(fixes_of(drive, PERIOD_S, NOISE_M, seed=seed), receiver, seed)
    gyro = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    gyro = gyro._replace(rate_rad_s=size * gyro.rate_rad_s)
    settings = PoseSettings(quality=Quality.DIFFERENTIAL, accuracy_m=receiver.accuracy_m)
    try:
        found = estimate_poses(fixes, Carrier(0.0), DATUM, settings, Motion(gyro=gyro)).trajectory
    except GnssError:
        return 0.0, float("nan")
    truth = drive.at((found.time_ns - fixes.time_ns[0]) / 1e9)
    off_deg = np.abs(wrap_deg(found.heading_deg - np.degrees(truth.heading_rad)))
    inside = (off_deg < 3.0 * found.heading_sigma_deg)[found.accepted]
    return float(found.accepted.mean()), float(inside.mean()) if inside.size else float("nan")


def report() -> Iterator[str]:
    """A line a receiver and gyro: the median and the worst of all drives."""
    yield f"{'drift, lasts, stated; gyro':<42}{'within 3 sigma':>24}{'accepted':>20}"
    drives = {**DRIVES, "town": TOWN}
    for receiver, size in product(RECEIVERS, GYROS):
        found = [
            score(simulate(commands, 35.0 + 50.0 * seed), receiver, size, seed)
            for commands, seed in product(drives.values(), SEEDS)
        ]
        accepted, within = (np.array(column) for column in zip(*found, strict=True))
        name = (
            f"{receiver.drift_mps:g} m/s, {receiver.lasts_s:g} s, {receiver.accuracy_m:g} m; "
            f"gyro x {size:g}"
        )
        yield (
            f"{name:<42}{percent(float(np.nanmedian(within)), 1):>12}"
            f"{percent(float(np.nanmin(within)), 1):>12}"
            f"{percent(float(np.median(accepted)), 1):>10}{percent(float(accepted.min()), 1):>10}"
        )
