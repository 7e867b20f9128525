"""The clocks of camera and receiver: by how much they differ, from the drive itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64, PoseSettings
from fieldgrid.geometry import Gyro, Motion, Steps
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import DriveEstimate, smooth_drive
from fieldgrid.poses.faults.camera_turns import FEWEST_STEPS, goes_with, turns_with
from fieldgrid.poses.faults.clock.change import ClockChange, found_change, may_change
from fieldgrid.poses.faults.clock.search import (
    LEAST_SIGMA_S,
    MOST_SIGMA_S,
    ClockOffset,
    ClockSearch,
    MotionContradiction,
)
from fieldgrid.poses.gears.stations import NO_HINTS
from fieldgrid.poses.smoother.declared import AHEAD, ASIDE, IMAGES, LATE
from fieldgrid.poses.smoother.slow_error import SlowError

POOR_MISFIT, NEAR_SHARE, BETTER_SHARE = 4.0, 0.5, 0.45
"""A drive and its camera fit badly when steps are off by more than two usual sigmas; then another
offset is believed where its misfit is less than these shares, near or far: a drive that repeats
itself fits somewhat at the offset of one repetition, too."""

SUSPECT_MISFIT = 2.5
"""Where what was declared is off by so many sigmas, a clock may have been set within the drive."""

MOST_ROUNDS = 6
"""In which the offset of camera and gyro beside the fixes settles."""


class ClockFindings(NamedTuple):
    """What the camera's motion tells of its clock beside that of the fixes: the `offset` at which
    it fits the drive, how much of it is a `contradiction` even so, and the `change` of the offset
    within the drive. None where it does not tell."""

    offset: ClockOffset | None = None
    contradiction: MotionContradiction | None = None
    change: ClockChange | None = None

    def offset_s(self, time_ns: Int64) -> Float64:
        """What is certain of the offset at some instants [n], else 0."""
        if self.change is not None:
            return self.change.offset_s(time_ns)
        certain = self.offset is not None and self.offset.is_certain
        return np.full(len(time_ns), self.offset.offset_s if certain and self.offset else 0.0)


def check_clock(
    drive: DriveEstimate,
    fixes: AcceptedFixes,
    motion: Motion,
    axle: Axle,
    hints: PoseSettings = NO_HINTS,
    *,
    recorded: Gyro | None = None,
) -> ClockFindings:
    """Lays the camera's motion beside the drive without it.

    The offset is None when the drive is too even to tell; it is looked for farther away only
    where the camera fits badly near by. All are None without enough steps. `recorded` is the gyro
    whether it is used or not: it tells of what moments the images are.
    """
    steps = motion.steps
    if steps is None or len(steps.start_ns) < FEWEST_STEPS:
        return ClockFindings()
    declared = drive.smoothed.declared
    suspect = declared.misfit() > SUSPECT_MISFIT or drive.slow != SlowError()
    if drive.slow != SlowError():
        # A slow error that the fixes do not state may be what steps of other moments look like.
        alone = fixes, drive.time_ns, motion._replace(steps=None), axle
        drive = smooth_drive(*alone, hints=hints, as_stated=True)
    search = ClockSearch(drive, steps, axle)
    # What an antenna explains is no clock that was set.
    suspect = (suspect or may_change(search)) and not declared.explains(AHEAD)
    change = _change(fixes, steps, axle, hints, recorded) if suspect else None
    near = search.best() if change is None else None
    usual = near.misfit if near is not None else search.misfit(0.0)
    if change is None and usual >= POOR_MISFIT:
        far = min(
            _far_offsets(fixes, steps, motion.gyro or recorded, axle, hints, usual),
            key=lambda one: one.misfit,
            default=None,
        )
        if far is not None:
            return ClockFindings(_with_gyro(far, steps, recorded))
    unfit = search.contradiction(near.offset_s if near is not None else 0.0)
    if recorded is not None and turns_with(steps, recorded):
        unfit = unfit._replace(gyro_too=True)
    if near is not None and usual >= max(POOR_MISFIT, NEAR_SHARE * search.misfit(0.0)):
        near = None
    return ClockFindings(_with_gyro(near, steps, recorded), unfit, change)


def _change(
    fixes: AcceptedFixes, steps: Steps, axle: Axle, hints: PoseSettings, recorded: Gyro | None
) -> ClockChange | None:
    """A clock that is set within the drive. A gyro that goes with the images bends the drive
    towards them, so it is the fixes alone that tell."""
    alone = smooth_drive(fixes, fixes.time_ns, Motion(), axle, hints=hints)
    found = found_change(ClockSearch(alone, steps, axle))
    if found is None or recorded is None:
        return found
    return found._replace(gyro_too=turns_with(steps, recorded))


def _with_gyro(found: ClockOffset | None, steps: Steps, gyro: Gyro | None) -> ClockOffset | None:
    if found is None or gyro is None:
        return found
    return found._replace(gyro_too=goes_with(steps, gyro, found.offset_s))


def _far_offsets(
    fixes: AcceptedFixes,
    steps: Steps,
    gyro: Gyro | None,
    axle: Axle,
    hints: PoseSettings,
    usual: float,
) -> Iterator[ClockOffset]:
    """What the offset is by the fixes alone; by fixes and gyro; by fixes and a gyro that goes
    with the images. Steps of other moments are left out of all three: they would spoil the
    drive, and so would a gyro of the wrong clock."""

    def search(known: Gyro | None) -> ClockSearch:
        alone = smooth_drive(fixes, fixes.time_ns, Motion(gyro=known), axle, hints=hints)
        return ClockSearch(alone, steps, axle)

    by_fixes = search(None)
    rough_s = by_fixes.rough()
    found = [None if rough_s is None else by_fixes.best(rough_s)]
    if gyro is not None:
        by_gyro = search(gyro)
        near_s = by_gyro.rough()
        found.append(None if near_s is None else by_gyro.best(near_s))
        if rough_s is not None and by_fixes.tells(rough_s):
            found.append(_together(fixes, steps, gyro, rough_s, axle, hints))
    # Steps of other moments bend a drive towards them, which fits them better than it should.
    most = BETTER_SHARE * max(usual, by_fixes.misfit(0.0))
    return (one for one in found if one is not None and one.misfit < most)


def _together(
    fixes: AcceptedFixes,
    steps: Steps,
    gyro: Gyro,
    offset_s: float,
    axle: Axle,
    hints: PoseSettings,
) -> ClockOffset | None:
    """The offset, near the one given, of a camera and a gyro of one clock, by how late the fixes
    are beside both; None where that does not settle or is not told, or does not fit."""
    for _ in range(MOST_ROUNDS):
        by_ns = round(offset_s * 1e9)
        moved = Motion(
            gyro=gyro._replace(time_ns=gyro.time_ns + by_ns),
            steps=steps._replace(start_ns=steps.start_ns + by_ns, stop_ns=steps.stop_ns + by_ns),
        )
        drive = smooth_drive(fixes, fixes.time_ns, moved, axle, hints=hints)
        late = drive.smoothed.declared.off(LATE, ASIDE, AHEAD, IMAGES)
        if late.sigma > MOST_SIGMA_S:
            return None
        if abs(late.value) < max(LEAST_SIGMA_S, late.sigma / 2.0):
            misfit = ClockSearch(drive, steps, axle).misfit(offset_s)
            if misfit >= POOR_MISFIT:  # camera and gyro are of two clocks
                return None
            sigma_s = math.hypot(late.sigma, LEAST_SIGMA_S)
            return ClockOffset(offset_s, sigma_s, len(steps.start_ns), misfit)
        offset_s += late.value
    return None
