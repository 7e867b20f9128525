"""Fixes that drift bit by bit, as the camera sees.

A receiver with the wrong number of waves may drift by metres in minutes and state centimetres. No
two fixes are far apart, but the camera's way from one end of the drive to the other is another.
That of wheels is no evidence: they slip by some per cent uphill and not downhill, and that adds up
to metres along rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.faults.clock.offset import ClockFindings
from fieldgrid.poses.faults.denied import FAR_M, DriveContradiction, sees_way
from fieldgrid.poses.smoother.slow_drift import slow_drift
from fieldgrid.poses.smoother.wander import wander
from fieldgrid.poses.table import PoseTable

CLEAR_NATS = 8.0
"""Fixes drift only where that is likelier by this: where the fixes of rendered drives are right,
it is less likely by 5 at least."""

EXPLAINED_NATS = 2.0
"""No drift is what usual errors of the antenna's place, of stamps and of a gyro's scale explain
better by this, as an antenna does that an IMU, tilted by 5°, leans."""

CLEAR_MISFIT = 5.5
"""Six numbers that are right are more sigmas away once in 20,000 drives."""

MOST_LEFT = 5.0
"""A drift that leaves more sigmas between the sensors and what was declared is not what is wrong
with a drive, or not all of it. Simulated drives whose fixes drift have 1.4 to 2.1 left."""

STATED_TIMES, LEAST_M = 3.0, 0.2
"""A drift of less than this multiple of the stated error, or than this, is not reported: the camera
itself makes as much."""


class Drift(NamedTuple):
    """Fixes that drift: how far apart they lie by it, `extent_m`, and by how much the headings [n]
    differ from those of fixes that do not, `turned_rad`."""

    extent_m: float
    turned_rad: Float64


class Drifts(NamedTuple):
    """The drift of the fixes of a drive, None where there is none or something else explains it;
    and whether the drive would show one."""

    found: Drift | None = None
    is_shown: bool = False


def drifts(
    drive: DriveEstimate,
    axle: Axle,
    denied: DriveContradiction,
    clocks: ClockFindings,
) -> Drifts:
    """By how much the fixes of a drive drift beside its camera's way; nothing is found where a
    wrong declaration or clock explains what does not fit."""
    slow, seen = None, Drifts()
    if sees_way(drive):
        slow = slow_drift(drive.smoothed, drive.measured, *axle.frame())
        # Whether the drive denies a drift of :data:`FAR_M` from one end of it to the other, beyond
        # what the receiver states.
        stated_m = float(np.median(drive.measured.bias_m))
        open_m = 2.0 * math.sqrt(max(slow.sigma_m**2 - stated_m**2, 0.0))
        seen = Drifts(None, CLEAR_MISFIT * open_m < FAR_M)
    by_clock = (clocks.contradiction, clocks.offset)
    certain = any(one is not None and one.is_certain for one in by_clock)
    if denied.clear or certain or clocks.change is not None:
        return seen
    if len(drive.measured.step) and (found := _wandering(drive, axle)) is not None:
        return seen._replace(found=found)
    # A slow drift that is there, and explains what does not fit.
    clear = slow is not None and slow.misfit > CLEAR_MISFIT and slow.left < MOST_LEFT
    if slow is not None and clear and _is_large(slow.extent_m, drive):
        return seen._replace(found=Drift(slow.extent_m, slow.turned_rad))
    return seen


def _wandering(drive: DriveEstimate, axle: Axle) -> Drift | None:
    """A drift at random, faster than the slow ones."""
    nats, unexplained_nats, extent_m, turned_rad = wander(
        drive.smoothed, drive.measured, *axle.frame()
    )
    likely = nats > CLEAR_NATS and unexplained_nats > -EXPLAINED_NATS
    return Drift(extent_m, turned_rad) if likely and _is_large(extent_m, drive) else None


def _is_large(extent_m: float, drive: DriveEstimate) -> bool:
    return extent_m > max(LEAST_M, STATED_TIMES * float(np.median(drive.measured.bias_m)))


def unsure_drift(table: PoseTable, drive: DriveEstimate, drifts: Drifts) -> PoseTable:
    """The poses, as unsure as the fixes drift: nobody knows where these were right, so
    positions by half of the drift along each axis."""
    found = drifts.found
    if found is None:
        return table
    turned_rad = np.interp(table.time_ns, drive.time_ns, np.abs(found.turned_rad))
    return table._replace(
        position_sigma_m=np.hypot(table.position_sigma_m, found.extent_m / 2.0),
        heading_sigma_deg=np.hypot(table.heading_sigma_deg, np.degrees(turned_rad)),
    )


def drift_notes(drifts: Drifts) -> Iterator[str]:
    """That the fixes drift."""
    if (found := drifts.found) is not None:
        yield (
            f"By the camera the fixes drift by about {found.extent_m:.1f} m within the "
            "drive, more than they state, and nothing shows where they are right: positions count "
            f"as good to {found.extent_m / 2.0:.1f} m. Check the receiver's base station and "
            "corrections, and how cameras and IMU are mounted: one that is tilted or was pushed "
            "looks the same."
        )
