"""Poses of another program that drift, beside fixes of several receivers, in the estimate of a
drive: `python -m benchmarks.given_poses`.

Of simulated rows and turns the poses have an error that grows with the way, as a share of each
metre (lasting 50 m) and in their heading (degrees on 100 m). Printed are the share of poses that
are accepted, how far these are off at most and in 95 %, and the share within three sigma, of three
drives each.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import GnssError
from fieldgrid.geometry import FixColumns, GivenPoses, LeverArm, Motion, wrap_deg
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM, Command, Drive, fixes_of, simulate, time_ns

_Float64 = npt.NDArray[np.float64]

SEEDS, PERIOD_S = 3, 0.1
LASTS_M = 50.0
ROWS = [one for k in range(6) for one in (Command(30.0, 1.5), Command(7.0, 1.2, 0.4 * (-1) ** k))]


class Case(NamedTuple):
    """What poses and fixes of a drive are like: the fixes from `seen` until `stop`, as shares of
    it, and none in the hole between 0.35 and 0.75 of one."""

    name: str
    share: float = 0.0
    drift_deg: float = 0.0
    yaw_deg: float = 0.0
    period_s: float = 0.2
    noise_m: float = 0.01
    stop: float = 1.0
    hole: bool = False
    ahead_m: float = 0.0


CASES = (
    Case("as they are"),
    Case("drift", 0.01, 0.5),
    Case("drift, fixes at 1 Hz", 0.01, 0.5, period_s=1.0),
    Case("drift, fixes at 0.2 Hz", 0.01, 0.5, period_s=5.0),
    Case("drift, fixes of 0.3 m", 0.01, 0.5, noise_m=0.3),
    Case("drift, antenna 1 m ahead", 0.01, 0.5, ahead_m=1.0),
    Case("drift, hole of 40 %", 0.01, 0.5, hole=True),
    Case("drift, fixes in a third", 0.01, 0.5, stop=1.0 / 3.0),
    Case("drift three times usual", 0.03, 1.5),
    Case("the same, hole of 40 %", 0.03, 1.5, hole=True),
    Case("yaw of 2 degrees", yaw_deg=2.0),
)


def poses_of(drive: Drive, case: Case, seed: int) -> GivenPoses:
    """The poses of the antenna by another program, in a frame of its own, with their errors."""
    random = np.random.default_rng(seed)
    seen = drive.every(PERIOD_S)
    n, step = len(seen.time_s), np.diff(seen.point(0.0, case.ahead_m).T)
    way_m = np.hypot(*step)
    wander = np.radians(case.drift_deg) * np.sqrt(way_m / 100.0) * random.normal(size=n - 1)
    turned = 0.6 + np.concatenate([[0.0], np.cumsum(wander)])
    shares = np.empty(n - 1)
    share = random.normal(0.0, case.share)
    for k, kept in enumerate(np.exp(-way_m / LASTS_M).tolist()):
        share = kept * share + np.sqrt(1.0 - kept**2) * random.normal(0.0, case.share)
        shares[k] = share
    moved = (1.0 + shares) * (step[0] + 1j * step[1]) * np.exp(-1j * turned[:-1])
    at = np.concatenate([[0.0], np.cumsum(moved)])
    x, y = (part + random.normal(0.0, 0.01, n) for part in (at.real, at.imag))
    heading = np.degrees(seen.heading_rad + turned) + case.yaw_deg + random.normal(0.0, 0.1, n)
    flat, unsaid = np.zeros(n), np.full(n, np.nan)
    ns = time_ns(seen.time_s)
    return GivenPoses(ns, x, y, flat, np.asarray(wrap_deg(heading)), flat, flat, unsaid, unsaid)


def fixes_in(drive: Drive, case: Case, seed: int) -> FixColumns:
    """The fixes of a case."""
    antenna = LeverArm(0.0, case.ahead_m, 2.0)
    fixes = fixes_of(drive, case.period_s, case.noise_m, seed=seed, antenna=antenna)
    fixes = fixes.replace(sigma_m=np.full(len(fixes), max(case.noise_m, 0.01)))
    share = (fixes.time_ns - fixes.time_ns[0]) / float(np.ptp(fixes.time_ns))
    kept = (share <= case.stop) & ~(case.hole & (share > 0.35) & (share < 0.75))
    return fixes[np.flatnonzero(kept)]


def measured(case: Case) -> str:
    """What a case gives, as a line."""
    drive = simulate(ROWS, 20.0, speed_mps=1.5)
    accepted, off, sigmas = list[float](), list[_Float64](), list[_Float64]()
    for seed in range(SEEDS):
        poses = poses_of(drive, case, seed)
        try:
            found = estimate_poses(
                fixes_in(drive, case, seed), None, DATUM, motion=Motion(poses=poses)
            ).trajectory
        except GnssError as problem:
            return f"refused: {problem}"
        ok = found.accepted
        true = drive.at((found.time_ns[ok] - time_ns(np.zeros(1))[0]) / 1e9)
        accepted.append(float(ok.mean()))
        ahead = case.ahead_m * np.stack([np.sin(true.heading_rad), np.cos(true.heading_rad)])
        away = np.stack([found.east_m[ok] - true.east_m, found.north_m[ok] - true.north_m]) - ahead
        turn = np.abs(wrap_deg(found.heading_deg[ok] - np.degrees(true.heading_rad)))
        off.append(np.stack([np.hypot(*away), turn]))
        sigma_m = np.sqrt(2.0) * found.position_sigma_m[ok]
        sigmas.append(off[-1] / np.stack([sigma_m, found.heading_sigma_deg[ok]]))
    (place_m, turn_deg), within = np.hstack(off), (np.hstack(sigmas) < 3.0).mean(axis=1)
    return (
        f"{min(accepted):8.1%} {np.percentile(place_m, 95.0):8.3f} {place_m.max():8.3f} m "
        f"{np.percentile(turn_deg, 95.0):8.2f} {turn_deg.max():8.2f} deg "
        f"{within[0]:8.1%} {within[1]:8.1%}"
    )


def main() -> None:
    """Print a line for each case."""
    print(
        f"{'':26}{'accepted':>8} {'95 %':>8} {'most':>8}   {'95 %':>8} {'most':>8}     in 3 sigma"
    )
    for case in CASES:
        print(f"{case.name:26}{measured(case)}")


if __name__ == "__main__":
    main()
