"""Leaps of a receiver's solution that the camera sees.

Two decimetres from one fix to the next, or half a metre over a hole under trees, may be driven as
far as fixes can tell. The camera knows how the vehicle moved there.
"""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import LeverArm, Steps
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.drive import DriveEstimate
from fieldgrid.poses.faults.leaps.leaps import HOLE_PERIODS, TORN_S, usual_period_s
from fieldgrid.poses.faults.leaps.seams import LEAST_M, SeenLeap

CLEAR_SIGMAS, STATED_SIGMAS = 5.0, 3.0
"""Least size of a leap in sigmas of what the camera tells, and in sigmas that fixes state."""

WORTH_SIGMAS = 4.0
"""Between fixes that follow each other, only steps of more than this number of sigmas of their
noise are examined; they count where the camera says the same."""

SAME_SHARE = 0.5
"""What fixes and camera make of a leap differs by no more than this share of it."""

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
    if steps is None or len(fixes.time_ns) < 3:
        return ()
    # The fixes after which a leap may lie.
    every = np.arange(1, len(fixes.time_ns) - 2)
    off_m, hole = _by_fixes(fixes, every)
    noise_m = np.maximum(fixes.noise.across_m[every], fixes.noise.across_m[every + 1])
    large = np.hypot(*off_m.T) > np.maximum(LEAST_M / 2.0, WORTH_SIGMAS * noise_m)
    at = every[hole | large]
    if not len(at):
        return ()
    path = _CameraPath(fixes, drive, steps, antenna)
    found = []
    for k, off_m, is_hole in zip(at.tolist(), *_by_fixes(fixes, at), strict=True):
        seen = path.beside(*fixes.time_ns[k : k + 2].tolist())
        if seen is None:
            continue
        leap_m, sigma_m = seen
        size_m = float(np.hypot(*leap_m))
        stated_m = float(np.hypot(*fixes.sigma_m[k : k + 2]))
        least_m = max(LEAST_M, CLEAR_SIGMAS * sigma_m, STATED_SIGMAS * stated_m)
        same = is_hole or np.hypot(*(off_m - leap_m)) < SAME_SHARE * size_m
        if size_m > least_m and same:
            time_ns = int(fixes.time_ns[k + 1])
            found.append(SeenLeap(time_ns, float(leap_m[0]), float(leap_m[1]), sigma_m))
    return tuple(found)


def _by_fixes(fixes: AcceptedFixes, at: Int64) -> tuple[Float64, Bool]:
    """By how much [m, 2] the steps after some fixes are longer than the mean of the steps before
    and after them, and which are holes."""
    points_m, time_s = fixes.points_m(), (fixes.time_ns - fixes.time_ns[0]) / 1e9
    step_s, step_m = np.diff(time_s), np.diff(points_m, axis=0)
    pace = step_m / np.maximum(step_s, 1e-3)[:, None]
    usual = (pace[at - 1] + pace[np.minimum(at + 1, len(pace) - 1)]) / 2.0
    hole = step_s[at] > HOLE_PERIODS * usual_period_s(step_s)
    return step_m[at] - usual * step_s[at][:, None], hole


class _CameraPath:
    """The way of the antenna by the camera's steps, beside that of the fixes."""

    def __init__(
        self, fixes: AcceptedFixes, drive: DriveEstimate, steps: Steps, antenna: LeverArm
    ) -> None:
        order = np.argsort(steps.start_ns, kind="stable")
        steps = Steps._make(column[order] for column in steps)
        heading_deg = np.degrees(np.unwrap(np.radians(drive.heading_deg)))
        scale = drive.smoothed.camera_scale
        size = 1.0 if scale is None else 1.0 / (1.0 + scale.value)

        def turned(time_ns: Int64, right_m: Float64, ahead_m: Float64) -> Float64:
            phi = np.radians(np.interp(time_ns, drive.time_ns, heading_deg))
            east = right_m * np.cos(phi) + ahead_m * np.sin(phi)
            return np.stack([east, ahead_m * np.cos(phi) - right_m * np.sin(phi)], axis=1)

        right_m = np.full(len(order), float(antenna.right_m))
        ahead_m = np.full(len(order), float(antenna.forward_m))
        moved_m = turned(steps.start_ns, size * steps.right_m, size * steps.forward_m)
        moved_m += turned(steps.stop_ns, right_m, ahead_m)
        moved_m -= turned(steps.start_ns, right_m, ahead_m)
        node = np.clip(np.searchsorted(drive.time_ns, steps.start_ns), 0, len(drive.time_ns) - 1)
        self._start_ns, self._stop_ns, self._moved_m = steps.start_ns, steps.stop_ns, moved_m
        self._way_m = np.hypot(steps.right_m, steps.forward_m)
        self._sigma_rad = np.radians(drive.heading_sigma_deg[node])
        self._from_m, self._to_m = _at(fixes, steps.start_ns), _at(fixes, steps.stop_ns)
        # How an antenna sways, and what else makes steps and fixes differ, the drive itself says.
        off_m = self._to_m - self._from_m - moved_m
        known = np.abs(off_m[np.isfinite(off_m).all(axis=1)])
        usual_m = 1.48 * float(np.median(known)) if len(known) >= FEWEST_STEPS else math.inf
        self._step_sigma_m = max(usual_m, LEAST_STEP_M)

    def beside(self, before_ns: int, after_ns: int) -> tuple[Float64, float] | None:
        """How far east and north fixes of an instant lie beside where the camera went from those
        of an instant before, and the error of that along one axis; None where it does not say."""
        first = int(np.searchsorted(self._start_ns, before_ns, side="right")) - 1
        last = int(np.searchsorted(self._stop_ns, after_ns))
        if first < 0 or last >= len(self._stop_ns) or last < first:
            return None
        part = slice(first, last + 1)
        way_m = float(self._way_m[part].sum())
        is_broken = (self._start_ns[first + 1 : last + 1] != self._stop_ns[first:last]).any()
        off_m = self._to_m[last] - self._from_m[first] - self._moved_m[part].sum(axis=0)
        if is_broken or way_m > MOST_WAY_M or not np.isfinite(off_m).all():
            return None
        turned_m = float(self._sigma_rad[part].max()) * way_m
        steps_m = self._step_sigma_m * math.sqrt(last - first + 1)
        return off_m, math.hypot(steps_m, turned_m, SCALE_SHARE * way_m)


def _at(fixes: AcceptedFixes, time_ns: Int64) -> Float64:
    """East and north [n, 2] of the antenna at instants between two fixes, NaN where those are far
    apart."""
    after = np.clip(np.searchsorted(fixes.time_ns, time_ns), 1, len(fixes.time_ns) - 1)
    inside = (time_ns >= fixes.time_ns[0]) & (time_ns <= fixes.time_ns[-1])
    near = np.diff(fixes.time_ns)[after - 1] <= TORN_S * 1e9
    near |= fixes.time_ns[after] == time_ns
    places = [np.interp(time_ns, fixes.time_ns, column) for column in fixes.points_m().T]
    return np.where((inside & near)[:, None], np.stack(places, axis=1), np.nan)
