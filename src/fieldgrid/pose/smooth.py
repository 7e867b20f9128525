"""The default way to poses: everything that the drive carries, in one batch estimate."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.angles import heading_deg, wrap_deg
from fieldgrid.course import first_beyond, stations
from fieldgrid.gear import Gears, Track, gears
from fieldgrid.motion import Motion, Steps
from fieldgrid.pose.nodes import UNSEEN_NS, Nodes, nodes
from fieldgrid.pose.placed import Placed
from fieldgrid.pose.rest import at_rest
from fieldgrid.rig import Vehicle
from fieldgrid.smoother import STATES, Sightings, Smoothed, smooth

_Float64 = npt.NDArray[np.float64]
_Int64 = npt.NDArray[np.int64]

USUAL_ANTENNA_M = 2.0
"""How high an antenna sits when nobody says it."""

SWAY_DEG = 0.5
"""How much a vehicle rolls and pitches on a field; an antenna 2 m up sways by 2 cm with it."""

SWAY_S = 0.3
"""How long a sway lasts: fixes that follow each other faster say the same again."""

LEAST_HEADING_SIGMA_DEG = 0.3
"""What no sighting shows: an axle out of line, a vehicle that crabs on a side slope."""

RTK_FLOAT = 5
BIAS_S, FLOAT_BIAS_S = 300.0, 10.0
"""For how long the slow part of a receiver's error lasts: minutes, as orbits, clocks and air
change; but a float solution (RTK without whole numbers of waves) wanders while it converges."""

STATION_M, STATION_SIGMAS = 0.05, 2.0
"""A vehicle has moved on when it is this far, and beyond the noise, from where it was."""

GUESS_REACH_M, GUESS_SIGMAS = 0.3, 8.0
"""The first guess of the heading is the course over at least this."""

STEP_NATS, WHEEL_NATS, RECORDED_NATS = 8.0, 2.0, 4.0
"""How strongly a camera's step, a wheel's and a compass's sign speak of the gear."""

WHEEL_SIGMA_MPS, WHEEL_SIGMA_SHARE = 0.05, 0.05
"""Slip and a tyre's radius: how well wheels know the speed."""

TURNING_RAD_S = np.radians(4.0)
"""A faster turn than a gyro's bias and a shaking engine make is one."""

DRIVING_MPS = 0.2
"""Faster, a vehicle drives for certain, and its speed has a sign."""

RECORDED_NEAR_S = 2.0
"""For so long a recorded heading vouches for those around it."""

DRIVEN_M = 0.1
"""A camera that has moved by more was driven."""

MOST_NODES_A_STEP = 40
"""A camera's step over more nodes than this is left out: it would make the matrix too wide."""


class Drive(NamedTuple):
    """The estimate at n nodes: the middle of the unsteered axle, and what is sure of it.

    `fix` [n] is the accepted fix at a node or -1; `gear` +1, -1, 0 at rest; `doubt` the
    probability that it is the other one; `gyro_bias_dps` is NaN without a gyro.
    """

    time_ns: _Int64
    fix: _Int64
    east_m: _Float64
    north_m: _Float64
    heading_deg: _Float64
    heading_sigma_deg: _Float64
    position_sigma_m: _Float64
    relative_sigma_m: _Float64
    speed_mps: _Float64
    gear: _Int64
    doubt: _Float64
    resting: npt.NDArray[np.bool_]
    gyro_bias_dps: float


def smooth_drive(
    placed: Placed, motion: Motion, rig: Vehicle | None, nose_deg: _Float64 | None = None
) -> Drive:
    """The batch estimate from accepted fixes (`placed`) and the vehicle's own motion.

    `nose_deg` [len(placed)] is a recorded heading that has passed its comparison with the
    course, NaN where there is none.
    """
    fixes = placed.accepted()
    at = nodes(fixes.time_ns, placed.time_ns, motion)
    resting = at_rest(
        _seconds(fixes.time_ns), fixes.east_m, fixes.north_m, fixes.noise_m, fixes.speed_mps
    ) & ~_turning(at, fixes.time_ns)
    nose = np.full(len(fixes.time_ns), np.nan) if nose_deg is None else nose_deg[placed.ok]
    moves = _moves(fixes, at, resting, motion, nose)
    # Between two fixes it rests only where it does at both; beyond them nobody knows.
    rest = np.interp(at.time_ns, fixes.time_ns, resting.astype(np.float64), left=0.0, right=0.0)
    node_rest = rest > 0.99
    node_rest &= ~_driven(at.time_ns, motion.steps)
    seen = _sightings(fixes, at, node_rest, motion, nose, rig)
    lever, ahead_m = _axle(rig)
    found = smooth(seen, _first_guess(fixes, at, moves), lever, ahead_m)
    return _drive(at, seen, found, moves, node_rest, _has_gyro(at))


