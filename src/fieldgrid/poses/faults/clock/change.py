"""Clocks of images and fixes that are set within a drive, or drift apart.

One offset fits the camera's motion to the drive up to some instant, and another from there on: that
of images and gyro when a computer was set, that of the fixes when a receiver was.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.poses.faults.clock.search import COARSE_S, WIDEST_S, ClockSearch

LEAST_CHANGE_S = 0.15
"""A smaller change is not told: at walking pace it is 15 cm."""

FEWEST_ON_A_SIDE = 8
"""Fewer steps of the camera tell no offset of their own."""

FITTING = 4.0
"""With both offsets steps are off by less than two of the sigmas of step and drive; where they are
not, something else is wrong."""

SUSPECT_GAIN, CLEAR_GAIN = 1.0, 7.0
"""Least gain of two offsets over the best single one, to look closer and to be told: the decrease
of the sum of squares, in mean squares of a step. Of 240 stretches of drives with one clock
none reaches the latter (`benchmarks.stretches`)."""


class ClockChange(NamedTuple):
    """`before_s` is to be added to the stamps of images to give the receiver's time up to
    `time_ns`, and `after_s` from there on, as two stretches of `steps` motions of the camera have
    it. With `gyro_too` the gyro goes with the images: then it is the fixes that are off."""

    time_ns: int
    before_s: float
    after_s: float
    steps: int
    gain: float
    misfit: float
    gyro_too: bool = False

    def offset_s(self, time_ns: Int64) -> Float64:
        """The offset at some instants [n]."""
        return np.where(time_ns < self.time_ns, self.before_s, self.after_s)


def may_change(search: ClockSearch) -> bool:
    """Whether it is worth a drive by the fixes alone to look closer."""
    found = _two_offsets(search)
    return found is not None and found.gain > SUSPECT_GAIN


def found_change(search: ClockSearch) -> ClockChange | None:
    """Where the offset changes; None where one is as good. `search` is of the fixes alone."""
    found = _two_offsets(search)
    if found is None or found.gain < CLEAR_GAIN or found.misfit > FITTING:
        return None
    # An antenna that sits elsewhere looks like a clock that is late one way and early backing up.
    least_s, most_s = sorted((found.before_s, found.after_s))
    one_way = least_s > -LEAST_CHANGE_S or most_s < LEAST_CHANGE_S
    return found if one_way and most_s - least_s >= LEAST_CHANGE_S else None


def _two_offsets(search: ClockSearch) -> ClockChange | None:
    """The best two offsets and where one follows the other; None with too few steps."""
    count = round(WIDEST_S / COARSE_S)
    offsets_s = COARSE_S * np.arange(-count, count + 1, dtype=np.float64)
    steps, squared = search.by_step(offsets_s)
    count = len(steps.start_ns)
    if count < 2 * FEWEST_ON_A_SIDE:
        return None
    before = np.cumsum(squared, axis=1)
    after = before[:, -1:] - before
    inner = slice(FEWEST_ON_A_SIDE - 1, count - FEWEST_ON_A_SIDE)
    both = (before.min(axis=0) + after.min(axis=0))[inner]
    last = int(both.argmin()) + FEWEST_ON_A_SIDE - 1
    least = float(both.min())
    return ClockChange(
        int(steps.stop_ns[last]),
        float(offsets_s[before[:, last].argmin()]),
        float(offsets_s[after[:, last].argmin()]),
        count,
        (float(before[:, -1].min()) - least) / max(least / count, 1.0),
        least / count,
    )
