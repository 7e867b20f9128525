"""The default way to poses: everything that the drive carries, in one batch estimate."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64, PoseSettings, Quality
from fieldgrid.geometry import Motion, wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.faults.leaps.leaps import holes
from fieldgrid.poses.faults.leaps.seams import SeenLeap
from fieldgrid.poses.faults.leaps.told import told_leaps
from fieldgrid.poses.gears.stations import (
    NO_HINTS,
    StationGears,
    first_guess,
    station_gears,
)
from fieldgrid.poses.measured import RecordedHeadings, measurements, with_headings
from fieldgrid.poses.nodes import Nodes, nodes, seconds
from fieldgrid.poses.smoother.batch import SmoothedDrive, refine, smooth
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.slow_error import CLEAR_NATS, SlowError, likeliest

# When the vehicle stood still: by what the receiver's speed says, or by where it stayed.


HALF_WINDOW_S = 1.5
"""A vehicle at rest stays in place for this long before and after."""

REST_MPS = 0.1
"""Slower than this over the window, a vehicle stands and its positions wander."""

STAY_S, STAY_MPS = 5.0, 0.1
"""So does one whose positions all stay so near for this long before and after, though they may
wander faster in between."""

WANDER_MPS = 0.25
"""The positions of a standing vehicle may wander at this speed when its receiver says 0."""


def at_rest(
    time_s: Float64, east_m: Float64, north_m: Float64, noise_m: Float64, speed_mps: Float64
) -> Bool:
    """Which of n fixes were taken at rest. `speed_mps` is the receiver's own, NaN: none."""
    first = np.searchsorted(time_s, time_s - HALF_WINDOW_S)
    last = np.searchsorted(time_s, time_s + HALF_WINDOW_S, side="right") - 1
    span_s = time_s[last] - time_s[first]
    moved_m = np.hypot(east_m[last] - east_m[first], north_m[last] - north_m[first])
    long_enough = span_s >= 0.7 * HALF_WINDOW_S
    slow = long_enough & (moved_m < np.maximum(REST_MPS * span_s, 2.0 * noise_m))
    # Which fixes have all of their neighbours in time near them.
    near = np.ones(len(time_s), dtype=np.bool_)
    seen_s = np.zeros(len(time_s))
    for offset_s in np.linspace(-STAY_S, STAY_S, 9):
        at = np.clip(np.searchsorted(time_s, time_s + offset_s), 0, len(time_s) - 1)
        near &= np.hypot(east_m[at] - east_m, north_m[at] - north_m) < STAY_MPS * STAY_S
        seen_s = np.maximum(seen_s, np.abs(time_s[at] - time_s))
    slow |= near & (seen_s > 0.7 * STAY_S)
    if not _believable(speed_mps, moved_m, span_s):
        return slow
    said = np.nan_to_num(speed_mps, nan=np.inf) < REST_MPS
    near = moved_m < np.maximum(WANDER_MPS * span_s, 4.0 * noise_m)
    return np.asarray(np.where(np.isnan(speed_mps), slow, said & near))


def _believable(speed_mps: Float64, moved_m: Float64, span_s: Float64) -> bool:
    """Whether the receiver's speeds are those of this drive: some loggers write only zeros."""
    with np.errstate(invalid="ignore", divide="ignore"):
        driven = moved_m / span_s
        moving = (driven > 0.5) & np.isfinite(speed_mps)
    if not moving.any():
        return bool(np.isfinite(speed_mps).any())
    return bool(0.5 < np.median(speed_mps[moving] / driven[moving]) < 2.0)


LEAST_HEADING_SIGMA_DEG = 0.3
"""What no measurement shows: an axle out of line, a vehicle that crabs on a side slope."""

TURNING_RAD_S = np.radians(4.0)
"""A faster turn than a gyro's bias and a shaking engine make is one."""

MISPLACED_S = 1.0
"""A cusp lies between two fixes of a receiver of 1 Hz."""

DRIVING_MPS = 0.2
"""Faster, a vehicle drives for certain, and its speed has a sign."""

RECORDED_NEAR_S = 2.0
"""For so long a recorded heading vouches for those around it."""

BACK_M = 1.5
"""Who drives farther back in a hole has changed the gear there."""

SETTLED_DOUBT = 1e-30
"""So little doubt leaves only the user, whose word no estimate outweighs."""

MOST_STEP_SIGMAS = 8.0
"""A step of the camera that is off the drive by more says nothing of a slow error, which spreads
over all steps."""

