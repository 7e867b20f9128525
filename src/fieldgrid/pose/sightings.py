"""What was seen at the nodes of a drive, as the smoother takes it."""

from __future__ import annotations

import numpy as np

from fieldgrid.array_types import Bool, Float64, Int64
from fieldgrid.motion import Motion, Steps
from fieldgrid.pose.nodes import UNSEEN_NS, Nodes, seconds
from fieldgrid.pose.placed import Placed
from fieldgrid.quality import Quality
from fieldgrid.rig import Vehicle
from fieldgrid.smoother import Sightings

USUAL_ANTENNA_M = 2.0
"""How high an antenna sits when nobody says it."""

SWAY_DEG = 0.5
"""How much a vehicle rolls and pitches on a field; an antenna 2 m up sways by 2 cm with it."""

SWAY_S = 0.3
"""How long a sway lasts: fixes that follow each other faster say the same again."""

BIAS_S, FLOAT_BIAS_S = 300.0, 10.0
"""For how long the slow part of a receiver's error lasts: minutes, as orbits, clocks and air
change; but a float solution (RTK without whole numbers of waves) wanders while it converges."""

WHEEL_SIGMA_MPS, WHEEL_SIGMA_SHARE = 0.05, 0.05
"""Slip and a tyre's radius: how well wheels know the speed."""

MOST_NODES_A_STEP = 40
"""A camera's step over more nodes than this is left out: it would make the matrix too wide."""


def sightings(
    fixes: Placed,
    at: Nodes,
    resting: Bool,
    motion: Motion,
    nose_deg: Float64,
    rig: Vehicle | None,
) -> Sightings:
    """All that was seen at the nodes; `resting` [n] marks nodes at rest, `nose_deg` recorded
    headings at the fixes."""
    has = at.fix >= 0
    fix = at.fix[has]

    def at_nodes(values: Float64) -> Float64:
        column = np.full(len(at.time_ns), np.nan)
        column[has] = values[fix]
        return column

    sigma_m = np.hypot(fixes.noise_m, _sway_m(rig)) * _repetition(fixes.time_ns)
    ends, step, step_sigma = _steps(at.time_ns, motion.steps)
    speed, speed_sigma = _wheel_speeds(at.time_ns, motion)
    return Sightings(
        time_s=seconds(at.time_ns),
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


def _bias_s(fixes: Placed) -> Float64:
    return np.where(fixes.quality == Quality.RTK_FLOAT, FLOAT_BIAS_S, BIAS_S)


def _last_before(time_ns: Int64, sorted_ns: Int64) -> Int64:
    """For each instant the last of `sorted_ns` at or before it, else the first."""
    return np.asarray(np.maximum(np.searchsorted(sorted_ns, time_ns, side="right") - 1, 0))


def _sway_m(rig: Vehicle | None) -> float:
    up_m = 0.0 if rig is None else rig.antenna.up_m
    return (up_m if up_m > 0.0 else USUAL_ANTENNA_M) * float(np.radians(SWAY_DEG))


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


def _wheel_speeds(time_ns: Int64, motion: Motion) -> tuple[Float64, Float64]:
    wheels = motion.wheels
    unknown = np.full(len(time_ns), np.nan)
    if wheels is None or not (wheels.speed_mps < -WHEEL_SIGMA_MPS).any():
        return unknown, unknown
    near = np.abs(wheels.time_ns[_at(wheels.time_ns, time_ns)] - time_ns) <= UNSEEN_NS // 20
    speed = np.where(near, np.interp(time_ns, wheels.time_ns, wheels.speed_mps), np.nan)
    spread = np.hypot(WHEEL_SIGMA_MPS, WHEEL_SIGMA_SHARE * speed) * _repetition(time_ns)
    return speed, spread


def _at(sorted_ns: Int64, time_ns: Int64) -> Int64:
    """Index of the nearest of `sorted_ns` to each instant."""
    after = np.clip(np.searchsorted(sorted_ns, time_ns), 1, len(sorted_ns) - 1)
    earlier = time_ns - sorted_ns[after - 1] < sorted_ns[after] - time_ns
    return np.asarray(np.where(earlier, after - 1, after))
