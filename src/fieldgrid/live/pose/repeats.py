"""Whether the camera shows something new, judged again with each estimate of where it is.

The rule is that of a build (`checks.stuck`). Of a frame that waits for its pose it is applied anew
whenever that pose changes, so what is told of a frame once it is settled is what a build says.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from fieldgrid.geometry import Pose, Status
from fieldgrid.live.perceiver import PerceivedFrame
from fieldgrid.pipeline import REPEATED, StuckCamera


class _CameraState(NamedTuple):
    """The camera after a frame, whether that frame showed an image again, and whether of a place
    where the vehicle was not any more."""

    camera: StuckCamera = StuckCamera()
    is_again: bool = False
    is_stuck: bool = False


class Repeats:
    """Judges frames in order of time; `say` is told when a camera begins to be stuck, and when it
    shows something new again."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._taken = self._settled = self._now = _CameraState()
        self._stuck_ns = self._again_ns = -1
        self.new_ns = 0
        """The time of the newest frame whose image is of where the vehicle was then."""

    def taken(self, seen: PerceivedFrame) -> PerceivedFrame:
        """The next frame as it comes, without the camera's step where that cannot be the vehicle's:
        no camera that shows an image again tells how it went, nor how far it came since."""
        is_again = self._taken.camera.repeats(seen.images_sha256)
        tells = not is_again and not self._taken.is_again
        self._taken = _CameraState(StuckCamera(seen.images_sha256), is_again)
        return seen if tells else seen._replace(step=None)

    def begin(self) -> None:
        """Judge the frames that wait anew, from the first of them on."""
        self._now = self._settled

    def judged(self, seen: PerceivedFrame, pose: Pose, *, is_settled: bool) -> Pose:
        """The next frame's pose, rejected where an image of it is that of an earlier place."""
        before, time_ns = self._now, seen.time_ns
        is_again = before.camera.repeats(seen.images_sha256)
        camera, pose = before.camera.judged(seen.images_sha256, pose)
        is_stuck = is_again and (pose.reason == REPEATED or before.is_stuck)
        # Each is told once, though the frames are judged many times.
        if is_stuck and time_ns > self._stuck_ns:
            self._stuck_ns = time_ns
            if not before.is_stuck:
                self._say(
                    f"Frame {seen.frame_id} repeats the image of the frame before to the last bit, "
                    "though the vehicle moved: the camera or its driver is stuck, and its frames "
                    "are left out until it shows something new."
                )
        if before.is_stuck and not is_again and time_ns > self._again_ns:
            self._again_ns = time_ns
            self._say("The camera shows something new again.")
        if not is_again or (pose.status is Status.OK and not is_stuck):
            self.new_ns = max(self.new_ns, time_ns)
        self._now = _CameraState(camera, is_again, is_stuck)
        if is_settled:
            self._settled = self._now
        return pose
