"""The plane of the ground in the frame of the sensor, with nothing known of how that is mounted.

A plane is `up` (a unit vector in the sensor's frame) and the sensor's height: a point P is
`up · P + height_m` above it. What is not nearly level is no ground, whatever its size: the wall
of a canopy fills more of an image than the lane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry import Mount, robust_plane
from fieldgrid.perception import LOW_SHARE, MIN_SAMPLES

HEIGHTS_M = (0.1, 10.0)
TILTS_DEG, MOST_ROLL_DEG = (-10.0, 75.0), 20.0
"""What a `Mount` can be."""

TRIES, MOST_POINTS = 400, 3000
FEWEST_POINTS = 200

ROUGH_M = 0.05
"""How far ground is from a plane at the least."""

BELOW_COSTS = 3.0
"""A point below the ground speaks against it more than one on it speaks for it: nothing is seen
through the ground, and much stands on it."""

PATCH_M, SPARSE_PATCH_M = 0.25, 1.0
"""Side of the square patches: finer than a local grid's, since a vehicle is only so wide; and of
points that are too few for that."""

FEWEST_PATCHES = 24

NEAR_M, NEAR_SHARE = 0.3, 0.03
"""How high above the plane a patch may still be ground, and how much more per metre of range."""


class SensorGround(NamedTuple):
    """The ground in the frame of the sensor."""

    up: Float64
    height_m: float

    @property
    def tilt_deg(self) -> float:
        """How far the sensor looks down."""
        return math.degrees(math.atan2(-self.up[2], -self.up[1]))

    @property
    def roll_deg(self) -> float:
        """Positive when the sensor's right side is down."""
        return -math.degrees(math.asin(min(max(float(self.up[0]), -1.0), 1.0)))

    def rotation(self) -> Float64:
        """R_level_sensor [3, 3]: x right, y where the sensor looks, z up from the plane."""
        return Mount(1.0, self.tilt_deg, self.roll_deg).rotation()

    def level(self, points_m: Float64) -> Float64:
        """Points [n, 3] of the sensor's frame: right, ahead, above the ground."""
        return np.asarray(points_m @ self.rotation().T + [0.0, 0.0, self.height_m])

    def corrected(self, c: Float64) -> SensorGround:
        """The plane z = c0 + c1·x + c2·y of this one's level frame."""
        norm = math.sqrt(1.0 + float(c[1] * c[1] + c[2] * c[2]))
        up = self.rotation().T @ (np.array([-c[1], -c[2], 1.0]) / norm)
        return SensorGround(up, (self.height_m - float(c[0])) / norm)

    def can_be(self) -> bool:
        """Whether a vehicle carries a sensor so."""
        return (
            HEIGHTS_M[0] < self.height_m < HEIGHTS_M[1]
            and TILTS_DEG[0] < self.tilt_deg < TILTS_DEG[1]
            and abs(self.roll_deg) < MOST_ROLL_DEG
        )


def median_plane(planes: Sequence[SensorGround]) -> SensorGround:
    """The median of planes, each coordinate of `up` by itself."""
    up = np.median([plane.up for plane in planes], axis=0)
    height_m = float(np.median([plane.height_m for plane in planes]))
    return SensorGround(up / np.linalg.norm(up), height_m)


def rough_plane(points_m: Float64, range_sigma_m: Float64) -> SensorGround | None:
    """The plane that most points [n, 3] lie on and hardly one below; None when there is none.

    `range_sigma_m` [n] is how far off the points are along their rays.
    """
    n = len(points_m)
    if n < FEWEST_POINTS:
        return None
    random = np.random.default_rng(n)  # the same for the same points
    if n > MOST_POINTS:
        chosen = random.choice(n, MOST_POINTS, replace=False)
        points_m, range_sigma_m, n = points_m[chosen], range_sigma_m[chosen], MOST_POINTS
    range_m = np.linalg.norm(points_m, axis=1)
    per_height = 2.0 * range_sigma_m / range_m  # an error along the ray, seen across the plane

    def score(plane: SensorGround) -> float:
        above = points_m @ plane.up + plane.height_m
        slack = np.maximum(per_height * plane.height_m, ROUGH_M)
        support = np.count_nonzero(np.abs(above) < slack)
        return support - BELOW_COSTS * np.count_nonzero(above < -2.0 * slack)

    three_m = points_m[random.integers(0, n, (TRIES, 3))]
    normal = np.cross(three_m[:, 1] - three_m[:, 0], three_m[:, 2] - three_m[:, 0])
    height_m = -np.sum(normal * three_m[:, 0], axis=1)
    # Up is the side of the sensor.
    per_size = np.copysign(1.0 / np.maximum(np.linalg.norm(normal, axis=1), 1e-6), height_m)
    tried = map(SensorGround, normal * per_size[:, None], (height_m * per_size).tolist())
    best = max((plane for plane in tried if plane.can_be()), key=score, default=None)
    return best if best is not None and score(best) > 0.0 else None


def refined_plane(
    plane: SensorGround, points_m: Float64, range_sigma_m: Float64, patch_m: float = PATCH_M
) -> SensorGround | None:
    """A rough plane fitted to the low heights of patches; None when there are too few of them."""
    for _ in range(3):
        x, y, z, sigma = low_patches(plane, points_m, range_sigma_m, patch_m).T
        c, agreeing = robust_plane(x, y, z, sigma)
        plane = plane.corrected(c)
        if agreeing < FEWEST_PATCHES or not plane.can_be():
            return None
    return plane


def low_patches(
    plane: SensorGround, points_m: Float64, range_sigma_m: Float64, patch_m: float = PATCH_M
) -> Float64:
    """The ground of patches near a plane, in its level frame: x, y, z, sigma of z, [m, 4].

    The ground of a patch is where the lowest quarter of its points ends, as for local grids.
    """
    level = plane.level(points_m)
    range_m = np.linalg.norm(points_m, axis=1)
    near = np.abs(level[:, 2]) < 2.0 * (NEAR_M + NEAR_SHARE * range_m)
    x, y, z = level[near].T
    sigma = range_sigma_m[near] * plane.height_m / range_m[near]
    cell = np.floor(np.stack([x, y]) / patch_m).astype(np.int64)
    order = np.lexsort((z, cell[0], cell[1]))
    x, y, z, sigma, cell = x[order], y[order], z[order], sigma[order], cell[:, order]
    starts = np.flatnonzero(np.any(np.diff(cell, axis=1, prepend=cell[:, :1] - 1) != 0, axis=0))
    counts = np.diff(np.append(starts, len(z)))
    if len(counts) == 0:
        return np.zeros((0, 4))
    means = [np.add.reduceat(column, starts) / counts for column in (x, y, sigma)]
    low = z[starts + (LOW_SHARE * counts).astype(np.int64)]
    patches = np.column_stack([means[0], means[1], low, np.hypot(means[2], 0.03)])
    ahead_m = np.hypot(patches[:, 0], patches[:, 1])
    kept = (counts >= MIN_SAMPLES) & (np.abs(low) < NEAR_M + NEAR_SHARE * ahead_m)
    return np.asarray(patches[kept])
