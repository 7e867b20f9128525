"""Leaps of a receiver's solution that the estimate of the whole drive denies.

Multipath moves a solution by a metre from one fix to the next, for some seconds. Where a vehicle
could have driven that far, no gate sees it. But the estimate goes on as vehicles do, through the
fixes on both sides, so that the step stands out in what the fixes differ from it.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.pose.accepted import AcceptedFixes
from fieldgrid.pose.drive import DriveEstimate
from fieldgrid.pose.leaps import holes
from fieldgrid.pose.seams import LEAST_M, SeenLeap

CLEAR_SIGMAS, STATED_SIGMAS = 10.0, 3.0
"""Least size of a leap in sigmas of the steps of this drive, and in sigmas that fixes state."""

ALONE_SHARE = 0.5
"""The steps beside a leap differ from the estimate by no more than this share of it: what is spread
over several steps is rather an error of the estimate, of a gear say."""

SIZE_SHARE = 0.1
"""The size of a leap is known to this share: the estimate is drawn over to it."""

FEWEST_STEPS = 20
"""Of fewer steps it is not known what is usual."""

NORMAL_MAD = 1.4826
LEAST_SIGMA_M = 1e-3


def denied_leaps(fixes: AcceptedFixes, drive: DriveEstimate) -> tuple[SeenLeap, ...]:
    """Where the step from one accepted fix to the next is far from that of the drive's estimate,
    and those beside it are not."""
    if len(fixes.time_ns) < FEWEST_STEPS:
        return ()
    phi = np.radians(drive.heading_deg[np.flatnonzero(drive.fix >= 0)])[1:]
    east, north = -np.diff(drive.offset_m, axis=0).T
    off_m = np.stack(
        [east * np.sin(phi) + north * np.cos(phi), east * np.cos(phi) - north * np.sin(phi)]
    )
    hole = holes(np.diff(fixes.time_ns) / 1e9)
    if np.count_nonzero(~hole) < FEWEST_STEPS:
        return ()
    # Along the path steps differ by the stamps, too.
    usual_m = np.maximum(NORMAL_MAD * np.median(np.abs(off_m[:, ~hole]), axis=1), LEAST_SIGMA_M)
    size_m = np.hypot(*off_m)
    stated_m = np.hypot(fixes.sigma_m[1:], fixes.sigma_m[:-1])
    large = np.hypot(*(off_m / usual_m[:, None])) > CLEAR_SIGMAS
    large &= (size_m > np.maximum(LEAST_M, STATED_SIGMAS * stated_m)) & ~hole
    beside_m = np.pad(size_m, 1)
    large &= np.maximum(beside_m[:-2], beside_m[2:]) < ALONE_SHARE * size_m
    drawn_m = np.pad(np.stack([east, north]), ((0, 0), (1, 1)))
    leap_m = np.stack([east, north]) - (drawn_m[:, :-2] + drawn_m[:, 2:]) / 2.0
    noise_m = float(np.hypot(*usual_m))
    return tuple(
        SeenLeap(
            int(fixes.time_ns[k + 1]),
            float(leap_m[0, k]),
            float(leap_m[1, k]),
            float(np.hypot(noise_m, SIZE_SHARE * size_m[k])),
        )
        for k in np.flatnonzero(large).tolist()
    )