DRIVEN_M = 0.1
"""A camera that has moved by more was driven."""


class DriveEstimate(NamedTuple):
    """The estimate at n nodes: the middle of the unsteered axle, and what is sure of it.

    `fix` [n] is the accepted fix at a node or -1; `gear` +1, -1, 0 at rest; `doubt` the
    probability that it is the other one. `offset_m` [accepted fixes, 2] is how far east and north
    of each fix the antenna is estimated. `smoothed` are the states and constants behind it,
    and `slow` is what the drive shows of the fixes' slow error, `leaps` where it leaps.
    """

    at: Nodes
    measured: Measurements
    stations: StationGears
    smoothed: SmoothedDrive
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
    offset_m: Float64
    slow: SlowError
    leaps: tuple[SeenLeap, ...]

    @property
    def time_ns(self) -> Int64:
        """The instants of the nodes."""
        return self.at.time_ns

    @property
    def fix(self) -> Int64:
        """The accepted fix at each node, or -1."""
        return self.at.fix

    @property
    def headings_recorded(self) -> bool:
        """Whether most fixes have a recorded heading that was used."""
        return self.measured.records_headings()

    @property
    def gyro_bias_dps(self) -> float:
        """The median bias of the gyro, degrees a second; NaN without one."""
        if not self.at.has_gyro():
            return float("nan")
        return float(np.degrees(np.median(self.smoothed.state[:, 5])))


def smooth_drive(
    fixes: AcceptedFixes,
    all_ns: Int64,
    motion: Motion,
    axle: Axle,
    recorded: RecordedHeadings | None = None,
    hints: PoseSettings = NO_HINTS,
    *,
    as_stated: bool = False,
    near: DriveEstimate | None = None,
) -> DriveEstimate:
    """The batch estimate from accepted fixes and the vehicle's own motion.

    `all_ns` are the times of all fixes, which get poses too; `recorded` headings have passed their
    comparison with the course. The slow error of the fixes is learnt, unless it is to be
    `as_stated`. An estimate `near` this one, with the same nodes, gears and gyro, is where it
    begins, with the steering that it has learnt.
    """
    at = nodes(fixes.time_ns, all_ns, motion)
    standing = _standing(fixes)
    # Where the gyro sees a vehicle turn on the spot, which its position does not show.
    rate = np.nan_to_num(at.turned_rad) / np.maximum(np.diff(at.time_ns) / 1e9, 1e-3)
    node = np.clip(np.searchsorted(at.time_ns, fixes.time_ns), 0, max(len(rate) - 1, 0))
    resting = standing & ~(np.abs(rate[node]) > TURNING_RAD_S) if len(rate) else standing
    recorded = recorded or RecordedHeadings(np.full(len(fixes.time_ns), np.nan))
    found = station_gears(fixes, at, standing, resting, motion, recorded.heading_deg, hints)
    # Between two fixes it rests only where it does at both; beyond them nobody knows.
    rest = np.interp(at.time_ns, fixes.time_ns, resting.astype(np.float64), left=0.0, right=0.0)
    # Nodes during a step of the camera that shows motion do not rest.
    change = np.zeros(len(at.time_ns) + 1, dtype=np.int64)
    if motion.steps is not None:
        distance_m = np.hypot(motion.steps.forward_m, motion.steps.right_m)
        real = distance_m > np.maximum(DRIVEN_M, 4.0 * motion.steps.sigma_m)
        np.add.at(change, np.searchsorted(at.time_ns, motion.steps.start_ns[real]), 1)
        np.add.at(change, np.searchsorted(at.time_ns, motion.steps.stop_ns[real], side="right"), -1)
    node_rest = (rest > 0.99) & (np.cumsum(change[:-1]) <= 0)
    gear, _ = _assigned(at, found)
    measured = measurements(fixes, at, node_rest, motion, gear, axle.vehicle)
    measured = with_headings(measured, fixes, at, recorded)
    begun = (
        near is not None
        and np.array_equal(near.time_ns, at.time_ns)
        and near.at.has_gyro() == at.has_gyro()
        and np.array_equal(_assigned(near.at, near.stations)[0], gear)
    )
    if near is not None and begun:
        smoothed = refine(near.smoothed, measured, *axle.frame(), axle.sigma_m)
    else:
        lever_m, step_ahead_m = axle.frame()
        # Not a name here, nor `*axle.frame()`: either would keep the guess, which `smooth` lets go.
        smoothed = smooth(
            measured,
            first_guess(fixes, at, found, measured),
            *(lever_m, step_ahead_m, axle.sigma_m),
        )
    leaps = () if as_stated else told_leaps(smoothed, measured, at, fixes, axle)
    slow = SlowError()
    if not as_stated and measured.sees_turns() and smoothed.wander_nats > CLEAR_NATS:
        # A camera that is stuck looks like fixes that leap.
        off = np.abs(smoothed.step_off) / measured.step_sigma[:, [0, 0, 1]]
        measured = measured.with_steps(off.max(axis=1) < MOST_STEP_SIGMAS)
        slow, smoothed = _wandering(smoothed, measured, axle)
    return _drive(fixes, at, slow.of(measured), found, smoothed, axle, rest > 0.99, slow, leaps)


