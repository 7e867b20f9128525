"""Transforms of a bag that do not change: where each frame sits on the vehicle."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import CalibrationError, Float64, quoted
from fieldgrid.recordings.poses.pose_files import rotations

_DEEPEST = 64
_MAX_FRAMES = 10_000
_FARTHEST_M, _UNIT = 1e6, 0.01
_SAME = 1e-6
"""Transforms that differ by less, in metres or radians, are of one place."""


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
        for _, (child, parent, place) in told(message):
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

    def _ancestors(self, frame: str) -> dict[str, FrameTransform]:
        """The frame itself and those above it, nearest first, with its place in each."""
        here = FrameTransform(np.eye(3), np.zeros(3))
        found = {frame: here}
        while frame in self._parents:
            parent, place = self._parents[frame]
            if parent in found or len(found) > _DEEPEST:
                raise CalibrationError(
                    f"The static transforms of frame {quoted(frame)} lead in a circle; record a "
                    "/tf_static in which each frame has one parent, or write mounting.json."
                )
            here = FrameTransform(place.R @ here.R, place.R @ here.at_m + place.at_m)
            found[parent] = here
            frame = parent
        return found


def told(message: Any) -> Iterator[tuple[Any, tuple[str, str, FrameTransform]]]:
    """The transforms of a message that are any, each with its child, parent and place."""
    for one in message.transforms:
        child, parent = _plain(one.child_frame_id), _plain(one.header.frame_id)
        place = place_of(one.transform)
        if place is not None and child != parent:
            yield one, (child, parent, place)


def _plain(frame: str) -> str:
    return frame.lstrip("/")


def place_of(transform: Any) -> FrameTransform | None:
    """What a geometry_msgs/Transform says; None where it is none."""
    shift, turn = transform.translation, transform.rotation
    at_m = np.array([shift.x, shift.y, shift.z], dtype=np.float64)
    q = np.array([turn.x, turn.y, turn.z, turn.w], dtype=np.float64)
    if not (np.abs(at_m).max() < _FARTHEST_M and np.abs(q).max() < 2.0):  # nor NaN
        return None
    if abs(float(np.linalg.norm(q)) - 1.0) > _UNIT:
        return None
    return FrameTransform(rotations(q[None])[0], at_m)
