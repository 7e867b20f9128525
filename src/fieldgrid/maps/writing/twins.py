"""One drive in two maps: whether two sessions are the same drive, and whether they lie together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import Pose
from fieldgrid.maps.file.map_file import MapFile
from fieldgrid.maps.file.records import SessionInfo
from fieldgrid.maps.writing.redatum import Redatum

SAME_PLACE_M = 0.02
"""What lies as near is in the same place."""

_ACROSS_PLANES_M = 0.05
"""The same where one comes from another plane: planes lean to each other, by 0.16 mrad for each km
between their datums."""

REMEDY = (
    "put both in one place with `fieldgrid align --undo` or `fieldgrid sessions --shift`, or "
    "remove one of them with `fieldgrid sessions --remove`"
)
"""What to do about one drive in two places."""


class Twin(NamedTuple):
    """A session that another map may have, too: what its frames saw, and where they are in the
    common plane, metres east, north and up [n, 3], as driven and as placed. `moved` says that it
    comes from another plane. Without heights (`has_heights`) its poses are level there, which tells
    nothing."""

    info: SessionInfo
    seen: tuple[tuple[int, str, bool], ...]
    driven_m: Float64
    placed_m: Float64
    moved: bool
    has_heights: bool

    def is_drive(self, other: Twin) -> bool:
        """Whether the two are one drive: of one plane by their evidence, of two planes, in which
        poses differ, by what they saw from the same places."""
        if not (self.moved or other.moved):
            return self.info.digest == other.info.digest
        if self.seen != other.seen:
            return False
        return _apart_m(self.driven_m, other.driven_m)[0] <= _ACROSS_PLANES_M

    def contradiction(self, other: Twin) -> str | None:
        """How far the same drive lies from the other, as a clause; None where it lies there."""
        limit_m = _ACROSS_PLANES_M if self.moved or other.moved else SAME_PLACE_M
        place_m, height_m = _apart_m(self.placed_m, other.placed_m)
        if place_m > limit_m:
            return f"lies up to {place_m:.2f} m aside"
        if height_m > limit_m and self.has_heights and other.has_heights:
            return f"lies up to {height_m:.2f} m higher or lower"
        return None


def twin_of(universal: MapFile, info: SessionInfo, moved: Redatum | None) -> Twin:
    """A session of a map, in the plane that `moved` leads to."""
    frames = list(universal.frames(info.name))
    accepted = [frame for frame in frames if frame.accepted]

    def places_m(poses: Iterable[Pose]) -> Float64:
        found_m = np.array([(p.east_m, p.north_m, p.up_m) for p in poses], np.float64)
        found_m = found_m.reshape(-1, 3)
        return found_m if moved is None else np.column_stack(moved.places(*found_m.T))

    return Twin(
        info,
        tuple((frame.pose.time_ns, frame.cells_sha256, frame.accepted) for frame in frames),
        places_m(frame.driven for frame in accepted),
        places_m(frame.pose for frame in accepted),
        moved is not None,
        any(frame.driven.up_m != 0.0 for frame in accepted),
    )


def _apart_m(one_m: Float64, other_m: Float64) -> tuple[float, float]:
    """How far places lie apart at most, in the plane and in height."""
    off_m = np.nan_to_num(one_m - other_m)
    aside_m = np.hypot(off_m[:, 0], off_m[:, 1])
    return float(aside_m.max(initial=0.0)), float(np.abs(off_m[:, 2]).max(initial=0.0))