def _wandering(
    known: SmoothedDrive, measured: Measurements, axle: Axle
) -> tuple[SlowError, SmoothedDrive]:
    """The slow error of the fixes that makes a drive likeliest, and the drive by it."""
    drives: dict[SlowError, SmoothedDrive] = {}
    if len(measured.step) == len(known.step_off):
        drives[SlowError()] = known

    def nats(slow: SlowError) -> float:
        if slow not in drives:
            drives[slow] = refine(known, slow.of(measured), *axle.frame(), axle.sigma_m)
        return drives[slow].nats

    slow = likeliest(nats)
    return slow, drives[slow]


def with_recorded(
    drive: DriveEstimate,
    fixes: AcceptedFixes,
    motion: Motion,
    axle: Axle,
    recorded: RecordedHeadings,
    hints: PoseSettings,
) -> DriveEstimate:
    """The drive by its recorded headings, too: only what they change is estimated again,
    unless they turn a gear around."""
    resting = drive.resting[np.flatnonzero(drive.fix >= 0)]
    found = station_gears(
        *(fixes, drive.at, _standing(fixes), resting, motion, recorded.heading_deg, hints)
    )
    if not np.array_equal(found.gears.gear, drive.stations.gears.gear):
        return smooth_drive(fixes, drive.time_ns, motion, axle, recorded, hints)
    measured = with_headings(drive.measured, fixes, drive.at, recorded)
    smoothed = refine(drive.smoothed, measured, *axle.frame(), axle.sigma_m)
    return _drive(
        *(fixes, drive.at, measured, found, smoothed, axle),
        *(drive.resting, drive.slow, drive.leaps),
    )


def _standing(fixes: AcceptedFixes) -> Bool:
    """Fixes at which a vehicle stays where it is, whether it turns there or not."""
    return at_rest(
        seconds(fixes.time_ns), fixes.east_m, fixes.north_m, fixes.noise.across_m, fixes.speed_mps
    )


def _assigned(at: Nodes, found: StationGears) -> tuple[Int64, Float64]:
    """Gear and doubt of the station at or before each node."""
    fix = np.maximum.accumulate(at.fix)
    station = np.maximum(np.searchsorted(found.station, fix, side="right") - 1, 0)
    return found.gears.gear[station], found.gears.doubt[station]


def _drive(
    fixes: AcceptedFixes,
    at: Nodes,
    measured: Measurements,
    found: StationGears,
    smoothed: SmoothedDrive,
    axle: Axle,
    rested: Bool,
    slow: SlowError,
    leaps: tuple[SeenLeap, ...],
) -> DriveEstimate:
    assigned, doubt = _assigned(at, found)
    east, north, heading, speed = smoothed.state[:, :4].T
    # A step of the camera that reaches beyond a stop was driven there, so it denies none of it.
    resting = measured.standing | rested & (np.abs(speed) < DRIVING_MPS)
    turns = at._replace(turned_rad=measured.seen_turns_rad())
    denied = contradicted_gear(turns, assigned, speed) & (doubt > SETTLED_DOUBT)
    doubt = np.where(denied, 1.0, doubt)
    doubt = np.where(_near_recorded(measured), 0.0, doubt)
    against = (speed * assigned < -DRIVING_MPS) & ~resting
    doubt = np.where(lasting(against, measured.time_s), 1.0, doubt)
    sigma_deg = np.hypot(np.degrees(smoothed.heading_sigma_rad), LEAST_HEADING_SIGMA_DEG)
    if resting.all() and not np.isfinite(measured.heading_rad).any():
        sigma_deg = np.full(len(resting), 180.0)  # what wanders is no motion
    sigma_deg = np.hypot(sigma_deg, np.degrees(smoothed.unsure.heading_rad))
    # For how long the error of a float solution lasts is a guess; if it lasts, no mean over the
    # drive makes it smaller than stated.
    last = np.maximum(np.searchsorted(fixes.time_ns, at.time_ns, side="right") - 1, 0)
    floats = fixes.quality[last] == Quality.RTK_FLOAT
    least_m = np.where(floats, measured.bias_m, 0.0)
    (right_m, ahead_m), _ = axle.frame()
    has = at.fix >= 0
    sin, cos = np.sin(heading[has]), np.cos(heading[has])
    offset_m = np.stack(
        [
            east[has] + right_m * cos + ahead_m * sin - fixes.east_m[at.fix[has]],
            north[has] - right_m * sin + ahead_m * cos - fixes.north_m[at.fix[has]],
        ],
        axis=1,
    )
    return DriveEstimate(
        at,
        measured,
        found,
        smoothed,
        east,
        north,
        np.asarray(wrap_deg(np.degrees(heading))),
        np.asarray(sigma_deg),
        np.maximum(smoothed.position_sigma_m, least_m),
        smoothed.relative_sigma_m,
        np.where(resting, 0.0, speed),
        np.where(resting, 0, np.where(speed >= 0.0, 1, -1)).astype(np.int64),
        doubt,
        resting,
        offset_m,
        slow,
        leaps,
    )


