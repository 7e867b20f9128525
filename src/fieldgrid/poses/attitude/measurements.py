"""What a drive measures of its attitude, at nodes and from node to node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import (
    Inertial,
    R_enu_level,
    R_level_vehicle,
    RecordedTilt,
    Steps,
    to_vectors,
)
from fieldgrid.poses.attitude.axes import AxisTilt
from fieldgrid.poses.attitude.increments import increments, sample_noise

LEAST_STEP_NS, MOST_STEP_NS = 190_000_000, 250_000_000
"""Fixes closer than the one add little; nodes of a vehicle with an IMU are no farther apart than
the other, so that it turns little between them."""

BREAK_NS = 10_000_000_000
"""In a longer break of the fixes nobody asks how the vehicle leant."""

WANDER_S = 300.0
"""The slow part of a receiver's error changes in minutes."""

WANDER_SHARE = np.array([1.2, 1.2, 2.5])
"""How the slow errors east, north and up compare with the stated one of a horizontal axis: few
satellites are seen near the horizon, and none below it."""

GYRO_NOISE = np.radians(0.05)
"""Noise of an integrated gyro with a vehicle's vibrations, rad/√s: never less."""

GYRO_SQUARENESS = 0.004
"""By how much the axes of gyro and accelerometer are out of square, and the gyro's scale off: in
a turn by a radian, this share of it seems to be a tilt."""

FORCE_NOISE = 0.02
"""White noise of an accelerometer, (m/s²)·√s."""

STEP_TURN_SIGMA, STEP_WAY_SHARE = np.radians(0.015), 0.004
"""What the covariance of a camera's step does not know: errors of calibration and mounting."""

FIT_NS, FIT_FIXES = 700_000_000, 6
"""The antenna at a frame is found from this number of fixes around it, within this time or three of
the receiver's periods."""

TILT_S = 30.0
"""For how long the error of a recorded roll and pitch stays the same."""


HEADING_GAP_NS = 1_500_000_000
"""Between headings that are farther apart a vehicle may have turned anyhow."""


class KnownHeadings(NamedTuple):
    """The vehicle's headings at two or more instants in order of time, degrees, with their sigmas.
    They count turns on: 370° follows 350° of a vehicle that turned to the right."""

    time_ns: Int64
    heading_deg: Float64
    sigma_deg: Float64

    def at(self, time_ns: Int64) -> tuple[Float64, Float64]:
        """Headings and sigmas at other instants. Inside a gap nobody knows how the vehicle turned:
        there the sigma is infinite."""
        heading_deg = np.interp(time_ns, self.time_ns, self.heading_deg)
        sigma_deg = np.interp(time_ns, self.time_ns, self.sigma_deg)
        after = np.clip(np.searchsorted(self.time_ns, time_ns), 1, len(self.time_ns) - 1)
        before_ns, after_ns = self.time_ns[after - 1], self.time_ns[after]
        inside = (before_ns < time_ns) & (time_ns < after_ns)
        sigma_deg[inside & (after_ns - before_ns > HEADING_GAP_NS)] = np.inf
        return heading_deg, sigma_deg


class AntennaTrack(NamedTuple):
    """The antenna by accepted fixes, n in order of time: LTP metres `enu_m` [n, 3], the white part
    `noise_m` [n, 3] of their error along each axis, the stated slow error `wander_m` [n] of a
    horizontal one; and the vehicle's headings."""

    time_ns: Int64
    enu_m: Float64
    noise_m: Float64
    wander_m: Float64
    headings: KnownHeadings


