"""A garden tractor, positions only, beside its dual-antenna heading.

The log has rows at 20 to 40 Hz. Positions come at about 8 Hz and headings at 5 Hz; in between,
both are repeated, and where the radio link broke the last heading stays for seconds although it
is still marked valid. So a heading counts as truth only in the row where it changes, and only
while its baseline is fixed. Its lag of about 0.05 s is not corrected: it is in our errors. One
offset a log, of the two antennas' baseline from the nose, is: the median over moving epochs.

The gear is that of the transmission: its actuator stands near 2840 in neutral, above in
reverse. Next to neutral it tells nothing, and neither does it while the vehicle stands.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.heading_scores import (
    DATA,
    SCORES_HEAD,
    Scores,
    circular_median_deg,
    make_fixes,
    numbers,
    percent,
    pooled,
    poses_at,
    scores_line,
    table,
)
from fieldgrid.core import GnssError
from fieldgrid.geometry import wrap_deg
from fieldgrid.poses import estimate_poses

FOLDER = DATA / "gnss" / "tractor2025" / "compact"

QUALITY = {"RTK Fixed": 4, "RTK Float": 5, "DGPS": 2, "Invalid": 0}

NEUTRAL, NEAR_NEUTRAL = 2840.0, 60.0
MOVING_MPS, RESTING_MPS, SURELY_RESTING_MPS = 0.2, 0.2, 0.05
FEWEST_MOVING = 20
OWN_SPAN_S, FEWEST_AT_STOP = 1.2, 10

_Float64 = npt.NDArray[np.float64]
_Int64 = npt.NDArray[np.int64]


class Log(NamedTuple):
    """A log of n rows. `truth_deg` is NaN where it is none; `true_gear` 0 where unknown."""

    name: str
    time_ns: _Int64
    lat_deg: _Float64
    lon_deg: _Float64
    quality: _Int64
    truth_deg: _Float64
    speed_mps: _Float64
    true_gear: _Int64


def logs() -> list[Log]:
    return [read_log(path) for path in sorted(FOLDER.glob("*.csv"))]


def read_log(path: Path) -> Log:
    """The rows of a log; those without a position keep NaN there."""
    names = ("time", "lat", "lon", "fix_quality", "heading_deg", "head_valid", "carrier")
    text = table(path, (*names, "speed_mps", "jrk_current"))
    seconds = [datetime.fromisoformat(time).timestamp() for time in text["time"]]
    heading = numbers(text["heading_deg"])
    fresh = np.concatenate([[False], np.diff(heading) != 0.0])
    valid = np.array(text["head_valid"]) == "True"
    fixed = np.array(text["carrier"]) == "fixed"
    off = numbers(text["jrk_current"]) - NEUTRAL
    return Log(
        path.name.split("_202")[0],
        np.array([round(1e3 * s) * 1_000_000 for s in seconds], dtype=np.int64),
        numbers(text["lat"]),
        numbers(text["lon"]),
        np.array([QUALITY[quality] for quality in text["fix_quality"]], dtype=np.int64),
        np.where(fresh & valid & fixed, heading, np.nan),
        numbers(text["speed_mps"]),
        np.where(np.abs(off) > NEAR_NEUTRAL, -np.sign(off), 0).astype(np.int64),
    )


class MeasuredValue(NamedTuple):
    """Epochs with a truth while moving, at rest, and at rest by the stricter measure."""

    moving: Scores
    resting: Scores
    surely: Scores
    time_ns: _Int64


def measure(log: Log, truth: Log | None = None) -> MeasuredValue:
    """The estimate from a log's positions, beside the truth of the same or of another log."""
    truth = truth or log
    fixes = make_fixes(log.time_ns, log.lat_deg, log.lon_deg, log.quality)
    trajectory = estimate_poses(fixes).trajectory
    rows = np.flatnonzero(np.isfinite(truth.truth_deg))
    poses = poses_at(trajectory, truth.time_ns[rows])
    speed = truth.speed_mps[rows]
    off = np.asarray(wrap_deg(poses.heading_deg - truth.truth_deg[rows]))
    telling = (speed > MOVING_MPS) & poses.accepted
    offset = circular_median_deg(off[telling]) if telling.sum() >= FEWEST_MOVING else 0.0
    error = np.asarray(wrap_deg(off - offset))
    scores = Scores(error, poses.sigma_deg, poses.accepted, poses.gear, truth.true_gear[rows])
    return MeasuredValue(
        scores.of(speed > MOVING_MPS),
        scores.of(speed <= RESTING_MPS),
        scores.of(speed <= SURELY_RESTING_MPS),
        truth.time_ns[rows][speed > MOVING_MPS],
    )


