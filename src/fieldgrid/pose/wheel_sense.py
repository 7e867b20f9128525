"""Wheels whose sign is turned round: they say that a vehicle backs up while it drives forward."""

from __future__ import annotations

import numpy as np

from fieldgrid.motion import Motion, Steps, WheelSpeed
from fieldgrid.pose.measured import turn_back, wheel_speed_at

FEWEST_STEPS, LEAST_STEP_M = 8, 0.3
"""How many steps of the camera tell the sense of the wheels, each at least so long."""

TURNED_SHARE = 0.8
"""Share of the steps told by wheels and camera that go the other way when a sign is turned."""

BACKING_SHARE, LEAST_WAY_M = 0.8, 50.0
"""Without a camera: hardly any vehicle backs up over this share of a drive of at least this
length."""


def with_right_wheels(motion: Motion) -> tuple[Motion, str | None]:
    """The motion with the wheels as the camera has them, and a sentence where their sign is, or
    may be, turned round; None otherwise."""
    wheels, steps = motion.wheels, motion.steps
    if wheels is None or not turn_back(wheels):
        return motion, None
    other_way, told = (0, 0) if steps is None else _other_way(wheels, steps)
    if told >= FEWEST_STEPS:
        if other_way < TURNED_SHARE * told:
            return motion, None
        turned = wheels._replace(speed_mps=-wheels.speed_mps)
        return motion._replace(wheels=turned), (
            f"The wheels go the other way than the camera in {other_way} of {told} steps: the sign "
            "of their speed was turned round. Correct it where it is recorded."
        )
    way_m = wheels.speed_mps[:-1] * np.diff(wheels.time_ns) / 1e9
    whole_m, back_m = float(np.nansum(np.abs(way_m))), float(-np.nansum(np.minimum(way_m, 0.0)))
    if whole_m < LEAST_WAY_M or back_m < BACKING_SHARE * whole_m:
        return motion, None
    return motion, (
        f"By its wheels the vehicle backs up over {back_m:.0f} of {whole_m:.0f} m. If it drives "
        "forward, the sign of their speed is turned round, and headings with it: correct it where "
        "it is recorded."
    )


def _other_way(wheels: WheelSpeed, steps: Steps) -> tuple[int, int]:
    """How many steps the wheels take the other way than the camera, and how many both tell."""
    inside = [steps.start_ns + (steps.stop_ns - steps.start_ns) * k // 4 for k in (1, 2, 3)]
    speeds = np.stack([wheel_speed_at(at_ns, wheels) for at_ns in inside])
    one_way = (speeds > 0.0).all(axis=0) | (speeds < 0.0).all(axis=0)
    told = one_way & (np.abs(steps.forward_m) > LEAST_STEP_M)
    other_way = told & (speeds[0] * steps.forward_m < 0.0)
    return int(other_way.sum()), int(told.sum())