class NodeMotion(NamedTuple):
    """What was measured from each node to the next, [n - 1] or [n - 1, 3]; NaN where nothing was.

    `turn_rad` is a rotation vector with `turn_sigma_rad`, by a gyro over `gyro_s` seconds (0: by
    the camera). `push_mps` and `push_m` are what the accelerometer adds to speed and way, with
    `push_sigma` of the speed. `way_m` is the camera's way with `way_sigma_m`. `wander_m` is by how
    much the receiver's slow error may change.
    """

    turn_rad: Float64
    turn_sigma_rad: Float64
    gyro_s: Float64
    push_mps: Float64
    push_m: Float64
    push_sigma: Float64
    way_m: Float64
    way_sigma_m: Float64
    wander_m: Float64

    @property
    def turned(self) -> Bool:
        """Where the turn is known [n - 1]."""
        return np.asarray(np.isfinite(self.turn_rad[:, 0]))

    @property
    def pushed(self) -> Bool:
        """Where the accelerometer says something [n - 1]."""
        return np.asarray(np.isfinite(self.push_sigma))

    @property
    def watched(self) -> Bool:
        """Where the camera saw the way [n - 1]."""
        return np.asarray(np.isfinite(self.way_m[:, 0]))


class AttitudeMeasurements(NamedTuple):
    """What was measured at n nodes, NaN where nothing was, and between them.

    The antenna `fix_m` [n, 3] with `fix_sigma_m`, `heading_rad` and `heading_sigma_rad` [n], the
    vertical in the vehicle's axes by a recorded tilt `vertical` [n, 2] (right, forward) with
    `vertical_sigma` [n], and the sine of the rise of each recorded axis with its sigma, [n] each.
    """

    time_s: Float64
    fix_m: Float64
    fix_sigma_m: Float64
    heading_rad: Float64
    heading_sigma_rad: Float64
    vertical: Float64
    vertical_sigma: Float64
    risen: tuple[tuple[Float64, Float64], ...]
    moved: NodeMotion

    def part(self, start: int, stop: int) -> AttitudeMeasurements:
        """What was measured from node `start` to before node `stop`."""
        columns = self._asdict()
        risen, moved = columns.pop("risen"), columns.pop("moved")
        return AttitudeMeasurements(
            **{name: column[start:stop] for name, column in columns.items()},
            risen=tuple((sine[start:stop], sigma[start:stop]) for sine, sigma in risen),
            moved=NodeMotion(*(column[start : stop - 1] for column in moved)),
        )


def measure(
    track: AntennaTrack,
    wanted_ns: Int64,
    sensed: Inertial | None,
    steps: Steps | None,
    tilt: RecordedTilt | None,
    axes: Sequence[AxisTilt] = (),
) -> tuple[Int64, AttitudeMeasurements]:
    """The nodes, at `wanted_ns` and where else something was measured, and what was."""
    pushed = sensed is not None and bool(np.isfinite(sensed.force_mps2).any())
    # The camera's motion says no more than gyro and accelerometer together, and it is of longer
    # intervals.
    steps = None if pushed or steps is None or len(steps.start_ns) == 0 else steps
    node_ns, fix_m, fix_sigma_m = _nodes(track, wanted_ns, sensed is not None, steps)
    time_s, at_s = (node_ns - node_ns[0]) / 1e9, (track.time_ns - node_ns[0]) / 1e9
    step_s = np.diff(time_s)
    wander_m = np.interp(time_s, at_s, track.wander_m)[:-1, None] * WANDER_SHARE
    moved = _moved(sensed, node_ns, wander_m * np.sqrt(2.0 * step_s / WANDER_S)[:, None])
    heading_deg, heading_sigma_deg = track.headings.at(node_ns)
    vertical, vertical_sigma = _recorded(tilt, node_ns)
    return node_ns, AttitudeMeasurements(
        time_s,
        fix_m,
        fix_sigma_m,
        np.radians(heading_deg),
        np.radians(heading_sigma_deg),
        vertical,
        vertical_sigma,
        tuple(axis.at(node_ns) for axis in axes),
        moved if steps is None else _with_steps(moved, steps, node_ns),
    )