def lasting(against: Bool, time_s: Float64) -> Bool:
    """Where the estimate goes against its gears for longer than a cusp may be misplaced: then
    nobody knows which way the vehicle went."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], against, [False]]).astype(np.int8)))
    found = np.zeros(len(against), dtype=np.bool_)
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        found[first:stop] = time_s[stop - 1] - time_s[first] > MISPLACED_S
    return found


def contradicted_gear(at: Nodes, assigned: Int64, speed_mps: Float64) -> Bool:
    """Nodes [n] whose gear the estimate denies: it drives back within a hole of the fixes, in which
    nothing tells how the vehicle turned, and whose two sides have the same gear, so that one of
    them is wrong. That is rather the side of which less was seen until the next such hole, and on
    it what lies before the next hole of any kind, with the nodes in the holes beside it; the gear
    of each node is `assigned`."""
    node = np.flatnonzero(at.fix >= 0)
    gap_s = np.diff(at.time_ns[node]) / 1e9
    denied = np.zeros(len(assigned), dtype=np.bool_)
    if len(gap_s) == 0:
        return denied
    hole = holes(gap_s)
    against_m = np.maximum(-(speed_mps * assigned)[:-1], 0.0) * np.diff(at.time_ns) / 1e9
    back_m = np.diff(np.concatenate([[0.0], np.cumsum(against_m)])[node])
    # What saw how it turned in the hole tells which way it stood on both sides.
    unseen = np.concatenate([[0], np.cumsum(np.isnan(at.turned_rad))])[node]
    hole_unseen = hole & (np.diff(unseen) > 0)
    wrong = np.flatnonzero(hole_unseen & (back_m > BACK_M) & (np.diff(assigned[node]) == 0))
    seen_s = np.concatenate([[0.0], np.cumsum(np.where(hole, 0.0, gap_s))])
    ends = np.concatenate([[0], np.flatnonzero(hole) + 1, [len(node)]])
    around = np.concatenate([[-1], wrong, [len(node) - 1]])
    for before, one, after in zip(around[:-2], wrong, around[2:], strict=True):
        later = seen_s[after] - seen_s[one + 1] <= seen_s[one] - seen_s[before + 1]
        piece = int(np.searchsorted(ends, one + later, side="right"))
        first, stop = ends[piece - 1], ends[piece]
        begin = node[first - 1] + 1 if first > 0 else 0
        denied[begin : node[stop] if stop < len(node) else None] = True
    return denied


def _near_recorded(measured: Measurements) -> Bool:
    """Nodes whose heading is as good as recorded, so that it does not hang on the gear."""
    recorded = np.flatnonzero(np.isfinite(measured.heading_rad))
    if recorded.size == 0:
        return np.zeros(len(measured.time_s), dtype=np.bool_)
    before = np.searchsorted(recorded, np.arange(len(measured.time_s)), side="right") - 1
    after = np.minimum(before + 1, recorded.size - 1)
    nearest_s = np.minimum(
        np.abs(measured.time_s - measured.time_s[recorded[np.maximum(before, 0)]]),
        np.abs(measured.time_s - measured.time_s[recorded[after]]),
    )
    return np.asarray(nearest_s < RECORDED_NEAR_S)
