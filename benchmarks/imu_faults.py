"""`python -m benchmarks.imu_faults`: roll and pitch by IMUs that are mounted sideways, late, noisy.

Simulated drives over hills, rough and level ground, without a camera. An IMU counts as honest if it
is not used, or if roll and pitch are within three sigmas in 95 % of the frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from fieldgrid.fixes import FixColumns
from fieldgrid.motion import Gyro, Inertial, Motion
from fieldgrid.pose import estimate_poses
from fieldgrid.quality import Quality
from fieldgrid.rotations import roll_pitch_deg
from tests.hilly import Hike, antenna_fixes, hike, hills, inertial, rows, slope
from tests.pose.test_levelled import ANTENNA_M, RIG
from tests.simulated import DATUM, time_ns

GROUNDS = {"hills": hills(9.0, 45.0), "rough": hills(6.0, 12.0), "level": slope(0.0)}
RECEIVERS = ((0.2, 0.012, 0.01), (1.0, 0.02, 0.02), (0.2, 0.05, 0.3))
"""Seconds from fix to fix, their white and their slow error, metres."""

IMUS = (
    (100.0, 0.1, 0.05, 0.0),
    (100.0, 1.0, 1.0, 0.0),
    (25.0, 0.3, 0.3, 0.0),
    (100.0, 0.1, 0.05, 30.0),
)
"""Hertz, noise of gyro (°/s) and accelerometer (m/s²), and of one in 200 samples (m/s²)."""

FAULTS = ("none", "90° left", "45° right", "backward", "0.1 s late", "0.3 s late")
SWAYS_DEG = (0.35, 2.0)


class Outcome(NamedTuple):
    """Whether an IMU was used, the 95th percentile of what it was off, degrees, and the share of
    errors beyond three sigmas."""

    used: bool
    off_deg: float = 0.0
    beyond: float = 0.0

    @property
    def honest(self) -> bool:
        """Whether its sigmas hold."""
        return not self.used or self.beyond <= 0.05


def main() -> None:
    """Print a line a fault and sway."""
    print("fault         sway      used   honest   off by (95 %), median and most   beyond 3 sigma")
    for fault, sway_deg in product(FAULTS, SWAYS_DEG):
        found = list(outcomes(fault, sway_deg))
        used = [one for one in found if one.used]
        off = [one.off_deg for one in used] or [0.0]
        print(
            f"{fault:12} {sway_deg:5.2f}°  {len(used):3d}/{len(found)}"
            f"   {sum(one.honest for one in found):3d}/{len(found)}"
            f"   {np.median(off):8.2f}° {max(off):8.2f}°"
            f"   {max((one.beyond for one in used), default=0.0):22.2f}",
            flush=True,
        )


def outcomes(fault: str, sway_deg: float) -> Iterator[Outcome]:
    """One of each ground, IMU and receiver."""
    for ground, (hertz, gyro_dps, force_mps2, shock_mps2), receiver in product(
        GROUNDS.values(), IMUS, RECEIVERS
    ):
        way = hike(ground, rows(3, 40.0), sway_deg=sway_deg)
        sensed = inertial(way, hertz, gyro_noise_dps=gyro_dps, force_noise_mps2=force_mps2)
        yield _outcome(way, _with_fault(_jolted(sensed, shock_mps2), fault), receiver)


def _outcome(way: Hike, sensed: Inertial, receiver: tuple[float, float, float]) -> Outcome:
    frames_s = np.arange(1.03, way.drive.time_s[-1] - 2.0, 0.5)
    found = estimate_poses(
        _fixes(way, *receiver),
        RIG,
        DATUM,
        motion=Motion(gyro=Gyro(sensed.time_ns, -sensed.rate_rad_s[:, 2]), inertial=sensed),
        frame_ns=time_ns(frames_s),
    ).report.attitude
    if found is None:
        return Outcome(used=False)
    at = found.at(time_ns(frames_s))
    roll_deg, pitch_deg = roll_pitch_deg(way.at(frames_s).R)
    off = np.abs(np.concatenate([at.roll_deg - roll_deg, at.pitch_deg - pitch_deg]))
    sigma = np.concatenate([at.roll_sigma_deg, at.pitch_sigma_deg])
    return Outcome(True, float(np.percentile(off, 95)), float(np.mean(off > 3.0 * sigma)))


def _fixes(way: Hike, period_s: float, noise_m: float, wander_m: float) -> FixColumns:
    times, enu = antenna_fixes(way, ANTENNA_M, period_s, noise_m, wander_m)
    lat, lon, height = DATUM.to_geodetic(*enu.T)
    return FixColumns.of(
        times,
        lat_deg=lat,
        lon_deg=lon,
        height_m=height,
        quality=Quality.RTK_FIXED if wander_m < 0.1 else Quality.DIFFERENTIAL,
        satellites=12,
        hdop=0.8,
        age_s=1.0,
        sigma_m=np.hypot(noise_m, wander_m),
    )


def _jolted(sensed: Inertial, shock_mps2: float) -> Inertial:
    random = np.random.default_rng(1)
    force = sensed.force_mps2.copy()
    hit = random.integers(0, len(force), len(force) // 200)
    force[hit] += random.normal(0.0, 1.0, (len(hit), 3)) * shock_mps2
    return sensed._replace(force_mps2=force)


def _with_fault(sensed: Inertial, fault: str) -> Inertial:
    if fault.endswith("late"):
        late_ns = round(float(fault.split(maxsplit=1)[0]) * 1e9)
        return sensed._replace(time_ns=sensed.time_ns + late_ns)
    left = np.radians({"90° left": 90.0, "45° right": -45.0, "backward": 180.0}.get(fault, 0.0))
    R_imu_vehicle = np.array(
        [[np.cos(left), np.sin(left), 0.0], [-np.sin(left), np.cos(left), 0.0], [0.0, 0.0, 1.0]]
    )
    return sensed._replace(
        rate_rad_s=(sensed.rate_rad_s @ R_imu_vehicle.T).astype(sensed.rate_rad_s.dtype),
        force_mps2=(sensed.force_mps2 @ R_imu_vehicle.T).astype(sensed.force_mps2.dtype),
    )


if __name__ == "__main__":
    main()
