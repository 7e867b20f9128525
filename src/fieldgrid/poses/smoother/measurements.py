"""What is measured at the nodes of a drive, as the batch estimate takes it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64

MOUNTING_SIGMA_RAD = np.radians(20.0)
"""A recorded heading may be off by any mounting."""


LEAST_SEEN_SHARE = 0.5
"""A camera or a gyro that saw less of a drive tells nothing of what was declared: of five frames,
and of a log that ended early, the antenna was 3 m aside by six sigmas."""


LEAP_M = 0.5
"""By how much a receiver's solution leaps along an axis, 1-sigma."""

NOWHERE = np.zeros(0, dtype=np.int64)


class Measurements(NamedTuple):
    """Measurements at n nodes, ordered by `time_s`; NaN where there is none.

    `fix_m` [n, 2] is the antenna's east and north, `fix_sigma_m` [n, 2] its noise along the
    heading and across it. `bias_m` [n] is the 1-sigma of the receiver's slow error along one
    axis and `bias_s` [n] for how long that lasts, both at every node. `heading_rad` is a recorded
    heading, `speed_mps` a signed speed. `turned_rad` [n - 1] is the gyro's integral from node to
    node, `seen` [n - 1] whether the way to the next node is short enough to be known; `standing`
    marks nodes at rest.

    `step_nodes` [s, 2] are the start and the end of relative motions, `step` [s, 3] = forward,
    right (metres in the vehicle frame at the start) and clockwise turn (rad), `step_sigma`
    [s, 2] the sigma of the distance along one axis and of the turn. `heading_offset_sigma_rad` is
    how far recorded headings may be off by one angle. `leapt` [l] are the nodes after which the
    receiver's solution goes on elsewhere. With `one_clock` gyro and fixes have the same one.
    """

    time_s: Float64
    fix_m: Float64
    fix_sigma_m: Float64
    bias_m: Float64
    bias_s: Float64
    heading_rad: Float64
    heading_sigma_rad: Float64
    speed_mps: Float64
    speed_sigma_mps: Float64
    turned_rad: Float64
    seen: Bool
    standing: Bool
    step_nodes: Int64
    step: Float64
    step_sigma: Float64
    heading_offset_sigma_rad: float = MOUNTING_SIGMA_RAD
    leapt: Int64 = NOWHERE
    one_clock: bool = False

    def part(self, start: int, stop: int) -> Measurements:
        """What was measured from node `start` to before node `stop`."""
        between = {"turned_rad", "seen"}
        inside = np.all((self.step_nodes >= start) & (self.step_nodes < stop), axis=1)
        columns: dict[str, Any] = {
            name: column[start : stop - (name in between)]
            for name, column in self._asdict().items()
            if isinstance(column, np.ndarray) and not name.startswith(("step", "leapt"))
        }
        return self._replace(
            **columns,
            leapt=self.leapt[(self.leapt >= start) & (self.leapt < stop - 1)] - start,
            step_nodes=self.step_nodes[inside] - start,
            step=self.step[inside],
            step_sigma=self.step_sigma[inside],
        )

    def seen_turns_rad(self) -> Float64:
        """How the vehicle was seen to turn from node to node [n - 1]: by the gyro, else by relative
        motions, each spread evenly over its time; NaN where nothing saw it."""
        by_steps = self.by_steps(self.step[:, 2])
        return np.where(np.isfinite(self.turned_rad), self.turned_rad, by_steps)

    def by_steps(self, change: Float64) -> Float64:
        """How much of what changes over each relative motion [s] does so from node to node [n - 1],
        spread evenly over its time; NaN where there is none."""
        rate, seen = np.zeros(len(self.time_s)), np.zeros(len(self.time_s))
        length_s = np.diff(self.time_s[self.step_nodes], axis=1)[:, 0]
        per_s = change / np.maximum(length_s, 1e-9)
        for ends, sign in zip(self.step_nodes.T, (1.0, -1.0), strict=True):
            np.add.at(rate, ends, sign * per_s)
            np.add.at(seen, ends, sign)
        seen, step_s = np.cumsum(seen)[:-1], np.diff(self.time_s)
        return np.asarray(np.cumsum(rate)[:-1] * step_s / np.where(seen > 0.0, seen, np.nan))

    def with_steps(self, kept: Bool) -> Measurements:
        """All but the relative motions that are not `kept` [s]."""
        return self._replace(
            step_nodes=self.step_nodes[kept],
            step=self.step[kept],
            step_sigma=self.step_sigma[kept],
        )

    def leap_m2(self) -> Float64:
        """By how much leaps raise the variance of the slow error's change [n - 1]."""
        variance = np.zeros(max(len(self.time_s) - 1, 0))
        variance[self.leapt] = LEAP_M**2
        return variance

    def sees_turns(self) -> bool:
        """Whether a gyro or a camera saw how the vehicle turned, over most of the drive."""
        step_s, turned = np.diff(self.time_s), np.isfinite(self.turned_rad)
        by_gyro = float(step_s[turned].sum()) / max(float(step_s.sum()), 1e-9)
        return max(by_gyro, self._camera_share()) >= LEAST_SEEN_SHARE

    def sees_speed(self) -> bool:
        """Whether wheels or a camera measured its speed, over most of the drive."""
        by_wheels = float(np.mean(np.isfinite(self.speed_mps)))
        return max(by_wheels, self._camera_share()) >= LEAST_SEEN_SHARE

    def sees_way(self) -> bool:
        """Whether a camera measured its way, over most of the drive."""
        return self._camera_share() >= LEAST_SEEN_SHARE

    def records_headings(self) -> bool:
        """Whether most fixes have a recorded heading."""
        fixes = np.isfinite(self.fix_m[:, 0])
        return bool(fixes.any()) and float(np.isfinite(self.heading_rad[fixes]).mean()) > 0.5

    def _camera_share(self) -> float:
        """The share of the drive's time that the camera's steps cover."""
        lasted_s = float(self.time_s[-1] - self.time_s[0])
        covered_s = float(np.diff(self.time_s[self.step_nodes], axis=1).sum())
        return covered_s / max(lasted_s, 1e-9)
