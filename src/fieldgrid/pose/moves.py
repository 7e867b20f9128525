"""Where a drive went and in which gears: its stations, and the first guess of its poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.angles import heading_deg, wrap_deg
from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.course import first_beyond, stations
from fieldgrid.gear import Gears, Track, gears
from fieldgrid.motion import Motion
from fieldgrid.pose.nodes import UNSEEN_NS, Nodes, seconds
from fieldgrid.pose.placed import Placed
from fieldgrid.pose.sightings import WHEEL_SIGMA_MPS
from fieldgrid.smoother import STATES

STATION_M, STATION_SIGMAS = 0.05, 2.0
"""A vehicle has moved on when it is this far, and beyond the noise, from where it was."""

GUESS_REACH_M, GUESS_SIGMAS = 0.3, 8.0
"""The first guess of the heading is the course over at least this."""

STEP_NATS, WHEEL_NATS, RECORDED_NATS = 8.0, 2.0, 4.0
"""How strongly a camera's step, a wheel's and a compass's sign speak of the gear."""


class Moves(NamedTuple):
    """The stations of a drive and their gears: `station` are fixes, the rest is at them."""

    station: Int64
    gears: Gears


def find_moves(
    fixes: Placed,
    at: Nodes,
    resting: Bool,
    motion: Motion,
    nose_deg: Float64,
) -> Moves:
    """Stations and gears of accepted fixes; `resting` marks those at rest, `nose_deg` are
    recorded headings, NaN where there is none."""
    points = np.stack([fixes.east_m, fixes.north_m], axis=1)
    unseen = np.diff(fixes.time_ns) > UNSEEN_NS
    part = np.concatenate([[0], np.cumsum(unseen)])
    step_m = max(STATION_M, STATION_SIGMAS * float(np.median(fixes.noise_m)))
    station = stations(points, part, resting, step_m)
    time_ns = fixes.time_ns[station]
    gap_s = np.where(np.diff(part[station], prepend=-1) > 0, _hole_s(time_ns), 0.0)
    track = Track(
        points[station],
        gap_s,
        fixes.noise_m[station],
        _turned_deg(at, time_ns, fixes.time_ns[resting]),
        _forward_nats(points[station], time_ns, motion, nose_deg[station]),
    )
    return Moves(station, gears(track))


def _hole_s(time_ns: Int64) -> Float64:
    return np.concatenate([[np.inf], np.diff(time_ns) / 1e9])


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


def _forward_nats(points: Float64, time_ns: Int64, motion: Motion, nose_deg: Float64) -> Float64:
    """Log odds of forward on the way to each station, from camera, wheels and compass."""
    nats = np.zeros(len(time_ns))
    steps, wheels = motion.steps, motion.wheels
    if steps is not None:
        middle = (steps.start_ns + steps.stop_ns) // 2
        to = np.searchsorted(time_ns, middle)
        inside = (to > 0) & (to < len(time_ns))
        said = np.clip(steps.forward_m / (3.0 * steps.sigma_m), -1.0, 1.0) * STEP_NATS
        np.add.at(nats, to[inside], said[inside])
    if wheels is not None and (wheels.speed_mps < -WHEEL_SIGMA_MPS).any():
        # Wheels that never turn back may as well not know how.
        speed = np.interp(time_ns, wheels.time_ns, wheels.speed_mps)
        nats += np.clip(speed / (2.0 * WHEEL_SIGMA_MPS), -1.0, 1.0) * WHEEL_NATS
    if len(points) > 1:
        course = heading_deg(*np.diff(points, axis=0).T)
        agree = np.cos(np.radians(course - nose_deg[1:]))
        nats[1:] += np.nan_to_num(agree) * RECORDED_NATS
    return nats


def first_guess(fixes: Placed, at: Nodes, moves: Moves) -> Float64:
    """States [n, 8] with the right gears: course over a short chord, turned in reverse."""
    station, found = moves
    points = np.stack([fixes.east_m, fixes.north_m], axis=1)[station]
    reach_m = max(GUESS_REACH_M, GUESS_SIGMAS * float(np.median(fixes.noise_m)))
    nose, speed = np.full(len(station), np.nan), np.zeros(len(station))
    cuts = np.flatnonzero(np.diff(found.leg)) + 1
    for leg in np.split(np.arange(len(station)), cuts):
        nose[leg], speed[leg] = _chords(points[leg], seconds(fixes.time_ns[station[leg]]), reach_m)
    backward = found.gear < 0
    nose = np.where(backward, nose + 180.0, nose)
    nose[~found.driven] = np.nan  # a wandering path, which would turn the guess around
    known = np.flatnonzero(np.isfinite(nose))
    guess = np.zeros((len(at.time_ns), STATES))
    east, north = (np.interp(at.time_ns, fixes.time_ns, c) for c in (fixes.east_m, fixes.north_m))
    guess[:, 0], guess[:, 1] = east, north
    if known.size:
        times = fixes.time_ns[station[known]]
        turns = np.asarray(wrap_deg(np.diff(nose[known])))
        angle = np.radians(nose[known[0]] + np.concatenate([[0.0], np.cumsum(turns)]))
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
