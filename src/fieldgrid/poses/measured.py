"""What is measured at the nodes of a drive, as the batch estimate takes it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64, Quality
from fieldgrid.geometry import Motion, Steps, VehicleGeometry, WheelSpeed
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.nodes import UNSEEN_NS, Nodes, seconds
from fieldgrid.poses.smoother.measurements import Measurements

USUAL_ANTENNA_M = 2.0
"""How high an antenna sits when nobody says it."""

SWAY_DEG = 0.5
"""How much a vehicle rolls and pitches on a field; an antenna 2 m up sways by 2 cm with it."""

SWAY_S = 0.3
"""How long a sway lasts: fixes that follow each other faster say the same again."""

BRIEF_SHARE = 0.05
"""Of a stated error, what may come and go within a second: neither new in each fix nor slow."""

BIAS_S, FLOAT_BIAS_S = 300.0, 10.0
"""For how long the slow part of a receiver's error lasts at least: minutes, as orbits, clocks and
air change; but a float solution (RTK without whole numbers of waves) wanders while it converges."""

LEAST_WANDER = 0.03
"""No slow error wanders by less than this, m/√s. One that would wander by more than fixes scatter
over a second lasts longer; not that of a float solution, which is known to wander."""

WHEEL_SIGMA_MPS, WHEEL_SIGMA_SHARE = 0.05, 0.05
"""Slip and a tyre's play: how well wheels know the speed."""

WHEEL_NEAR_NS = 500_000_000
"""A wheel's speed vouches for nodes as near as this."""

MOST_NODES_A_STEP = 400
"""A camera's step over more nodes than this is left out: it would make the system too large."""


class RecordedHeadings(NamedTuple):
    """Headings of the vehicle recorded with accepted fixes, NaN where there is none, and how far
    all of them may be off by one angle: a degree where nothing but their declaration is known."""

    heading_deg: Float64
    offset_sigma_deg: float = 1.0


def measurements(
    fixes: AcceptedFixes,
    at: Nodes,
    resting: Bool,
    motion: Motion,
    gear: Int64,
    rig: VehicleGeometry | None,
) -> Measurements:
    """All that was measured at the nodes, but for recorded headings. `resting` [n] marks nodes at
    rest, `gear` [n] is theirs, which signs the speeds of wheels that never turn back."""
    has = at.fix >= 0
    fix = at.fix[has]

    def at_nodes(values: Float64) -> Float64:
        column = np.full(len(at.time_ns), np.nan)
        column[has] = values[fix]
        return column

    up_m = 0.0 if rig is None else rig.antenna.up_m
    # What comes and goes within a second is no more than is seen over one.
    sway_m = (up_m if up_m > 0.0 else USUAL_ANTENNA_M) * float(np.radians(SWAY_DEG))
    brief_m = np.minimum(np.hypot(BRIEF_SHARE * fixes.sigma_m, sway_m), fixes.noise.second_m)
    noise_m = np.hypot(fixes.noise.across_m, brief_m) * _repetition(fixes.time_ns)
    late_m = fixes.noise.late_s * _pace_mps(fixes)
    bias_m = np.interp(at.time_ns, fixes.time_ns, fixes.sigma_m)
    ends, step, step_sigma = _steps(at.time_ns, motion.steps)
    speed, speed_sigma = _wheel_speeds(at.time_ns, motion.wheels, gear)
    unknown = np.full(len(at.time_ns), np.nan)
    last_fix = np.searchsorted(fixes.time_ns, at.time_ns, side="right") - 1
    wander = np.maximum(fixes.noise.second_m, LEAST_WANDER)
    lasting_s = np.maximum(BIAS_S, 2.0 * (fixes.sigma_m / wander) ** 2)
    lasting_s = np.where(fixes.quality == Quality.RTK_FLOAT, FLOAT_BIAS_S, lasting_s)
    return Measurements(
        time_s=seconds(at.time_ns),
        fix_m=np.stack([at_nodes(fixes.east_m), at_nodes(fixes.north_m)], axis=1),
        fix_sigma_m=np.stack([at_nodes(np.hypot(noise_m, late_m)), at_nodes(noise_m)], axis=1),
        bias_m=bias_m,
        bias_s=np.minimum(lasting_s, fixes.lasting_s)[np.maximum(last_fix, 0)],
        heading_rad=unknown,
        heading_sigma_rad=unknown,
        speed_mps=speed,
        speed_sigma_mps=speed_sigma,
        turned_rad=at.turned_rad,
        seen=np.diff(at.time_ns) <= UNSEEN_NS,
        standing=resting,
        step_nodes=ends,
        step=step,
        step_sigma=step_sigma,
        one_clock=bool((fixes.stamp_sigma_s == 0.0).all()),
    )


