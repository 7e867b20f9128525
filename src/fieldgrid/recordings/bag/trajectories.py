"""A trajectory in a bag: nav_msgs/Odometry, nav_msgs/Path, or stamped poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import RecordingError
from fieldgrid.recordings.bag.listeners import Numbers, NumberTable
from fieldgrid.recordings.bag.order import clock
from fieldgrid.recordings.bag.topic_names import ODOMETRY, POSE, SURE_POSE
from fieldgrid.recordings.bag.topics import listing, short
from fieldgrid.recordings.poses.pose_files import MOST_M, OFF_UNIT, BodyPoses, rotations
from fieldgrid.recordings.ros.bag import Bag, Take, open_bag
from fieldgrid.recordings.ros.definitions import decode
from fieldgrid.recordings.ros.model import Message

_PATH = "nav_msgs/msg/Path"
_TYPES = (ODOMETRY, POSE, SURE_POSE, _PATH)
_SECOND_NS = 1_000_000_000


def pose_numbers(message: Any) -> tuple[float, ...]:
    """Where a stamped pose is, its quaternion x, y, z, w, and the variances that are stated of x, y
    and the turn about z: NaN where none is, and of a program that writes zeros."""
    pose, stated = message.pose, np.full(3, np.nan)
    if hasattr(pose, "covariance"):
        stated = np.asarray(pose.covariance, dtype=np.float64)[[0, 7, 35]]
        pose = pose.pose
    p, q = pose.position, pose.orientation
    variance = np.where(stated > 0.0, stated, np.nan)
    return (p.x, p.y, p.z, q.x, q.y, q.z, q.w, *variance.tolist())


_ROWS: NumberTable = {
    **dict.fromkeys((ODOMETRY, SURE_POSE, POSE), (10, pose_numbers)),
    _PATH: (10, lambda _: ()),
}


def read_pose_topic(
    path: Path, topic: str | None, offset_ns: int = 0, epoch_ns: int | None = None
) -> BodyPoses:
    """The poses of a topic of a bag, of the only one that has poses where none is named; `epoch_ns`
    as `open_bag` takes it.

    Raises RecordingError where there is none, several, or one whose poses are none.
    """
    heard: dict[str, Numbers] = {}
    paths: dict[str, Message] = {}

    def listen(name: str, type_: str) -> Take | None:
        if type_ not in _TYPES or (topic is not None and name != topic):
            return None
        heard[name] = Numbers(name, type_, _ROWS)
        # A path grows, so that the last message counts.
        return heard[name].take if type_ != _PATH else lambda one, _: paths.update({name: one})

    with open_bag(path, listen, epoch_ns) as bag:
        name = _chosen(bag, list(heard), topic)
        if name in paths:
            poses = decode(paths[name]).poses
            values = np.array([pose_numbers(one) for one in poses]).reshape(-1, 10)
            stamps = [one.header.stamp for one in poses]
            stamp_ns = np.array([one.sec * _SECOND_NS + one.nanosec for one in stamps], np.int64)
            dated_ns = bag.dated(stamp_ns)
            time_ns = clock(name, dated_ns, dated_ns).time_ns
        else:
            values = heard[name].rows()
            time_ns = clock(name, *bag.stamps(name)).time_ns[heard[name].places]
    length = np.linalg.norm(values[:, 3:7], axis=1)
    good = np.isfinite(values[:, :7]).all(axis=1) & (np.abs(values[:, :3]) < MOST_M).all(axis=1)
    wrong = ~(good & (np.abs(length - 1.0) < OFF_UNIT))
    if not len(values) or wrong.any():
        what = f"{np.count_nonzero(wrong)} of {len(values)} poses" if len(values) else "no pose"
        why = "hold NaN, or a quaternion that has not the length 1" if len(values) else "is in it"
        raise RecordingError(f"{path}: {what} of {name} {why}; choose another with --poses-topic.")
    known = time_ns > 0
    return BodyPoses(
        f"{path.name} {name}",
        time_ns[known] + offset_ns,
        values[known, :3],
        rotations(values[known, 3:7]),
        values[known, 7:],
    )


def _chosen(bag: Bag, candidates: list[str], topic: str | None) -> str:
    """The only topic with poses, or the one that was asked for."""
    if len(candidates) == 1:
        return candidates[0]
    what = " has several topics of poses" if candidates else " has no topic of poses"
    if topic is not None:
        there = f"is of the type {short(bag.topics[topic].type)}" if topic in bag.topics else ""
        what = f": {topic} {there or 'is not there'}"
    raise RecordingError(
        f"{bag.path}{what}; a topic of poses is one of {', '.join(map(short, _TYPES))}, and the "
        f"bag has {listing(bag.topics[name] for name in candidates or bag.topics)}; choose one "
        "with --poses-topic."
    )