def _turning(at: Nodes, time_ns: _Int64) -> npt.NDArray[np.bool_]:
    """Where the gyro sees a vehicle turn on the spot, which its position does not show."""
    rate = np.nan_to_num(at.turned_rad) / np.maximum(np.diff(at.time_ns) / 1e9, 1e-3)
    node = np.clip(np.searchsorted(at.time_ns, time_ns), 0, max(len(rate) - 1, 0))
    return np.abs(rate[node]) > TURNING_RAD_S if len(rate) else np.zeros(len(time_ns), np.bool_)


def _driven(time_ns: _Int64, steps: Steps | None) -> npt.NDArray[np.bool_]:
    """Nodes during a step of the camera that is one."""
    change = np.zeros(len(time_ns) + 1, dtype=np.int64)
    if steps is not None:
        way_m = np.hypot(steps.forward_m, steps.right_m)
        real = way_m > np.maximum(DRIVEN_M, 4.0 * steps.sigma_m)
        np.add.at(change, np.searchsorted(time_ns, steps.start_ns[real]), 1)
        np.add.at(change, np.searchsorted(time_ns, steps.stop_ns[real], side="right"), -1)
    return np.asarray(np.cumsum(change[:-1]) > 0)


def _has_gyro(at: Nodes) -> bool:
    return bool(np.isfinite(at.turned_rad).any())


def _seconds(time_ns: _Int64) -> _Float64:
    return np.asarray((time_ns - time_ns[0]) / 1e9)


class _Moves(NamedTuple):
    """The stations of a drive and their gears: `station` are fixes, the rest is at them."""

    station: _Int64
    gears: Gears


def _moves(
    fixes: Placed,
    at: Nodes,
    resting: npt.NDArray[np.bool_],
    motion: Motion,
    nose_deg: _Float64,
) -> _Moves:
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
    return _Moves(station, gears(track))


def _hole_s(time_ns: _Int64) -> _Float64:
    return np.concatenate([[np.inf], np.diff(time_ns) / 1e9])


def _turned_deg(at: Nodes, time_ns: _Int64, resting_ns: _Int64) -> _Float64:
    """What the gyro saw on the way to each instant, its bias taken out where the vehicle rests;
    NaN on the way across a hole in it."""
    if not _has_gyro(at):
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
    points: _Float64, time_ns: _Int64, motion: Motion, nose_deg: _Float64
) -> _Float64:
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


def _first_guess(fixes: Placed, at: Nodes, moves: _Moves) -> _Float64:
    """States [n, 8] with the right gears: course over a short chord, turned in reverse."""
    station, found = moves
    points = np.stack([fixes.east_m, fixes.north_m], axis=1)[station]
    reach_m = max(GUESS_REACH_M, GUESS_SIGMAS * float(np.median(fixes.noise_m)))
    nose, speed = np.full(len(station), np.nan), np.zeros(len(station))
    cuts = np.flatnonzero(np.diff(found.leg)) + 1
    for leg in np.split(np.arange(len(station)), cuts):
        nose[leg], speed[leg] = _chords(points[leg], _seconds(fixes.time_ns[station[leg]]), reach_m)
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


def _chords(points: _Float64, time_s: _Float64, reach_m: float) -> tuple[_Float64, _Float64]:
    """Course, degrees, and speed, m/s, at each point of a leg; NaN for a leg that is a point."""
    before, after = first_beyond(points, reach_m, -1), first_beyond(points, reach_m, 1)
    start, stop = np.where(before < 0, 0, before), np.where(after < 0, len(points) - 1, after)
    chord = points[stop] - points[start]
    length_m, span_s = np.hypot(*chord.T), time_s[stop] - time_s[start]
    course = np.where(length_m > reach_m / 2.0, heading_deg(*chord.T), np.nan)
    return course, length_m / np.maximum(span_s, 0.02)


