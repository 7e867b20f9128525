"""The drives of a map as alignment sees them: submaps, where they lie now, what their receiver
leaves open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.field.align.submaps import Submap, cut
from fieldgrid.geometry import Bounds
from fieldgrid.maps import FrameRecord, MapFile, Transform

LEAST_SIGMA_M = 0.01
"""No receiver is better."""

UNKNOWN_SIGMA_M = 1.0
"""Of poses that state none."""


WANDER_SHARE = 0.7
"""The wandering part of a stated error, beside the part that stays for a drive."""


class Role(Enum):
    """What may become of a drive: it moves; it stays although it may be wrong, which others are not
    to follow; it holds, and is what others come to."""

    MOVES = "moves"
    STAYS = "stays"
    HOLDS = "holds"


@dataclass(frozen=True, slots=True)
class SubmapDrive:
    """A session: its submaps in the order of time, [n], and where each was as driven.

    `sigma_m` is the error along one axis that its receiver leaves open, `wander_m` the part of it
    that moves slowly.
    """

    name: str
    role: Role
    submaps: tuple[Submap, ...]
    transform: Transform
    sigma_m: float
    wander_m: float
    time_ns: Int64
    middle_m: Float64
    """Where the submaps were driven [n, 2], east and north."""
    pivot_m: Float64
    """The middle of the drive [2]."""
    stated_m: float
    """What its receiver states, whatever it turns out to be."""

    @property
    def half_length_m(self) -> float:
        """How far its submaps lie from the pivot at most."""
        return float(np.hypot(*(self.middle_m - self.pivot_m).T).max(initial=1.0))


def read_drives(universal: MapFile, roles: Mapping[str, Role]) -> list[SubmapDrive]:
    """Sessions with accepted frames by their roles; of those that do not move the part near others
    that do. Sessions of which nothing is near are left out."""
    transforms = {info.name: info.transform for info in universal.sessions()}
    moving = [name for name, role in roles.items() if role is Role.MOVES]
    poses = [f.pose for name in moving for f in universal.frames(name) if f.accepted]
    reach_m = max(info.grid.reach_m for info in universal.sessions() if info.grid is not None)
    near = Bounds(
        min(pose.east_m for pose in poses) - reach_m, min(pose.north_m for pose in poses) - reach_m,
        max(pose.east_m for pose in poses) + reach_m, max(pose.north_m for pose in poses) + reach_m,
    )  # fmt: skip
    drives = []
    for name, role in roles.items():
        found = universal.frames(name, with_grid=True, near=near)
        frames = [frame for frame in found if frame.accepted]
        if not frames:
            continue
        submaps = tuple(cut(name, frames))
        points = np.array([[f.driven.east_m, f.driven.north_m] for f in frames])
        sigma_m = _sigma_m(frames, transforms[name], role)
        drives.append(
            SubmapDrive(
                name,
                role,
                submaps,
                transforms[name],
                sigma_m,
                WANDER_SHARE * sigma_m,
                np.array([submap.time_ns for submap in submaps], np.int64),
                np.array([submap.driven_m() for submap in submaps]),
                (points.min(axis=0) + points.max(axis=0)) / 2.0,
                sigma_m,
            )
        )
    return drives


def _sigma_m(frames: Sequence[FrameRecord], transform: Transform, role: Role) -> float:
    """What is open of where a drive lies: what its receiver states, or, of one that was aligned
    and stays so, what that left."""
    aligned = transform.aligned
    if role is not Role.MOVES and aligned is not None and aligned.sigma_m is not None:
        return max(aligned.sigma_m, LEAST_SIGMA_M)
    stated = np.array([frame.driven.position_sigma_m for frame in frames])
    known = stated[np.isfinite(stated)]
    return max(float(np.median(known)), LEAST_SIGMA_M) if len(known) else UNKNOWN_SIGMA_M
