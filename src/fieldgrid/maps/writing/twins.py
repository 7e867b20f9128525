"""One drive in two maps: whether two sessions are the same drive, and whether they lie together."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.maps.file.map_file import MapFile
from fieldgrid.maps.file.records import SessionInfo
from fieldgrid.maps.writing.redatum import Redatum

SAME_PLACE_M = 0.02
"""What lies as near is in the same place: planes of other datums lean a little to each other."""

REMEDY = (
    "put both in one place with `fieldgrid align --undo` or `fieldgrid sessions --shift`, or "
    "remove one of them with `fieldgrid sessions --remove`"
)
"""What to do about one drive in two places."""


class Twin(NamedTuple):
    """A session that another map may have, too: what its frames saw, and where the accepted ones
    are in the common plane, metres east, north and up [n, 3], as driven and as placed (NaN where a
    height is not known). `moved` says that it comes from another plane, whose shifts `lean` to the
    common one: metres that a level one rises there for each metre. Without heights
    (`has_heights`) all are 0 in the plane of its map, which tells nothing."""

    info: SessionInfo
    seen: tuple[tuple[int, str], ...]
    driven_m: Float64
    placed_m: Float64
    moved: bool
    lean: float
    has_heights: bool

    def is_drive(self, other: Twin) -> bool:
        """Whether the two are one drive. Those of two planes are when they saw the same from the
        same places: the same images may have other poses."""
        if self.info.digest == other.info.digest:
            return True
        comparable = (self.moved or other.moved) and self.seen == other.seen
        return (
            comparable and max(self._from_m(other, self.driven_m, other.driven_m)) <= SAME_PLACE_M
        )

    def contradiction(self, other: Twin) -> str | None:
        """How far the same drive lies from the other, as a clause; None where it lies there."""
        place_m, height_m = self._from_m(other, self.placed_m, other.placed_m)
        # A shift is level in the plane of its map, and a height upright.
        aside_m, raised_m = np.add(self._leaning_m(), other._leaning_m()) + SAME_PLACE_M
        if place_m <= aside_m and height_m <= raised_m:
            return None
        if height_m > raised_m and height_m > place_m:
            return f"lies up to {_more_than(height_m, raised_m)} m higher or lower"
        return f"lies up to {_more_than(place_m, aside_m)} m aside"

    def _from_m(self, other: Twin, own_m: Float64, others_m: Float64) -> tuple[float, float]:
        """How far places lie from those of the other at most, in the plane and in height, as far as
        both have heights."""
        place_m, height_m = _apart_m(own_m, others_m)
        if (self.has_heights and other.has_heights) or math.isinf(height_m):
            return place_m, height_m
        return max(place_m - (self.lean + other.lean) * height_m, 0.0), 0.0

    def _leaning_m(self) -> tuple[float, float]:
        """How far aside and how high its transform may put it, as it leans to the common plane."""
        level_m, up_m = _apart_m(self.placed_m, self.driven_m)
        return self.lean * up_m, self.lean * level_m


def twin_of(universal: MapFile, info: SessionInfo, moved: Redatum | None) -> Twin:
    """A session of a map, in the plane that `moved` leads to."""
    frames = list(universal.frames(info.name))
    accepted = [frame for frame in frames if frame.accepted]
    driven_m, placed_m = (
        np.array([(p.east_m, p.north_m, p.up_m) for p in poses], np.float64).reshape(-1, 3)
        for poses in ([f.driven for f in accepted], [f.pose for f in accepted])
    )
    has_heights = bool(np.any(driven_m[:, 2] != 0.0))
    if moved is not None:
        driven_m, placed_m = (
            np.column_stack(moved.places(*places_m.T)) for places_m in (driven_m, placed_m)
        )
    lean = 0.0
    if moved is not None and accepted:
        lean = moved.lean(accepted[0].driven.east_m, accepted[0].driven.north_m)
    seen = tuple((frame.pose.time_ns, frame.cells_sha256) for frame in frames)
    return Twin(info, seen, driven_m, placed_m, moved is not None, lean, has_heights)


def _more_than(size_m: float, limit_m: float) -> str:
    """A size that is more than a limit, to centimetres, or to millimetres where it is near that."""
    return f"{size_m:.2f}" if size_m > limit_m + 0.01 else f"{size_m:.3f}"


def _apart_m(one: Float64, other: Float64) -> tuple[float, float]:
    """How far places lie apart at most, in the plane and in height; infinite where they are not
    the same ones, or only one of them has a height."""
    if one.shape != other.shape or np.any(np.isnan(one[:, 2]) != np.isnan(other[:, 2])):
        return math.inf, math.inf
    off_m = np.nan_to_num(one - other)
    return (
        float(np.hypot(off_m[:, 0], off_m[:, 1]).max(initial=0.0)),
        float(np.abs(off_m[:, 2]).max(initial=0.0)),
    )
