"""Plantings of which everything is known, and what a vehicle in some of their lanes would see.

Canopies are bands about polylines, seen from the lanes that were driven: a cell of a canopy shows
with a probability that falls with its depth behind the face, the ground of a driven lane is seen
but for holes, that of other lanes is not. Random false obstacles stand for noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from fieldgrid.geometry import Bounds, Datum, Lattice
from fieldgrid.maps import MapView

Array = npt.NDArray[np.float64]
DATUM = Datum(41.65, -4.72, 787.4)


@dataclass(frozen=True)
class Planting:
    """Rows as polylines [n, 2] (metres east and north), each from one end to the other.

    `missing` are holes in rows: row, from and to in metres along it. `lanes` says between which
    neighbouring rows there is a lane. `things` are discs in the way: east, north, radius.
    """

    rows: Sequence[Array]
    half_width_m: float = 0.35
    missing: Sequence[tuple[int, float, float]] = ()
    things: Sequence[tuple[float, float, float]] = ()


@dataclass(frozen=True)
class Sight:
    """How a planting is seen. `sides[k]` tells whether row k is seen from its left and right."""

    sides: Sequence[tuple[bool, bool]] | None = None
    depth_m: float = 0.35
    fill: float = 0.8
    noise_per_m2: float = 0.05
    hole_share: float = 0.03
    headland_m: float = 8.0
    margin_m: float = 10.0
    density: tuple[int, int] = (120, 255)
    seed: int = 0
    unseen: Sequence[Bounds] = field(default_factory=tuple)


def dense(line: Array, step_m: float = 0.05) -> tuple[Array, Array]:
    """Points of a polyline every `step_m` or less, and how far along it each is."""
    s = np.r_[0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))]
    at = np.linspace(0.0, s[-1], max(2, int(np.ceil(s[-1] / step_m)) + 1))
    return np.column_stack([np.interp(at, s, line[:, k]) for k in (0, 1)]), at


def seen_view(planting: Planting, sight: Sight, cell_m: float = 0.05) -> MapView:
    """What a map of the planting would hold."""
    rng = np.random.default_rng(sight.seed)
    lattice = Lattice(cell_m)
    every = np.concatenate([np.asarray(row) for row in planting.rows])
    low, high = every.min(axis=0) - sight.margin_m, every.max(axis=0) + sight.margin_m
    window = lattice.window(Bounds(*low, *high))
    shape = window.shape
    i0, j0 = window.i0, window.j0

    seeds = np.ones(shape, dtype=np.uint8)
    owner = np.full(shape, -1, dtype=np.int32)
    along = np.zeros(shape, dtype=np.float32)
    lines = []
    for k, row in enumerate(planting.rows):
        points, at = dense(np.asarray(row, dtype=np.float64), cell_m / 2)
        i, j = lattice.index(points[:, 0], points[:, 1])
        seeds[j - j0, i - i0], owner[j - j0, i - i0], along[j - j0, i - i0] = 0, k, at
        lines.append((points, at))
    distance, labels = cv2.distanceTransformWithLabels(
        seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    places = np.zeros(labels.max() + 1, dtype=np.int64)
    places[labels[seeds == 0]] = np.flatnonzero(seeds == 0)
    nearest = places[labels]
    row = owner.ravel()[nearest]
    s = along.ravel()[nearest]
    # Signed exact distance: left of the row is positive.
    east, north = lattice.centres(window)
    v = np.empty(shape, dtype=np.float32)
    beyond = np.zeros(shape, dtype=np.float32)
    for k, (points, at) in enumerate(lines):
        mine = row == k
        jj, ii = np.nonzero(mine)
        place = np.searchsorted(at, s[mine]).clip(1, len(at) - 1)
        a, b = points[place - 1], points[place]
        u = (b - a) / np.hypot(*(b - a).T)[:, None]
        d = np.column_stack([east[ii], north[jj]]) - a
        v[mine] = u[:, 0] * d[:, 1] - u[:, 1] * d[:, 0]
        t = (u * d).sum(axis=1) + at[place - 1]
        beyond[mine] = np.maximum(-t, t - at[-1]).clip(0.0)
    inside = beyond < 0.05
    missing = np.zeros(shape, dtype=bool)
    for k, start, stop in planting.missing:
        missing |= (row == k) & (s > start) & (s < stop)
    half = planting.half_width_m
    # Ragged faces: the canopy's width wanders along the row.
    wander = cv2.GaussianBlur(rng.normal(size=shape).astype(np.float32), (0, 0), 0.3 / cell_m)
    wander *= 0.05 / max(float(wander.std()), 1e-9)
    canopy = inside & (np.abs(v) < half + wander) & ~missing

    sides = sight.sides or [(True, True)] * len(planting.rows)
    left, right = (np.array([side[k] for side in sides], dtype=bool)[row] for k in (0, 1))
    shown = np.zeros(shape, dtype=np.float32)
    for flag, depth in ((left, half - v), (right, half + v)):
        chance = np.where(flag, np.exp(-np.maximum(depth, 0.0) / sight.depth_m), 0.0)
        shown = 1.0 - (1.0 - shown) * (1.0 - chance.astype(np.float32))
    obstacle = canopy & (rng.random(shape) < sight.fill * shown)
    side_seen = np.where(v > 0, left, right)
    ground = np.where(inside, side_seen & ~canopy, beyond < sight.headland_m)
    ground &= distance * cell_m < sight.headland_m
    # Behind a missing plant the ground is seen from either side.
    ground |= missing & (left | right) & inside & (np.abs(v) < half)
    for east_m, north_m, radius_m in planting.things:
        disc = np.hypot(east[None, :] - east_m, north[:, None] - north_m) < radius_m
        obstacle |= disc & (rng.random(shape) < 0.9)
        ground &= ~disc
    holes = cv2.GaussianBlur(rng.normal(size=shape).astype(np.float32), (0, 0), 0.15 / cell_m)
    unseen = holes > np.quantile(holes, 1.0 - sight.hole_share)
    obstacle &= ~unseen
    ground &= ~unseen
    noise = rng.random(shape) < sight.noise_per_m2 * cell_m**2
    obstacle |= noise & ground
    for bounds in sight.unseen:
        part = lattice.window(bounds).intersect(window)
        if part is not None:
            place_of = window.slices_of(part)
            obstacle[place_of], ground[place_of] = False, False
    observed = obstacle | ground
    density = np.where(obstacle, rng.integers(*sight.density, shape), 0).astype(np.uint8)
    return MapView(lattice, window, density, observed, DATUM, is_base=True)