def with_headings(
    measured: Measurements, fixes: AcceptedFixes, at: Nodes, recorded: RecordedHeadings
) -> Measurements:
    """The measurements with the headings that were recorded with the fixes."""
    has = at.fix >= 0
    heading = np.full(len(at.time_ns), np.nan)
    sigma = heading.copy()
    heading[has] = np.radians(recorded.heading_deg[at.fix[has]])
    stated = np.where(np.isnan(recorded.heading_deg), np.nan, fixes.recorded_sigma_deg)
    sigma[has] = np.radians((stated * _repetition(fixes.time_ns))[at.fix[has]])
    return measured._replace(
        heading_rad=heading,
        heading_sigma_rad=sigma,
        heading_offset_sigma_rad=float(np.radians(recorded.offset_sigma_deg)),
    )


def _pace_mps(fixes: AcceptedFixes) -> Float64:
    """How fast the antenna moves at each fix, over a second or two around it, or its neighbours."""
    time_s = seconds(fixes.time_ns)
    k = np.arange(len(time_s))
    # Its neighbours at least, where fixes come less than once a second.
    first = np.minimum(np.searchsorted(time_s, time_s - 1.0), np.maximum(k - 1, 0))
    last = np.searchsorted(time_s, time_s + 1.0, side="right") - 1
    last = np.maximum(last, np.minimum(k + 1, len(time_s) - 1))
    moved = np.hypot(*(fixes.points_m()[last] - fixes.points_m()[first]).T)
    return np.asarray(moved / np.maximum(time_s[last] - time_s[first], 0.1))


def _repetition(time_ns: Int64) -> Float64:
    """By how much less a fix says than an independent one: more of them, the same sway."""
    steps = np.diff(time_ns) / 1e9
    apart_s = np.minimum(np.append(steps, np.inf), np.concatenate([[np.inf], steps]))
    return np.asarray(np.sqrt(np.maximum(1.0, 2.0 * SWAY_S / np.maximum(apart_s, 1e-3))))


def _steps(time_ns: Int64, steps: Steps | None) -> tuple[Int64, Float64, Float64]:
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


def turn_back(wheels: WheelSpeed) -> bool:
    """Whether wheels have ever said that they turn back: others may as well not know how."""
    return bool((wheels.speed_mps < -WHEEL_SIGMA_MPS).any())


def wheel_speed_at(time_ns: Int64, wheels: WheelSpeed) -> Float64:
    """The speed that wheels tell [n]; NaN where they say nothing near by."""
    known = np.isfinite(wheels.speed_mps)
    told_ns, told_mps = wheels.time_ns[known], wheels.speed_mps[known]
    if len(told_ns) < 2:
        return np.full(len(time_ns), np.nan)
    after = np.clip(np.searchsorted(told_ns, time_ns), 1, len(told_ns) - 1)
    apart = np.minimum(np.abs(time_ns - told_ns[after - 1]), np.abs(told_ns[after] - time_ns))
    return np.where(apart <= WHEEL_NEAR_NS, np.interp(time_ns, told_ns, told_mps), np.nan)


def _wheel_speeds(
    time_ns: Int64, wheels: WheelSpeed | None, gear: Int64
) -> tuple[Float64, Float64]:
    if wheels is None:
        unknown = np.full(len(time_ns), np.nan)
        return unknown, unknown
    speed = wheel_speed_at(time_ns, wheels)
    if not turn_back(wheels):
        speed = speed * np.where(gear < 0, -1.0, 1.0)
    return speed, np.hypot(WHEEL_SIGMA_MPS, WHEEL_SIGMA_SHARE * speed) * _repetition(time_ns)
