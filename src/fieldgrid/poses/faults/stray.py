"""Fixes that a drive as a whole denies: jumps that looked drivable beside their neighbours.

While a vehicle turns, a jump of some metres may be as drivable as the way back from it, and the
sequence of fixes that is kept may run through it. The batch estimate tells them apart: it is tied
to the fixes on both sides, and gives no weight to what lies tens of sigmas beside it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from fieldgrid.core import Bool, Float64
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.gears.stations import breaks
from fieldgrid.poses.nodes import seconds
from fieldgrid.poses.table import ConditionedLog

STRAY_SIGMAS, STRAY_M = 10.0, 0.3
"""A fix lies beside the drive when it is off by this number of sigmas of its noise, and by this
distance; by as much the fixes leave the drive, and come back."""

LONGEST_S = 3.0
"""Of fixes that are off for longer it is not known who is wrong."""

NEAR_S, FAR_S = 2.0, 10.0
"""The drive is known where a fix that it agrees with is this near on one side, and one on the
other."""

MOST_ROUNDS = 3
"""Without strays other fixes are accepted, and may be strays in turn; so often at most."""

MOST_SHARE = 0.1
"""A drive that would deny more of its fixes at once is itself in doubt, and denies none of them."""


def stray_fixes(drive: DriveEstimate, log: ConditionedLog) -> dict[int, str]:
    """The accepted fixes that are short excursions from the drive that the others tell: rows of
    the log's fixes, and why."""
    has = drive.fix >= 0
    off_m, sigma_m = drive.smoothed.fix_off_m[has], drive.measured.fix_sigma_m[has]
    away_m = np.hypot(*off_m.T)
    beside = _far(off_m, sigma_m)
    # An antenna elsewhere than declared leaves its drive, too, but bit by bit.
    leaps = np.concatenate([[False], _far(np.diff(off_m, axis=0), sigma_m[1:]), [False]])
    time_s = seconds(log.accepted.time_ns)
    rows = np.flatnonzero(log.verdicts.ok)
    found: dict[int, str] = {}
    for first, stop, jumped in _excursions(beside, log):
        if first == 0 or stop == len(beside):
            continue
        sides_s = time_s[first] - time_s[first - 1], time_s[stop] - time_s[stop - 1]
        known = min(sides_s) <= NEAR_S and max(sides_s) <= FAR_S
        if not known or time_s[stop - 1] - time_s[first] > LONGEST_S:
            continue
        if not jumped and not (leaps[first] and leaps[stop]):
            continue
        for k in range(first, stop):
            found[int(rows[k])] = (
                "lies between jumps of the position: no motion leads there"
                if jumped
                else f"lies {away_m[k]:.2f} m beside the drive that the others tell, where "
                f"fixes scatter by {sigma_m[k, 1]:.2f} m"
            )
    return found if len(found) <= MOST_SHARE * len(beside) else {}


def _far(off_m: Float64, sigma_m: Float64) -> Bool:
    """Which of the offsets [n, 2] are no noise."""
    return np.asarray(
        (np.hypot(*(off_m / sigma_m).T) > STRAY_SIGMAS) & (np.hypot(*off_m.T) > STRAY_M)
    )


def _excursions(beside: Bool, log: ConditionedLog) -> Iterator[tuple[int, int, bool]]:
    """From where to where fixes lie beside the drive, and whether jumps say so: all that is short
    between a jump and the next jump or hole, since an estimate may be drawn over to it.

    Where a solution has moved for good, an estimate that is drawn over from one to the other blames
    the fixes beside the jump on both sides; each belongs to what is long.
    """
    hole, torn = breaks(log.accepted)
    time_s = seconds(log.accepted.time_ns)
    starts = np.concatenate([[0], np.flatnonzero(hole | torn) + 1, [len(beside)]])
    jumps = set((np.flatnonzero(torn) + 1).tolist())
    for first, stop in pairwise(starts.tolist()):
        if {first, stop} & jumps and time_s[stop - 1] - time_s[first] <= LONGEST_S:
            yield first, stop, True
        elif beside[first:stop].any():
            part = np.concatenate([[False], beside[first:stop], [False]]).astype(np.int8)
            edges = (np.flatnonzero(np.diff(part)) + first).tolist()
            for run in zip(edges[::2], edges[1::2], strict=True):
                if not jumps.intersection(run):
                    yield *run, False
