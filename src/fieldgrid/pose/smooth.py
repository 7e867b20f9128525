"""The default way to poses: everything that the drive carries, in one batch estimate."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.angles import wrap_deg
from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.motion import Motion, Steps
from fieldgrid.pose.moves import Moves, find_moves, first_guess
from fieldgrid.pose.nodes import Nodes, nodes, seconds
from fieldgrid.pose.placed import Placed
from fieldgrid.pose.rest import at_rest
from fieldgrid.pose.sightings import sightings
from fieldgrid.rig import Vehicle
from fieldgrid.smoother import Sightings, Smoothed, smooth

LEAST_HEADING_SIGMA_DEG = 0.3
"""What no sighting shows: an axle out of line, a vehicle that crabs on a side slope."""

TURNING_RAD_S = np.radians(4.0)
"""A faster turn than a gyro's bias and a shaking engine make is one."""

MISPLACED_S = 1.0
"""A cusp lies between two fixes of a receiver of 1 Hz."""

DRIVING_MPS = 0.2
"""Faster, a vehicle drives for certain, and its speed has a sign."""

RECORDED_NEAR_S = 2.0
"""For so long a recorded heading vouches for those around it."""

DRIVEN_M = 0.1
"""A camera that has moved by more was driven."""


class Drive(NamedTuple):
    """The estimate at n nodes: the middle of the unsteered axle, and what is sure of it.

    `fix` [n] is the accepted fix at a node or -1; `gear` +1, -1, 0 at rest; `doubt` the
    probability that it is the other one; `gyro_bias_dps` is NaN without a gyro.
    """

    time_ns: Int64
    fix: Int64
    east_m: Float64
    north_m: Float64
    heading_deg: Float64
    heading_sigma_deg: Float64
    position_sigma_m: Float64
    relative_sigma_m: Float64
    speed_mps: Float64
    gear: Int64
    doubt: Float64
    resting: Bool
    gyro_bias_dps: float


def smooth_drive(
    placed: Placed, motion: Motion, rig: Vehicle | None, nose_deg: Float64 | None = None
) -> Drive:
    """The batch estimate from accepted fixes (`placed`) and the vehicle's own motion.

    `nose_deg` [len(placed)] is a recorded heading that has passed its comparison with the
    course, NaN where there is none.
    """
    fixes = placed.accepted()
    at = nodes(fixes.time_ns, placed.time_ns, motion)
    resting = at_rest(
        seconds(fixes.time_ns), fixes.east_m, fixes.north_m, fixes.noise_m, fixes.speed_mps
    ) & ~_turning(at, fixes.time_ns)
    nose = np.full(len(fixes.time_ns), np.nan) if nose_deg is None else nose_deg[placed.ok]
    moves = find_moves(fixes, at, resting, motion, nose)
    # Between two fixes it rests only where it does at both; beyond them nobody knows.
    rest = np.interp(at.time_ns, fixes.time_ns, resting.astype(np.float64), left=0.0, right=0.0)
    node_rest = rest > 0.99
    node_rest &= ~_driven(at.time_ns, motion.steps)
    seen = sightings(fixes, at, node_rest, motion, nose, rig)
    lever, ahead_m = _axle(rig)
    found = smooth(seen, first_guess(fixes, at, moves), lever, ahead_m)
    return _drive(at, seen, found, moves, node_rest, at.has_gyro())


def _turning(at: Nodes, time_ns: Int64) -> Bool:
    """Where the gyro sees a vehicle turn on the spot, which its position does not show."""
    rate = np.nan_to_num(at.turned_rad) / np.maximum(np.diff(at.time_ns) / 1e9, 1e-3)
    node = np.clip(np.searchsorted(at.time_ns, time_ns), 0, max(len(rate) - 1, 0))
    return np.abs(rate[node]) > TURNING_RAD_S if len(rate) else np.zeros(len(time_ns), np.bool_)


def _driven(time_ns: Int64, steps: Steps | None) -> Bool:
    """Nodes during a step of the camera that is one."""
    change = np.zeros(len(time_ns) + 1, dtype=np.int64)
    if steps is not None:
        way_m = np.hypot(steps.forward_m, steps.right_m)
        real = way_m > np.maximum(DRIVEN_M, 4.0 * steps.sigma_m)
        np.add.at(change, np.searchsorted(time_ns, steps.start_ns[real]), 1)
        np.add.at(change, np.searchsorted(time_ns, steps.stop_ns[real], side="right"), -1)
    return np.asarray(np.cumsum(change[:-1]) > 0)


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


def _lasting(against: Bool, time_s: Float64) -> Bool:
    """Where the estimate goes against its gears for longer than a cusp may be misplaced: then
    nobody knows which way the vehicle went."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], against, [False]]).astype(np.int8)))
    found = np.zeros(len(against), dtype=np.bool_)
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        found[first:stop] = time_s[stop - 1] - time_s[first] > MISPLACED_S
    return found


def _near_recorded(seen: Sightings) -> Bool:
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
    moves: Moves,
    resting: Bool,
    gyro: bool,
) -> Drive:
    fix_station = np.searchsorted(moves.station, _last_fix(at.fix), side="right") - 1
    doubt = moves.gears.doubt[np.maximum(fix_station, 0)]
    doubt = np.where(_near_recorded(seen), 0.0, doubt)
    assigned = moves.gears.gear[np.maximum(fix_station, 0)]
    against = (found.state[:, 3] * assigned < -DRIVING_MPS) & ~resting
    doubt = np.where(_lasting(against, seen.time_s), 1.0, doubt)
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


def _last_fix(fix: Int64) -> Int64:
    """For each node the latest fix at or before it."""
    return np.asarray(np.maximum.accumulate(fix))
