"""Simulated vehicles that back up where nobody sees it: headings and gears of logs with holes.

`python -m benchmarks.heading_shunts [COUNT [FIRST]]`. A vehicle, what it does, its holes and its
receiver are drawn with each seed. Each kind of work backs up in its own way, and one never does.
What matters is how many of the accepted headings are the other way round, over all drives and in
the worst of them, and whether the doubt that is said is the share that is wrong.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from multiprocessing import Pool
from typing import NamedTuple

import numpy as np

from benchmarks.heading_honesty import DECADES
from benchmarks.heading_scores import percent
from benchmarks.heading_stops import MACHINES, Machine, Receiver, received, work
from fieldgrid.core import Bool, Float64, GnssError, PoseSettings, Quality
from fieldgrid.geometry import Motion, wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import smooth_drive
from fieldgrid.poses.fused import conditioned
from tests.simulated import DATUM, Command, Drive, simulate

LASTS_S, MOVING_MPS = 400.0, 0.3
RATES_HZ = (1.0, 2.0, 5.0, 10.0)
BEATS_S = {
    "8 of 10 s": (8.0, 10.0),
    "5 of 10 s": (5.0, 10.0),
    "12 of 15 s": (12.0, 15.0),
    "3 of 20 s": (3.0, 20.0),
}
AT_RANDOM = "at random"
GRADES = {
    Quality.RTK_FIXED: (0.008, 0.015),
    Quality.DIFFERENTIAL: (0.03, 0.3),
    Quality.UNKNOWN: (0.015, 0.1),
}
"""The noise and the slow error of a receiver, metres, by what it calls its fixes."""


def k_turns(machine: Machine, random: np.random.Generator) -> list[Command]:
    """Rows, at whose ends it turns about in three strokes."""
    v, bend = machine.speed_mps, random.choice([-1.0, 1.0]) / machine.radius_m
    first, back = random.uniform(0.6, 1.6), random.uniform(0.4, 1.4)
    strokes = (first, back, max(np.pi - first - back, 0.3))
    out = [Command(random.uniform(0.5, 1.0) * machine.row_s, v)]
    for k, turned in enumerate(strokes):
        way = -0.7 if k == 1 else 0.9
        out += [Command(turned * machine.radius_m / (abs(way) * v), way * v, way / abs(way) * bend)]
    return out


def shunts(machine: Machine, random: np.random.Generator) -> list[Command]:
    """Back and forth in curves, as who loads does, with short stops."""
    v, out = machine.speed_mps, []
    for way in (1.0, -0.8):
        bend = random.uniform(-1.0, 1.0) / machine.radius_m
        out += [Command(random.uniform(4.0, 14.0), way * v, bend)]
        out += [Command(random.uniform(0.0, 3.0), 0.0, bend)]
    return out


def shuttles(machine: Machine, random: np.random.Generator) -> list[Command]:
    """Up a row and back out of it in reverse."""
    v, row_s = machine.speed_mps, random.uniform(0.5, 1.0) * machine.row_s
    aside = random.uniform(-0.3, 0.3) / machine.radius_m
    return [Command(row_s, v), Command(row_s, -0.8 * v), Command(6.0, v, aside)]


def dead_ends(machine: Machine, random: np.random.Generator) -> list[Command]:
    """Into a dead end, back out of it around a corner, and on; often it drives on without."""
    v, bend = machine.speed_mps, random.choice([-1.0, 1.0]) / machine.radius_m
    corner_s = random.uniform(0.8, 1.8) * machine.radius_m / (0.7 * v)
    out = [Command(random.uniform(10.0, 40.0), v), Command(1.5 * corner_s, v, bend)]
    if random.uniform() < 0.5:
        straight_s = random.uniform(2.0, 12.0)
        out += [Command(straight_s, v), Command(straight_s, -0.7 * v)]
        out += [Command(corner_s, -0.7 * v, -bend)]
    return out


def turns(machine: Machine, random: np.random.Generator) -> list[Command]:
    """Rows and turns, never back."""
    v, bend = machine.speed_mps, random.choice([-1.0, 1.0]) / machine.radius_m
    row_s, stop_s = random.uniform(0.5, 1.0) * machine.row_s, random.choice([0.0, 0.0, 8.0])
    return [
        *(Command(row_s, v), Command(stop_s, 0.0)),
        Command(np.pi * machine.radius_m / v * random.uniform(0.8, 1.1), v, bend),
    ]


Piece = Callable[[Machine, np.random.Generator], list[Command]]
WORKS: dict[str, Piece | None] = {
    "K-turns": k_turns,
    "shunts": shunts,
    "shuttles": shuttles,
    "dead ends": dead_ends,
    "turns": turns,
    "rows and stops": None,
}
"""What a vehicle does over and over; None: :func:`benchmarks.heading_stops.work`."""


class Case(NamedTuple):
    """What is drawn with a seed."""

    seed: int
    machine: Machine
    works: str
    holes: str
    receiver: Receiver
    quality: Quality


class Found(NamedTuple):
    """Of a case, at its fixes while moving: how far headings are off, degrees, their sigmas, which
    are accepted, whose gears are right, and the doubt of the gear that is said; nothing of a drive
    that is refused."""

    case: Case
    off_deg: Float64
    sigma_deg: Float64
    accepted: Bool
    right: Bool
    doubt: Float64

    @property
    def turned(self) -> float:
        """The share of the accepted headings that are the other way round."""
        return float(np.mean(self.off_deg[self.accepted] > 90.0)) if self.accepted.any() else 0.0


def drawn(seed: int) -> tuple[Case, np.random.Generator]:
    """The case of a seed."""
    random = np.random.default_rng([71, seed])
    machine = MACHINES[int(random.choice(3))]
    machine = machine._replace(
        speed_mps=machine.speed_mps * random.uniform(0.7, 1.6),
        radius_m=machine.radius_m * random.uniform(0.8, 1.5),
    )
    rate_hz, quality = float(random.choice(RATES_HZ)), Quality(int(random.choice(list(GRADES))))
    late_s, missing = [(0.0, 0.0), (0.03, 0.05)][int(random.choice(2))]
    receiver = Receiver(f"{rate_hz:g} Hz", 1.0 / rate_hz, *GRADES[quality], late_s, missing)
    works = list(WORKS)[seed % len(WORKS)]
    return Case(
        seed, machine, works, str(random.choice([*BEATS_S, AT_RANDOM])), receiver, quality
    ), random


def driven(case: Case, random: np.random.Generator) -> Drive:
    """The drive of a case."""
    piece = WORKS[case.works]
    if piece is None:
        return work(case.machine, random)
    commands = [Command(random.uniform(5.0, 15.0), case.machine.speed_mps)]
    while sum(one.seconds for one in commands) < LASTS_S:
        commands += piece(case.machine, random)
    heading_deg = float(random.uniform(0.0, 360.0))
    return simulate(commands, heading_deg, speed_mps=case.machine.speed_mps)


def kept(times_s: Float64, holes: str, random: np.random.Generator) -> Bool:
    """Instants that lie outside the holes."""
    if holes != AT_RANDOM:
        hole_s, every_s = BEATS_S[holes]
        phase_s = random.uniform(0.0, every_s)
        return np.asarray((times_s + phase_s) % every_s > hole_s)
    seen, at_s = np.zeros(len(times_s), dtype=np.bool_), 0.0
    while at_s < times_s[-1]:
        until_s = at_s + 1.0 + random.exponential(6.0)
        seen |= (times_s >= at_s) & (times_s < until_s)
        at_s = until_s + random.uniform(1.5, 14.0)
    return seen


def found(seed: int) -> Found:
    """The poses of a case beside its truth."""
    case, random = drawn(seed)
    fixes, truth = received(driven(case, random), case.receiver, random)
    seen = np.flatnonzero(kept(truth.time_s, case.holes, random))
    fixes, truth = fixes[seen], truth.at(truth.time_s[seen])
    fixes = fixes.replace(quality=np.full(len(seen), int(case.quality)))
    moving = np.abs(truth.speed_mps) > MOVING_MPS
    n = int(moving.sum())
    try:
        known = conditioned(fixes, PoseSettings(), DATUM)
        drive = smooth_drive(known.accepted, known.fixes.time_ns, Motion(), Axle(None))
        estimate = estimate_poses(fixes, None, DATUM)
    except GnssError:
        none = np.zeros(n, dtype=np.bool_)
        return Found(case, *2 * (np.full(n, np.nan),), none, none, np.full(n, np.nan))
    track, row = estimate.trajectory, estimate.fix_row
    off = np.abs(wrap_deg(track.heading_deg[row] - np.degrees(truth.heading_rad)))
    node = np.searchsorted(drive.time_ns, fixes.time_ns)
    doubt = drive.doubt[np.minimum(node, len(drive.doubt) - 1)]
    columns = off, track.heading_sigma_deg[row], track.accepted[row]
    right = track.gear[row] == truth.gear()
    return Found(case, *(column[moving] for column in (*columns, right, doubt)))


def _lines(title: str, groups: dict[str, list[Found]]) -> Iterator[str]:
    """A line a group: of the accepted headings, and of the worst drive."""
    yield (
        f"{title:<16}{'drives':>7}{'moving':>8}{'used':>8}{'> 90°':>8}{'gear':>8}{'3 sigma':>9}"
        f"{'drives > 0.5 %':>16}{'worst':>8}{'seed':>6}"
    )
    for name, many in groups.items():
        used = np.concatenate([one.accepted for one in many])
        off, sigma = (np.concatenate([one[k][one.accepted] for one in many]) for k in (1, 2))
        right = np.concatenate([one.right[one.accepted] for one in many])
        worst = max(many, key=lambda one: one.turned)
        yield (
            f"{name:<16}{len(many):>7}{len(used):>8}{percent(used.mean(), 1):>8}"
            f"{percent(np.mean(off > 90.0)):>8}{percent(right.mean()):>8}"
            f"{percent(np.mean(off <= 3.0 * sigma), 1):>9}"
            f"{sum(one.turned > 0.005 for one in many):>16}{percent(worst.turned, 1):>8}"
            f"{worst.case.seed:>6}"
        )


def report(many: Sequence[Found]) -> Iterator[str]:
    """Tables by what was drawn, and the doubt that is said beside what is observed."""
    for title, name in (
        ("work", lambda case: case.works),
        ("holes", lambda case: case.holes),
        ("receiver", lambda case: case.quality.label),
        ("rate", lambda case: case.receiver.name),
        ("", lambda _: "all"),
    ):
        groups: dict[str, list[Found]] = {}
        for one in many:
            groups.setdefault(name(one.case), []).append(one)
        yield from _lines(title, groups)
    doubt, off = (np.concatenate([one[k] for one in many]) for k in (5, 1))
    yield f"{'said doubt':<22}{'headings':>9}{'said, mean':>12}{'wrong':>9}{'drives':>8}"
    for low, high in pairwise(DECADES):
        inside = (doubt >= low) & (doubt < high)
        drives = sum(bool(((one.doubt >= low) & (one.doubt < high)).any()) for one in many)
        if inside.any():
            yield (
                f"{f'{low:g} to {min(high, 0.5):g}':<22}{inside.sum():>9}"
                f"{percent(doubt[inside].mean(), 4):>12}{percent(np.mean(off[inside] > 90.0)):>9}"
                f"{drives:>8}"
            )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=96)
    parser.add_argument("first", nargs="?", type=int, default=0)
    options = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with Pool(2) as pool:
        many = pool.map(found, range(options.first, options.first + options.count), 4)
    for line in report(many):
        print(line)


if __name__ == "__main__":
    main()