def _moved(sensed: Inertial | None, node_ns: Int64, wander_m: Float64) -> NodeMotion:
    """What the IMU measured between nodes."""
    step_s = np.diff(node_ns) / 1e9
    unknown = np.full((len(step_s), 3), np.nan)
    nothing = unknown[:, 0]
    if sensed is None:
        alone = np.zeros(len(step_s))
        pushes = unknown, unknown, nothing
        return NodeMotion(unknown, unknown, alone, *pushes, unknown, unknown, wander_m)
    found = increments(sensed, node_ns)
    turn_noise = np.hypot(GYRO_NOISE, sample_noise(sensed.rate_rad_s, sensed.time_ns))
    push_noise = np.hypot(FORCE_NOISE, sample_noise(sensed.force_mps2, sensed.time_ns))
    turned_rad = np.linalg.norm(np.nan_to_num(found.turn_rad), axis=1)
    turn_sigma = np.sqrt(turn_noise**2 * step_s + GYRO_SQUARENESS**2 * turned_rad)
    known = np.isfinite(found.speed_mps[:, 0])
    return NodeMotion(
        found.turn_rad,
        np.repeat(turn_sigma[:, None], 3, axis=1),
        step_s,
        found.speed_mps,
        found.way_m,
        np.where(known, push_noise * np.sqrt(step_s), np.nan),
        unknown,
        unknown,
        wander_m,
    )


def _with_steps(moved: NodeMotion, steps: Steps, node_ns: Int64) -> NodeMotion:
    """The motion between nodes, with the camera's motion between the nodes that a step joins."""
    start, stop = (np.searchsorted(node_ns, ends) for ends in (steps.start_ns, steps.stop_ns))
    joins = (stop == start + 1) & (stop < len(node_ns)) & np.isfinite(steps.up_m)
    joins &= node_ns[np.minimum(start, len(node_ns) - 1)] == steps.start_ns
    k = start[joins]
    way = np.stack([steps.right_m, steps.forward_m, steps.up_m], axis=1)[joins]
    way_sigma = np.hypot(steps.sigma_m[joins], STEP_WAY_SHARE * np.linalg.norm(way, axis=1))
    R = R_enu_level(steps.turn_deg) @ R_level_vehicle(steps.roll_deg, steps.pitch_deg)
    turn_sigma = np.hypot(np.radians(steps.tilt_sigma_deg[joins]), STEP_TURN_SIGMA)

    def placed(column: Float64, values: Float64) -> Float64:
        out = column.copy()
        out[k] = values
        return out

    return moved._replace(
        turn_rad=placed(moved.turn_rad, to_vectors(R[joins])),
        turn_sigma_rad=placed(moved.turn_sigma_rad, turn_sigma[:, None]),
        gyro_s=placed(moved.gyro_s, np.zeros(len(k))),
        way_m=placed(moved.way_m, way),
        way_sigma_m=placed(moved.way_sigma_m, way_sigma[:, None]),
    )


def _nodes(
    track: AntennaTrack, wanted_ns: Int64, filled: bool, steps: Steps | None
) -> tuple[Int64, Float64, Float64]:
    """Instants of nodes, and the antenna there [n, 3] with its sigma, NaN where it is unknown.

    Fixes, the wanted instants, and with an IMU more between them. Within a step of the camera
    no node is of use: fixes there say where the antenna was at its ends.
    """
    first_ns, last_ns = int(track.time_ns[0]), int(track.time_ns[-1])
    # Instants at least `LEAST_STEP_NS` apart.
    kept, k = [0], 0
    while k < len(track.time_ns):
        kept.append(k)
        k = int(np.searchsorted(track.time_ns, track.time_ns[k] + LEAST_STEP_NS))
    fixes_ns = track.time_ns[kept[1:]]
    wanted_ns = wanted_ns[(wanted_ns >= first_ns) & (wanted_ns <= last_ns)]
    if steps is not None:
        ends_ns = np.union1d(steps.start_ns, steps.stop_ns)
        ends_ns = ends_ns[(ends_ns >= first_ns) & (ends_ns <= last_ns)]
        fixes_ns = fixes_ns[~_within(fixes_ns, steps)]
        wanted_ns = np.union1d(wanted_ns[~_within(wanted_ns, steps)], ends_ns)
    node_ns = np.union1d(fixes_ns, wanted_ns)
    if filled:
        more = _filled(node_ns)
        node_ns = np.union1d(node_ns, more if steps is None else more[~_within(more, steps)])
    fix_m, sigma_m = np.full((len(node_ns), 3), np.nan), np.full((len(node_ns), 3), np.nan)
    if steps is not None:
        at = np.searchsorted(node_ns, ends_ns)
        fix_m[at], sigma_m[at] = _antenna_at(track, ends_ns)
    at, of = np.searchsorted(node_ns, fixes_ns), np.searchsorted(track.time_ns, fixes_ns)
    fix_m[at], sigma_m[at] = track.enu_m[of], track.noise_m[of]
    return node_ns, fix_m, sigma_m


