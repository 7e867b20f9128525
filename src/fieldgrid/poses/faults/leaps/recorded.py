"""Leaps of a receiver's solution that recorded headings deny.

A vehicle goes where it looks. Two antennas, or a compass, tell where that is whatever the solution
does, so that a step of half a metre to the side stands out, also at one fix a second, where an
estimate would rather doubt two headings than such a step.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.faults.leaps.leaps import TORN_MPS2, holes
from fieldgrid.poses.faults.leaps.seams import LEAST_M, SeenLeap

CLEAR_SIGMAS, STATED_SIGMAS = 10.0, 3.0
"""Least size of a leap in sigmas of the steps of this drive, and in sigmas that fixes state."""

ALONE_SHARE = 0.5
"""The steps beside a leap go to the side by no more than this share of it: a vehicle that slips on
a slope does so for longer."""

BEND_SHARE, LEVER_M = 0.25, 1.0
"""Where a vehicle turns within a step, the step may lie beside its mean heading by this share of
its way times the turn; and the antenna may sit so far from where it was declared."""

SIZE_SHARE = 0.1
"""The size of a leap is known to this share: of its part along the path little is known."""

FEWEST_STEPS = 20
"""Of fewer steps it is not known what is usual."""

NORMAL_MAD = 1.4826
LEAST_SIGMA_M = 1e-3


def recorded_leaps(
    fixes: AcceptedFixes, nose_deg: Float64, antenna_ahead_m: float
) -> tuple[SeenLeap, ...]:
    """Where the step from one accepted fix to the next goes to the side of the recorded headings
    of the nose, degrees [n] (NaN: none), and those beside it do not. The antenna sits so far ahead
    of the axle that does not steer."""
    if len(fixes.time_ns) < FEWEST_STEPS:
        return ()
    turn = np.radians(wrap_deg(np.diff(nose_deg)))
    phi = np.radians(nose_deg[:-1]) + turn / 2.0
    step_s, step_m = np.diff(fixes.time_ns) / 1e9, np.diff(fixes.points_m(), axis=0)
    known = np.isfinite(turn) & ~holes(step_s)
    if np.count_nonzero(known) < FEWEST_STEPS:
        return ()
    east, north = step_m.T
    along_m = east * np.sin(phi) + north * np.cos(phi)
    # The antenna swings about the axle, whose chord points where the vehicle looks on the way.
    aside_m = east * np.cos(phi) - north * np.sin(phi) - 2.0 * antenna_ahead_m * np.sin(turn / 2.0)
    aside_m, along_m = np.where(known, (aside_m, along_m), 0.0)
    usual_m = NORMAL_MAD * float(np.median(np.abs(aside_m[known])))
    looks_rad = np.radians(np.hypot(fixes.recorded_sigma_deg[1:], fixes.recorded_sigma_deg[:-1]))
    noise_m = np.hypot(max(usual_m, LEAST_SIGMA_M), looks_rad / 2.0 * np.abs(along_m))
    bend_m = np.abs(np.nan_to_num(turn)) * (BEND_SHARE * np.abs(along_m) + LEVER_M)
    beside_m = np.pad(np.abs(aside_m), 1)
    clear = np.abs(aside_m) > np.maximum(np.maximum(LEAST_M, bend_m), CLEAR_SIGMAS * noise_m)
    clear &= np.maximum(beside_m[:-2], beside_m[2:]) < ALONE_SHARE * np.abs(aside_m)
    # Ahead of where the pace before and after leads, a vehicle may as well have speeded up.
    pace_mps = np.pad(along_m / np.maximum(step_s, 1e-3), 1, mode="edge")
    ahead_m = along_m - (pace_mps[:-2] + pace_mps[2:]) / 2.0 * step_s
    ahead_m = np.where(np.abs(ahead_m) > TORN_MPS2 * step_s**2, ahead_m, 0.0)
    size_m = np.hypot(aside_m, ahead_m)
    stated_m = np.hypot(fixes.sigma_m[1:], fixes.sigma_m[:-1])
    clear &= known & (size_m > STATED_SIGMAS * stated_m)
    east_m = aside_m * np.cos(phi) + ahead_m * np.sin(phi)
    north_m = ahead_m * np.cos(phi) - aside_m * np.sin(phi)
    sigma_m = np.hypot(noise_m, SIZE_SHARE * size_m)
    return tuple(
        SeenLeap(int(fixes.time_ns[k + 1]), *(float(of[k]) for of in (east_m, north_m, sigma_m)))
        for k in np.flatnonzero(clear).tolist()
    )
