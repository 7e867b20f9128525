"""Where the camera looks beside where the vehicle goes, against what is declared.

By the motions of the camera itself (`poses.travel_direction`), so however good the fixes are. What
is placed lies off by the same angle: half a metre at ten metres for three degrees. A vehicle that
slips sideways on a slope looks the same, and with headings along its path does the same to the
map.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from fieldgrid.geometry import Steps
from fieldgrid.poses.axle import Axle, ways_of
from fieldgrid.poses.travel_direction import travel

CLEAR_SIGMAS, LEAST_DEG = 4.0, 0.5
"""A yaw is off when it is by more than both; half a degree is what a mounting is measured to."""


class CameraYaw(NamedTuple):
    """How far to the right of what is declared the camera looks, `off_deg` ± `sigma_deg`."""

    off_deg: float
    sigma_deg: float

    @property
    def is_off(self) -> bool:
        """Whether it certainly does not look where it is declared to."""
        return abs(self.off_deg) > max(CLEAR_SIGMAS * self.sigma_deg, LEAST_DEG)


def camera_yaw(steps: Steps | None, axle: Axle) -> CameraYaw | None:
    """By the camera's steps, whose axes are those that are declared; None where they do not tell.
    The axle's place regards that in a curve a camera ahead of it moves sideways, too."""
    if steps is None or not len(steps.start_ns):
        return None
    yaw = travel(ways_of(steps), axle.frame()[1]).yaw_deg
    return None if yaw is None else CameraYaw(yaw.value, yaw.sigma)


def yaw_notes(yaw: CameraYaw) -> Iterator[str]:
    """That the camera looks elsewhere than declared, and what to do about it."""
    if yaw.is_off:
        yield (
            f"{off_sentence(yaw)}; measure it with `fieldgrid mount`, and correct camera_yaw_deg "
            "in mounting.json. A vehicle that slips sideways on a slope looks the same, and so "
            "does a camera that was moved during the drive."
        )


def off_sentence(yaw: CameraYaw) -> str:
    """That the camera looks elsewhere than declared, without an end."""
    side, off_deg = "right" if yaw.off_deg > 0.0 else "left", abs(yaw.off_deg)
    return (
        f"By its own motion the camera looks {off_deg:.1f}° ± {yaw.sigma_deg:.1f}° farther {side} "
        "than declared, and what it sees is misplaced by "
        f"{100.0 * math.radians(off_deg):.0f} cm in 1 m"
    )
