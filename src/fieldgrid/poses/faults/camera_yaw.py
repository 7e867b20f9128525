"""Where the camera looks beside where the vehicle goes, against what is declared.

By the motions of the camera itself (`poses.travel_direction`), so however good the fixes are. What
is placed lies off by the same angle: half a metre at ten metres for three degrees. A vehicle that
slips sideways on a slope looks the same, and with headings along its path does the same to the
map.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Float64, utc_text
from fieldgrid.geometry import Steps
from fieldgrid.poses.axle import Axle, ways_of
from fieldgrid.poses.smoother.declared import Constant
from fieldgrid.poses.travel_direction import Ways, travel

CLEAR_SIGMAS, LEAST_DEG = 4.0, 0.5
"""A yaw is off when it is by more than both; half a degree is what a mounting is measured to."""

SPLITS, LEAST_MOVE_DEG = 8, 1.0
"""At how many places of a drive it is looked whether the camera was moved, and by how much at
least; about the clearest of them at twice as many more."""


class CameraTurn(NamedTuple):
    """That the camera looks `by_deg` ± `sigma_deg` farther right from `time_ns` on than before."""

    time_ns: int
    by_deg: float
    sigma_deg: float


class CameraYaw(NamedTuple):
    """How far to the right of what is declared the camera looks, `off_deg` ± `sigma_deg`, and
    whether that changes in the drive."""

    off_deg: float
    sigma_deg: float
    moved: CameraTurn | None = None

    @property
    def is_off(self) -> bool:
        """Whether it certainly does not look where it is declared to."""
        return abs(self.off_deg) > max(CLEAR_SIGMAS * self.sigma_deg, LEAST_DEG)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        moved = None if self.moved is None else self.moved._asdict()
        return self._asdict() | {"moved": moved}


def camera_yaw(off: Constant | None, steps: Steps | None, axle: Axle) -> CameraYaw | None:
    """What the drive's estimate says, radians, and whether the camera was moved by its own steps,
    whose axes are those that are declared. The axle's place regards that in a curve a camera ahead
    of it moves sideways, too."""
    if off is None or steps is None:
        return None
    off_deg, sigma_deg = map(math.degrees, off)
    return CameraYaw(off_deg, sigma_deg, _moved(ways_of(steps), steps, axle.frame()[1]))


def yaw_notes(yaw: CameraYaw) -> Iterator[str]:
    """That the camera looks elsewhere than declared, or was moved, and what to do about it."""
    if yaw.moved is not None:
        at = utc_text(yaw.moved.time_ns)
        yield (
            f"From {at} on the camera looks {_aside(yaw.moved.by_deg, yaw.moved.sigma_deg)} than "
            "before, by its own motion: it was moved, or the vehicle slips sideways on a slope. If "
            "it was moved, make two recordings of the drive and measure the mounting of each with "
            "`fieldgrid mount`."
        )
    elif yaw.is_off:
        yield (
            f"{off_sentence(yaw)}; measure it with `fieldgrid mount`, and correct camera_yaw_deg "
            "in mounting.json. A vehicle that slips sideways on a slope looks the same."
        )


def off_sentence(yaw: CameraYaw) -> str:
    """That the camera looks elsewhere than declared, without an end."""
    return (
        f"By its own motion the camera looks {_aside(yaw.off_deg, yaw.sigma_deg)} than declared, "
        f"and what it sees is misplaced by {100.0 * math.radians(abs(yaw.off_deg)):.0f} cm in 1 m"
    )


def _aside(by_deg: float, sigma_deg: float) -> str:
    side = "right" if by_deg > 0.0 else "left"
    return f"{abs(by_deg):.1f}° ± {sigma_deg:.1f}° farther {side}"


def _moved(ways: Ways, steps: Steps, ahead_m: float) -> CameraTurn | None:
    """The clearest place at which the yaw is another after than before; None if none is clear."""
    count = len(ways.stop)
    places = np.linspace(0, count, SPLITS + 2)
    coarse = _clearest(ways, ahead_m, np.rint(places[1:-1]))
    if coarse is None:
        return None
    near = np.clip(np.linspace(-places[1], places[1], 2 * SPLITS + 1) + coarse[0], 1, count - 1)
    at, by_deg, sigma_deg = _clearest(ways, ahead_m, np.rint(near)) or coarse
    return CameraTurn(int(steps.start_ns[ways.stop[at]]), by_deg, sigma_deg)


def _clearest(ways: Ways, ahead_m: float, places: Float64) -> tuple[int, float, float] | None:
    """Of some places, counted in steps, the one at which the yaw changes by the most sigmas, by
    how much, and with which sigma; None where it does at none."""
    best, clearest = None, CLEAR_SIGMAS
    for at in np.unique(places).astype(np.int64).tolist():
        before = travel(_part(ways, slice(0, at)), ahead_m).yaw_deg
        after = travel(_part(ways, slice(at, None)), ahead_m).yaw_deg
        if before is None or after is None:
            continue
        by_deg = after.value - before.value
        sigma_deg = math.hypot(before.sigma, after.sigma)
        if abs(by_deg) > LEAST_MOVE_DEG and abs(by_deg) / sigma_deg > clearest:
            best, clearest = (at, by_deg, sigma_deg), abs(by_deg) / sigma_deg
    return best


def _part(ways: Ways, part: slice) -> Ways:
    return Ways._make(column[part] for column in ways)