def report() -> Iterator[str]:
    """The figures of each log and of all together."""
    yield SCORES_HEAD + f"{'at rest used':>14}{'> 10°':>9}"
    yield asked_line()
    found = [(log.name, measure(log)) for log in logs()]
    for name, one in found:
        yield _line(name, one)
    yield _line("pooled", pool([one for _, one in found]))
    yield from _reference_lines()
    yield from _hindsight_lines()


HINDSIGHT_M, HINDSIGHT_S = (0.4, 0.8, 1.2, 1.6, 2.4), 10.0
"""Lines are fitted to positions so far before and behind, at most for so long."""


def _hindsight_lines() -> Iterator[str]:
    """The bound: headings by a line through the positions around, however long it is."""
    found: dict[float, list[_Float64]] = {reach_m: [] for reach_m in HINDSIGHT_M}
    for log in logs():
        fixes = make_fixes(log.time_ns, log.lat_deg, log.lon_deg, log.quality)
        rows = np.flatnonzero(np.isfinite(log.truth_deg) & (log.speed_mps > MOVING_MPS))
        poses = poses_at(estimate_poses(fixes).trajectory, log.time_ns[rows])
        rows, reverse = rows[poses.accepted], poses.gear[poses.accepted] < 0
        for reach_m, off in found.items():
            course_deg = _courses_deg(log, log.time_ns[rows], reach_m) + 180.0 * reverse
            away = np.asarray(wrap_deg(course_deg - log.truth_deg[rows]))
            known = np.isfinite(away)
            if known.sum() >= FEWEST_MOVING:
                off.append(np.abs(wrap_deg(away[known] - circular_median_deg(away[known]))))
    for reach_m, off in found.items():
        size = np.concatenate(off)
        yield (
            f"course of a line through the positions within {reach_m:.1f} m, gears as estimated: "
            f"{np.median(size):.2f}°, 95 % {np.percentile(size, 95):.2f}°"
        )


def _courses_deg(log: Log, at_ns: _Int64, reach_m: float) -> _Float64:
    """The direction of travel at some instants; NaN where there are too few positions."""
    moved = (np.diff(log.lat_deg) != 0.0) | (np.diff(log.lon_deg) != 0.0)
    new = np.concatenate([[True], moved]) & (log.quality == 4) & np.isfinite(log.lat_deg)
    time_s, north_m = log.time_ns[new] / 1e9, log.lat_deg[new] * _M_A_DEGREE
    east_m = log.lon_deg[new] * _M_A_DEGREE * np.cos(np.radians(np.median(log.lat_deg[new])))
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(east_m), np.diff(north_m)))])
    found = np.full(len(at_ns), np.nan)
    for k, at_s in enumerate(at_ns / 1e9):
        off_m = way_m - np.interp(at_s, time_s, way_m)
        near = (np.abs(off_m) < reach_m) & (np.abs(time_s - at_s) < HINDSIGHT_S)
        if near.sum() >= 3:
            since_s = time_s[near] - time_s[near].mean()
            weight = (1.0 - np.abs(off_m[near] / reach_m) ** 3) ** 6
            found[k] = np.degrees(
                np.arctan2(
                    *(
                        np.polyfit(since_s, one[near], 1, w=np.sqrt(weight))[0]
                        for one in (east_m - east_m[0], north_m - north_m[0])
                    )
                )
            )
    return found


def _reference_lines() -> Iterator[str]:
    """The floor: how much the two antennas' heading scatters itself."""
    moving, within_stops = [], []
    for log in logs():
        rows = np.flatnonzero(np.isfinite(log.truth_deg))
        heading_deg = np.degrees(np.unwrap(np.radians(log.truth_deg[rows])))
        time_s, speed = log.time_ns[rows] / 1e9, log.speed_mps[rows]
        moving.append(_own_scatter_deg(time_s, heading_deg)[speed > MOVING_MPS])
        within_stops += _within_stops_deg(heading_deg, speed <= SURELY_RESTING_MPS)
    for name, parts in (
        ("moving, from one to the next", moving),
        ("at rest, beside the stop's median", within_stops),
    ):
        size = np.abs(np.concatenate(parts))
        size = size[np.isfinite(size)]
        yield (
            f"the reference's own scatter, {name}: "
            f"{np.median(size):.2f}°, 95 % {np.percentile(size, 95):.2f}°"
        )


