"""Pose of a frame newer than the latest estimate, propagated by visual odometry."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Pose, Status, Trajectory, wrap_deg
from fieldgrid.live.pose.fixed_lag import pose_at
from fieldgrid.perception import CameraStep
from fieldgrid.poses import ErrorBudget

CARRIED_S = 2.0
"""A step carries a pose on that was estimated this time before the step begins, or less. How long
the step itself takes does not matter: its error says what it is worth."""

MOST_SHARE = 0.5
"""Share of the error that a cell may have which the way since then may take."""

STILL_MPS = 0.05

MOST_CHANGE_MPS2 = 3.0
"""How much a vehicle's speed may change in a second, in any direction."""

POSELESS_S = 1.5
"""Without a pose for longer, the window is not to be trusted."""

UNSEEN_DEG = 20.0
"""How much a heading may change in a second, 1 sigma, that nothing measures: the smoother's."""


class PropagatedPose(NamedTuple):
    """A pose and its gear, and what was added to it since it was estimated: seconds, those of them
    before its last step, and 1-sigma errors of the place and of the heading."""

    pose: Pose
    gear: int
    since_s: float = 0.0
    before_s: float = 0.0
    added_m: float = 0.0
    added_deg: float = 0.0

    def on(self, time_ns: int, step: CameraStep) -> PropagatedPose:
        """The pose after a step of the camera."""
        pose, took_s = self.pose, (time_ns - self.pose.time_ns) / 1e9
        phi = math.radians(pose.heading_deg)
        # An error of the heading moves the end of the step sideways.
        step_m = math.hypot(step.forward_m, step.right_m)
        off_m = math.hypot(step.sigma_m, step_m * math.radians(pose.heading_sigma_deg))
        speed_mps = step.forward_m / took_s if took_s > 0.0 else pose.speed_mps
        return PropagatedPose(
            Pose(
                time_ns,
                pose.east_m + step.right_m * math.cos(phi) + step.forward_m * math.sin(phi),
                pose.north_m - step.right_m * math.sin(phi) + step.forward_m * math.cos(phi),
                pose.up_m,
                float(wrap_deg(pose.heading_deg + step.turn_deg)),
                math.hypot(pose.position_sigma_m, off_m),
                math.hypot(pose.heading_sigma_deg, step.sigma_deg),
                speed_mps,
                pose.status,
            ),
            self.gear if abs(speed_mps) < STILL_MPS else (1 if speed_mps > 0.0 else -1),
            self.since_s + took_s,
            self.since_s,
            math.hypot(self.added_m, off_m),
            math.hypot(self.added_deg, step.sigma_deg),
        )

    def fits(self, known: PropagatedPose | None) -> bool:
        """Whether a vehicle can be there that was just now where it is `known` to have been. A step
        of the camera may begin much earlier, and rows of plants look alike."""
        if known is None:
            return True
        was, now = known.pose, self.pose
        since_s = abs(now.time_ns - was.time_ns) / 1e9
        apart_m = math.hypot(now.east_m - was.east_m, now.north_m - was.north_m)
        sigma_m = math.hypot(was.position_sigma_m, now.position_sigma_m)
        driven_m = since_s * (abs(was.speed_mps) + MOST_CHANGE_MPS2 * since_s)
        return apart_m <= 3.0 * sigma_m + driven_m

    def is_good(self, settings: PoseSettings, budget: ErrorBudget) -> bool:
        """Whether it is still good enough for the window, as the pose was that it began with."""
        off_m = math.hypot(self.added_m, budget.reach_m * math.radians(self.added_deg))
        return (
            self.before_s <= CARRIED_S
            and off_m <= MOST_SHARE * budget.cell_m
            and self.pose.heading_sigma_deg <= settings.max_heading_sigma_deg
            and self.pose.position_sigma_m <= settings.max_position_sigma_m
        )


def pose_now(
    trajectory: Trajectory, latest: PropagatedPose | None, newest_ns: int, told_ns: int | None
) -> tuple[Pose, int, str]:
    """The latest pose at the time of the newest data, with what may have happened since, its gear,
    and why it is not to be trusted. `latest` is the pose of the last frame, `told_ns` the time of
    the newest fix, or pose of another program."""
    known = trajectory.time_ns[trajectory.accepted]
    if not len(known):
        pose, gear = pose_at(trajectory, newest_ns)
        return pose, gear, pose.reason
    pose, gear = pose_at(trajectory, min(newest_ns, int(known[-1])))
    if latest and latest.since_s and latest.pose.time_ns > pose.time_ns:
        pose, gear = latest.pose, latest.gear
    since_s = max(newest_ns - pose.time_ns, 0) / 1e9
    if since_s > 0.0:
        speed_mps = abs(pose.speed_mps)
        turned_deg = UNSEEN_DEG * math.sqrt(since_s) if speed_mps > 0.1 else 0.0
        pose = replace(
            pose,
            time_ns=newest_ns,
            position_sigma_m=math.hypot(pose.position_sigma_m, speed_mps * since_s),
            up_sigma_m=math.hypot(pose.up_sigma_m, speed_mps * since_s),
            heading_sigma_deg=math.hypot(pose.heading_sigma_deg, turned_deg),
        )
    if since_s > POSELESS_S:
        after = trajectory.time_ns > known[-1]
        if after.any():
            why = trajectory.reason[-1]
        elif told_ns is None or (newest_ns - told_ns) / 1e9 > POSELESS_S:
            why = "nothing arrived that tells where the vehicle is"
        else:
            why = "the estimate is behind what has arrived"
        return pose, gear, f"no pose that can be used for {since_s:.1f} s: {why}"
    return pose, gear, pose.reason if pose.status is Status.REJECTED else ""
