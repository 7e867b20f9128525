"""Where a drive went and in which gears: its stations, and the first guess of its poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.angles import heading_deg, wrap_deg
from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.course import first_beyond, stations
from fieldgrid.gear import Gears, Track, gears
from fieldgrid.motion import Motion
from fieldgrid.pose.accepted import AcceptedFixes
from fieldgrid.pose.measured import WHEEL_SIGMA_MPS, turn_back, wheel_speed_at
from fieldgrid.pose.nodes import Nodes, seconds
from fieldgrid.settings import PoseSettings
from fieldgrid.smoother import STATES

STATION_M, STATION_SIGMAS = 0.05, 2.0
"""A vehicle has moved on when it is this far, and beyond the noise, from where it was."""

HOLE_S, HOLE_PERIODS = 2.0, 2.5
"""Longer without a fix, and over so many of a receiver's periods, a vehicle may have stopped and
turned back unseen."""

TORN_S, TORN_M, TORN_SIGMAS, TORN_MPS2 = 2.0, 0.5, 15.0, 1.0
"""Between two fixes the positions have jumped when the step differs by this much, beyond the noise,
the way that the pace makes in it, and what a vehicle gains by speeding up, from the velocities over
so long before and after it."""

DISPUTED_SHARE = 0.6
"""Where fixes in between were refused for how they lie, this share of the pace's way is enough."""

GUESS_REACH_M, GUESS_SIGMAS = 0.3, 8.0
"""The first guess of the heading is the course over at least this."""

STEP_NATS, WHEEL_NATS, RECORDED_NATS = 8.0, 2.0, 4.0
"""How strongly a camera's step, a wheel's and a compass's sign speak of the gear."""

UNSIGNED_NATS = 0.3
"""The same of wheels that never turn back: they may not know how."""

HINT_NATS = 200.0
"""A hint of the user outweighs everything."""


class StationGears(NamedTuple):
    """The stations of a drive and their gears: `station` are fixes, the rest is at them."""

    station: Int64
    gears: Gears


class GearHints(NamedTuple):
    """What the user knows: the gear (+1, -1; 0: nothing) that the drive starts in, and that of
    some spans, (from, to, gear) with UTC nanoseconds."""

    starts: int = 0
    spans: tuple[tuple[int, int, int], ...] = ()


NO_HINTS = GearHints()


def gear_hints(settings: PoseSettings) -> GearHints:
    """The hints that the settings hold."""
    starts = 0 if settings.starts is None else settings.starts.sign
    spans = tuple((one.start_ns, one.stop_ns, one.gear.sign) for one in settings.gear_spans)
    return GearHints(starts, spans)


def station_gears(
    fixes: AcceptedFixes,
    at: Nodes,
    resting: Bool,
    motion: Motion,
    recorded_deg: Float64,
    hints: GearHints,
) -> StationGears:
    """Stations and gears of accepted fixes; `resting` marks those at rest, `recorded_deg` are
    headings that were recorded, NaN where there is none."""
    points, time_ns = fixes.points_m(), fixes.time_ns
    noise_m, steps_s = fixes.noise.across_m, np.diff(time_ns) / 1e9
    hole, torn = breaks(fixes)
    part = np.concatenate([[0], np.cumsum(hole | torn)])
    station = stations(
        points, part, resting, max(STATION_M, STATION_SIGMAS * float(np.median(noise_m)))
    )
    at_ns = time_ns[station]
    # A hole lasts from station to station, a jump only between its two fixes.
    holes, torn_s = (
        np.diff(np.concatenate([[0.0], np.cumsum(column)])[station])
        for column in (hole, np.where(torn, steps_s, 0.0))
    )
    gap_s = np.concatenate([[np.inf], np.where(holes > 0.0, np.diff(at_ns) / 1e9, torn_s)])
    track = Track(
        points[station],
        seconds(at_ns),
        gap_s,
        noise_m[station],
        _turned_deg(at, at_ns, time_ns[resting]),
        _forward_nats(points[station], at_ns, motion, recorded_deg[station], hints),
    )
    return StationGears(station, gears(track))


def usual_period_s(step_s: Float64) -> float:
    """The period of a receiver that took fixes at such steps; where many are missing, half of the
    steps may be holes."""
    return float(np.percentile(step_s, 25)) if len(step_s) else 1.0


def holes(step_s: Float64) -> Bool:
    """Which steps between fixes are so long that a vehicle may have turned back unseen."""
    return np.asarray(step_s > max(HOLE_S, HOLE_PERIODS * usual_period_s(step_s)))


def breaks(fixes: AcceptedFixes) -> tuple[Bool, Bool]:
    """Which steps [n - 1] between fixes are holes, and which of the others the motion before and
    after them does not make: of these one side is a jump that conditioning has let pass, or the
    solution has moved."""
    points, time_s, noise_m = fixes.points_m(), seconds(fixes.time_ns), fixes.noise.across_m
    n, step_s = len(points), np.diff(time_s)
    if n < 2:
        return np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=np.bool_)
    hole = holes(step_s)
    row = np.arange(n)
    before = np.minimum(np.searchsorted(time_s, time_s - TORN_S), np.maximum(row - 1, 0))
    after = np.maximum(
        np.searchsorted(time_s, time_s + TORN_S, side="right") - 1, np.minimum(row + 1, n - 1)
    )
    came, left = (
        (points[to] - points[of]) / np.maximum(time_s[to] - time_s[of], 1e-3)[:, None]
        for of, to in ((before, row), (row, after))
    )
    usual_m = (came[:-1] + left[1:]) / 2.0 * step_s[:, None]
    off_m = np.hypot(*(np.diff(points, axis=0) - usual_m).T)
    pace_mps = np.maximum(np.hypot(*came[:-1].T), np.hypot(*left[1:].T))
    free_m = np.maximum(TORN_M, TORN_SIGMAS * np.maximum(noise_m[1:], noise_m[:-1]))
    way_m = pace_mps * step_s
    free_m += np.where(fixes.disputed[1:], DISPUTED_SHARE * way_m, way_m + TORN_MPS2 * step_s**2)
    return hole, (off_m > free_m) & ~hole