def _own_scatter_deg(time_s: _Float64, heading_deg: _Float64) -> _Float64:
    """How far each heading lies off the cubic through two on either side, scaled to the error of
    one; NaN where they are not close."""
    off = np.full(len(time_s), np.nan)
    for k in range(2, len(time_s) - 2):
        around = [k - 2, k - 1, k + 1, k + 2]
        at_s = time_s[around] - time_s[k]
        if at_s[-1] - at_s[0] <= OWN_SPAN_S:
            weight = np.linalg.solve(np.vander(at_s, 4).T, [0.0, 0.0, 0.0, 1.0])
            away = heading_deg[k] - weight @ heading_deg[around]
            off[k] = away / np.sqrt(1.0 + (weight**2).sum())
    return off


def _within_stops_deg(heading_deg: _Float64, resting: npt.NDArray[np.bool_]) -> list[_Float64]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], resting.astype(int), [0]])))
    return [
        heading_deg[first:stop] - np.median(heading_deg[first:stop])
        for first, stop in zip(edges[::2], edges[1::2], strict=True)
        if stop - first >= FEWEST_AT_STOP
    ]


def pool(many: list[MeasuredValue]) -> MeasuredValue:
    return MeasuredValue(
        pooled(one.moving for one in many),
        pooled(one.resting for one in many),
        pooled(one.surely for one in many),
        np.concatenate([one.time_ns for one in many]),
    )


def asked_line() -> str:
    return (
        f"{'asked, moving > 0.2 m/s':<34}{'':>8}{'':>8}{'<= 0.8°':>8}{'<= 2.6°':>8}{'<= 0.5':>8}"
        f"{'>= 99':>8}{'>= 98':>9}{'<= 2':>10}{'':>14}{'<= 1 %':>9}"
    )


def _line(name: str, one: MeasuredValue) -> str:
    rests = []
    for resting in (one.resting, one.surely):
        used = resting.of(resting.accepted)
        wrong = np.mean(np.abs(used.error_deg) > 10.0) if len(used.error_deg) else np.nan
        rests.append((f"{len(used.error_deg)}/{len(resting.accepted)}", percent(wrong)))
    line = f"{scores_line(name, one.moving):<101}{rests[0][0]:>14}{rests[0][1]:>9}"
    return line + f"   below {SURELY_RESTING_MPS} m/s: {rests[1][0]}, {rests[1][1]}"


# --- the same drives as another receiver would have seen them


class Harm(NamedTuple):
    """What is done to a log: fixes thinned to a rate, noise and slow bias added, holes cut."""

    name: str
    rate_hz: float = np.inf
    noise_m: float = 0.0
    bias_m: float = 0.0
    hole_s: float = 0.0
    every_s: float = 20.0
    quality: int | None = None
    quantum_deg: float = 0.0


HARMS = (
    Harm("as recorded, repeats taken out"),
    Harm("5 Hz", 5.0),
    Harm("2 Hz", 2.0),
    Harm("1 Hz", 1.0),
    Harm("2 cm noise", noise_m=0.02),
    Harm("5 cm noise", noise_m=0.05),
    Harm("10 cm noise, RTK float", noise_m=0.1, quality=5),
    Harm("30 cm noise, DGPS", noise_m=0.3, quality=2),
    Harm("30 cm noise, said to be RTK", noise_m=0.3),
    Harm("5 Hz, 2 cm", 5.0, 0.02),
    Harm("5 Hz, 5 cm", 5.0, 0.05),
    Harm("5 Hz, 10 cm, DGPS", 5.0, 0.1, quality=2),
    Harm("5 Hz, 30 cm, DGPS", 5.0, 0.3, quality=2),
    Harm("1 Hz, 2 cm", 1.0, 0.02),
    Harm("1 Hz, 10 cm, DGPS", 1.0, 0.1, quality=2),
    Harm("bias 0.5 m, 5 Hz, 3 cm, DGPS", 5.0, 0.03, 0.5, quality=2),
    Harm("holes of 3 s every 20 s", hole_s=3.0),
    Harm("holes of 8 s every 20 s", hole_s=8.0),
    Harm("holes of 8 s every 10 s", hole_s=8.0, every_s=10.0),
    Harm("holes of 8 s every 10 s, 1 Hz", 1.0, hole_s=8.0, every_s=10.0),
    Harm("holes of 4 s every 6 s, 5 Hz", 5.0, hole_s=4.0, every_s=6.0),
    Harm("holes of 12 s every 15 s", hole_s=12.0, every_s=15.0),
    Harm("holes of 8 s, 2 Hz, 5 cm", 2.0, 0.05, hole_s=8.0),
    Harm("4 decimals of a minute, 5 Hz", 5.0, quantum_deg=1e-4 / 60, quality=2),
    Harm("5 decimals of a minute", quantum_deg=1e-5 / 60),
)

