"""Whether the frames of a drive agree on what stands.

What one frame calls an obstacle, another that was taken a metre or two beside it and saw the place
should not call free ground. False matches differ from frame to frame, so noise, hard compression
and dirt show in the share of obstacle cells that are denied so, without any truth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from fieldgrid.grids import FREE_UP_TO, OBSTACLE_ABOVE, LocalGrid
from fieldgrid.mapfile import StagedFrames
from fieldgrid.rig import Lidar, Rig
from fieldgrid.trajectory import Pose
from fieldgrid.transfer import to_local, to_universal

DENIED_WARN = 0.012
"""The denied share from which on it is told. Three rendered vineyards with two receivers each have
0.0 to 0.3 %, KITTI's street, with its passers-by, 0.0 to 0.6. One of the vineyards with noise of
12, 18 and 25 grey levels has 0.6, 2.6 and 3.4 %, with JPEG of quality 20, 12 and 8 0.9, 1.9 and
3.5 %, where the precision of its map at 10 cm falls from 95 to 89, 80, 67 and to 88, 78, 59 %."""

NEAR_M = 0.2
"""An obstacle cell is not denied when anything but free ground is seen so near to it: what moves
in the wind, and the noise of the range."""

APART_M, FEWEST_CELLS, FEWEST_PAIRS = (0.7, 4.0), 30, 8
"""How far apart two frames are taken that are compared, how many obstacle cells of the one the
other must have seen, and how many such pairs tell anything."""

TRIED, PAIRS = 240, 60
"""All over the drive, so many frames are looked at for another beside them, and so many pairs of
these are compared."""

Placed = tuple[int, Pose]
"""The number of a staged frame, and its pose."""


def denied_share(frames: StagedFrames, placed: Sequence[Placed]) -> float | None:
    """The share of the obstacle cells of a frame that another frame, taken near it, saw and calls
    free. `placed` are the accepted ones in order of time.

    It is the lower quartile of pairs of frames: three of four deny more. Who passes by, or one pose
    that leaps, is in few pairs, and false matches are in all. None where too few frames see the
    same obstacles.
    """
    shares = [
        share
        for (k, pose), (near_k, near_pose) in _pairs(placed)
        if (share := _denied(frames[k].grid(), pose, frames[near_k].grid(), near_pose)) is not None
    ]
    return float(np.quantile(shares, 0.25)) if len(shares) >= FEWEST_PAIRS else None


def agreement_notes(share: float | None, rig: Rig) -> Iterator[str]:
    """What a build says of frames that do not agree; a lidar sees the same thing with few points,
    or with none."""
    if share is None or share <= DENIED_WARN or isinstance(rig.sensor, Lidar):
        return
    yield (
        "In three of four pairs of frames, taken some metres apart, more than "
        f"{100.0 * share:.1f} % of what the one calls obstacles is free ground to the other (good "
        "images: at most 0.6 %), so the map holds obstacles that are not there. Look at the images "
        "for noise, hard compression, dirt and rain; take them with more light and less gain, and "
        "store them without loss."
    )


def _pairs(placed: Sequence[Placed]) -> Iterator[tuple[Placed, Placed]]:
    """Frames all over the drive, each with the next that is far enough from it: now as the one that
    is asked, now as the one that denies."""
    # By the way, so that a vehicle that stands for an hour is looked at there once.
    at_m = np.array([(pose.east_m, pose.north_m) for _, pose in placed]).reshape(-1, 2)
    way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(at_m, axis=0).T)))
    tried = np.unique(np.searchsorted(way_m, np.linspace(0.0, way_m[-1], TRIED)))
    near = [pair for k in tried.tolist() if (pair := _beside(placed, k)) is not None]
    chosen = np.unique(np.linspace(0, len(near) - 1, min(len(near), PAIRS)).round().astype(int))
    for at in chosen.tolist():
        one, other = near[at]
        yield (one, other) if at % 2 else (other, one)


def _beside(placed: Sequence[Placed], k: int) -> tuple[Placed, Placed] | None:
    """The frame with the first after it that is `APART_M` away; None where the drive ends or jumps
    before."""
    here = placed[k][1]
    for later in range(k + 1, len(placed)):
        pose = placed[later][1]
        apart_m = math.hypot(pose.east_m - here.east_m, pose.north_m - here.north_m)
        if apart_m >= APART_M[0]:
            return (placed[k], placed[later]) if apart_m <= APART_M[1] else None
    return None


def _denied(grid: LocalGrid, pose: Pose, near: LocalGrid, near_pose: Pose) -> float | None:
    """Of a grid's obstacle cells that the other saw, the share that it calls free; None where they
    are too few."""
    spec = near.spec
    right_m, ahead_m = grid.spec.centres_m()
    rows, columns = np.nonzero(grid.observed & (grid.density > OBSTACLE_ABOVE))
    x_m, y_m = to_local(*to_universal(right_m[columns], ahead_m[rows], pose), near_pose)
    i = np.floor((x_m + spec.width_m / 2.0) / spec.cell_m).astype(np.int64)
    j = np.floor(y_m / spec.cell_m).astype(np.int64)
    inside = (i >= 0) & (i < spec.n_x) & (j >= 0) & (j < spec.n_y)
    i, j = i[inside], j[inside]
    seen = near.observed[j, i]
    if seen.sum() < FEWEST_CELLS:
        return None
    reach = max(round(NEAR_M / spec.cell_m), 1)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    stands = (near.observed & (near.density > FREE_UP_TO)).astype(np.uint8)
    return 1.0 - float(cv2.dilate(stands, disc)[j, i][seen].mean())
