"""A camera whose driver hands out an old image again, under a new stamp, while the vehicle drives.

Its frames would be carried to where the vehicle is by then, and smear what they show along the way.
No camera takes the same image twice, to the last bit; who stands sees nothing new, so only the way
driven since tells a stuck camera from one that is simulated without noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from fieldgrid.geometry import Pose, Status, wrap_deg

MOVED_M, TURNED_DEG = 0.25, 3.0
"""How far off a grid may be: the paper's cell, and the most that a heading's sigma may be."""

REPEATED = (
    "its image or cloud is identical to that of the previous frame, although the vehicle moved"
)
"""Why a frame of a stuck camera is rejected."""


class StuckCamera(NamedTuple):
    """What the latest frame of a drive showed, and the poses since when each of its images is the
    same: those of the first frame of a drive are none."""

    images: tuple[str, ...] = ()
    since: tuple[Pose, ...] = ()

    def repeats(self, images_sha256: Sequence[str]) -> bool:
        """Whether one of these images, of the next frame, is that of the latest."""
        return any(self._again(images_sha256))

    def judged(self, images_sha256: Sequence[str], pose: Pose) -> tuple[StuckCamera, Pose]:
        """The camera after the next frame, in order of time, and that frame's pose, rejected where
        one of its images is that of an earlier place."""
        again = self._again(images_sha256)
        # How far the vehicle came since a place that is not known cannot be told.
        since = tuple(
            self.since[k] if one and _is_known(self.since[k]) else pose
            for k, one in enumerate(again)
        )
        is_off = any(
            math.hypot(pose.east_m - at.east_m, pose.north_m - at.north_m) > MOVED_M
            or abs(float(wrap_deg(pose.heading_deg - at.heading_deg))) > TURNED_DEG
            for at in since
        )
        if is_off and pose.status is not Status.REJECTED:
            pose = replace(pose, status=Status.REJECTED, reason=REPEATED)
        return StuckCamera(tuple(images_sha256), since), pose

    def _again(self, images_sha256: Sequence[str]) -> list[bool]:
        """For each of a frame's images, whether it is that of the latest frame."""
        if len(images_sha256) != len(self.images):
            return [False] * len(images_sha256)
        return [
            bool(one) and one == last for one, last in zip(images_sha256, self.images, strict=True)
        ]


def _is_known(pose: Pose) -> bool:
    return math.isfinite(pose.east_m + pose.north_m + pose.heading_deg)
