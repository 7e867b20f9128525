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

from fieldgrid.core import Figure, Finding, StopCode, error, warning
from fieldgrid.geometry import Steps
from fieldgrid.poses.axle import Axle, ways_of
from fieldgrid.poses.faults.denied import CLEAR_SIGMAS
from fieldgrid.poses.smoother.declared import Constant
from fieldgrid.poses.travel_direction import Ways, travel

LEAST_DEG = 0.5
"""A yaw is off when it is so clearly, and by more than this: half a degree is what a mounting is
measured to."""

ASKEW_DEG = 2.0
"""A camera that looks so far aside puts what is 7 m away by a cell of the paper elsewhere. Less
than that a vehicle may slip on a slope, which looks the same."""

LEAST_TURN_DEG = 1.0
"""In the last third of a drive a camera looks elsewhere if by this, and by as many sigmas."""


class CameraYaw(NamedTuple):
    """How far to the right of what is declared the camera looks, `off_deg` ± `sigma_deg`, and how
    much farther in the last third of the drive than in the first, 0 where that is not clear."""

    off_deg: float
    sigma_deg: float
    turned_deg: float = 0.0

    @property
    def is_off(self) -> bool:
        """Whether it certainly does not look where it is declared to."""
        return abs(self.off_deg) > max(CLEAR_SIGMAS * self.sigma_deg, LEAST_DEG)


def camera_yaw(off: Constant | None, steps: Steps | None, axle: Axle) -> CameraYaw | None:
    """What the drive's estimate says, radians, and whether the camera was moved by its own steps,
    whose axes are those that are declared. The axle's place regards that in a curve a camera ahead
    of it moves sideways, too."""
    if off is None or steps is None:
        return None
    found = CameraYaw(*map(math.degrees, off))
    ways, ahead_m = ways_of(steps), axle.frame()[1]
    third = len(ways.stop) // 3
    early, late = (
        travel(Ways._make(column[part] for column in ways), ahead_m).yaw_deg
        for part in (slice(third), slice(-third, None))
    )
    if early is None or late is None:
        return found
    turned_deg, sigma_deg = late.value - early.value, math.hypot(early.sigma, late.sigma)
    is_clear = abs(turned_deg) > max(CLEAR_SIGMAS * sigma_deg, LEAST_TURN_DEG)
    return found._replace(turned_deg=turned_deg) if is_clear else found


def yaw_findings(yaw: CameraYaw | None) -> Iterator[Finding]:
    """That the camera looks elsewhere than declared, or was moved, and what to do about it."""
    if yaw is None:
        return
    if yaw.is_off and (abs(yaw.off_deg) >= ASKEW_DEG or not yaw.turned_deg):
        yield (error if abs(yaw.off_deg) >= ASKEW_DEG else warning)(
            StopCode.CAMERA_YAW.value,
            f"By its own motion the camera looks {abs(yaw.off_deg):.1f}° ± {yaw.sigma_deg:.1f}° "
            f"{_side(yaw.off_deg)} than declared, and what it sees is misplaced by "
            f"{100.0 * math.radians(abs(yaw.off_deg)):.0f} cm in 1 m. A vehicle that slips "
            "sideways on a slope looks the same.",
            "Measure the mounting with `fieldgrid mount --write`, or correct camera_yaw_deg in "
            "mounting.json.",
            Figure(yaw.off_deg, "deg"),
        )
    if yaw.turned_deg:
        yield warning(
            "camera-moved",
            f"By its own motion the camera looks {abs(yaw.turned_deg):.1f}° {_side(yaw.turned_deg)}"
            " at the end of the drive than at its beginning: it was moved, or the vehicle slips "
            "sideways on a slope.",
            "If it was moved, cut the drive there, and measure the mounting of each part with "
            "`fieldgrid mount`.",
            Figure(yaw.turned_deg, "deg"),
        )


def _side(by_deg: float) -> str:
    return "farther right" if by_deg > 0.0 else "farther left"
