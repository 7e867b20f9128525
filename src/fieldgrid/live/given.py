"""Poses of another program as they are pushed: checked, kept as they are written, made a motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fieldgrid.core import ConfigError
from fieldgrid.live.pose.sensor_rows import Rows, joined, rows_of
from fieldgrid.recordings import MOST_M, OFF_UNIT, BodyPoses, PoseBody, check_axes, rotations

GIVEN_ROWS = "poses"
"""What rows of poses are called."""

NO_POSES = Rows(np.zeros(0, np.int64), (np.zeros((0, 3)), np.zeros((0, 9)), np.zeros((0, 3))))


def check_body(body: PoseBody) -> PoseBody:
    """The body, once its axes are checked. ConfigError where they are none."""
    try:
        check_axes(body.axes)
    except ValueError as problem:
        raise ConfigError(str(problem).replace("an IMU", "the body of poses") + ".") from problem
    return body


def pose_rows(
    time_ns: npt.ArrayLike,
    position_m: npt.ArrayLike,
    quaternion_xyzw: npt.ArrayLike,
    variance: npt.ArrayLike | None = None,
) -> Rows:
    """Rows of poses, one or [n]: positions [n, 3], quaternions [n, 4] and, where they are stated,
    variances [n, 3]. ConfigError, which says which value, for what can be none."""
    times = np.atleast_1d(np.asarray(time_ns, dtype=np.int64))
    turned = np.asarray(quaternion_xyzw, dtype=np.float64)
    if turned.size != 4 * len(times):
        raise ConfigError(
            f"Quaternions of poses have the shape {turned.shape} for {len(times)} times; give "
            "x, y, z, w of each."
        )
    turned = turned.reshape(-1, 4)
    wrong = ~(np.abs(np.linalg.norm(turned, axis=1) - 1.0) < OFF_UNIT)
    if wrong.any():
        value = ", ".join(f"{part:g}" for part in turned[int(np.argmax(wrong))])
        raise ConfigError(
            f"A pose has the quaternion ({value}), which has not the length 1; leave out poses "
            "that were lost, and write x, y, z, w."
        )
    stated = np.full((len(times), 3), np.nan)
    if variance is not None:
        stated[:] = np.asarray(variance, dtype=np.float64).reshape(-1, 3)
    known = np.where(stated > 0.0, stated, np.nan)
    rows = rows_of(GIVEN_ROWS, times, position_m, rotations(turned).reshape(-1, 9), known)
    if rows.columns[0].size and not np.abs(rows.columns[0]).max() < MOST_M:
        raise ConfigError("A pose is farther from its origin than any drive leads; leave it out.")
    return rows


def check_order(rows: Rows, newest_ns: int, late_ns: int) -> int:
    """The time of the newest pose, with these rows. ConfigError where one comes more than `late_ns`
    after the newest before it: none of the rows is to be taken then."""
    times = rows.time_ns
    before = np.maximum.accumulate(np.concatenate([[newest_ns], times]))
    late = before[:-1] - times
    if late.size and late.max() > late_ns:
        raise ConfigError(
            f"A pose of {times[int(late.argmax())]} ns came {late.max() / 1e9:.1f} s after a newer "
            f"one, and {late_ns / 1e9:g} s are taken; push poses in order, or state a larger lag."
        )
    return int(before[-1])


def body_poses(body: PoseBody, chunks: Sequence[Rows]) -> BodyPoses:
    """Poses as they were pushed, as a file would have them."""
    times, (position_m, R, variance) = joined(chunks)
    return BodyPoses(body.name, times, position_m, R.reshape(-1, 3, 3), variance)


def rows_of_body(poses: BodyPoses) -> Rows:
    """Poses of a recording as rows, in order of time, of equal times in that of the recording."""
    assert poses.time_ns is not None
    order = np.argsort(poses.time_ns, kind="stable")
    columns = poses.position_m, poses.R.reshape(-1, 9), poses.variance
    return Rows(poses.time_ns[order], tuple(column[order] for column in columns))
