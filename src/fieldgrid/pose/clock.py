"""The clocks of camera and receiver: by how much they differ, from the drive itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.angles import wrap_deg
from fieldgrid.motion import Motion, Steps
from fieldgrid.pose.placed import Placed
from fieldgrid.pose.smooth import Drive, axle_forward_m, smooth_drive
from fieldgrid.rig import Vehicle

_Float64 = npt.NDArray[np.float64]
_Int64 = npt.NDArray[np.int64]

WIDEST_S, FINEST_S = 2.5, 0.05
"""Offsets are tried up to the widest, this far apart."""

WAY_SIGMA_M, TURN_SIGMA_DEG = 0.05, 0.5
"""How far the drive and a camera's step differ with the best of clocks."""

OUTLIER_FREEDOM = 4.0
"""Of Student's distribution, which a step is taken to differ by."""

FEWEST_STEPS = 10

MOST_SIGMA_S = 0.1
"""A drive that does not tell the offset better than this does not tell it."""


class ClockOffset(NamedTuple):
    """`offset_s` ± `sigma_s` is to be added to image time stamps, beyond what the rig declares
    already, to give the receiver's time; from `steps` motions of the camera."""

    offset_s: float
    sigma_s: float
    steps: int


def clock_offset(placed: Placed, motion: Motion, rig: Vehicle | None) -> ClockOffset | None:
    """The offset at which the camera's motion fits the drive without it; None when the drive
    is too even to tell."""
    if motion.steps is None or len(motion.steps.start_ns) < FEWEST_STEPS:
        return None
    drive = smooth_drive(placed, motion._replace(steps=None), rig)
    ahead_m = 0.0 if rig is None else -axle_forward_m(rig)
    offsets_s = np.arange(-WIDEST_S, WIDEST_S + FINEST_S / 2.0, FINEST_S)
    steps = _inside(motion.steps, drive, WIDEST_S)
    if len(steps.start_ns) < FEWEST_STEPS:
        return None
    misfit = np.array([_misfit(steps, drive, ahead_m, offset) for offset in offsets_s])
    best = int(np.argmin(misfit))
    if best in (0, len(misfit) - 1):
        return None
    below, here, above = misfit[best - 1 : best + 2]
    bend = (below - 2.0 * here + above) / FINEST_S**2
    if bend <= 0.0:
        return None
    offset_s = offsets_s[best] + (below - above) / (2.0 * bend * FINEST_S)
    # A misfit of one a step is as it should be; a larger one tells of larger errors.
    sigma_s = float(np.sqrt(2.0 / bend * max(1.0, here / len(steps.start_ns))))
    if sigma_s > MOST_SIGMA_S:
        return None
    return ClockOffset(float(offset_s), sigma_s, len(steps.start_ns))


def _inside(steps: Steps, drive: Drive, margin_s: float) -> Steps:
    margin_ns = int(margin_s * 1e9)
    first, last = drive.time_ns[0] + margin_ns, drive.time_ns[-1] - margin_ns
    keep = (steps.start_ns >= first) & (steps.stop_ns <= last)
    return Steps(*(column[keep] for column in steps))


def _misfit(steps: Steps, drive: Drive, ahead_m: float, offset_s: float) -> float:
    """Sum over the steps of their squared distance from the drive, in sigmas; outliers count the
    less the farther they lie (a bound would kink the sum, and shift its lowest place)."""
    shift = round(offset_s * 1e9)
    e0, n0, phi0 = _pose_at(drive, steps.start_ns + shift, ahead_m)
    e1, n1, phi1 = _pose_at(drive, steps.stop_ns + shift, ahead_m)
    sin, cos = np.sin(np.radians(phi0)), np.cos(np.radians(phi0))
    forward = (e1 - e0) * sin + (n1 - n0) * cos
    aside = (e1 - e0) * cos - (n1 - n0) * sin
    way = np.hypot(forward - steps.forward_m, aside - steps.right_m)
    turn = np.asarray(wrap_deg(phi1 - phi0 - steps.turn_deg))
    squared = (way / np.hypot(steps.sigma_m, WAY_SIGMA_M)) ** 2
    squared += (turn / np.hypot(steps.sigma_deg, TURN_SIGMA_DEG)) ** 2
    return float((OUTLIER_FREEDOM * np.log1p(squared / OUTLIER_FREEDOM)).sum())


def _pose_at(drive: Drive, time_ns: _Int64, ahead_m: float) -> tuple[_Float64, _Float64, _Float64]:
    """East, north and heading (unwrapped, degrees) of the grid origin."""
    heading = np.degrees(np.unwrap(np.radians(drive.heading_deg)))
    phi = np.interp(time_ns, drive.time_ns, heading)
    east = np.interp(time_ns, drive.time_ns, drive.east_m) + ahead_m * np.sin(np.radians(phi))
    north = np.interp(time_ns, drive.time_ns, drive.north_m) + ahead_m * np.cos(np.radians(phi))
    return east, north, phi
