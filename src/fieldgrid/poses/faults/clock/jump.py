"""A clock of images and gyro that jumps within a drive.

A computer that is set while it records stamps what follows by another clock. In the stamps of its
gyro that is a hole, like any other; but the vehicle did too little in it for its length. The
camera's step over the hole tells, where the vehicle moved: it is as long as the way of the fixes
when the recorder paused, and as that without the hole when the clock jumped. A clock that is set
back leaves no hole, nor does that of a receiver: see `poses.faults.clock.change`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.geometry import Gyro, Steps
from fieldgrid.poses.accepted import AcceptedFixes

LEAST_JUMP_S = 0.15
"""Stamps of the gyro that are farther apart than usual by this time leave a hole."""

MOST_HOLES = 50
"""More holes than these are how the stream is, and no clock that jumped."""

LEAST_WAY_M, OFF_SIGMAS, FITTING_SIGMAS = 0.3, 5.0, 3.0
"""How far the vehicle must have gone in the hole, and how far off the step must be with the hole
as it is, and may be without it."""

STEP_SIGMA_M, SCALE_SHARE, LEVER_M = 0.05, 0.03, 1.0
"""How far a step and fixes differ, by what share the camera's distances may be off, and how far
the antenna is from the camera."""


class ClockJump(NamedTuple):
    """That images and gyro are stamped later by `jump_s` from `time_ns` on, against the fixes.
    There the camera went `seen_m`, and the fixes `driven_m`."""

    time_ns: int
    jump_s: float
    seen_m: float
    driven_m: float


def clock_jump(fixes: AcceptedFixes, steps: Steps | None, gyro: Gyro | None) -> ClockJump | None:
    """The largest jump; None where there is none that camera and gyro show."""
    if steps is None or gyro is None or not len(fixes.time_ns):
        return None
    apart_ns = np.diff(gyro.time_ns)
    usual_ns = float(np.median(apart_ns)) if len(apart_ns) else 0.0
    holes = np.flatnonzero(apart_ns > usual_ns + LEAST_JUMP_S * 1e9)
    if len(holes) > MOST_HOLES:
        return None
    found = []
    for hole in holes.tolist():
        before_ns, after_ns = gyro.time_ns[hole : hole + 2].tolist()
        seen = _way_over(steps, before_ns, after_ns)
        jump_ns = after_ns - before_ns - round(usual_ns)
        if seen is not None and (jump := _jump(fixes, seen, after_ns, jump_ns)) is not None:
            found.append(jump)
    return max(found, key=lambda jump: jump.jump_s, default=None)


class _Way(NamedTuple):
    """How far the camera went from one instant to another, in a straight line, and how much it
    turned."""

    start_ns: int
    stop_ns: int
    distance_m: float
    turn_rad: float


def _way_over(steps: Steps, before_ns: int, after_ns: int) -> _Way | None:
    """The steps from before a hole to after it, one joined to the other; None where one lacks."""
    first = int(np.searchsorted(steps.start_ns, before_ns, side="right")) - 1
    last = int(np.searchsorted(steps.stop_ns, after_ns))
    if first < 0 or last >= len(steps.stop_ns) or last < first:
        return None
    part = slice(first, last + 1)
    if (steps.stop_ns[part][:-1] != steps.start_ns[part][1:]).any():
        return None
    turn_rad = np.radians(np.cumsum(steps.turn_deg[part]))
    sin, cos = np.sin(turn_rad), np.cos(turn_rad)
    sin, cos = np.append(0.0, sin[:-1]), np.append(1.0, cos[:-1])
    forward_m, right_m = steps.forward_m[part], steps.right_m[part]
    ahead_m = float((forward_m * cos - right_m * sin).sum())
    aside_m = float((forward_m * sin + right_m * cos).sum())
    return _Way(
        int(steps.start_ns[first]),
        int(steps.stop_ns[last]),
        float(np.hypot(ahead_m, aside_m)),
        float(np.abs(np.diff(turn_rad, prepend=0.0)).sum()),
    )


def _jump(fixes: AcceptedFixes, seen: _Way, after_ns: int, jump_ns: int) -> ClockJump | None:
    """The jump, if the camera went as far as the fixes without the hole and not as with it."""
    if seen.stop_ns > fixes.time_ns[-1] or seen.start_ns < fixes.time_ns[0]:
        return None
    instants_ns = (seen.start_ns, seen.stop_ns, seen.stop_ns - jump_ns)
    east_m, north_m = (
        np.interp(instants_ns, fixes.time_ns, along) for along in (fixes.east_m, fixes.north_m)
    )
    here, there, earlier = np.stack([east_m, north_m], axis=1)
    with_hole_m = float(np.hypot(*(there - here)))
    without_m = float(np.hypot(*(earlier - here)))
    noise_m = max(STEP_SIGMA_M, float(np.median(fixes.noise.across_m)))
    # The antenna swings about the camera in a turn.
    sigma_m = float(
        np.linalg.norm([noise_m, SCALE_SHARE * seen.distance_m, LEVER_M * seen.turn_rad])
    )
    if (
        abs(with_hole_m - without_m) < LEAST_WAY_M
        or abs(seen.distance_m - with_hole_m) < OFF_SIGMAS * sigma_m
        or abs(seen.distance_m - without_m) > FITTING_SIGMAS * sigma_m
    ):
        return None
    return ClockJump(after_ns, jump_ns / 1e9, seen.distance_m, with_hole_m)