def _turned_deg(at: Nodes, time_ns: Int64, resting_ns: Int64) -> Float64:
    """What the gyro saw on the way to each instant, its bias taken out where the vehicle rests;
    NaN on the way across a hole in it."""
    if not at.has_gyro():
        return np.full(len(time_ns), np.nan)
    step_s = np.diff(at.time_ns) / 1e9
    seen = np.isfinite(at.turned_rad)
    still = np.isin(at.time_ns[:-1], resting_ns) & seen
    bias = 0.0
    if step_s[still].sum() > 2.0:
        bias = float(at.turned_rad[still].sum() / step_s[still].sum())
    steps = np.where(seen, at.turned_rad - bias * step_s, 0.0)
    node = np.searchsorted(at.time_ns, time_ns)
    angle, holes = (np.concatenate([[0.0], np.cumsum(c)])[node] for c in (steps, ~seen))
    turned = np.where(np.diff(holes) == 0.0, np.diff(angle), np.nan)
    return np.asarray(np.degrees(np.concatenate([[np.nan], turned])))


def _forward_nats(
    points: Float64,
    time_ns: Int64,
    motion: Motion,
    recorded_deg: Float64,
    hints: GearHints,
) -> Float64:
    """Log odds of forward on the way to each station, from camera, wheels, compass and user."""
    nats = np.zeros(len(time_ns))
    steps, wheels = motion.steps, motion.wheels
    if steps is not None:
        middle = (steps.start_ns + steps.stop_ns) // 2
        to = np.searchsorted(time_ns, middle)
        inside = (to > 0) & (to < len(time_ns))
        told = np.clip(steps.forward_m / (3.0 * steps.sigma_m), -1.0, 1.0) * STEP_NATS
        np.add.at(nats, to[inside], told[inside])
    if wheels is not None:
        speed = np.nan_to_num(wheel_speed_at(time_ns, wheels))
        each = WHEEL_NATS if turn_back(wheels) else UNSIGNED_NATS
        nats += np.clip(speed / (2.0 * WHEEL_SIGMA_MPS), -1.0, 1.0) * each
    if len(points) > 1:
        course = heading_deg(*np.diff(points, axis=0).T)
        agree = np.cos(np.radians(course - recorded_deg[1:]))
        nats[1:] += np.nan_to_num(agree) * RECORDED_NATS
    nats[1:2] += HINT_NATS * hints.starts
    for start_ns, stop_ns, gear in hints.spans:
        nats[(time_ns > start_ns) & (time_ns <= stop_ns)] += HINT_NATS * gear
    return nats


def first_guess(fixes: AcceptedFixes, at: Nodes, stations_of: StationGears) -> Float64:
    """States [n, 8] with the right gears: course over a short chord, turned in reverse."""
    station, found = stations_of
    points = fixes.points_m()[station]
    reach_m = max(GUESS_REACH_M, GUESS_SIGMAS * float(np.median(fixes.noise.across_m)))
    heading, speed = np.full(len(station), np.nan), np.zeros(len(station))
    cuts = np.flatnonzero(np.diff(found.leg)) + 1
    for leg in np.split(np.arange(len(station)), cuts):
        time_s = seconds(fixes.time_ns[station[leg]])
        heading[leg], speed[leg] = _chords(points[leg], time_s, reach_m)
    heading = np.where(found.gear < 0, heading + 180.0, heading)
    heading[~found.driven] = np.nan  # a wandering path, which would turn the guess around
    known = np.flatnonzero(np.isfinite(heading))
    guess = np.zeros((len(at.time_ns), STATES))
    guess[:, 0] = np.interp(at.time_ns, fixes.time_ns, fixes.east_m)
    guess[:, 1] = np.interp(at.time_ns, fixes.time_ns, fixes.north_m)
    if known.size:
        times = fixes.time_ns[station[known]]
        turns = np.asarray(wrap_deg(np.diff(heading[known])))
        angle = np.radians(heading[known[0]] + np.concatenate([[0.0], np.cumsum(turns)]))
        guess[:, 2] = np.interp(at.time_ns, times, angle)
        guess[:, 3] = np.interp(at.time_ns, times, (speed * found.gear)[known])
    return guess


def _chords(points: Float64, time_s: Float64, reach_m: float) -> tuple[Float64, Float64]:
    """Course, degrees, and speed, m/s, at each point of a leg; NaN for a leg that is a point."""
    before, after = first_beyond(points, reach_m, -1), first_beyond(points, reach_m, 1)
    start, stop = np.where(before < 0, 0, before), np.where(after < 0, len(points) - 1, after)
    chord = points[stop] - points[start]
    length_m, span_s = np.hypot(*chord.T), time_s[stop] - time_s[start]
    course = np.where(length_m > reach_m / 2.0, heading_deg(*chord.T), np.nan)
    return course, length_m / np.maximum(span_s, 0.02)