def _sightings(
    fixes: Placed,
    at: Nodes,
    resting: npt.NDArray[np.bool_],
    motion: Motion,
    nose_deg: _Float64,
    rig: Vehicle | None,
) -> Sightings:
    has = at.fix >= 0
    fix = at.fix[has]

    def at_nodes(values: _Float64) -> _Float64:
        column = np.full(len(at.time_ns), np.nan)
        column[has] = values[fix]
        return column

    sigma_m = np.hypot(fixes.noise_m, _sway_m(rig)) * _repetition(fixes.time_ns)
    ends, step, step_sigma = _steps(at.time_ns, motion.steps)
    speed, speed_sigma = _wheel_speeds(at.time_ns, motion)
    return Sightings(
        time_s=_seconds(at.time_ns),
        fix_m=np.stack([at_nodes(fixes.east_m), at_nodes(fixes.north_m)], axis=1),
        fix_sigma_m=at_nodes(sigma_m),
        fix_bias_m=np.interp(at.time_ns, fixes.time_ns, fixes.sigma_m),
        fix_bias_s=_bias_s(fixes)[_last_before(at.time_ns, fixes.time_ns)],
        nose_rad=np.radians(at_nodes(nose_deg)),
        nose_sigma_rad=np.radians(
            at_nodes(
                np.where(np.isnan(nose_deg), np.nan, fixes.recorded_sigma_deg)
                * _repetition(fixes.time_ns)
            )
        ),
        speed_mps=speed,
        speed_sigma_mps=speed_sigma,
        turned_rad=at.turned_rad,
        seen=np.diff(at.time_ns) <= UNSEEN_NS,
        standing=resting,
        step_nodes=ends,
        step=step,
        step_sigma=step_sigma,
    )


def _bias_s(fixes: Placed) -> _Float64:
    return np.where(fixes.quality == RTK_FLOAT, FLOAT_BIAS_S, BIAS_S)


def _last_before(time_ns: _Int64, sorted_ns: _Int64) -> _Int64:
    """For each instant the last of `sorted_ns` at or before it, else the first."""
    return np.asarray(np.maximum(np.searchsorted(sorted_ns, time_ns, side="right") - 1, 0))


def _sway_m(rig: Vehicle | None) -> float:
    up_m = 0.0 if rig is None else rig.antenna.up_m
    return (up_m if up_m > 0.0 else USUAL_ANTENNA_M) * float(np.radians(SWAY_DEG))


def _repetition(time_ns: _Int64) -> _Float64:
    """By how much less a fix says than an independent one: more of them, the same sway."""
    steps = np.diff(time_ns) / 1e9
    apart_s = np.minimum(np.append(steps, np.inf), np.concatenate([[np.inf], steps]))
    return np.asarray(np.sqrt(np.maximum(1.0, 2.0 * SWAY_S / np.maximum(apart_s, 1e-3))))


def _steps(time_ns: _Int64, steps: Steps | None) -> tuple[_Int64, _Float64, _Float64]:
    """Nodes [s, 2], motions [s, 3] and sigmas [s, 2] of the camera's steps between nodes."""
    if steps is None or len(steps.start_ns) == 0:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3)), np.zeros((0, 2))
    inside = (steps.start_ns >= time_ns[0]) & (steps.stop_ns <= time_ns[-1])
    ends = np.stack(
        [np.searchsorted(time_ns, t) for t in (steps.start_ns[inside], steps.stop_ns[inside])],
        axis=1,
    )
    step = np.stack([steps.forward_m, steps.right_m, np.radians(steps.turn_deg)], axis=1)[inside]
    sigma = np.stack([steps.sigma_m, np.radians(steps.sigma_deg)], axis=1)[inside]
    near = np.diff(ends, axis=1)[:, 0] <= MOST_NODES_A_STEP
    return ends[near].astype(np.int64), step[near], sigma[near]


