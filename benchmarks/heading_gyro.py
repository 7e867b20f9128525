"""Gyros right, scaled, upside down and late, on simulated drives: what is made of them.

The truth is the simulation's. A drive with positions only stands beside them, since that is what is
left of a drive whose gyro is not used.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from benchmarks.heading_scores import percent
from fieldgrid.core import GnssError, PoseSettings
from fieldgrid.geometry import Carrier, FixColumns, Gyro, Motion, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.report import PoseReport
from tests.simulated import DATUM, K_TURN, SLALOM, Command, Drive, fixes_of, gyro_of, simulate
from tests.told import codes

ROWS = [
    *(Command(20.0, 1.5), Command(6.3, 1.0, 0.5), Command(20.0, 1.5), Command(6.3, 1.0, -0.5)),
    Command(20.0, 1.5),
]
FAST = [
    *(Command(20.0, 4.0), Command(6.0, 3.0, 0.15), Command(20.0, 4.0), Command(6.0, 3.0, -0.15)),
    Command(20.0, 4.0),
]
BACK = [
    *(Command(12.0, 1.5), Command(6.0, 1.0, 0.2), Command(8.0, -1.0, -0.15)),
    *(Command(10.0, 1.2, 0.1), Command(12.0, -1.0, 0.05), Command(15.0, 1.5)),
]
DRIVES = {"slalom": SLALOM, "K-turn": K_TURN, "rows": ROWS, "fast": FAST, "back": BACK}
SEEDS = (0, 1)
PERIODS_S = (0.2, 1.0)
NOISES_M = {0.01: 0.02, 0.3: 1.5}
"""The noise from fix to fix, and the accuracy that is declared."""

HOLE_S, EVERY_S = 5.0, 10.0


class Wrong(NamedTuple):
    """What is wrong with a gyro: its rates times `size`, its stamps late; None for no gyro."""

    name: str
    size: float | None = 1.0
    late_s: float = 0.0


GYROS = (
    Wrong("right"),
    Wrong("10 % too small", 0.9),
    Wrong("upside down", -1.0),
    Wrong("0.5 s late", late_s=0.5),
    Wrong("no gyro", None),
)


class Outcome(NamedTuple):
    """One drive: what was done with the gyro, the share of accepted poses, their largest error in
    degrees, the share of them within three sigma and that of more than 90° off; NaN where none is
    accepted."""

    drive: str
    done: str
    accepted: float
    worst_deg: float
    within: float
    around: float


def report(
    periods_s: Sequence[float] = PERIODS_S, noises_m: Sequence[float] = tuple(NOISES_M)
) -> Iterator[str]:
    """A line a receiver and gyro, over all drives: the median drive and the worst one."""
    yield f"{'':<52}{'largest error':>19}{'within 3 sigma':>17}{'> 90°':>9}{'accepted':>17}"
    yield (
        f"{'rate, noise, fixes, gyro':<31}{'kept scaled dropped':>21}"
        f"{'median':>10}{'worst':>9}{'median':>9}{'worst':>8}{'worst':>9}{'median':>9}{'worst':>8}"
        "  worst drive"
    )
    for period_s, noise_m, holes in product(periods_s, noises_m, (False, True)):
        for wrong in GYROS:
            found = [
                outcome(name, simulate(commands, 35.0 + 50.0 * seed), receiver, wrong, seed)
                for (name, commands), seed in product(DRIVES.items(), SEEDS)
                for receiver in [Receiver(period_s, noise_m, holes)]
            ]
            yield _line(
                f"{period_s:g} s, {noise_m:g} m, {'holes' if holes else 'whole'}", wrong, found
            )


class Receiver(NamedTuple):
    """Its period, the noise from fix to fix, and whether half of the drive is not seen."""

    period_s: float
    noise_m: float
    holes: bool


def outcome(name: str, drive: Drive, receiver: Receiver, wrong: Wrong, seed: int) -> Outcome:
    """One drive with one receiver and one gyro."""
    fixes = fixes_of(drive, receiver.period_s, receiver.noise_m, seed=seed)
    start_ns = fixes.time_ns[0]
    if receiver.holes:
        fixes = _seen(fixes)
    settings = PoseSettings(quality=4, accuracy_m=NOISES_M[receiver.noise_m])
    motion = Motion(gyro=_gyro(drive, wrong))
    try:
        found = estimate_poses(fixes, Carrier(0.0), DATUM, settings, motion)
    except GnssError:
        return Outcome(name, "refused", 0.0, *3 * (float("nan"),))
    track = found.trajectory
    truth = drive.at((track.time_ns - start_ns) / 1e9)
    off_deg = np.abs(wrap_deg(track.heading_deg - np.degrees(truth.heading_rad)))[track.accepted]
    sigma_deg = track.heading_sigma_deg[track.accepted]
    worst, within, around = 3 * (float("nan"),)
    if off_deg.size:
        worst, within = float(off_deg.max()), float(np.mean(off_deg < 3.0 * sigma_deg))
        around = float(np.mean(off_deg > 90.0))
    return Outcome(name, _done(found.report), float(track.accepted.mean()), worst, within, around)


def _seen(fixes: FixColumns) -> FixColumns:
    seconds = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    return fixes[np.flatnonzero(seconds % EVERY_S < EVERY_S - HOLE_S)]


def _gyro(drive: Drive, wrong: Wrong) -> Gyro | None:
    if wrong.size is None:
        return None
    true = gyro_of(drive, bias_dps=0.4, noise_dps=0.05)
    return Gyro(true.time_ns + round(wrong.late_s * 1e9), wrong.size * true.rate_rad_s)


def _done(report: PoseReport) -> str:
    if not np.isfinite(report.gyro_bias_dps):
        return "dropped"
    return "scaled" if "gyro-scale" in codes(report) else "kept"


def _line(receiver: str, wrong: Wrong, found: list[Outcome]) -> str:
    counts = "-"
    if wrong.size is not None:
        done = [one.done for one in found]
        counts = "  ".join(f"{done.count(what):>5}" for what in ("kept", "scaled", "dropped"))
    accepted = np.array([one.accepted for one in found])
    known = [one for one in found if np.isfinite(one.worst_deg)]
    if not known:
        return f"{receiver + ', ' + wrong.name:<31}{counts:>21}{'no pose accepted':>30}"
    worst_deg = np.array([one.worst_deg for one in known])
    within = np.array([one.within for one in known])
    worst = known[int(np.argmin(within - worst_deg / 1e6))]
    return (
        f"{receiver + ', ' + wrong.name:<31}{counts:>21}"
        f"{np.median(worst_deg):>9.1f}°{worst_deg.max():>8.1f}°"
        f"{percent(float(np.median(within))):>9}{percent(float(within.min())):>8}"
        f"{percent(max(one.around for one in known)):>9}"
        f"{percent(float(np.median(accepted))):>9}{percent(float(accepted.min())):>8}"
        f"  {worst.drive}"
    )
