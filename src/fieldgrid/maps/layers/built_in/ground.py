"""The terrain: height and slope of the ground that frames saw, in blocks of cells.

A frame's channel `ground_cm` says how high the ground of a cell lies above that on which its
vehicle stood; the pose says how high that is. A frame's height has the error

    sigma² = (2 · position sigma)² + (2 cm)² + (0.4 % · distance)²

since receivers know heights half as well, and a tilt of 0.2° is 0.4 % of the distance.

**In a session** the height of a block is the mean of the middle fifth of its frames, by the weights
1/sigma²: a weighted median that does not jump where weights change. Frames share most of their
error (the receiver's slow one), so the session's sigma is that of one of them, the harmonic mean;
or what the frames are apart, where that is more.

**Sessions meet** in a histogram of heights in bins of 25 cm, which repeats every 4 m. A session
adds its weight, weight times height, and weight times its square to one bin. All are whole sums, so
neither the order of sessions nor one taken out changes a bit. What is read is the mean of the
middle fifth of the bins, each at the mean of what it holds. A bin whose variance shows heights that
are 4 m or more apart is not believed, and there is no height where such bins have more than 40 % of
the weight. The sigma is that of the sessions, their harmonic mean, or what they are apart, inside
the bins too, where that is more. Where no majority is clear, all sessions count for what they are
apart, also those that do not move the height.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from fieldgrid.core import AnyArray, Float64, Int64, UInt64, kernel, palette
from fieldgrid.geometry import GROUND_CHANNEL, NO_GROUND_CM, GridSpec, Lattice
from fieldgrid.maps.layers.blocks import COLUMN_BITS, session_means
from fieldgrid.maps.layers.built_in.robust import (
    BIN_CM,
    BINS,
    MOST_HALVINGS,
    WIDEST_SIGMA_M,
    Heights,
    read_bins,
)
from fieldgrid.maps.layers.declaration import (
    Cells,
    Channel,
    ChannelGroup,
    Colours,
    Combine,
    Layer,
    OverviewChannel,
    is_nothing,
    nothing,
)
from fieldgrid.maps.layers.frame import FrameInPlace

LEAST_SIGMA_M, SIGMA_SHARE = 0.02, 0.004

HIGHEST_M = 1e7
"""Poses that are farther above or below the datum tell no heights."""

RISE_REACH_M = 0.5
"""The slope of a cell is that between the heights so far to either side of it."""

_PER_RISE = 500
"""Slopes are kept in steps of 0.2 %."""


class _Terrain:
    """Heights of blocks, frame by frame, and the sums of their slopes: how many, and their rise to
    east and north."""

    def __init__(self, blocks: int, _: Lattice) -> None:
        self._blocks = blocks
        self._heights: Heights | None = None  # before the first frame that tells any
        self._rises = np.empty((0, 3), np.int64)

    def add(self, frame: FrameInPlace) -> None:
        ground_cm, pose = frame.cells.channels.get(GROUND_CHANNEL), frame.pose
        if ground_cm is None or not abs(pose.up_m) < HIGHEST_M:
            return
        if self._heights is None:
            self._heights = Heights(self._blocks)
            self._rises = np.zeros((self._blocks, 3), dtype=np.int64)
        spec, (block, cell) = frame.cells.grid.spec, frame.in_blocks
        reach = max(round(RISE_REACH_M / spec.cell_m), 1)
        scale = _PER_RISE / (100.0 * 2.0 * reach * spec.cell_m)
        phi = math.radians(pose.heading_deg)
        found = np.empty((block.size, 3), np.int64)
        count = add_terrain(
            np.ascontiguousarray(ground_cm, dtype=np.int16),
            block,
            cell,
            halvings(spec, float(pose.up_sigma_m)),
            round(100.0 * pose.up_m),
            reach,
            math.cos(phi) * scale,
            math.sin(phi) * scale,
            found,
            self._rises,
        )
        self._heights.add(found[:count])

    def channels(self) -> Sequence[UInt64]:
        if self._heights is None:
            return [nothing((self._blocks,))] * 6
        said = self._heights.settled()
        self._heights = None  # which takes more than all that follows
        count, *rises = self._rises.T
        slopes = (count > 0).astype(np.int64), *(session_means(one, count) for one in rises)
        return [one.view(np.uint64) for one in (*said, *slopes)]


def _unfold(said: Sequence[UInt64]) -> list[UInt64]:
    """The channels from what a session says: whether it saw a block, its weight, its height; and
    its slope."""
    seen, *slopes = said[0], *said[3:]
    weight, height_cm = (np.ascontiguousarray(one).view(np.int64) for one in said[1:3])
    bins, own = height_cm // BIN_CM % BINS, seen > 0
    of_bin = weight, weight * height_cm, weight * height_cm * height_cm
    sums: list[UInt64] = []
    for k in range(BINS):
        inside = own & (bins == k)
        if inside.any():
            sums += [np.where(inside, of, 0).view(np.uint64) for of in of_bin]
        else:
            sums += [nothing(seen.shape)] * len(of_bin)
    return [seen, *sums, *slopes]


def halvings(spec: GridSpec, up_sigma_m: float) -> Int64:
    """How often the square of `WIDEST_SIGMA_M` was halved, for a height in each row of a local
    grid, int64 [n_y]: the weight is 2 to the power of it."""
    return _row_halvings(spec, _halvings(up_sigma_m))


@lru_cache(maxsize=256)
def _row_halvings(spec: GridSpec, pose_halvings: int) -> Int64:
    pose_m2 = WIDEST_SIGMA_M**2 / 2.0**pose_halvings
    sigma_m = np.sqrt(pose_m2 + LEAST_SIGMA_M**2 + (SIGMA_SHARE * spec.centres_m()[1]) ** 2)
    return np.array([_halvings(sigma) for sigma in sigma_m.tolist()], dtype=np.int64)


def _halvings(sigma_m: float) -> int:
    if not sigma_m < WIDEST_SIGMA_M:
        return 0
    return min(round(2.0 * math.log2(WIDEST_SIGMA_M / max(sigma_m, 1e-6))), MOST_HALVINGS)


@kernel
def add_terrain(ground_cm, block, cell, halvings, up_cm, reach, cos, sin, found, rises):  # type: ignore[no-untyped-def]
    """Fill `found` with block, height and halvings where a frame, ground_cm [n_y, n_x], has a
    height at any of the points of a block, the least sure of which counts. Add its slopes to
    `rises` [blocks, 3]. Returns how many heights there are.

    `cos` and `sin` of the heading turn a difference of centimetres over twice the reach into the
    rise to east and north.
    """
    n_y, n_x = ground_cm.shape
    count = 0
    for b in range(block.size):
        known = total = slopes = np.int64(0)
        east = north = 0.0
        least = np.int64(MOST_HALVINGS)
        for p in range(cell.shape[1]):
            if cell[b, p] < 0:
                continue
            j, i = cell[b, p] >> COLUMN_BITS, cell[b, p] & ((1 << COLUMN_BITS) - 1)
            height = np.int64(ground_cm[j, i])
            if height == NO_GROUND_CM:
                continue
            known, total = known + 1, total + height
            least = min(least, halvings[j])
            if j < reach or j >= n_y - reach or i < reach or i >= n_x - reach:
                continue
            left, right = np.int64(ground_cm[j, i - reach]), np.int64(ground_cm[j, i + reach])
            near, far = np.int64(ground_cm[j - reach, i]), np.int64(ground_cm[j + reach, i])
            if min(min(left, right), min(near, far)) == NO_GROUND_CM:
                continue
            slopes += 1
            east += cos * (right - left) + sin * (far - near)
            north += cos * (far - near) - sin * (right - left)
        if known == 0:
            continue
        height = up_cm + np.int64(np.floor(total / known + 0.5))
        found[count, 0], found[count, 1], found[count, 2] = block[b], height, least
        count += 1
        if slopes > 0:
            rises[block[b], 0] += 1
            rises[block[b], 1] += np.int64(np.floor(east / slopes + 0.5))
            rises[block[b], 2] += np.int64(np.floor(north / slopes + 0.5))
    return count


def _from_bins(cells: Cells) -> tuple[Float64, Float64]:
    """The height over all sessions, NaN where there is none, and its sigma, centimetres."""
    number = [k for k in range(BINS) if not is_nothing(cells[_BINS[k][0].name])]
    sessions = cells["ground_sessions"]
    height_cm, sigma_cm = np.full(sessions.shape, np.nan), np.zeros(sessions.shape)
    if number:
        sums = (
            np.stack([cells[_BINS[k][of].name].reshape(-1) for k in number]).view(np.int64)
            for of in range(3)
        )
        into = height_cm.reshape(-1), sigma_cm.reshape(-1)
        stated = np.ascontiguousarray(sessions).reshape(-1).view(np.int64)
        read_bins(np.array(number), *sums, stated, *into)
    return height_cm, sigma_cm


def _base_values(cells: Cells) -> tuple[UInt64, UInt64, UInt64]:
    """Whether there is a height, whole millimetres, and square millimetres of its sigma."""
    height_cm, sigma_cm = _from_bins(cells)
    known = np.isfinite(height_cm).astype(np.uint64)
    height_mm = np.rint(10.0 * np.nan_to_num(height_cm)).astype(np.int64)
    return known, height_mm.view(np.uint64), np.rint((10.0 * sigma_cm) ** 2).astype(np.uint64)


def _mean(cells: Cells, total: str, count: str) -> AnyArray:
    """A mean of signed sums, NaN where there is none."""
    known = cells[count] > 0
    mean = cells[total].view(np.int64) / np.maximum(cells[count], np.uint64(1))
    return np.where(known, mean, np.nan)


def _rises(cells: Cells) -> tuple[AnyArray, AnyArray]:
    """The rise of the ground to east and north, in steps of slopes."""
    return _mean(cells, "rise_east", "rise_parts"), _mean(cells, "rise_north", "rise_parts")


def _slope(cells: Cells) -> AnyArray:
    return np.degrees(np.arctan(np.hypot(*_rises(cells)) / _PER_RISE))


def _aspect(cells: Cells) -> AnyArray:
    east, north = _rises(cells)
    return np.degrees(np.arctan2(-east, -north))


def _agreeing(weight: UInt64, weighted_cm: UInt64) -> UInt64:
    """Sum of weight times the square of the height, modulo 2^64, less what the squares of heights
    about their mean, rounded down, add to it: 0 where one session, or those that agree, saw it."""
    own, total = weight.astype(np.int64), weighted_cm.astype(np.int64)
    mean = total // np.maximum(own, 1)
    return (2 * mean * total - mean * mean * own).view(np.uint64)


_BINS = [
    (
        Channel(f"ground_weight_{k}", coarser=Combine.ABSENT),
        Channel(f"ground_cm_{k}", coarser=Combine.ABSENT, signed=True),
        Channel(
            f"ground_squares_{k}",
            coarser=Combine.ABSENT,
            guess=_agreeing,
            guessed_from=(f"ground_weight_{k}", f"ground_cm_{k}"),
        ),
    )
    for k in range(BINS)
]

GROUP = ChannelGroup(
    "terrain",
    (
        Channel("ground_sessions", coarser=Combine.ABSENT),
        *(one for channels in _BINS for one in channels),
        Channel("rise_parts"),
        Channel("rise_east", signed=True),
        Channel("rise_north", signed=True),
    ),
    fold=_Terrain,
    overview=(
        OverviewChannel("ground_cells", Combine.SUM),
        OverviewChannel("ground_mm", Combine.SUM, signed=True),
        OverviewChannel("ground_variance", Combine.SUM),
    ),
    overview_of_base=_base_values,
    unfold=_unfold,
    frame=(GROUND_CHANNEL,),
    blocks=True,
)

_GROUPS, _NAN = ("density", "terrain"), float("nan")

GROUND = Layer(
    "ground",
    "float32",
    "m",
    "height of the ground above the datum's plane, of sessions that tell how the vehicle leans",
    _GROUPS,
    lambda cells: _mean(cells, "ground_mm", "ground_cells") / 1000.0,
    _NAN,
    Colours(palette.TERRAIN),
    above_datum=True,
)

SIGMA = Layer(
    "ground_sigma",
    "float32",
    "m",
    "1-sigma error of the ground's height: what a session states, or what sessions are apart",
    _GROUPS,
    lambda cells: np.sqrt(_mean(cells, "ground_variance", "ground_cells")) / 1000.0,
    _NAN,
    Colours(palette.UNSURE, 0.0, 0.5),
)

SLOPE = Layer(
    "slope",
    "float32",
    "°",
    "how steep the ground is, over a metre",
    _GROUPS,
    _slope,
    _NAN,
    Colours(palette.STEEP, 0.0, 20.0),
)

ASPECT = Layer(
    "aspect",
    "float32",
    "°",
    "direction in which the ground falls, clockwise from north, -180 to 180",
    _GROUPS,
    _aspect,
    _NAN,
    Colours.of(palette.VALUES, -180.0, 180.0),
)