def _wheel_speeds(time_ns: _Int64, motion: Motion) -> tuple[_Float64, _Float64]:
    wheels = motion.wheels
    unknown = np.full(len(time_ns), np.nan)
    if wheels is None or not (wheels.speed_mps < -WHEEL_SIGMA_MPS).any():
        return unknown, unknown
    near = np.abs(wheels.time_ns[_at(wheels.time_ns, time_ns)] - time_ns) <= UNSEEN_NS // 20
    speed = np.where(near, np.interp(time_ns, wheels.time_ns, wheels.speed_mps), np.nan)
    spread = np.hypot(WHEEL_SIGMA_MPS, WHEEL_SIGMA_SHARE * speed) * _repetition(time_ns)
    return speed, spread


def _at(sorted_ns: _Int64, time_ns: _Int64) -> _Int64:
    """Index of the nearest of `sorted_ns` to each instant."""
    after = np.clip(np.searchsorted(sorted_ns, time_ns), 1, len(sorted_ns) - 1)
    earlier = time_ns - sorted_ns[after - 1] < sorted_ns[after] - time_ns
    return np.asarray(np.where(earlier, after - 1, after))


def _axle(rig: Vehicle | None) -> tuple[tuple[float, float], float]:
    """The antenna (right, ahead) and the grid origin (ahead) as seen from the axle, metres.

    An axle that nobody names is taken to lie below the antenna.
    """
    if rig is None:
        return (0.0, 0.0), 0.0
    axle_m = axle_forward_m(rig)
    return (rig.antenna.right_m, rig.antenna.forward_m - axle_m), -axle_m


def axle_forward_m(rig: Vehicle) -> float:
    """Forward coordinate of the unsteered axle: the antenna's when the rig does not name it."""
    axle_m = rig.rear_axle_forward_m
    return rig.antenna.forward_m if axle_m is None else axle_m


def _near_recorded(seen: Sightings) -> npt.NDArray[np.bool_]:
    """Nodes whose heading is as good as recorded, so that it does not hang on the gear."""
    recorded = np.flatnonzero(np.isfinite(seen.nose_rad))
    if recorded.size == 0:
        return np.zeros(len(seen.time_s), dtype=np.bool_)
    before = np.searchsorted(recorded, np.arange(len(seen.time_s)), side="right") - 1
    after = np.minimum(before + 1, recorded.size - 1)
    nearest_s = np.minimum(
        np.abs(seen.time_s - seen.time_s[recorded[np.maximum(before, 0)]]),
        np.abs(seen.time_s - seen.time_s[recorded[after]]),
    )
    return np.asarray(nearest_s < RECORDED_NEAR_S)


def _drive(
    at: Nodes,
    seen: Sightings,
    found: Smoothed,
    moves: _Moves,
    resting: npt.NDArray[np.bool_],
    gyro: bool,
) -> Drive:
    fix_station = np.searchsorted(moves.station, _last_fix(at.fix), side="right") - 1
    doubt = moves.gears.doubt[np.maximum(fix_station, 0)]
    doubt = np.where(_near_recorded(seen), 0.0, doubt)
    # The batch may say that the vehicle went the other way than its gears do: nobody knows.
    assigned = moves.gears.gear[np.maximum(fix_station, 0)]
    backward = (np.sign(found.state[:, 3]) != assigned) & ~resting
    doubt = np.where(backward & (np.abs(found.state[:, 3]) > DRIVING_MPS), 1.0, doubt)
    east, north, heading, speed, _, bias = found.state[:, :6].T
    gear = np.where(resting, 0, np.where(speed >= 0.0, 1, -1))
    sigma_deg = np.hypot(np.degrees(found.heading_sigma_rad), LEAST_HEADING_SIGMA_DEG)
    return Drive(
        at.time_ns,
        at.fix,
        east,
        north,
        np.asarray(wrap_deg(np.degrees(heading))),
        sigma_deg,
        found.position_sigma_m,
        found.relative_sigma_m,
        np.where(resting, 0.0, speed),
        gear.astype(np.int64),
        doubt,
        resting,
        float(np.degrees(np.median(bias))) if gyro else float("nan"),
    )


def _last_fix(fix: _Int64) -> _Int64:
    """For each node the latest fix at or before it."""
    return np.asarray(np.maximum.accumulate(fix))