def _within(time_ns: Int64, steps: Steps) -> Bool:
    """Instants inside a step, its ends apart."""
    change = np.zeros(len(time_ns) + 1, dtype=np.int64)
    np.add.at(change, np.searchsorted(time_ns, steps.start_ns, side="right"), 1)
    np.add.at(change, np.searchsorted(time_ns, steps.stop_ns), -1)
    return np.asarray(np.cumsum(change[:-1]) > 0)


def _filled(time_ns: Int64) -> Int64:
    """Instants with more of them evenly between, at most `MOST_STEP_NS` apart, but in a break."""
    steps = np.diff(time_ns)
    parts = np.where(steps <= BREAK_NS, -(-steps // MOST_STEP_NS), 1)
    first = np.repeat(np.cumsum(parts) - parts, parts)
    share = (np.arange(parts.sum()) - first) / np.repeat(parts, parts)
    more = np.rint(share * np.repeat(steps, parts)).astype(np.int64)
    return np.append(np.repeat(time_ns[:-1], parts) + more, time_ns[-1])


def _antenna_at(track: AntennaTrack, time_ns: Int64) -> tuple[Float64, Float64]:
    """The antenna [m, 3] at instants between fixes, by a parabola through those around, and its
    sigma; NaN where there is no fix before or none after."""
    period_ns = float(np.median(np.diff(track.time_ns))) if len(track.time_ns) > 1 else 0.0
    reach_ns = max(FIT_NS, 3.0 * period_ns)
    found, sigma = np.full((len(time_ns), 3), np.nan), np.full((len(time_ns), 3), np.nan)
    after = np.searchsorted(track.time_ns, time_ns)
    for k, middle in enumerate(after.tolist()):
        near = slice(max(middle - FIT_FIXES // 2, 0), middle + FIT_FIXES // 2)
        late_s = (track.time_ns[near] - time_ns[k]) / 1e9
        close = np.abs(late_s) * 1e9 <= reach_ns
        late_s = late_s[close]
        if not ((late_s <= 0.0).any() and (late_s >= 0.0).any()):
            continue
        powers = late_s[:, None] ** np.arange(min(len(late_s) - 1, 2) + 1)
        weights = np.linalg.pinv(powers)[0]
        found[k] = weights @ track.enu_m[near][close]
        sigma[k] = np.sqrt(weights**2 @ track.noise_m[near][close] ** 2)
    return found, sigma


def _recorded(tilt: RecordedTilt | None, node_ns: Int64) -> tuple[Float64, Float64]:
    """The vertical [n, 2] in the vehicle's axes by a recorded roll and pitch, and its sigma."""
    vertical, sigma = np.full((len(node_ns), 2), np.nan), np.full(len(node_ns), np.nan)
    if tilt is None or len(tilt.time_ns) < 2:
        return vertical, sigma
    after = np.clip(np.searchsorted(tilt.time_ns, node_ns), 1, len(tilt.time_ns) - 1)
    near = tilt.time_ns[after] - tilt.time_ns[after - 1] <= MOST_STEP_NS
    near &= (node_ns >= tilt.time_ns[0]) & (node_ns <= tilt.time_ns[-1])
    roll, pitch, stated = (
        np.interp(node_ns, tilt.time_ns, column)
        for column in (tilt.roll_deg, tilt.pitch_deg, tilt.sigma_deg)
    )
    up = R_level_vehicle(roll, pitch)[:, 2]
    vertical[near], sigma[near] = up[near, :2], np.radians(stated[near])
    spacing_s = np.gradient(node_ns / 1e9) if len(node_ns) > 1 else np.ones(1)
    return vertical, sigma * np.sqrt(np.maximum(TILT_S / np.maximum(spacing_s, 1e-3), 1.0))
