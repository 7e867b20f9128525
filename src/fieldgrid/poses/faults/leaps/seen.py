"""Leaps of a receiver's solution that the camera sees.

Two decimetres from one fix to the next, or half a metre over a hole under trees, may be driven as
far as fixes can tell. The camera knows how the vehicle moved there.
"""

from __future__ import annotations

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import LeverArm, Steps
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.faults.leaps.leaps import HOLE_PERIODS, TORN_S, usual_period_s
from fieldgrid.poses.faults.leaps.seams import LEAST_M, SeenLeap

CLEAR_SIGMAS, STATED_SIGMAS = 5.0, 3.0
"""Least size of a leap in sigmas of what the camera tells, and in sigmas that fixes state."""

SAME_SHARE = 0.5
"""What the camera and the fixes around make of a leap differs by no more than this share of it, but
for a hole."""

LEAST_STEP_M, FEWEST_STEPS, SCALE_SHARE = 0.015, 10, 0.005
"""Fixes and the camera's steps differ by this at least, and by what is usual of the drive, told by
no fewer steps; and the camera's way may be off by this share."""

MOST_WAY_M = 30.0
"""Over a longer way the camera tells nothing so small."""


def seen_leaps(
    fixes: AcceptedFixes, drive: DriveEstimate, steps: Steps | None, antenna: LeverArm
) -> tuple[SeenLeap, ...]:
    """Where fixes that follow each other lie elsewhere to each other than the camera went.

    `antenna` is its place from the grid origin, whose way the steps are; headings are those of the
    drive.
    """
    if steps is None or not len(steps.start_ns) or len(fixes.time_ns) < 3:
        return ()
    order = np.argsort(steps.start_ns, kind="stable")
    steps = Steps._make(column[order] for column in steps)
    moved_m = _antenna_moved_m(drive, steps, antenna)
    from_m, to_m = _at(fixes, steps.start_ns), _at(fixes, steps.stop_ns)
    # How an antenna sways, and what else makes steps and fixes differ, the drive itself says.
    off_m = np.abs(to_m - from_m - moved_m)
    told = off_m[np.isfinite(off_m).all(axis=1)]
    if len(told) < FEWEST_STEPS:
        return ()
    step_sigma_m = max(1.48 * float(np.median(told)), LEAST_STEP_M)
    # From each fix to the next by the steps from before the one to after the other.
    first = np.searchsorted(steps.start_ns, fixes.time_ns[:-1], side="right") - 1
    last = np.searchsorted(steps.stop_ns, fixes.time_ns[1:])
    known = (first >= 0) & (last >= first) & (last < len(order))
    first, last = np.where(known, (first, last), 0)
    joined = np.concatenate([[0], np.cumsum(steps.start_ns[1:] != steps.stop_ns[:-1])])
    seen_m, way_m = (
        np.concatenate([0.0 * one[:1], np.cumsum(one, axis=0)])
        for one in (moved_m, np.hypot(steps.right_m, steps.forward_m))
    )
    way_m = way_m[last + 1] - way_m[first]
    leap_m = to_m[last] - from_m[first] - (seen_m[last + 1] - seen_m[first])
    size_m = np.hypot(*leap_m.T)
    known &= (joined[last] == joined[first]) & (way_m < MOST_WAY_M) & np.isfinite(size_m)
    node = np.clip(np.searchsorted(drive.time_ns, fixes.time_ns), 0, len(drive.time_ns) - 1)
    sigma_rad = np.radians(drive.heading_sigma_deg[node])
    sigma_rad = np.maximum(sigma_rad[1:], sigma_rad[:-1])
    sigma_m = np.linalg.norm(
        [step_sigma_m * np.sqrt(last - first + 1.0), sigma_rad * way_m, SCALE_SHARE * way_m], axis=0
    )
    stated_m = np.hypot(fixes.sigma_m[1:], fixes.sigma_m[:-1])
    beside_m, hole = _beside_pace_m(fixes)
    same = np.hypot(*(beside_m - leap_m).T) < SAME_SHARE * size_m
    least_m = np.maximum(np.maximum(CLEAR_SIGMAS * sigma_m, STATED_SIGMAS * stated_m), LEAST_M)
    return tuple(
        SeenLeap(int(fixes.time_ns[k + 1]), *(float(of) for of in (*leap_m[k], sigma_m[k])))
        for k in np.flatnonzero(known & (size_m > least_m) & (same | hole)).tolist()
    )


def _beside_pace_m(fixes: AcceptedFixes) -> tuple[Float64, Bool]:
    """By how much [n - 1, 2] each step between fixes is longer than the mean pace of the steps
    before and after it makes it, and which are holes."""
    step_s, step_m = np.diff(fixes.time_ns) / 1e9, np.diff(fixes.points_m(), axis=0)
    pace = np.pad(step_m / np.maximum(step_s, 1e-3)[:, None], ((1, 1), (0, 0)), mode="edge")
    usual_m = (pace[:-2] + pace[2:]) / 2.0 * step_s[:, None]
    return step_m - usual_m, step_s > HOLE_PERIODS * usual_period_s(step_s)


def _antenna_moved_m(drive: DriveEstimate, steps: Steps, antenna: LeverArm) -> Float64:
    """The way east and north [s, 2] of the antenna in each step of the camera."""
    heading_deg = np.degrees(np.unwrap(np.radians(drive.heading_deg)))
    scale = drive.smoothed.camera_scale
    size = 1.0 if scale is None else 1.0 / (1.0 + scale.value)

    def turned(time_ns: Int64, right_m: Float64 | float, ahead_m: Float64 | float) -> Float64:
        phi = np.radians(np.interp(time_ns, drive.time_ns, heading_deg))
        sin, cos = np.sin(phi), np.cos(phi)
        return np.stack([right_m * cos + ahead_m * sin, ahead_m * cos - right_m * sin], axis=1)

    lever_m = antenna.right_m, antenna.forward_m
    by_camera = turned(steps.start_ns, size * steps.right_m, size * steps.forward_m)
    swung = turned(steps.stop_ns, *lever_m) - turned(steps.start_ns, *lever_m)
    return np.asarray(by_camera + swung)


def _at(fixes: AcceptedFixes, time_ns: Int64) -> Float64:
    """East and north [n, 2] of the antenna at instants between two fixes, NaN where those are far
    apart."""
    after = np.clip(np.searchsorted(fixes.time_ns, time_ns), 1, len(fixes.time_ns) - 1)
    inside = (time_ns >= fixes.time_ns[0]) & (time_ns <= fixes.time_ns[-1])
    near = np.diff(fixes.time_ns)[after - 1] <= TORN_S * 1e9
    near |= fixes.time_ns[after] == time_ns
    places = [np.interp(time_ns, fixes.time_ns, column) for column in fixes.points_m().T]
    return np.where((inside & near)[:, None], np.stack(places, axis=1), np.nan)
