"""The ground that the vehicle stands on, seen from where it was a little earlier.

How a camera is mounted is how it sits on the vehicle, and the vehicle stands on the ground under
its wheels, which the camera does not see. The ground ahead is another plane: in a lane the two
differ by a degree from frame to frame. But the camera saw, some metres back, where the vehicle
stands now; the camera's own motion since then carries that ground here. What a vehicle drives over
is also surely ground, and no canopy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Self

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import robust_plane
from fieldgrid.perception import RigidMotion
from fieldgrid.pipeline.mounting.plane import SensorGround, median_plane

HALF_WIDTH_M = 1.0
BACK_M, AHEAD_M = -2.0, 1.0
"""Where a vehicle stands, about the ground below its sensor."""

REACH_M = 11.0
"""Patches seen from farther away are too uncertain."""

MOST_WAY_M = 16.0
"""The camera's motion is believed over this far."""

DRIFT_M_PER_M = 0.003
"""What a metre of way adds to the error of a patch's height."""

FEWEST, SPREAD = 40, 0.6
"""Patches under a vehicle, and the share of its length and width that they must span."""

ROUNDS = 3


class Patches(NamedTuple):
    """The ground seen in one frame: points [n, 3] in the sensor's frame, and their sigma [n]."""

    points_m: Float64
    sigma_m: Float64


class MountSamples(NamedTuple):
    """How the sensor stood on the ground under the vehicle, frame by frame; all length n."""

    frame: Int64
    tilt_deg: Float64
    roll_deg: Float64
    height_m: Float64

    @classmethod
    def of(cls, planes: Iterable[tuple[int, SensorGround]]) -> Self:
        """The planes of some frames."""
        rows = np.array([(k, p.tilt_deg, p.roll_deg, p.height_m) for k, p in planes])
        frame, tilt_deg, roll_deg, height_m = rows.reshape(-1, 4).T
        return cls(frame.astype(np.int64), tilt_deg, roll_deg, height_m)


def ground_under_vehicle(
    seen: Sequence[Patches], motions: Sequence[RigidMotion | None], start: SensorGround
) -> tuple[MountSamples, SensorGround]:
    """How the sensor stood in all frames under which enough was seen, and their mean plane.

    `motions` lead from each frame to the next, in the sensor's frame; None where nothing is known.
    `start` is roughly the plane.
    """
    under = [_brought(k, seen, motions) for k in range(len(seen))]
    plane = start
    for _ in range(ROUNDS):
        found = [(k, plane_k) for k, there in enumerate(under) if (plane_k := _fit(there, plane))]
        if not found:
            break
        plane = median_plane([plane_k for _, plane_k in found])
    return MountSamples.of(found), plane


def _brought(k: int, seen: Sequence[Patches], motions: Sequence[RigidMotion | None]) -> Patches:
    """The patches of the frames around frame k, in its frame."""
    points, sigmas = [np.zeros((0, 3))], [np.zeros(0)]
    before = zip(reversed(motions[:k]), reversed(seen[:k]), strict=True)
    after = zip(map(_back, motions[k:]), seen[k + 1 :], strict=True)
    for way in (before, after):
        R, t, distance_m = np.eye(3), np.zeros(3), 0.0
        for step, there in way:
            if step is None:
                break
            R, t = R @ step.R_stop_start, R @ step.t_stop_start_m + t
            distance_m += float(np.linalg.norm(step.t_stop_start_m))
            if distance_m > MOST_WAY_M:
                break
            points.append(there.points_m @ R.T + t)
            sigmas.append(np.hypot(there.sigma_m, DRIFT_M_PER_M * distance_m))
    return Patches(np.concatenate(points), np.concatenate(sigmas))


def _back(motion: RigidMotion | None) -> RigidMotion | None:
    """A motion turned round."""
    if motion is None:
        return None
    R = motion.R_stop_start.T
    return RigidMotion(R, -R @ motion.t_stop_start_m)


def _fit(there: Patches, plane: SensorGround) -> SensorGround | None:
    """The plane under the vehicle; None when too little of it was seen."""
    level = plane.level(there.points_m)
    below = (np.abs(level[:, 0]) < HALF_WIDTH_M) & (level[:, 1] > BACK_M) & (level[:, 1] < AHEAD_M)
    if np.count_nonzero(below) < FEWEST:
        return None
    x, y, z = level[below].T
    if np.ptp(x) < SPREAD * 2.0 * HALF_WIDTH_M or np.ptp(y) < SPREAD * (AHEAD_M - BACK_M):
        return None
    c, agreeing = robust_plane(x, y, z, there.sigma_m[below])
    found = plane.corrected(c)
    return found if agreeing >= FEWEST and found.can_be() else None
