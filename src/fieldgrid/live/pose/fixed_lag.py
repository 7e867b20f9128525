"""Poses during the drive: the batch estimate over the last seconds, repeated (fixed lag)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import BuildSettings, FieldgridError, GnssError, Int64, PoseSettings
from fieldgrid.geometry import Datum, Fix, FixColumns, Motion, Pose, Rig, Status, Trajectory
from fieldgrid.live.given import GIVEN_ROWS, body_poses
from fieldgrid.live.pose.sensor_rows import RecentRows, motion_of
from fieldgrid.live.pose.stamps import FIXES, FRAMES
from fieldgrid.perception import CameraStep, Refusal, steps_of
from fieldgrid.pipeline import cell_budget
from fieldgrid.poses import (
    Attitude,
    ErrorBudget,
    Estimate,
    estimate_poses,
    levelling_attitude,
    tells_attitude,
)
from fieldgrid.recordings import PoseBody, motion_of_body

KEPT_S, GIVEN_KEPT_S = 60.0, 180.0
"""What is older than this before the newest is forgotten, however silent the receiver is; with
poses of another program, which lead on without fixes."""

BEFORE_NS = 5_000_000_000
"""How long before a frame that waits for its pose an estimate begins."""

FEWEST_FIXES = 3
"""Number of fixes that an estimate needs."""


class EstimateInputs(NamedTuple):
    """What an estimate is made of; nothing that is pushed later changes it."""

    fixes: FixColumns
    rig: Rig
    datum: Datum | None
    settings: PoseSettings
    motion: Motion
    budget: ErrorBudget
    frame_ns: Int64
    known_ns: int
    """The time of the newest fix; where none is needed, of the newest pose that was given."""
    level_grids: bool
    """Whether grids are level where the drive tells how its vehicle leans."""

    @property
    def is_level(self) -> bool:
        """Whether the poses are those of level grids."""
        return self.level_grids and tells_attitude(self.motion, self.fixes.time_ns)

    def levelling(self, estimate: Estimate) -> Attitude | None:
        """The attitude that makes grids level by the `estimate` of this, as in a build; None where
        they are square to the ground, also since the drive denies what states its lean."""
        if not self.level_grids:
            return None
        return levelling_attitude(estimate.report.attitude)

    def estimate(self) -> Estimate:
        """The poses. GnssError where there are none, which says why."""
        return estimate_poses(
            self.fixes,
            self.rig,
            self.datum,
            self.settings,
            self.motion,
            self.budget,
            frame_ns=self.frame_ns,
            level_grids=self.level_grids,
        )


class FixedLagSmoother:
    """The measurements of the last seconds, and the poses estimated from them.

    Not safe to call from several threads. `window_s` is how much of the drive before the newest
    fix goes into an estimate, and poses of another program, of the `body`, from there on.
    """

    def __init__(
        self,
        rig: Rig,
        settings: BuildSettings,
        datum: Datum | None,
        window_s: float,
        body: PoseBody | None = None,
    ) -> None:
        self._rig, self._settings, self._body = rig, settings, body
        self._budget = cell_budget(rig, settings)
        self.datum = datum
        self._window_ns = round(window_s * 1e9)
        self._kept_ns = round(1e9 * max(window_s, KEPT_S if body is None else GIVEN_KEPT_S))
        self.rows = RecentRows(self._kept_ns)
        """What sensors, and another program of poses, said; any thread may add to it."""
        self._said: dict[str, deque[tuple[int, Any]]] = {FIXES: deque(), FRAMES: deque()}
        """Fixes, and the steps to frames, with their times."""
        self._last_fix_ns: int | None = None
        self._newest_ns = 0

    @property
    def newest_ns(self) -> int:
        """The time of the newest of all that was said."""
        return max(self._newest_ns, self.rows.newest_ns)

    def add_fix(self, fix: Fix) -> None:
        """A fix, in any order."""
        self._last_fix_ns = max(fix.time_ns, self._last_fix_ns or fix.time_ns)
        self._add(FIXES, fix.time_ns, fix)

    def add_frame(self, time_ns: int, step: CameraStep | None) -> None:
        """A frame, in order of time, and the camera's step to it from the one before."""
        self._add(FRAMES, time_ns, step)

    def _add(self, source: str, time_ns: int, value: Any) -> None:
        self._said[source].append((time_ns, value))
        self._newest_ns = max(self._newest_ns, time_ns)
        for said in self._said.values():
            while said and said[0][0] < self.newest_ns - self._kept_ns:
                said.popleft()

    def forget(self, sources: Collection[str], time_ns: int) -> None:
        """Forget what some sources (`stamps`) said after an instant, of another time; rows were
        forgotten before."""
        for source in self._said.keys() & set(sources):
            self._said[source] = deque(one for one in self._said[source] if one[0] <= time_ns)
        if FIXES in sources:
            self._last_fix_ns = max((ns for ns, _ in self._said[FIXES]), default=None)
        self._newest_ns = max([time_ns, *(ns for ns, _ in self._said[FRAMES])])

    def _since(self, source: str, since_ns: int) -> list[tuple[int, Any]]:
        """What a source said from an instant on."""
        return [one for one in self._said[source] if one[0] >= since_ns]

    def asked(self, oldest_ns: int, *, level_grids: bool = True) -> EstimateInputs:
        """What the estimate from before `oldest_ns` on is made of. GnssError where there is too
        little."""
        known_ns = self.told_ns
        if known_ns is None:
            if self._needs_fixes:
                raise GnssError("There is no fix yet; wait for the receiver.")
            raise GnssError("There is no pose yet; wait for the program that makes them.")
        if self._needs_fixes and len(self._said[FIXES]) < FEWEST_FIXES:
            raise GnssError(f"There are {len(self._said[FIXES])} fixes yet; wait for the receiver.")
        since_ns = min(known_ns - self._window_ns, oldest_ns - BEFORE_NS)
        fixes = [fix for _, fix in self._since(FIXES, since_ns)]
        if self._needs_fixes and len(fixes) < FEWEST_FIXES:
            silent_s = (self.newest_ns - known_ns) / 1e9
            raise GnssError(f"There was no fix for {silent_s:.0f} s; wait for the receiver.")
        return EstimateInputs(
            FixColumns.of_rows(fixes),
            self._rig,
            self.datum,
            self._settings.pose,
            self._motion(since_ns),
            self._budget,
            np.array([t for t, _ in self._since(FRAMES, since_ns)], dtype=np.int64),
            known_ns,
            level_grids,
        )

    @property
    def _needs_fixes(self) -> bool:
        """Whether nothing but fixes tells where the vehicle is."""
        return self._body is None or self._settings.pose.frame_origin is None

    @property
    def told_ns(self) -> int | None:
        """Until when something that was pushed tells where the vehicle is; None where nothing
        does."""
        if self._needs_fixes:
            return self._last_fix_ns
        poses = self.rows.since(0).get(GIVEN_ROWS)
        return None if poses is None else int(poses.time_ns[-1])

    def _motion(self, since_ns: int) -> Motion:
        parts = {part: [rows] for part, rows in self.rows.since(since_ns).items()}
        motion = motion_of(parts)
        if self._body is not None:
            if GIVEN_ROWS not in parts:
                raise GnssError("There is no pose yet; wait for the program that makes them.")
            poses, has_tilt = body_poses(self._body, parts[GIVEN_ROWS]), motion.tilt is not None
            given, _ = motion_of_body(poses, self._body, self._rig, has_tilt=has_tilt)
            return motion._replace(poses=given.poses, tilt=motion.tilt or given.tilt)
        frames = self._since(FRAMES, since_ns)
        steps = [step or Refusal.NOT_COMPARED for _, step in frames[1:]]
        if any(isinstance(step, CameraStep) for step in steps):
            motion = motion._replace(steps=steps_of([time_ns for time_ns, _ in frames], steps))
        return motion


def pose_at(trajectory: Trajectory, time_ns: int) -> tuple[Pose, int]:
    """The pose at an instant and its gear; rejected, with the reason, where nothing is known."""
    try:
        pose = trajectory.at(time_ns)
    except FieldgridError:
        reason = trajectory.reason[-1] if len(trajectory) else "no fix can be used"
        return unknown_pose(time_ns, reason), 0
    row = min(int(np.searchsorted(trajectory.time_ns, time_ns)), len(trajectory) - 1)
    return pose, int(trajectory.gear[row]) if pose.status is not Status.REJECTED else 0


def unknown_pose(time_ns: int, reason: str) -> Pose:
    """A pose of which nothing is known, and why."""
    nan = math.nan
    return Pose(time_ns, nan, nan, nan, nan, nan, nan, nan, Status.REJECTED, reason)
