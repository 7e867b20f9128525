"""Transforms of a bag: where each frame sits on the vehicle and which way its axes point, by the
tree of those that never change; and the way of the vehicle by those that do."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64, Int64, quoted
from fieldgrid.geometry import WheelSpeed
from fieldgrid.recordings.bag.listeners import TopicListener
from fieldgrid.recordings.bag.order import clock
from fieldgrid.recordings.bag.topic_names import stream_frame
from fieldgrid.recordings.poses.pose_files import rotations
from fieldgrid.recordings.ros.bag import Bag
from fieldgrid.recordings.tables.motion_files import directions

GROUND, BASE = "base_footprint", "base_link"
"""Frames by the convention of ROS: on the ground below the vehicle, and on the vehicle."""

R_OPTICAL_FLU: Float64 = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Directions forward, left, up as right, down, forward."""

_DEEPEST = 64
_MAX_FRAMES = 10_000
_FARTHEST_M, _UNIT = 1e6, 0.01
_SAME = 1e-6
"""Transforms that differ by less, in metres or radians, are of one place."""

_WHOLE = 1e-9
"""A rotation that is so near to one by right angles is that."""

_MOST_TREES = 10_000
_ALL_OF_FIRST, _THEN_EVERY = 200, 50

CHORD_NS, LONGEST_NS = 100_000_000, 1_000_000_000
"""The speed is told over so long a way: over less, the digits of a transform make noise. Over a
longer one than the second, nothing is told."""

JUMP_MPS = 30.0
"""Faster is no vehicle: what finds its place in a map again moves its frame at once."""

_BASE = re.compile(r"(?:.*/)?base_(?:footprint|link)")
_WORLD = {"odom": 0, "map": 1, "world": 2}
"""Frames in which a vehicle moves, the smoothest first."""


class FrameTransform(NamedTuple):
    """A frame seen from another: R turns its directions into the other's, `at_m` is its origin."""

    R: Float64
    at_m: Float64


