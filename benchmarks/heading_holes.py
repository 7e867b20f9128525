"""Simulated vehicles whose fixes have holes, positions only: headings between the holes, in sigmas.

The garden tractor is one vehicle, and its drives are few. Here harvesters, tractors and robots work
in rows and stop, cars turn at once, and holes come at a beat or at random.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.heading_scores import percent
from benchmarks.heading_stops import MACHINES, STANDING_MPS, Receiver, received, work
from benchmarks.random_drives import driven
from fieldgrid.core import Bool, Float64, GnssError, Quality
from fieldgrid.geometry import wrap_deg
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM

SEEDS = 4
VEHICLES = ("harvester", "tractor", "robot", "car")
RECEIVERS = (
    Receiver("10 Hz", 0.1, 0.008, 0.015),
    Receiver("5 Hz, late, misses", 0.2, 0.01, 0.015, 0.03, 0.05),
    Receiver("2 Hz", 0.5, 0.008, 0.015),
)
BEATS_S = {"8 of 10 s": (8.0, 10.0), "5 of 10 s": (5.0, 10.0), "3 of 20 s": (3.0, 20.0)}
AT_RANDOM = "at random"

HEAD = (
    f"{'':<28}{'holes':<12}{'moving':>8}{'used':>8}{'median':>8}{'95 %':>8}{'> 90°':>8}"
    f"{'3 sigma':>9}{'worst':>9}"
)


def kept(times_s: Float64, holes: str, random: np.random.Generator) -> Bool:
    """Instants that lie outside the holes."""
    if holes != AT_RANDOM:
        hole_s, every_s = BEATS_S[holes]
        return np.asarray(times_s % every_s > hole_s)
    seen, at_s = np.zeros(len(times_s), dtype=np.bool_), 0.0
    while at_s < times_s[-1]:
        until_s = at_s + 1.0 + random.exponential(6.0)
        seen |= (times_s >= at_s) & (times_s < until_s)
        at_s = until_s + random.uniform(1.5, 14.0)
    return seen


def found(vehicle: str, receiver: Receiver, holes: str, seed: int) -> tuple[Float64, Float64, Bool]:
    """Errors and sigmas, degrees, of a drive's moving poses at fixes, and which are accepted."""
    random = np.random.default_rng([43, seed])
    machines = {machine.name: machine for machine in MACHINES}
    drive = work(machines[vehicle], random) if vehicle in machines else driven(vehicle, random)
    fixes, truth = received(drive, receiver, random)
    seen = np.flatnonzero(kept(truth.time_s, holes, random))
    fixes, truth = fixes[seen], truth.at(truth.time_s[seen])
    moving = np.abs(truth.speed_mps) > STANDING_MPS
    try:
        estimate = estimate_poses(
            fixes.replace(quality=np.full(len(seen), int(Quality.RTK_FIXED))), None, DATUM
        )
    except GnssError:
        unknown = np.full(int(moving.sum()), np.nan)
        return unknown, unknown, np.zeros(len(unknown), dtype=np.bool_)
    track, row = estimate.trajectory, estimate.fix_row
    off = np.abs(wrap_deg(track.heading_deg[row] - np.degrees(truth.heading_rad)))
    return off[moving], track.heading_sigma_deg[row][moving], track.accepted[row][moving]


def report() -> Iterator[str]:
    """Accepted headings between the holes; asked: 98 % within three sigma."""
    yield HEAD
    for vehicle in VEHICLES:
        for holes in (*BEATS_S, AT_RANDOM):
            many = [found(vehicle, one, holes, k) for one in RECEIVERS for k in range(SEEDS)]
            yield _line(vehicle, holes, many)


def _line(vehicle: str, holes: str, many: list[tuple[Float64, Float64, Bool]]) -> str:
    used = np.concatenate([accepted for _, _, accepted in many])
    off, sigma = (np.concatenate([one[k] for one in many])[used] for k in (0, 1))
    line = f"{vehicle:<28}{holes:<12}{len(used):>8}{percent(used.mean(), 1):>8}"
    if not len(off):
        return line
    inside = [np.mean(o[a] <= 3.0 * s[a]) for o, s, a in many if a.any()]
    return (
        f"{line}{np.median(off):>7.2f}°{np.percentile(off, 95):>7.2f}°"
        f"{percent(np.mean(off > 90.0)):>8}{percent(np.mean(off <= 3.0 * sigma), 1):>9}"
        f"{percent(min(inside), 1):>9}"
    )
