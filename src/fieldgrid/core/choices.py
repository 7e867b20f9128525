"""What a user chooses by name. In a module that imports nothing: both the settings and the rooms
that act on them need it."""

from __future__ import annotations

from enum import StrEnum


class Transfer(StrEnum):
    """Where the value of a local cell goes."""

    CENTRE = "centre"
    AREA = "area"


class MatcherKind(StrEnum):
    """Which of OpenCV's matchers: from best to fastest on vegetation, sgbm, sgbm3way, bm."""

    SGBM_3WAY = "sgbm3way"
    SGBM = "sgbm"
    BM = "bm"


class StopCode(StrEnum):
    """What of a drive stops a build unless it is accepted, by the codes of `inspect`."""

    CLOCK_OFFSET = "clock-offset"
    CLOCK_JUMP = "clock-jump"
    FRAMES_MISPLACED = "frames-misplaced"
    MIRRORED = "mirrored"
    SCALE = "scale"
    CAMERA_YAW = "camera-yaw"
    VERTICAL_MISALIGNMENT = "vertical-misalignment"
    CAMERAS_SWAPPED = "cameras-swapped"
    CAMERAS_UNFIT = "cameras-unfit"
    COARSE_CELLS = "coarse-cells"


class GearName(StrEnum):
    """Which way a vehicle drives."""

    FORWARD = "forward"
    REVERSE = "reverse"

    @property
    def sign(self) -> int:
        """+1 forward, -1 reverse."""
        return 1 if self is GearName.FORWARD else -1
