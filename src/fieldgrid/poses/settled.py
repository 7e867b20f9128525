"""A number that was declared, put right step by step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.smoother.declared import Constant, DeclaredCorrection

MOST_STEPS, SETTLED_SHARE = 8, 0.1
"""What was declared by metres or seconds too much is settled in two to six steps: the next would
be smaller than this share of its sigma."""

FARTHEST = 10.0
"""Metres, and seconds: what leads farther leads nowhere."""


def settled(
    drive: DriveEstimate,
    put_right: Callable[[float], DriveEstimate],
    left: Callable[[DeclaredCorrection], Constant],
    start: float = 0.0,
) -> tuple[Constant, DriveEstimate]:
    """A number that was declared, `put_right` until nothing is `left` to add, since one step of the
    estimate is not all: by how much it was off, infinitely unsure where that leads nowhere, and
    the drive then. It begins with a `drive` of which it was put right by `start`."""
    total, rest = start, left(drive.smoothed.declared)
    for _ in range(MOST_STEPS):
        total += rest.value
        if abs(total) > FARTHEST:
            return Constant(total, np.inf), drive
        drive = put_right(total)
        rest = left(drive.smoothed.declared)
        if abs(rest.value) < SETTLED_SHARE * rest.sigma:
            break
    return Constant(total, float(np.hypot(rest.sigma, rest.value))), drive
