"""`python -m benchmarks.late_fixes [COUNT [FIRST]]`: fixes that are stamped late or early against a
gyro, antennas that sit elsewhere than declared, and drives with neither; these also with gyros that
are wrong, to which neither must be put down.

Vehicle, receiver, rate, holes, wheels and the size of the mistake are random, by seed. What the
report says is *named* where it is the mistake alone, to three of its sigmas or a tenth; *either*
where both are named; *other* where only the wrong one is; *doubt* where a note says something else,
and *silent* without any. Positions and headings are compared by the gyro's clock.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.random_drives import (
    DATUM,
    GRADES,
    RATES_HZ,
    VEHICLES,
    Case,
    driven,
    moved,
    received,
    rig,
)
from benchmarks.variations import THREE_SIGMA_2D
from fieldgrid.core import GnssError, Quality
from fieldgrid.geometry import Gyro
from fieldgrid.poses import estimate_poses
from tests.simulated import time_ns
from tests.told import warnings

SIZES = {"none": (0.0, 0.0), "stamps": (0.2, 3.0), "antenna ahead": (0.4, 2.5)}
"""Seconds or metres."""

_STAMPS = re.compile(r"stamped (\S+) s (?:± (\S+) s )?(late|early)")
_PLACE = re.compile(r"sits (\S+) m (?:± (\S+) m )?farther (ahead|back)")


class Mistake(NamedTuple):
    """What is wrong with a drive, and its size: seconds late, or metres farther ahead."""

    kind: str
    size: float
    quality: Quality
    has_holes: bool


class Told(NamedTuple):
    """How a report takes a mistake, the share of positions within three sigmas and of fixes whose
    pose is used."""

    mistake: Mistake
    says: str
    within: float
    used: float


GYROS = {"upside down": (-1.0, 0.0), "half the rate": (0.5, 0.0), "40 s later": (1.0, 40.0)}
"""Wrong gyros: how many times too fast, and seconds."""


def told(seed: int, gyro: tuple[float, float] = (1.0, 0.0)) -> Told:
    """The report on the drive of a seed, with a gyro so many times too fast and seconds late."""
    random = np.random.default_rng([531, seed])
    kind = str(random.choice(list(SIZES)))
    size = float(random.uniform(*SIZES[kind]) * random.choice([-1.0, 1.0]))
    mistake = Mistake(kind, size, Quality(int(random.choice(list(GRADES)))), random.uniform() < 0.3)
    case = Case(
        *(seed, str(random.choice(VEHICLES)), str(random.choice(["gyro", "gyro, wheels"]))),
        *("right", mistake.quality, float(random.choice(RATES_HZ))),
        *(float(random.uniform(0.05, 0.3)), float(random.choice([60.0, 300.0]))),
        *((kind, size) if kind == "antenna ahead" else ("none", 0.0)),
    )
    drive = driven(case.vehicle, random)
    fixes, late_s = received(case, drive, random), size if kind == "stamps" else 0.0
    since_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    if mistake.has_holes:
        hole_s = random.uniform(3.0, 9.0)
        fixes = fixes[np.flatnonzero(since_s % (2.5 * hole_s) < 1.5 * hole_s)]
    fixes = fixes.replace(time_ns=fixes.time_ns + round(late_s * 1e9))
    motion = moved(case, drive, random)
    assert motion.gyro is not None
    time, rate = motion.gyro.time_ns + round(gyro[1] * 1e9), gyro[0] * motion.gyro.rate_rad_s
    motion = motion._replace(gyro=Gyro(time, rate))
    try:
        found = estimate_poses(fixes, rig(), DATUM, motion=motion)
    except GnssError:
        return Told(mistake, "doubt", np.nan, 0.0)
    notes = [str(one) for one in warnings(found.report)]
    track = found.trajectory
    used = found.fix_row[track.accepted[found.fix_row]]
    true_s = (track.time_ns[used] - time_ns(np.zeros(1))[0]) / 1e9
    inside = (true_s >= 0.0) & (true_s <= drive.time_s[-1])
    used, truth = used[inside], drive.at(true_s[inside])
    off_m = np.hypot(track.east_m[used] - truth.east_m, track.north_m[used] - truth.north_m)
    inside = off_m < THREE_SIGMA_2D * track.position_sigma_m[used]
    share = float(inside.mean()) if len(used) else np.nan
    return Told(mistake, _says(mistake, notes), share, len(used) / len(fixes))


def _says(mistake: Mistake, notes: Sequence[str]) -> str:
    stamps, place = (
        next((seen for seen in map(kind.search, notes) if seen), None) for kind in (_STAMPS, _PLACE)
    )
    if stamps and place:
        return "either" if mistake.kind != "none" else "other"
    one = stamps or place
    if one is None:
        return "doubt" if notes else "silent"
    if mistake.kind != ("stamps" if stamps else "antenna ahead"):
        return "other"
    value = float(one[1]) * (1.0 if one[3] in ("late", "ahead") else -1.0)
    sigma = float(one[2] or 0.0)
    right = abs(value - mistake.size) < max(3.0 * sigma, 0.1 * abs(mistake.size))
    return "named" if right else "other"


SAYS = ("named", "either", "other", "doubt", "silent")


def report(many: Sequence[Told]) -> Iterator[str]:
    """A line for each mistake, with fixes of each quality, and with holes."""
    yield (
        f"{'':<34}{'drives':>7}"
        + "".join(f"{name:>8}" for name in SAYS)
        + (f"{'used':>8}{'in 3 sigma: median':>20}{'worst':>8}{'< 95 %':>8}")
    )
    for kind in SIZES:
        of_kind = [one for one in many if one.mistake.kind == kind]
        yield _line(kind, of_kind)
        for quality in GRADES:
            part = [one for one in of_kind if one.mistake.quality == quality]
            yield _line(f"  {quality.name.lower()}", part)
        yield _line("  with holes", [one for one in of_kind if one.mistake.has_holes])


def _line(name: str, some: Sequence[Told]) -> str:
    counts = "".join(f"{sum(one.says == says for one in some):>8}" for says in SAYS)
    within = np.array([one.within for one in some if np.isfinite(one.within)])
    used = np.median([one.used for one in some]) if some else np.nan
    shares = "-"
    if len(within):
        shares = f"{np.median(within):>20.1%}{within.min():>8.1%}{int((within < 0.95).sum()):>8}"
    return f"{name:<34}{len(some):>7}{counts}{used:>8.0%}{shares}"


if __name__ == "__main__":
    count, first = [*map(int, sys.argv[1:]), *(200, 0)[len(sys.argv) - 1 :]]
    seeds = range(first, first + count)
    right = [told(seed) for seed in seeds]
    for line in report(right):
        print(line)
    unmistaken = [s for s, one in zip(seeds, right, strict=True) if one.mistake.kind == "none"]
    for name, wrong in GYROS.items():
        print(_line(f"none, gyro {name}", [told(seed, wrong) for seed in unmistaken]), flush=True)
