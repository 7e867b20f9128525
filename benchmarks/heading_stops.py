"""Simulated vehicles that stop, positions only: headings in sigmas, driving and at rest.

A machine works in rows, stops in rows and in the turns between them, and backs up. Its receiver
says nothing of its quality, wanders slowly, stamps late by not always the same, and misses some
fixes. At rest nothing shows a heading but the last metre before and the first after.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.heading_scores import percent
from fieldgrid.core import Bool, Float64, GnssError, Quality
from fieldgrid.geometry import FixColumns, wrap_deg
from fieldgrid.poses import estimate_poses
from tests.simulated import DATUM, Command, Drive, simulate, time_ns

SEEDS, ROWS = 6, 6
LOCK_S, LOCK_PIECES = 1.5, 6
"""From straight on to the tightest turn, a wheel is turned for so long."""

STOP_S, STANDING_MPS, TURNING_SHARE = 20.0, 0.02, 0.3


class Machine(NamedTuple):
    """What turns no tighter than `radius_m`; in some of its stops it turns by up to `spot_deg`."""

    name: str
    speed_mps: float
    radius_m: float
    row_s: float
    spot_deg: float = 0.0


class Receiver(NamedTuple):
    """The period of a receiver, its noise and slow error, how late it stamps, what it misses."""

    name: str
    period_s: float
    noise_m: float
    wander_m: float = 0.0
    late_s: float = 0.0
    missing: float = 0.0


MACHINES = (
    Machine("harvester", 1.7, 7.0, 35.0),
    Machine("tractor", 1.5, 3.5, 30.0),
    Machine("robot", 0.8, 1.0, 25.0),
    Machine("robot, turns on the spot", 0.8, 1.0, 25.0, 70.0),
)
RECEIVERS = (
    Receiver("1 Hz, 2 cm", 1.0, 0.02, 0.3),
    Receiver("1 Hz, 2 cm, late, misses", 1.0, 0.02, 0.3, 0.1, 0.15),
    Receiver("1 Hz, 8 cm", 1.0, 0.08, 0.3),
    Receiver("5 Hz, 3 cm", 0.2, 0.03, 0.3),
)


def work(machine: Machine, random: np.random.Generator) -> Drive:
    """Rows with turns between them, and stops anywhere."""
    commands, v = [Command(8.0, machine.speed_mps)], machine.speed_mps
    for _ in range(ROWS):
        bend = float(random.choice([-1.0, 1.0])) / machine.radius_m
        half_turn_s = np.pi * machine.radius_m / v
        stops_at = random.uniform(0.2, 0.8)
        commands += [Command(machine.row_s * stops_at, v)]
        if random.uniform() < 0.5:
            commands += [Command(STOP_S, 0.0)]
        commands += [Command(machine.row_s * (1.0 - stops_at), v)]
        stops_at = random.uniform(0.2, 0.8)
        commands += [*_into(v, bend), Command(half_turn_s * stops_at, v, bend)]
        kind = random.uniform()
        if kind < 0.6:
            commands += [Command(STOP_S, 0.0, bend if kind < 0.3 else 0.0)]
        elif kind < 0.8:
            commands += [Command(6.0, -0.7 * v, -bend)]
        commands += [Command(half_turn_s * (1.0 - stops_at), v, bend), *_into(v, bend)[::-1]]
    return simulate(commands, float(random.uniform(0.0, 360.0)), speed_mps=v)


def _into(speed_mps: float, bend: float) -> list[Command]:
    """The way into a turn."""
    pieces = np.arange(1, LOCK_PIECES + 1) / LOCK_PIECES
    return [Command(LOCK_S / LOCK_PIECES, speed_mps, float(bend * share)) for share in pieces]


def turned_on_spot(drive: Drive, most_deg: float, random: np.random.Generator) -> Drive:
    """The drive whose vehicle turns in some of its stops, and goes on from there."""
    standing = np.abs(drive.speed_mps) < STANDING_MPS
    edges = np.flatnonzero(np.diff(np.concatenate([[False], standing, [False]]).astype(np.int8)))
    points, heading = drive.point(0.0, 0.0), drive.heading_rad.copy()
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        if drive.time_s[stop - 1] - drive.time_s[first] < STOP_S / 2.0 or random.uniform() < 0.5:
            continue
        turn = np.radians(random.uniform(-most_deg, most_deg))
        middle = (first + stop) // 2
        heading[first:] += np.clip((drive.time_s[first:] - drive.time_s[middle]) / 3.0, 0, 1) * turn
        sin, cos, pivot = np.sin(turn), np.cos(turn), points[stop - 1]
        east, north = (points[stop:] - pivot).T
        points[stop:] = pivot + np.stack([east * cos + north * sin, north * cos - east * sin], 1)
    return drive._replace(east_m=points[:, 0], north_m=points[:, 1], heading_rad=heading)


def received(drive: Drive, one: Receiver, random: np.random.Generator) -> tuple[FixColumns, Drive]:
    """What the receiver says, and the truth at its fixes."""
    times = np.arange(0.0, drive.time_s[-1], one.period_s)
    times = times[random.uniform(size=len(times)) >= one.missing]
    late_s = one.late_s * np.abs(random.normal(size=len(times)))
    at = drive.at(times - late_s)
    fading = np.exp(-one.period_s / 120.0)
    wander = np.zeros((2, len(times)))
    for k in range(1, len(times)):
        fresh = random.normal(size=2) * np.sqrt(1.0 - fading**2)
        wander[:, k] = fading * wander[:, k - 1] + fresh
    off = one.wander_m * wander + one.noise_m * random.normal(size=wander.shape)
    lat, lon, _ = DATUM.to_geodetic(at.east_m + off[0], at.north_m + off[1], np.zeros(len(times)))
    quality = np.full(len(times), int(Quality.UNKNOWN))
    fixes = FixColumns.of(time_ns(times), lat_deg=lat, lon_deg=lon, height_m=0.0, quality=quality)
    return fixes, drive.at(times)


class Found(NamedTuple):
    """Errors and sigmas, degrees, of all poses at fixes, and which are accepted; `resting` and
    `turning` by the truth."""

    off_deg: Float64
    sigma_deg: Float64
    accepted: Bool
    resting: Bool
    turning: Bool


def found(machine: Machine, receiver: Receiver, seed: int) -> Found | None:
    """One drive; None where it is refused as a whole."""
    random = np.random.default_rng(seed)
    drive = work(machine, random)
    if machine.spot_deg:
        drive = turned_on_spot(drive, machine.spot_deg, random)
    fixes, truth = received(drive, receiver, random)
    try:
        estimate = estimate_poses(fixes, None, DATUM)
    except GnssError:
        return None
    track, row = estimate.trajectory, estimate.fix_row
    off = np.abs(wrap_deg(track.heading_deg[row] - np.degrees(truth.heading_rad)))
    resting = np.abs(truth.speed_mps) < STANDING_MPS
    bends = np.abs(truth.curvature_per_m) * machine.radius_m > TURNING_SHARE
    return Found(off, track.heading_sigma_deg[row], track.accepted[row], resting, ~resting & bends)


HEAD = (
    f"{'':<52}{'':<11}{'epochs':>8}{'used':>8}{'median':>8}{'95 %':>8}{'sigma':>8}{'3 sigma':>9}"
    f"{'worst':>9}"
)


def report() -> Iterator[str]:
    """Accepted headings of each machine and receiver; asked: 98 % within three sigma."""
    yield HEAD
    for machine in MACHINES:
        for receiver in RECEIVERS:
            many = [one for k in range(SEEDS) if (one := found(machine, receiver, k)) is not None]
            for kind in ("straight", "turning", "at rest"):
                yield _line(f"{machine.name}, {receiver.name}", kind, many)


def _line(name: str, kind: str, many: list[Found]) -> str:
    used, all_of = [], 0
    for one in many:
        of = {"at rest": one.resting, "turning": one.turning}.get(kind, ~one.resting & ~one.turning)
        all_of += int(of.sum())
        used.append(np.stack([one.off_deg, one.sigma_deg])[:, of & one.accepted])
    off, sigma = np.concatenate(used, axis=1)
    line = f"{name:<52}{kind:<11}{all_of:>8}{percent(len(off) / max(all_of, 1), 1):>8}"
    if not len(off):
        return line
    inside = [float(np.mean(o <= 3.0 * s)) for o, s in used if len(o)]
    return (
        f"{line}{np.median(off):>7.2f}°{np.percentile(off, 95):>7.2f}°{np.median(sigma):>7.2f}°"
        f"{percent(np.mean(off <= 3.0 * sigma), 1):>9}{percent(min(inside), 1):>9}"
    )
