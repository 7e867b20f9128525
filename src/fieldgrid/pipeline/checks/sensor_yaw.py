"""The sensor's yaw error against the declared mounting, from frames of the same places.

With visual odometry the yaw follows from that (`poses.faults.camera_yaw`). Depths, clouds
and given poses have none. But a sensor that points three degrees farther left than declared puts an
obstacle 9 m away by 47 cm too far right, and in a frame taken 6 m farther on by 16 cm. With the
right correction, frames contradict each other least.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Figure, Finding, Float64, StopCode, error, warning
from fieldgrid.geometry import Lidar, Rig, wrap_deg
from fieldgrid.maps import StagedFrames
from fieldgrid.pipeline.checks.contradictions import FramePose, denied_counts, following
from fieldgrid.poses import ASKEW_DEG

APART_M, ALIKE_DEG, PAIRS = (4.0, 9.0), 30.0, 120
"""How far apart two frames are taken that are compared, within what of each other they look, and
how many pairs of them there are at most."""

TURNS_DEG = np.arange(-8.0, 8.01, 0.5).tolist()

FEWEST_PAIRS, FEWEST_CELLS = 16, 1000
"""Fewer pairs, or fewer obstacle cells that were seen by both, tell nothing."""

CONTRAST = 0.4
"""Frames agree at an angle at which at most this share is denied of what is denied at most angles:
rendered rows 2 to 16 %, as depths, clouds and pairs, KITTI's street 36; what is seen in a mirror 53
to 72 %."""

BLOCKS = 8
"""Number of parts of the drive: the error is that of leaving out one after the other."""

CLEAR_SIGMAS, TOLD_DEG = 4.0, 1.2
"""A yaw is told when it is by more than both. Of rendered drives whose sensor looks where it is
declared to, 0.6 deg at most are found, by what stands on one side alone 0.3."""


class SensorYaw(NamedTuple):
    """Yaw error of a sensor, positive to the right of the declared direction. `is_mirrored`: its
    frames agree at no angle, but with left and right exchanged; the error is then of these."""

    off_deg: float
    sigma_deg: float
    is_mirrored: bool = False

    @property
    def is_off(self) -> bool:
        """Whether it certainly does not look where it is declared to."""
        return abs(self.off_deg) > max(CLEAR_SIGMAS * self.sigma_deg, TOLD_DEG)


def sensor_yaw(frames: StagedFrames, placed: Sequence[FramePose]) -> SensorYaw | None:
    """Estimate the yaw error from the frames of a drive; `placed` are the accepted ones in order
    of time. None if too few of them saw the same obstacles, or they agree at no angle."""
    pairs = [
        (one, other)
        for one, other in following(placed, APART_M, PAIRS)
        if abs(wrap_deg(other[1].heading_deg - one[1].heading_deg)) <= ALIKE_DEG
    ]
    counts = denied_counts(frames, pairs, TURNS_DEG)
    if len(pairs) < FEWEST_PAIRS or counts[:, len(TURNS_DEG) // 2, 1].sum() < FEWEST_CELLS:
        return None
    denied = _denied(counts)
    if _agrees(denied):
        return SensorYaw(_least(denied), _sigma_deg(counts))
    flipped = denied_counts(frames, pairs, TURNS_DEG, flipped=True)
    mirrored = _denied(flipped)
    if _agrees(mirrored) and mirrored.min() < CONTRAST * denied.min():
        return SensorYaw(_least(mirrored), _sigma_deg(flipped), is_mirrored=True)
    return None


def sensor_yaw_findings(found: SensorYaw | None, rig: Rig) -> Iterator[Finding]:
    """That a sensor certainly looks elsewhere than declared, or sees left what is right."""
    if found is not None and found.is_mirrored:
        yield error(
            StopCode.MIRRORED.value,
            "The frames agree on obstacle positions only with left and right exchanged, so they "
            "are mirrored.",
            "Store them as the sensor sees: images from left to right, clouds in right-handed "
            "axes, such as x forward, y left, z up.",
        )
    elif found is not None and found.is_off:
        what = "lidar" if isinstance(rig.sensor, Lidar) else "camera"
        side = "right" if found.off_deg > 0.0 else "left"
        yield (error if abs(found.off_deg) >= ASKEW_DEG else warning)(
            StopCode.CAMERA_YAW.value,
            f"Frames of the same places show that the {what} points {abs(found.off_deg):.1f}° ± "
            f"{found.sigma_deg:.1f}° farther {side} than declared, which shifts obstacles by "
            f"{100.0 * math.radians(abs(found.off_deg)):.0f} cm per metre of range.",
            "Measure its yaw and correct camera_yaw_deg in mounting.json, or, if headings are "
            "recorded or given, their offset.",
            Figure(found.off_deg, "deg"),
        )


def _agrees(denied: Float64) -> bool:
    return bool(denied.min() <= CONTRAST * np.median(denied))


def _denied(counts: Float64) -> Float64:
    """The share of cells that is denied at each angle, of counts [pair, angle, 2]."""
    denied, seen = counts.sum(axis=0).T
    return np.asarray(denied / np.maximum(seen, 1.0))


def _least(denied: Float64) -> float:
    """The angle about which the least is denied: the middle of all around it with less than half
    of what is denied at most angles, the more the less it is."""
    half = (denied.min() + np.median(denied)) / 2.0
    best = int(denied.argmin())
    high = np.flatnonzero(np.append(denied > half, True))
    first = int(high[high < best].max(initial=-1)) + 1
    beyond = int(high[high > best].min())
    return float(np.average(TURNS_DEG[first:beyond], weights=half - denied[first:beyond]))


def _sigma_deg(counts: Float64) -> float:
    parts = np.array_split(np.arange(len(counts)), BLOCKS)
    without = [_least(_denied(np.delete(counts, part, axis=0))) for part in parts]
    return math.sqrt((BLOCKS - 1) * float(np.var(without)))
