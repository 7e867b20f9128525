"""Fixes that drift bit by bit, as the camera sees.

A receiver with the wrong number of waves may drift by metres in minutes and state centimetres. No
two fixes are far apart, but the camera's way from one end of the drive to the other is another.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fieldgrid.pose.axle import Axle
from fieldgrid.pose.clock import ClockFindings
from fieldgrid.pose.denied import Denied
from fieldgrid.pose.drive import DriveEstimate
from fieldgrid.pose.imu_turn import ImuTurn
from fieldgrid.pose.table import PoseTable
from fieldgrid.smoother import WanderTest, wander

CLEAR_NATS = 8.0
"""Fixes drift only where that is likelier by so much: where the fixes of rendered drives are right,
it is less likely by 5 at least."""

EXPLAINED_NATS = 2.0
"""It is no drift what an antenna, stamps and a gyro's scale that are off by what is usual explain
by so much better, as an antenna does that an IMU, tilted by 5°, leans."""

STATED_TIMES, LEAST_M = 3.0, 0.2
"""A drift by less than so many times the stated error, or by this, is not worth a word: the camera
itself makes as much."""


def drift(
    drive: DriveEstimate, axle: Axle, denied: Denied, clocks: ClockFindings, turned: ImuTurn | None
) -> WanderTest | None:
    """By how much the fixes of a drive drift beside its camera's way; None where they do not, and
    where a wrong declaration or clock, or an IMU that is `turned`, explains what does not fit."""
    certain = clocks.contradiction is not None and clocks.contradiction.is_certain
    if not len(drive.measured.step) or denied.clear or certain or clocks.change is not None:
        return None
    if clocks.offset is not None and clocks.offset.is_certain:
        return None
    if turned is not None and turned.is_off:
        return None
    found = wander(drive.smoothed, drive.measured, *axle.frame())
    stated_m = float(np.median(drive.measured.bias_m))
    large = found.extent_m > max(LEAST_M, STATED_TIMES * stated_m)
    likely = found.nats > CLEAR_NATS and found.unexplained_nats > -EXPLAINED_NATS
    return found if large and likely else None


def unsure_drift(table: PoseTable, drive: DriveEstimate, found: WanderTest | None) -> PoseTable:
    """The same poses, as unsure as the fixes drift: nobody knows where these were right, so
    positions by half of the drift along each axis."""
    if found is None:
        return table
    turned_rad = np.interp(table.time_ns, drive.time_ns, np.abs(found.turned_rad))
    return table._replace(
        position_sigma_m=np.hypot(table.position_sigma_m, found.extent_m / 2.0),
        heading_sigma_deg=np.hypot(table.heading_sigma_deg, np.degrees(turned_rad)),
    )


def drift_notes(found: WanderTest | None) -> Iterator[str]:
    """That the fixes drift."""
    if found is not None:
        yield (
            f"By the camera the fixes drift by about {found.extent_m:.1f} m within the drive, more "
            "than they state, and nothing shows where they are right: positions count as good to "
            f"{found.extent_m / 2.0:.1f} m. Check the receiver's base station and corrections, and "
            "the mounting of an IMU: one that is tilted looks the same."
        )
