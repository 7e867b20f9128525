"""The terrain: height and slope of the ground that frames saw.

A frame's channel `ground_cm` says how high the ground of a cell lies above that on which its
vehicle stood; the pose says how high that is. Frames meet by the mean, weighted by 1/sigma² of a
frame's height there:

    sigma² = (2 · position sigma)² + (2 cm)² + (0.4 % · distance)²

since receivers know heights half as well, and a tilt of 0.2° is 0.4 % of the distance. All sums are
whole numbers, so neither the order of frames nor a session taken out changes a bit. What frames
share (the receiver's slow error) does not shrink with their number, so the sigma that is read is
that of one of them, the harmonic mean.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from fieldgrid import palette
from fieldgrid.array_types import AnyArray, Bool, Int64, UInt64
from fieldgrid.grids import GROUND_CHANNEL, NO_GROUND_CM, GridSpec
from fieldgrid.kernel import kernel
from fieldgrid.lattice import Lattice
from fieldgrid.layers.declaration import Cells, Channel, ChannelGroup, Colours, Layer, nothing
from fieldgrid.layers.frame import FrameInPlace

HEIGHT_SHARE, LEAST_SIGMA_M, SIGMA_SHARE = 2.0, 0.02, 0.004

WIDEST_SIGMA_M, MOST_HALVINGS = 4.0, 14
"""Weights are powers of 2, so that their sums are stored in few bytes: 1 is a sigma of 4 m, and
each halving of its square doubles the weight, up to a sigma of 3 cm."""

RISE_REACH_M = 0.5
"""The slope of a cell is that between the heights so far to either side of it."""

_PER_RISE = 100
"""Slopes are summed in whole percent."""


class _Terrain:
    """Six sums over the parts of local cells that land in a cell: how many have a height, their
    weights, weights times centimetres; how many have a slope, and its rise to east and north."""

    def __init__(self, cells: int, _: Lattice) -> None:
        self._shape = cells, 6
        self._sums: Int64 | None = None  # before the first frame that tells any

    def add(self, frame: FrameInPlace) -> None:
        ground_cm, pose = frame.cells.channels.get(GROUND_CHANNEL), frame.pose
        if ground_cm is None or not math.isfinite(pose.up_m):
            return
        if self._sums is None:
            self._sums = np.zeros(self._shape, dtype=np.int64)
        spec, landing = frame.cells.grid.spec, frame.landing
        phi = math.radians(pose.heading_deg)
        add_terrain(
            np.ascontiguousarray(ground_cm, dtype=np.int16),
            landing.cell,
            landing.shift,
            landing.unit,
            weights(spec, float(pose.position_sigma_m)),
            round(100.0 * pose.up_m),
            max(round(RISE_REACH_M / spec.cell_m), 1),
            math.cos(phi) * _PER_RISE / (100.0 * spec.cell_m),
            math.sin(phi) * _PER_RISE / (100.0 * spec.cell_m),
            self._sums,
        )

    def channels(self) -> UInt64:
        return nothing(self._shape[::-1]) if self._sums is None else self._sums.T.view(np.uint64)


def weights(spec: GridSpec, position_sigma_m: float) -> Int64:
    """The weight of a height in each row of a local grid, int64 [n_y]."""
    return _weights(spec, _halvings(HEIGHT_SHARE * position_sigma_m))


@lru_cache(maxsize=256)
def _weights(spec: GridSpec, pose_halvings: int) -> Int64:
    pose_m2 = WIDEST_SIGMA_M**2 / 2.0**pose_halvings
    sigma_m = np.sqrt(pose_m2 + LEAST_SIGMA_M**2 + (SIGMA_SHARE * spec.centres_m()[1]) ** 2)
    return np.array([1 << _halvings(sigma) for sigma in sigma_m.tolist()], dtype=np.int64)


def _halvings(sigma_m: float) -> int:
    if not sigma_m < WIDEST_SIGMA_M:
        return 0
    return min(round(2.0 * math.log2(WIDEST_SIGMA_M / max(sigma_m, 1e-6))), MOST_HALVINGS)


@kernel
def add_terrain(ground_cm, cell, shift, unit, weights, up_cm, reach, cos, sin, sums):  # type: ignore[no-untyped-def]
    """Add a frame's heights [n_y, n_x] to `sums` [cells, 6], where its parts land.

    `cos` and `sin` of the heading turn a difference of centimetres between neighbouring cells into
    the rise to east and north.
    """
    n_y, n_x = ground_cm.shape
    by = np.uint32(reach)
    for r in range(cell.shape[0]):
        j = np.uint32(r >> shift)
        weight = unit * weights[j]
        inside = reach <= j < n_y - reach
        for c in range(cell.shape[1]):
            i = np.uint32(c >> shift)
            height = ground_cm[j, i]
            if cell[r, c] < 0 or height == NO_GROUND_CM:
                continue
            k = np.uint32(cell[r, c])
            sums[k, 0] += unit
            sums[k, 1] += weight
            sums[k, 2] += weight * (up_cm + height)
            if not inside or i < reach or i >= n_x - reach:
                continue
            left, right = ground_cm[j, i - by], ground_cm[j, i + by]
            near, far = ground_cm[j - by, i], ground_cm[j + by, i]
            if min(min(left, right), min(near, far)) == NO_GROUND_CM:
                continue
            to_right = (np.int64(right) - np.int64(left)) / (2.0 * reach)
            ahead = (np.int64(far) - np.int64(near)) / (2.0 * reach)
            sums[k, 3] += unit
            sums[k, 4] += unit * np.int64(np.floor(cos * to_right + sin * ahead + 0.5))
            sums[k, 5] += unit * np.int64(np.floor(cos * ahead - sin * to_right + 0.5))


def _over(cells: Cells, total: str, count: str) -> tuple[AnyArray, Bool]:
    """A mean of signed sums, and where there is one."""
    known: Bool = cells[count] > 0
    return cells[total].view(np.int64) / np.maximum(cells[count], np.uint64(1)), known


def _height(cells: Cells) -> AnyArray:
    height_cm, known = _over(cells, "ground_cm_weighted", "ground_weight")
    return np.where(known, height_cm / 100.0, np.nan)


def _sigma(cells: Cells) -> AnyArray:
    weight, known = _over(cells, "ground_weight", "ground_parts")
    return np.where(known, WIDEST_SIGMA_M / np.sqrt(np.where(known, weight, 1.0)), np.nan)


def _slope(cells: Cells) -> AnyArray:
    east, known = _over(cells, "rise_east", "rise_parts")
    north, _ = _over(cells, "rise_north", "rise_parts")
    slope = np.degrees(np.arctan(np.hypot(east, north) / _PER_RISE))
    return np.where(known, slope, np.nan)


def _expected(weight: UInt64, _: UInt64) -> Sequence[UInt64]:
    """Mostly the ground is seen wherever anything is."""
    none = nothing(weight.shape)
    return weight, none, none, weight, none, none


GROUP = ChannelGroup(
    "ground",
    (
        Channel("ground_parts", signed=True),
        Channel("ground_weight"),
        Channel("ground_cm_weighted", signed=True),
        Channel("rise_parts", signed=True),
        Channel("rise_east", signed=True),
        Channel("rise_north", signed=True),
    ),
    fold=_Terrain,
    expected=_expected,
    frame=(GROUND_CHANNEL,),
)

_GROUPS, _NAN = ("density", "ground"), float("nan")

GROUND = Layer(
    "ground",
    "float32",
    "m",
    "height of the ground above the datum's plane, of sessions that tell how the vehicle leans",
    _GROUPS,
    _height,
    _NAN,
    Colours(palette.TERRAIN),
    above_datum=True,
)

SIGMA = Layer(
    "ground_sigma",
    "float32",
    "m",
    "1-sigma error of the ground's height, as a frame knows it; frames share most of it",
    _GROUPS,
    _sigma,
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