class Transforms:
    """The tree of frames. Names are without a leading slash; the last word on a frame holds."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, FrameTransform]] = {}
        self._moved: set[str] = set()

    def add(self, message: Any) -> None:
        """The transforms of a tf2_msgs/TFMessage; those that are no transform are left out."""
        for _, child, parent, place in told(message):
            self.put(child, parent, place)

    def put(self, child: str, parent: str, place: FrameTransform) -> None:
        """One frame. Those that move or change their parent are noted for :meth:`unmoved`."""
        known = self._parents.get(child)
        if known is None and len(self._parents) == _MAX_FRAMES:
            return
        if known is not None:
            apart = max(np.abs(a - b).max() for a, b in zip(known[1], place, strict=True))
            if known[0] != parent or not apart < _SAME:
                self._moved.add(child)
        self._parents[child] = (parent, place)

    def unmoved(self) -> Transforms:
        """The tree without the frames that were seen to move."""
        found = Transforms()
        found._parents = {key: at for key, at in self._parents.items() if key not in self._moved}
        return found

    def update(self, other: Transforms) -> None:
        """Take in another tree, whose word on a frame holds."""
        self._parents.update(other._parents)

    def place(self, frame: str, base: str) -> FrameTransform | None:
        """A frame of the tree seen from `base`, whichever is above the other; None where nothing
        joins them.

        Raises CalibrationError for frames that hang in a circle.
        """
        frame = _plain(frame)
        if frame not in self._parents and all(frame != p for p, _ in self._parents.values()):
            return None
        up, from_base = self._ancestors(frame), self._ancestors(_plain(base))
        shared = next((name for name in up if name in from_base), None)
        if shared is None:
            return None
        of_frame, of_base = up[shared], from_base[shared]
        R_base = of_base.R.T
        return FrameTransform(R_base @ of_frame.R, R_base @ (of_frame.at_m - of_base.at_m))

    def top(self, frame: str) -> str:
        """The frame above all that a frame is below; itself where there is none."""
        return list(self._ancestors(frame))[-1]

    def on_vehicle(self, frame: str) -> FrameTransform | None:
        """A frame seen from that of the vehicle; None where nothing joins them."""
        placed = self.place(frame, BASE)
        return self.place(frame, GROUND) if placed is None else placed

    def _ancestors(self, frame: str) -> dict[str, FrameTransform]:
        """The frame itself and those above it, nearest first, with its place in each."""
        here = FrameTransform(np.eye(3), np.zeros(3))
        found = {frame: here}
        while frame in self._parents:
            frame, place = self._parents[frame]
            if frame in found or len(found) > _DEEPEST:
                raise CalibrationError(
                    f"The static transforms of frame {quoted(frame)} lead in a circle; record a "
                    "/tf_static in which each frame has one parent, or write mounting.json."
                )
            here = FrameTransform(place.R @ here.R, place.R @ here.at_m + place.at_m)
            found[frame] = here
        return found


def told(message: Any) -> Iterator[tuple[Any, str, str, FrameTransform]]:
    """The transforms of a message that are any, each with its child, parent and place."""
    for one in message.transforms:
        child, parent = _plain(one.child_frame_id), _plain(one.header.frame_id)
        place = place_of(one.transform)
        if place is not None and child != parent:
            yield one, child, parent, place


def _plain(frame: str) -> str:
    return frame.lstrip("/")


def place_of(transform: Any) -> FrameTransform | None:
    """What a geometry_msgs/Transform says; None where it is none."""
    shift, turn = transform.translation, transform.rotation
    at_m = np.array([shift.x, shift.y, shift.z], dtype=np.float64)
    q = np.array([turn.x, turn.y, turn.z, turn.w], dtype=np.float64)
    is_near = np.abs(at_m).max() < _FARTHEST_M and np.abs(q).max() < 2.0  # nor NaN
    if not is_near or abs(float(np.linalg.norm(q)) - 1.0) > _UNIT:
        return None
    return FrameTransform(rotations(q[None])[0], at_m)


def is_optical(frame: str) -> bool:
    """Whether a frame is named as one whose axes point right, down and forward."""
    return "optical" in frame.lower()


def optical(frame: str, transforms: Transforms, axes: str | None = None) -> Float64:
    """Turns directions of a sensor's frame into right, down, forward.

    `axes` are where its x, y and z point, when that is said. Else frames whose name says so are
    optical, and others are taken as forward, left, up, unless the static transforms show their x
    axis to point right and their z axis not up.
    """
    if axes is not None:
        return R_OPTICAL_FLU @ np.array(directions(axes), dtype=np.float64).T
    placed = None if is_optical(frame) else transforms.on_vehicle(frame)
    is_camera = placed is not None and placed.R[1, 0] < -0.5 and placed.R[2, 2] < 0.5
    return np.eye(3) if is_camera or is_optical(frame) else R_OPTICAL_FLU


def imu_rotation(imu_frame: str, transforms: Transforms) -> Float64 | None:
    """From an IMU's axes to those of the vehicle, forward, left, up [3, 3]; None where no static
    transform tells it."""
    placed = transforms.on_vehicle(imu_frame)
    if placed is None:
        return None
    whole = np.round(placed.R)
    return np.asarray(whole if np.abs(whole - placed.R).max() < _WHOLE else placed.R)


class Trees(TopicListener):
    """Static transforms."""

    def __init__(self, name: str, type_: str) -> None:
        super().__init__(name, type_)
        self.transforms = Transforms()

    def _wants(self, place: int) -> bool:
        return place < _MOST_TREES

    def _add(self, message: Any, place: int) -> None:
        self.transforms.add(message)


class StreamPlace(Trees):
    """The place of a stream on a topic of RealSense's recorder, which ends in the number of what it
    is seen from."""

    def _add(self, message: Any, place: int) -> None:
        at = place_of(message)
        if at is not None:
            self.transforms.put(stream_frame(self.name), self.name.rpartition("/")[2], at)


class MovingTrees(Trees):
    """Transforms on /tf: the way of the vehicle, as long as nothing else tells it (`is_whole`), and
    those that never change, which some robots publish there, too."""

    is_whole = True

    def __init__(self, name: str, type_: str) -> None:
        super().__init__(name, type_)
        self._ways: dict[tuple[str, str], tuple[array[int], array[float]]] = {}

    def _wants(self, place: int) -> bool:
        return self.is_whole or _is_sample(place)

    def _add(self, message: Any, place: int) -> None:
        if _is_sample(place):
            self.transforms.add(message)
        for one, child, parent, at in told(message):
            if parent.rpartition("/")[2] in _WORLD and _BASE.fullmatch(child):
                stamp = one.header.stamp
                times, values = self._ways.setdefault((parent, child), (array("q"), array("d")))
                times.extend((place, stamp.sec * 1_000_000_000 + stamp.nanosec))
                values.extend((*at.at_m, *at.R[:, 0]))

    def speed(self, bag: Bag, *, is_mapped: bool) -> tuple[str, WheelSpeed] | None:
        """Whose speed the transforms tell, and in which frame, and that speed: in `odom`, which has
        no jumps, before others. None where there is none, or of several vehicles, or not all was
        heard. In a `map` that lies on the globe (`is_mapped`) it was found by the fixes, and says
        nothing beside them."""
        moving = [
            (_WORLD[parent.rpartition("/")[2]], parent, child)
            for (parent, child), (_, values) in self._ways.items()
            if np.ptp(np.array(values).reshape(-1, 6)[:, :3], axis=0).max() > 0.0  # at two places
        ]
        moving = [one for one in moving if not (is_mapped and one[0] == _WORLD["map"])]
        found = [one for one in moving if one[0] == min(moving)[0]]
        if not self.is_whole or len(found) != 1:
            return None
        _, parent, child = found[0]
        times, values = self._ways[parent, child]
        place, stamp_ns = np.array(times, dtype=np.int64).reshape(-1, 2).T
        time_ns = clock(self.name, bag.dated(stamp_ns), bag.stamps(self.name)[1][place]).time_ns
        columns = np.array(values, dtype=np.float64).reshape(-1, 6)[time_ns > 0]
        told_ns, speed_mps = forward_speeds(time_ns[time_ns > 0], columns[:, :3], columns[:, 3:])
        return f"{child} in {parent}", WheelSpeed(told_ns, speed_mps)


def forward_speeds(time_ns: Int64, at_m: Float64, forward: Float64) -> tuple[Int64, Float64]:
    """Times in the middle of chords of a tenth of a second, and the speed along the vehicle's x
    axis on each, negative in reverse, by its places [n, 3] and the directions of that axis [n, 3].
    """
    order = np.unique(time_ns, return_index=True)[1]
    time_ns, at_m, forward = time_ns[order], at_m[order], forward[order]
    knots = [0]
    while knots[-1] < len(time_ns) - 1:  # a stamp may be a little early
        later = np.searchsorted(time_ns, time_ns[knots[-1]] + CHORD_NS - CHORD_NS // 20)
        knots.append(min(int(later), len(time_ns) - 1))
    first, last = np.array(knots[:-1], dtype=np.intp), np.array(knots[1:], dtype=np.intp)
    took_ns = time_ns[last] - time_ns[first]
    ahead = forward[first] + forward[last]
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1), 1e-9)[:, None]
    speed_mps = np.einsum("ni,ni->n", ahead, at_m[last] - at_m[first]) / (took_ns / 1e9)
    told_here = (took_ns <= LONGEST_NS) & (np.abs(speed_mps) < JUMP_MPS)
    return (time_ns[first] + took_ns // 2)[told_here], speed_mps[told_here]


def _is_sample(place: int) -> bool:
    return place < _ALL_OF_FIRST or (place < _MOST_TREES and place % _THEN_EVERY == 0)
