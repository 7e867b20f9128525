"""A camera whose driver hands out an old image again, under a new stamp, while the vehicle drives.

Its frames would be carried to where the vehicle is by then, and smear what they show along the way.
No camera takes the same image twice, to the last bit; who stands sees nothing new, so only the way
driven since tells a stuck camera from one that is simulated without noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from fieldgrid.angles import wrap_deg
from fieldgrid.trajectory import Pose, Status

MOVED_M, TURNED_DEG = 0.25, 3.0
"""A grid may be so far off: the paper's cell, and the most that a heading's sigma may be."""

REPEATED = (
    "its image or cloud repeats that of the frame before to the last bit, though the vehicle moved"
)
"""Why a frame of a stuck camera is rejected."""


class StuckCamera:
    """The frames of a drive in order of time, and since when each of its images is the same."""

    def __init__(self) -> None:
        self._images: tuple[str, ...] = ()
        self._since: list[Pose] = []

    def judged(self, images_sha256: Sequence[str], pose: Pose) -> Pose:
        """The next frame's pose, rejected where one of its images is that of an earlier place."""
        images = tuple(images_sha256)
        before = self._images if len(self._images) == len(images) else ("",) * len(images)
        since = self._since if len(self._since) == len(images) else [pose] * len(images)
        self._images = images
        self._since = [
            at if one and one == last else pose
            for one, last, at in zip(images, before, since, strict=True)
        ]
        moved_m = max((_moved_m(at, pose) for at in self._since), default=0.0)
        turned_deg = max((_turned_deg(at, pose) for at in self._since), default=0.0)
        if pose.status is Status.REJECTED or (moved_m <= MOVED_M and turned_deg <= TURNED_DEG):
            return pose
        return replace(pose, status=Status.REJECTED, reason=REPEATED)


def _moved_m(one: Pose, other: Pose) -> float:
    return math.hypot(other.east_m - one.east_m, other.north_m - one.north_m)


def _turned_deg(one: Pose, other: Pose) -> float:
    return abs(float(wrap_deg(other.heading_deg - one.heading_deg)))
