"""How steep the ground of a drive is, as the heights of its fixes tell, and how unsure that is.

On a slope the antenna leans downhill by its height times the slope, and where the slope changes its
track turns otherwise than the vehicle. Where nothing measures how the vehicle leans, this is what
is expected of it, and what the sigmas of its poses grow by.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64

USUAL_SLOPE = 0.14
"""Slopes of cultivated ground, 1 sigma along one axis (8°), before a height is known."""

LEAST_ROUGHNESS = 0.026
"""What a vehicle leans beside the ground's own slopes (1.5°)."""

STEP_M, ALIKE_M = 0.5, 10.0
"""Heights count every half metre of the way; what the ground does beside its plane, and a
receiver's slow error, is the same for so long."""

LEAST_NOISE_M = 0.05

CLIMB_SIGMA, LEAST_CHORD_M, MOST_CHORD_M = 0.01, 3.0, 30.0
"""The path's climb is that between fixes so far apart that their noise makes no more than this."""

BENT_SHARE = 0.6
"""Roll changes along the path by this share of what the climb changes: on a crest that is crossed
at any angle, the second derivative along the path and the mixed one are to each other as 0.61 to
0.35."""

FEWEST_CHORDS = 10
NORMAL_MAD = 1.4826


class ExpectedGround(NamedTuple):
    """A plane: its rise per metre east and north `rise` [2] with their `covariance` [2, 2]; slopes
    of the ground around it `rough`, 1 sigma along one axis, NaN where the way is too short; and how
    fast they change along the path, `bent`, radians a metre."""

    rise: Float64
    covariance: Float64
    rough: float
    bent: float

    @property
    def unseen(self) -> float:
        """The slope that the drive does not show: a single row does not tell how steep it is
        across. Rise per metre, 1 sigma, in no known direction."""
        return float(np.sqrt(np.trace(self.covariance)))

    @property
    def slope(self) -> float:
        """The same of all slopes."""
        return math.hypot(*self.rise, np.nan_to_num(self.rough), self.unseen)

    def seen_from(self, heading_rad: Float64) -> tuple[Float64, Float64]:
        """The vertical [n, 2] (right, forward) as seen from a vehicle that stands on the plane,
        and its sigma [n, 2]."""
        sin, cos = np.sin(heading_rad), np.cos(heading_rad)
        axes = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], axis=1)
        variance = np.einsum("nia,ab,nib->ni", axes, self.covariance, axes)
        rough = max(USUAL_SLOPE if np.isnan(self.rough) else self.rough, LEAST_ROUGHNESS)
        rise = axes @ self.rise / np.sqrt(1.0 + self.rise @ self.rise)
        return rise, np.sqrt(variance + rough**2)


def expected_ground(place_m: Float64, slow_m: float) -> ExpectedGround:
    """The ground by an antenna's places [n, 3], of which heights err by a slow error besides."""
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(place_m[:, :2], axis=0).T))])
    second_m = np.abs(np.diff(place_m[:, 2], 2)) if len(way_m) > 2 else np.zeros(1)
    noise_m = max(NORMAL_MAD * float(np.median(second_m)) / np.sqrt(6.0), 1e-3)
    # Of one stretch of the way counts one height, however long the vehicle stood there. What is
    # left beside the plane, as of hills in a single row, is an error of it.
    rows = np.searchsorted(way_m, np.arange(0.0, max(way_m[-1], STEP_M), STEP_M))
    at_m = place_m[rows] - place_m[rows].mean(axis=0)
    east_north_m, up_m = at_m[:, :2], at_m[:, 2]
    count = max(float(way_m[-1]) / ALIKE_M, 1.0)
    sigma_m = rough_m = max(float(np.hypot(slow_m, noise_m)), LEAST_NOISE_M)
    for _ in range(2):
        weight = count / len(rows) / rough_m**2
        known = east_north_m.T @ east_north_m * weight + np.eye(2) / USUAL_SLOPE**2
        covariance = np.linalg.inv(known)
        rise = covariance @ east_north_m.T @ up_m * weight
        off_m = np.abs(up_m - east_north_m @ rise)
        rough_m = max(NORMAL_MAD * float(np.median(off_m)), sigma_m)
    chord_m = float(np.clip(np.sqrt(2.0) * noise_m / CLIMB_SIGMA, LEAST_CHORD_M, MOST_CHORD_M))
    at_m = np.arange(0.0, way_m[-1], chord_m)
    if len(at_m) <= 2:
        return ExpectedGround(rise, covariance, np.nan, 0.0)
    step = np.diff([np.interp(at_m, way_m, axis) for axis in place_m.T]) / chord_m
    climb_noise = np.sqrt(2.0) * noise_m / chord_m
    rough, _ = _beyond(step[2] - rise @ step[:2], climb_noise)
    # What is large in less than half of the drive, as in the turns on a plane, is no crest.
    bent = min(_beyond(np.diff(step[2]) / chord_m, np.sqrt(3.0) * climb_noise / chord_m))
    seen = BENT_SHARE * bent if len(at_m) > FEWEST_CHORDS else 0.0
    return ExpectedGround(rise, covariance, rough, seen)


def _beyond(values: Float64, noise: float) -> tuple[float, float]:
    """How large values are beyond their noise: root mean square, outliers cut down to three times
    what is usual; and what is usual."""
    size = np.abs(values)
    usual = NORMAL_MAD * float(np.median(size))
    spread = float(np.sqrt(np.mean(np.minimum(size, 3.0 * max(usual, noise)) ** 2)))
    large, middle = (max(one**2 - noise**2, 0.0) ** 0.5 for one in (spread, usual))
    return large, middle