_BIAS_S = 60.0
_M_A_DEGREE = 111_200.0


def harmed(log: Log, harm: Harm, seed: int = 1) -> Log:
    """The log of a worse receiver: only rows with a new position, thinned, moved, cut."""
    random = np.random.default_rng(seed)
    new = np.concatenate([[True], (np.diff(log.lat_deg) != 0.0) | (np.diff(log.lon_deg) != 0.0)])
    still = np.concatenate([[True], np.diff(log.time_ns) > 0])
    since_s = (log.time_ns - log.time_ns[0]) / 1e9
    # A standing receiver repeats itself, too: at the least a row each 0.2 s stays.
    clock = np.floor(since_s / 0.2)
    keep = (new | np.concatenate([[True], np.diff(clock) > 0])) & still & (log.quality > 0)
    rows = np.flatnonzero(keep)
    if np.isfinite(harm.rate_hz):
        slots = np.floor(since_s[rows] * harm.rate_hz)
        rows = rows[np.concatenate([[True], np.diff(slots) > 0])]
    if harm.hole_s:
        rows = rows[since_s[rows] % harm.every_s > harm.hole_s]
    thin = log._replace(
        **{name: getattr(log, name)[rows] for name in Log._fields if name != "name"}
    )
    off = harm.noise_m * random.standard_normal((2, len(rows)))
    off += harm.bias_m * _wander(since_s[rows], random)
    lat = thin.lat_deg + off[0] / _M_A_DEGREE
    lon = thin.lon_deg + off[1] / (_M_A_DEGREE * np.cos(np.radians(thin.lat_deg)))
    if harm.quantum_deg:
        lat, lon = (harm.quantum_deg * np.round(x / harm.quantum_deg) for x in (lat, lon))
    quality = thin.quality if harm.quality is None else np.full(len(rows), harm.quality)
    return thin._replace(lat_deg=lat, lon_deg=lon, quality=quality)


def _wander(time_s: _Float64, random: np.random.Generator) -> _Float64:
    """Two slow errors of unit variance that last for a minute."""
    fading = np.exp(-np.diff(time_s, prepend=time_s[0]) / _BIAS_S)
    fresh = np.sqrt(1.0 - fading**2)
    noise = random.standard_normal((2, len(time_s)))
    fresh[0] = 1.0
    wander = np.zeros((2, len(time_s)))
    for k in range(len(time_s)):
        wander[:, k] = fading[k] * wander[:, k - 1] + fresh[k] * noise[:, k]
    return wander


def report_harmed() -> Iterator[str]:
    """All logs pooled, as worse and worse receivers would have seen them."""
    yield SCORES_HEAD + f"{'at rest used':>14}{'> 10°':>9}"
    originals = logs()
    for harm in HARMS:
        many = []
        for log in originals:
            try:
                many.append(measure(harmed(log, harm), log))
            except GnssError as problem:
                yield f"{harm.name:<34} {log.name}: {problem}"
        if many:
            yield _line(harm.name, pool(many))
        if harm.hole_s and harm.every_s <= OFTEN_S:
            yield _beside_holes_line(originals, harm)


OFTEN_S = 10.0
"""Holes that come so often leave little between them."""


def _beside_holes_line(originals: Sequence[Log], harm: Harm) -> str:
    """What is accepted between the holes while moving, in all and by the time since a hole."""
    accepted, since_s = [], []
    for log in originals:
        one = harmed(log, harm)
        with suppress(GnssError):
            found = measure(one)
            accepted.append(found.moving.accepted)
            since_s.append((found.time_ns - log.time_ns[0]) / 1e9 % harm.every_s - harm.hole_s)
    used, at_s = np.concatenate(accepted), np.concatenate(since_s)
    edges = np.linspace(0.0, harm.every_s - harm.hole_s, 5)
    shares = [percent(used[(at_s >= low) & (at_s < high)].mean()) for low, high in pairwise(edges)]
    return f"{'':<34}between the holes {percent(used.mean())}; by its quarters {', '.join(shares)}"
