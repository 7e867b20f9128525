"""Obstacles of one frame that another frame of the same place calls free ground."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from fieldgrid.core import Float64, UInt8
from fieldgrid.geometry import FREE_UP_TO, OBSTACLE_ABOVE, GridSpec, LocalGrid, Pose, wrap_deg
from fieldgrid.maps import StagedFrames, to_local, to_universal

NEAR_M = 0.2
"""An obstacle cell is not denied when anything but free ground is seen so near to it: what moves
in the wind, and the noise of the range."""

TRIED = 240
"""Number of frames, all over the drive, for which another frame beside them is looked for."""

OPPOSED_DEG = 30.0

_STANDS, _FREE = 1, 2

FramePose = tuple[int, Pose]
"""The number of a staged frame, and its pose."""


@dataclass(frozen=True, slots=True)
class SeenCells:
    """What a frame saw: its obstacle cells at `right_m`, `ahead_m` [n], and of each cell [row,
    column] of its grid whether it is unseen, free, or near to what stands."""

    spec: GridSpec
    right_m: Float64
    ahead_m: Float64
    state: UInt8

    @classmethod
    def of(cls, grid: LocalGrid) -> SeenCells:
        """What a frame saw, by its local grid."""
        right_m, ahead_m = grid.spec.centres_m()
        rows, columns = np.nonzero(grid.observed & (grid.density > OBSTACLE_ABOVE))
        reach = max(round(NEAR_M / grid.spec.cell_m), 1)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        stands = (grid.observed & (grid.density > FREE_UP_TO)).astype(np.uint8)
        state = np.where(cv2.dilate(stands, disc) > 0, _STANDS, _FREE) * grid.observed
        return cls(grid.spec, right_m[columns], ahead_m[rows], state.astype(np.uint8))

    def flipped(self) -> SeenCells:
        """What the frame saw, with left and right exchanged."""
        return replace(self, right_m=-self.right_m, state=np.ascontiguousarray(self.state[:, ::-1]))

    def denied(self, pose: Pose, other: SeenCells, other_pose: Pose) -> tuple[int, int]:
        """Number of the obstacle cells at a pose that the other frame calls free, and number of
        those that it saw."""
        spec = other.spec
        x_m, y_m = to_local(*to_universal(self.right_m, self.ahead_m, pose), other_pose)
        i = np.floor((x_m + spec.width_m / 2.0) / spec.cell_m).astype(np.int64)
        j = np.floor(y_m / spec.cell_m).astype(np.int64)
        inside = (i >= 0) & (i < spec.n_x) & (j >= 0) & (j < spec.n_y)
        state = other.state[j[inside], i[inside]]
        return int(np.count_nonzero(state == _FREE)), int(np.count_nonzero(state))


def denied_counts(
    frames: StagedFrames,
    pairs: Iterable[tuple[FramePose, FramePose]],
    turns_deg: Sequence[float] = (0.0,),
    *,
    flipped: bool = False,
) -> Float64:
    """How many obstacle cells of the first frame of each pair the second one denies, and how many
    it saw, with the headings of both turned by each angle: [pair, angle, 2]. With the frames
    `flipped`, left and right are exchanged in all of them."""
    pairs = list(pairs)
    seen = {k: SeenCells.of(frames[k].grid()) for k in {k for pair in pairs for k, _ in pair}}
    if flipped:
        seen = {k: one.flipped() for k, one in seen.items()}
    counts = [
        seen[k].denied(
            replace(one, heading_deg=one.heading_deg + by_deg),
            seen[m],
            replace(other, heading_deg=other.heading_deg + by_deg),
        )
        for (k, one), (m, other) in pairs
        for by_deg in turns_deg
    ]
    return np.array(counts, dtype=np.float64).reshape(-1, len(turns_deg), 2)


def following(
    placed: Sequence[FramePose], apart_m: tuple[float, float], most: int
) -> Iterator[tuple[FramePose, FramePose]]:
    """At most `most` frames all over a drive, each with the next one that is at least `apart_m[0]`
    from it, if that is at most `apart_m[1]` away."""
    at_m = np.array([(pose.east_m, pose.north_m) for _, pose in placed]).reshape(-1, 2)
    pairs = []
    for k in _all_over(placed):
        off_m = np.hypot(*(at_m[k + 1 :] - at_m[k]).T)
        far = np.flatnonzero(off_m >= apart_m[0])
        if far.size and off_m[far[0]] <= apart_m[1]:
            pairs.append((placed[k], placed[k + 1 + int(far[0])]))
    return _some(pairs, most)


def opposed(
    placed: Sequence[FramePose], apart_m: float, most: int
) -> Iterator[tuple[FramePose, FramePose]]:
    """At most `most` pairs of frames all over a drive that look in opposite directions, within
    `OPPOSED_DEG`, from at most `apart_m` apart: those of the two lanes beside a row."""
    tried = [placed[k] for k in _all_over(placed)]
    east_m, north_m, heading_deg = np.array(
        [(pose.east_m, pose.north_m, pose.heading_deg) for _, pose in tried]
    ).T
    apart = np.hypot(np.subtract.outer(east_m, east_m), np.subtract.outer(north_m, north_m))
    turned = np.abs(wrap_deg(np.subtract.outer(heading_deg, heading_deg) + 180.0))
    first, second = np.nonzero(np.triu((apart <= apart_m) & (turned <= OPPOSED_DEG), 1))
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    return _some([(tried[k], tried[m]) for k, m in pairs], most)


def _all_over(placed: Sequence[FramePose]) -> list[int]:
    """Frames by the way, so that a vehicle that stands for an hour is looked at there once."""
    at_m = np.array([(pose.east_m, pose.north_m) for _, pose in placed]).reshape(-1, 2)
    way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(at_m, axis=0).T)))
    tried = np.searchsorted(way_m, np.linspace(0.0, way_m[-1], TRIED))
    return list(np.unique(tried).tolist())


def _some(
    pairs: Sequence[tuple[FramePose, FramePose]], most: int
) -> Iterator[tuple[FramePose, FramePose]]:
    """At most `most` of the pairs, from all along, each frame now as the one that is asked, now as
    the one that denies."""
    chosen = np.linspace(0, len(pairs) - 1, min(len(pairs), most)).round().astype(int)
    for at in np.unique(chosen).tolist():
        one, other = pairs[at]
        yield (one, other) if at % 2 else (other, one)
