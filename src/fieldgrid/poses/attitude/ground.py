"""What slope to expect where nothing else tells it: the plane through all heights of a drive."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.attitude.measurements import WANDER_SHARE, AntennaTrack

USUAL_SLOPE = 0.14
"""Slopes of cultivated ground, 1 sigma along one axis (8°), before a height is known."""

CLIMB_M = 5.0
"""The ground's own slope is taken over this distance, beyond the noise of fixes."""

LEAST_ROUGHNESS = 0.026
"""Around its plane the ground is at least so steep (1.5°)."""


class ExpectedGround(NamedTuple):
    """A plane: its rise per metre east and north `rise` [2] with their `covariance` [2, 2], and
    `rough`, the slopes of the ground around it, 1 sigma along one axis."""

    rise: Float64
    covariance: Float64
    rough: float

    def seen_from(self, heading_rad: Float64) -> tuple[Float64, Float64]:
        """The vertical [n, 2] (right, forward) as seen from a vehicle that stands on the plane,
        and its sigma [n, 2]."""
        sin, cos = np.sin(heading_rad), np.cos(heading_rad)
        axes = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], axis=1)
        variance = np.einsum("nia,ab,nib->ni", axes, self.covariance, axes)
        rise = axes @ self.rise
        return rise / np.sqrt(1.0 + self.rise @ self.rise), np.sqrt(variance + self.rough**2)

    def sigma_deg(self) -> float:
        """How far a slope may be from the expected one, degrees, in the worse direction."""
        worst = float(np.linalg.eigvalsh(self.covariance)[-1])
        return float(np.degrees(np.arctan(np.sqrt(worst + self.rough**2))))


def expected_ground(track: AntennaTrack) -> ExpectedGround:
    """The plane through the heights of a drive, as far as its width and its receiver tell it.

    Heights share the receiver's slow error, so a thousand of them say little more than a few.
    """
    place = track.enu_m - track.enu_m.mean(axis=0)
    slow_m = float(np.median(track.wander_m)) * WANDER_SHARE[2]
    sigma_m = float(np.hypot(slow_m, np.median(track.noise_m[:, 2])))
    spread = place[:, :2].T @ place[:, :2] / len(place)
    known = spread / sigma_m**2 + np.eye(2) / USUAL_SLOPE**2
    covariance = np.linalg.inv(known)
    rise = covariance @ (place[:, :2].T @ place[:, 2] / len(place)) / sigma_m**2
    return ExpectedGround(rise, covariance, _roughness(track, rise))


def _roughness(track: AntennaTrack, rise: Float64) -> float:
    """How much steeper or flatter than the plane the antenna climbs, 1 sigma."""
    step_m = np.hypot(*np.diff(track.enu_m[:, :2], axis=0).T)
    apart_m = np.concatenate([[0.0], np.cumsum(step_m)])
    ahead = np.searchsorted(apart_m, apart_m + CLIMB_M)
    here = np.flatnonzero(ahead < len(apart_m))
    if here.size == 0:
        return USUAL_SLOPE
    way = track.enu_m[ahead[here]] - track.enu_m[here]
    off = (way[:, 2] - way[:, :2] @ rise) / CLIMB_M
    noise = 2.0 * float(np.median(track.noise_m[:, 2])) ** 2 / CLIMB_M**2
    # 0.455 is the median of a squared normal value.
    return float(max(np.sqrt(max(np.median(off**2) / 0.455 - noise, 0.0)), LEAST_ROUGHNESS))
