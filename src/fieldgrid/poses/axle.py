"""Where the axle that does not steer lies: declared, told by the drive, or unsure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.geometry import Rig, Steps, VehicleGeometry, with_antenna_ahead
from fieldgrid.poses.smoother.declared import Constant
from fieldgrid.poses.travel_direction import LEAST_STEP_M, MOST_TURN_DEG, Ways

UNNAMED_AXLE_M = 0.5
"""Sigma of how far ahead of the axle the antenna of a rig sits that nobody measured. Of a log
alone it is taken to be above the axle, and its report says so."""

FARTHEST_AXLE_M = 5.0
"""Farther than any antenna sits from the axle; such an answer is of something else."""

SURE_AXLE_M = 0.3
"""A place that turns show as well as this is used, with its sigma."""


class Axle(NamedTuple):
    """A vehicle with the place of its axle, and the 1-sigma error of that place along the way.

    `told` is whether the drive showed it, not the declaration of the vehicle.
    """

    vehicle: VehicleGeometry | None
    sigma_m: float = 0.0
    told: bool = False

    def frame(self) -> tuple[tuple[float, float], float]:
        """The antenna (right, ahead) and the grid origin (ahead) as seen from the axle, metres.

        An axle that nobody names is taken to lie below the antenna.
        """
        if self.vehicle is None:
            return (0.0, 0.0), 0.0
        antenna, axle_m = self.vehicle.antenna, axle_forward_m(self.vehicle)
        # Floats, whatever kind of number somebody declared: kernels take no other.
        return (float(antenna.right_m), float(antenna.forward_m - axle_m)), -float(axle_m)


def names_axle(vehicle: VehicleGeometry | None) -> bool:
    """Whether anything says where the axle that does not steer lies."""
    return vehicle is not None and vehicle.rear_axle_forward_m is not None


def axle_forward_m(vehicle: VehicleGeometry) -> float:
    """Forward coordinate of the unsteered axle: the antenna's when the vehicle does not name it."""
    axle_m = vehicle.rear_axle_forward_m
    return vehicle.antenna.forward_m if axle_m is None else axle_m


def axle_of(vehicle: VehicleGeometry | None) -> Axle:
    """The axle as it is declared, or as unsure as a guess."""
    if names_axle(vehicle) or not isinstance(vehicle, Rig):
        return Axle(vehicle)
    return Axle(vehicle, UNNAMED_AXLE_M)


def with_antenna_moved(axle: Axle, ahead_m: float) -> Axle:
    """The axle with the antenna `ahead_m` farther ahead of it."""
    (_, was_m), _ = axle.frame()
    return axle._replace(vehicle=with_antenna_ahead(axle.vehicle, was_m + ahead_m))


def axle_told(axle: Axle, ahead: Constant) -> Axle:
    """The axle by what a drive whose turns were seen would add to the antenna's place ahead."""
    (_, was_m), _ = axle.frame()
    ahead_m = was_m + ahead.value
    if ahead.sigma > SURE_AXLE_M or abs(ahead_m) > FARTHEST_AXLE_M:
        return axle
    return Axle(with_antenna_ahead(axle.vehicle, ahead_m), ahead.sigma, told=True)


def ways_of(steps: Steps) -> Ways:
    """The steps of the grid origin as `poses.travel_direction` takes them."""
    gear = np.where(steps.forward_m >= 0.0, 1.0, -1.0)
    distance_m = np.hypot(steps.forward_m, steps.right_m)
    turn = np.radians(steps.turn_deg)
    off = np.arctan2(gear * steps.right_m, gear * steps.forward_m) - turn / 2.0
    use = (distance_m >= LEAST_STEP_M) & (np.abs(steps.turn_deg) <= MOST_TURN_DEG)
    per_m = gear * turn / np.maximum(distance_m, LEAST_STEP_M)
    return Ways(
        np.flatnonzero(use),
        (gear * distance_m)[use],
        np.degrees(off)[use],
        steps.turn_deg[use],
        per_m[use],
    )
