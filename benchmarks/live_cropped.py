"""A drive whose pairs are cut to as many pixels as 640 x 480 have, and held in memory, as a camera
gives them: KITTI's comes at 10 Hz, which the example's does not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fieldgrid.core import Int64
from fieldgrid.live.pushed import PushedImage
from fieldgrid.recordings import Frame, Recording, StereoFrame

PIXELS = 640 * 480


@dataclass(frozen=True)
class Held:
    """Frames in memory as the source of a recording."""

    held: tuple[Frame, ...]

    @property
    def times_ns(self) -> Int64:
        """When they were taken, by the camera's clock."""
        return np.array([frame.time_ns for frame in self.held], dtype=np.int64)

    @property
    def roles(self) -> tuple[str, ...]:
        """Those of a pair."""
        return "left", "right"

    def frames(self, start: int, stop: int) -> Iterator[Frame]:
        """Frames number `start` to before `stop`."""
        return iter(self.held[start:stop])


def cropped(recording: Recording) -> Recording:
    """The same drive, of the middle columns of its pairs."""
    camera = recording.rig.camera
    width = PIXELS // camera.height_px
    left_px = (camera.width_px - width) // 2
    held = []
    for frame in recording.frames():
        assert isinstance(frame, StereoFrame)
        sides = [image[:, left_px : left_px + width] for image in frame.images()]
        left, right = (PushedImage(frame.frame_id, np.ascontiguousarray(one)) for one in sides)
        size_px = (width, camera.height_px)
        held.append(StereoFrame(frame.frame_id, frame.time_ns, left, right, size_px))
    sensor = replace(camera, width_px=width, cx_px=camera.cx_px - left_px)
    return replace(recording, rig=replace(recording.rig, sensor=sensor), source=Held(tuple(held)))
