"""Random drives beside their truth: `python -m benchmarks.random_drives [COUNT [FIRST]]`.

A vehicle, its sensors, its receiver, what that states of its error, and one fault are drawn with
each seed. What matters is whether poses are within three of their sigmas, and of those that are
not whether the report says so: in a note (else the drive is *silent*), or at least as a fault that
this drive would not show (else it is *unnamed*). `--each` prints every drive that is silently
wrong, the worst last, and `*` after those that are unnamed.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from itertools import pairwise
from multiprocessing import Pool
from typing import NamedTuple

import numpy as np

from benchmarks.heading_scores import percent
from benchmarks.heading_stops import MACHINES, work
from benchmarks.variations import THREE_SIGMA_2D
from fieldgrid.core import Float64, GnssError, Quality
from fieldgrid.geometry import (
    FixColumns,
    LeverArm,
    Lidar,
    Motion,
    Mount,
    Rig,
    Steps,
    WheelSpeed,
    wrap_deg,
)
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.faults.unseen import UnseenFault
from tests.simulated import DATUM, Command, Drive, gyro_of, simulate, steps_of, time_ns
from tests.told import warnings

MOST_BEYOND = 0.05
"""A drive is wrong when more of its accepted poses are beyond three sigma."""

VEHICLES = ("tractor", "robot", "harvester", "car")
SENSORS = {
    "fixes": "",
    "gyro": "g",
    "camera": "c",
    "gyro, camera": "gc",
    "gyro, wheels": "gw",
    "recorded heading": "h",
}
FAULTS = (
    *("none", "multipath", "drift", "holes", "late stamps", "antenna aside", "antenna ahead"),
    *("gyro scale", "camera scale", "slope"),
)
NAMED = {
    "antenna aside": UnseenFault.ANTENNA_ASIDE,
    "antenna ahead": UnseenFault.ANTENNA_AHEAD,
    "late stamps": UnseenFault.LATE_STAMPS,
    "drift": UnseenFault.SLOW_DRIFT,
}
"""What a report calls these faults where a drive would not show them."""

RATES_HZ = (1.0, 2.0, 5.0, 10.0)
STATEMENTS = {"right": 1.0, "3 x too small": 1.0 / 3.0, "3 x too large": 3.0, "growing": 1.0}
GRADES = {Quality.RTK_FIXED: 0.015, Quality.DIFFERENTIAL: 0.4, Quality.RTK_FLOAT: 0.15}
"""The slow error of a receiver, metres, by what it calls its fixes."""


class Case(NamedTuple):
    """What is drawn with a seed; `size` is that of the fault, in its own unit."""

    seed: int
    vehicle: str
    sensors: str
    statement: str
    quality: Quality
    rate_hz: float
    white_share: float
    lasts_s: float
    fault: str
    size: float


class Found(NamedTuple):
    """Of a case: the share of accepted poses, those of their positions and headings that are beyond
    three sigma, the largest errors, median sigmas, and of the report the warnings and the faults
    that it names as not seen."""

    case: Case
    accepted: float
    place_beyond: float
    heading_beyond: float
    most_m: float
    sigma_m: float
    most_deg: float
    sigma_deg: float
    notes: tuple[str, ...]
    unseen: tuple[UnseenFault, ...] = ()

    @property
    def is_wrong(self) -> bool:
        """Whether too many of its poses are beyond three sigma."""
        return max(self.place_beyond, self.heading_beyond) > MOST_BEYOND

    @property
    def is_silent(self) -> bool:
        """Whether they are, and no note says that something is wrong."""
        return self.is_wrong and not self.notes

    @property
    def is_unnamed(self) -> bool:
        """Whether they are, and the fault is not even among those that the report names."""
        return self.is_silent and NAMED.get(self.case.fault) not in self.unseen


def drawn(seed: int) -> tuple[Case, np.random.Generator]:
    """The case of a seed."""
    random = np.random.default_rng([2611, seed])
    sensors = str(random.choice(list(SENSORS)))
    possible = [
        fault
        for fault in FAULTS
        if not (fault == "gyro scale" and "g" not in SENSORS[sensors])
        and not (fault == "camera scale" and "c" not in SENSORS[sensors])
    ]
    fault = str(random.choice(possible))
    low, high = {
        "multipath": (0.3, 2.0),
        "drift": (0.3, 2.0),
        "holes": (3.0, 9.0),
        "late stamps": (0.05, 0.4),
        "antenna aside": (0.2, 1.0),
        "antenna ahead": (0.2, 1.0),
        "gyro scale": (0.03, 0.1),
        "camera scale": (0.02, 0.06),
        "slope": (3.0, 12.0),
    }.get(fault, (0.0, 0.0))
    return Case(
        seed,
        str(random.choice(VEHICLES)),
        sensors,
        str(random.choice(list(STATEMENTS))),
        Quality(int(random.choice(list(GRADES)))),
        float(random.choice(RATES_HZ)),
        float(random.uniform(0.05, 0.3)),
        float(random.choice([60.0, 300.0])),
        fault,
        float(random.uniform(low, high) * random.choice([-1.0, 1.0])),
    ), random


def driven(vehicle: str, random: np.random.Generator) -> Drive:
    """The drive of a vehicle."""
    for machine in MACHINES:
        if machine.name == vehicle:
            return work(machine, random)
    commands = [Command(8.0, 6.0)]
    for _ in range(14):
        commands += [
            Command(random.uniform(4.0, 12.0), random.uniform(5.0, 10.0)),
            Command(random.uniform(2.0, 5.0), 5.0, random.uniform(-0.1, 0.1)),
        ]
        if random.uniform() < 0.2:
            commands += [Command(random.uniform(5.0, 20.0), 0.0)]
    return simulate(commands, float(random.uniform(0.0, 360.0)), speed_mps=6.0)


# --- what its sensors record

DECLARED = LeverArm(0.0, 0.6, 2.6)
"""The antenna as declared, ahead of the axle, which is below the grid origin."""


def rig() -> Rig:
    """The vehicle as declared."""
    return Rig(Lidar(20_000.0), Mount(2.0, 0.0), DECLARED, rear_axle_forward_m=0.0)


def received(case: Case, drive: Drive, random: np.random.Generator) -> FixColumns:
    """The fixes of a case."""
    fault, size = case.fault, case.size
    times = np.arange(0.0, drive.time_s[-1], 1.0 / case.rate_hz)
    if fault == "holes":
        times = times[times % (2.5 * abs(size)) > abs(size)]
    late_s = abs(size) if fault == "late stamps" else 0.0
    at = drive.at(np.maximum(times - late_s, 0.0))
    point = at.point(
        DECLARED.right_m + size * (fault == "antenna aside"),
        DECLARED.forward_m + size * (fault == "antenna ahead"),
    )
    up_m, lean = _ground(case, at, random)
    true_m = np.full(len(times), GRADES[case.quality])
    if case.statement == "growing":
        true_m = true_m * np.linspace(1.0, 3.0, len(times))
    away = true_m[:, None] * _slow(times, case.lasts_s, random)
    away += case.white_share * true_m[:, None] * random.normal(size=away.shape)
    away -= DECLARED.up_m * lean
    away += _fault_m(case, times, random)
    east, north = (point + away).T
    lat, lon, height = DATUM.to_geodetic(east, north, up_m + DECLARED.up_m)
    heading = np.full(len(times), np.nan)
    if "h" in SENSORS[case.sensors]:
        offset = random.normal(0.0, 0.5)
        heading = np.degrees(at.heading_rad) + offset + random.normal(0.0, 0.5, len(times))
    return FixColumns.of(
        time_ns(times),
        lat_deg=lat,
        lon_deg=lon,
        height_m=height,
        quality=int(case.quality),
        sigma_m=true_m * STATEMENTS[case.statement],
        satellites=12,
        hdop=0.8,
        age_s=1.0,
        heading_deg=wrap_deg(heading),
        heading_sigma_deg=np.where(np.isfinite(heading), 0.5, np.nan),
    )


def _slow(times: Float64, lasts_s: float, random: np.random.Generator) -> Float64:
    """A slow error [n, 2] of unit sigma."""
    error = np.empty((len(times), 2))
    error[0] = random.normal(size=2)
    for k, step_s in enumerate(np.diff(times), 1):
        fading = np.exp(-step_s / lasts_s)
        error[k] = fading * error[k - 1] + np.sqrt(1.0 - fading**2) * random.normal(size=2)
    return error


def _ground(case: Case, at: Drive, random: np.random.Generator) -> tuple[Float64, Float64]:
    """The height of the ground and its slope east and north [n, 2] below a drive: a hillside."""
    way, wave_m = np.radians(random.uniform(0.0, 360.0)), random.uniform(25.0, 60.0)
    steep = np.tan(np.radians(abs(case.size))) if case.fault == "slope" else 0.0
    uphill = np.array([np.sin(way), np.cos(way)])
    along = at.east_m * uphill[0] + at.north_m * uphill[1]
    height = steep * (along + 0.5 * wave_m / 6.28 * np.sin(along * 6.28 / wave_m))
    slope = steep * (1.0 + 0.5 * np.cos(along * 6.28 / wave_m))
    return height, slope[:, None] * uphill


def _fault_m(case: Case, times: Float64, random: np.random.Generator) -> Float64:
    """What a fault adds to the positions [n, 2]."""
    way, off = np.radians(random.uniform(0.0, 360.0)), np.zeros(len(times))
    if case.fault == "drift":
        share = times / times[-1]
        shape = random.choice(3)
        off = (share, np.sin(np.pi * share) ** 2, np.sin(np.pi * share))[shape] * case.size
    elif case.fault == "multipath":
        start_s = 20.0
        while start_s < times[-1]:
            lasts_s = random.uniform(3.0, 30.0)
            inside = (times >= start_s) & (times < start_s + lasts_s)
            off[inside] = case.size * random.uniform(0.5, 1.0)
            start_s += lasts_s + random.uniform(20.0, 60.0)
    return np.outer(off, [np.sin(way), np.cos(way)])


def moved(case: Case, drive: Drive, random: np.random.Generator) -> Motion:
    """The motion that the other sensors of a case record."""
    has, seed = SENSORS[case.sensors], int(random.integers(1 << 30))
    gyro, steps, wheels = None, None, None
    if "g" in has:
        gyro = gyro_of(drive, 50.0, random.uniform(-0.5, 0.5), 0.1, seed)
        size = 1.0 + (case.size if case.fault == "gyro scale" else random.normal(0.0, 0.01))
        gyro = gyro._replace(rate_rad_s=gyro.rate_rad_s * size)
    if "c" in has:
        steps = steps_of(drive, 0.5, noise=1.0, seed=seed)
        steps = _scaled(steps, 1.0 + (case.size if case.fault == "camera scale" else 0.003))
    if "w" in has:
        at = drive.every(0.1)
        slip = 1.0 + random.normal(0.0, 0.02) + random.normal(0.0, 0.02, len(at.time_s))
        wheels = WheelSpeed(time_ns(at.time_s), at.speed_mps * slip)
    return Motion(gyro=gyro, wheels=wheels, steps=steps)


def _scaled(steps: Steps, size: float) -> Steps:
    unknown = np.full(len(steps.start_ns), np.nan)  # how it leans on a slope
    return steps._replace(
        forward_m=steps.forward_m * size,
        right_m=steps.right_m * size,
        up_m=unknown,
        roll_deg=unknown,
        pitch_deg=unknown,
        tilt_sigma_deg=unknown,
    )


# --- what its poses say


def found(seed: int) -> Found:
    """The poses of a case beside its truth."""
    case, random = drawn(seed)
    drive = driven(case.vehicle, random)
    fixes = received(case, drive, random)
    motion = moved(case, drive, random)
    nothing = np.nan
    try:
        estimate = estimate_poses(fixes, rig(), DATUM, motion=motion)
    except GnssError as problem:
        return Found(case, 0.0, *6 * (nothing,), (str(problem),))
    track, report = estimate.trajectory, estimate.report
    notes = tuple(map(str, warnings(report)))
    used = estimate.fix_row[track.accepted[estimate.fix_row]]
    accepted = float(track.accepted[estimate.fix_row].mean())
    if not len(used):
        return Found(case, 0.0, *6 * (nothing,), notes)
    truth = drive.at((track.time_ns[used] - time_ns(np.zeros(1))[0]) / 1e9)
    off_m = np.hypot(track.east_m[used] - truth.east_m, track.north_m[used] - truth.north_m)
    off_deg = np.abs(wrap_deg(track.heading_deg[used] - np.degrees(truth.heading_rad)))
    sigma_m, sigma_deg = track.position_sigma_m[used], track.heading_sigma_deg[used]
    return Found(
        case,
        accepted,
        float(np.mean(off_m > THREE_SIGMA_2D * sigma_m)),
        float(np.mean(off_deg > 3.0 * sigma_deg)),
        float(off_m.max()),
        float(np.median(sigma_m)),
        float(off_deg.max()),
        float(np.median(sigma_deg)),
        notes,
        report.unseen,
    )


def _each(many: Sequence[Found]) -> Iterator[str]:
    """A line a drive that is wrong and silent, the worst last."""
    silent = [one for one in many if one.is_silent]
    for one in sorted(silent, key=lambda one: max(one.place_beyond, one.heading_beyond)):
        case = one.case
        yield (
            f"{case.seed:>6} {case.vehicle:<10}{case.sensors:<17}{case.statement:<14}"
            f"{case.quality.label:<13}{case.rate_hz:>3.0f}Hz {case.lasts_s:>4.0f}s "
            f"{case.fault:<14}{case.size:>6.2f} used {percent(one.accepted):>5}"
            f" place {percent(one.place_beyond):>5} {one.most_m:>5.2f} m ({one.sigma_m:.2f})"
            f" heading {percent(one.heading_beyond):>5} {one.most_deg:>5.1f}° ({one.sigma_deg:.1f})"
            f"{' *' if one.is_unnamed else ''}"
        )


def _table(title: str, groups: dict[str, list[Found]]) -> Iterator[str]:
    """A line a group of drives."""
    yield (
        f"{title:<44}{'drives':>7}{'used':>9}{'place in 3':>12}{'worst':>10}"
        f"{'heading in 3':>14}{'worst':>10}{'wrong':>7}{'silent':>8}{'unnamed':>9}"
    )
    for name, many in groups.items():
        known = [one for one in many if np.isfinite(one.place_beyond)]
        place = 1.0 - np.array([one.place_beyond for one in known])
        heading = 1.0 - np.array([one.heading_beyond for one in known])
        wrong = [one for one in known if one.is_wrong]
        if not known:
            continue
        yield (
            f"{name:<44}{len(many):>7}{percent(float(np.mean([m.accepted for m in many])), 1):>9}"
            f"{percent(float(place.mean()), 1):>12}{percent(float(place.min())):>10}"
            f"{percent(float(heading.mean()), 1):>14}{percent(float(heading.min())):>10}"
            f"{len(wrong):>7}{sum(one.is_silent for one in wrong):>8}"
            f"{sum(one.is_unnamed for one in wrong):>9}"
        )


def report(many: Sequence[Found]) -> Iterator[str]:
    """Tables by what was drawn."""
    names = ("fault", "statement", "sensors", "vehicle")
    for name in names:
        yield from _table(name, _grouped(many, name))
    for one, other in pairwise(("fault", "statement", "sensors")):
        yield from _table(f"{one}, {other}", _grouped(many, one, other))
    yield from _table("", {"all": list(many)})


def _grouped(many: Sequence[Found], *names: str) -> dict[str, list[Found]]:
    groups: dict[str, list[Found]] = {}
    for one in sorted(many, key=lambda one: [getattr(one.case, name) for name in names]):
        groups.setdefault(", ".join(getattr(one.case, name) for name in names), []).append(one)
    return groups


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=300)
    parser.add_argument("first", nargs="?", type=int, default=0)
    parser.add_argument("--each", action="store_true")
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with Pool(2) as pool:
        many = pool.map(found, range(options.first, options.first + options.count), 4)
    if options.each:
        for line in _each(many):
            print(line)
    for line in report(many):
        print(line)


if __name__ == "__main__":
    main()
