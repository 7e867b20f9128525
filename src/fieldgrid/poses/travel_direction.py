"""Where a vehicle goes, as its camera sees it: the yaw of the camera, and the unsteered axle.

In a curve a point that is ahead of the unsteered axle moves sideways too: its direction of travel
is off the nose by the curvature times how far ahead it is. So the direction seen is

    direction = -yaw + ahead · curvature

over the steps of the drive, whose line is fitted. Reverse is no other case: the direction is that
of the motion or its opposite, whichever points where the camera looks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64, MeasuredValue, repeated

LEAST_STEP_M = 0.1
"""The direction of a shorter step is not known."""

FEWEST, LEAST_WAY_M = 8, 5.0
"""Steps, and metres nearly straight on, without which there is no yaw."""

STRAIGHT_PER_M = 0.05
"""Curvature of what is nearly straight on: a radius of 20 m."""

NOISE_M, NOISE_DEG, NOISE_SHARE = 0.006, 0.1, 0.15
"""How far directions are off by the way, in any case, and as a share of the turn in the step,
since no arc is exactly one."""

MOST_TURN_DEG = 20.0
"""Steps that turn more say little."""

AHEAD_M, AHEAD_SIGMA_M, SAID_SIGMA_M = 1.0, 1.5, 0.05
"""How far ahead of the unsteered axle a camera is when nobody says, and how sure that is; and how
sure it is when somebody says."""

TOLD_SIGMA_M, TOLD_SIGMA_DEG = 0.3, 1.0
"""An axle or a yaw that is less sure is not told: what was found is rather what was supposed.
Along a single curve the two cannot be told apart."""

ROUNDS = 8
FLOOR_DEG, AHEAD_FLOOR_M = 0.05, 0.05


class Ways(NamedTuple):
    """Steps of the ground point below the sensor, seen from above; all length n.

    `stop` is the frame that each leads to. `forward_m` is negative in reverse, `direction_deg` to
    the right of where the camera looks, `curvature_per_m` positive to the right when driving
    forward.
    """

    stop: Int64
    forward_m: Float64
    direction_deg: Float64
    turn_deg: Float64
    curvature_per_m: Float64


class Travel(NamedTuple):
    """The yaw of the camera in degrees, positive when it looks to the right of where the vehicle
    goes, and how far ahead of the unsteered axle it is; None when the drive does not tell."""

    yaw_deg: MeasuredValue | None
    ahead_m: MeasuredValue | None
    straight_m: float


def travel(steps: Ways, ahead_m: float | None = None) -> Travel:
    """Yaw and axle by the steps; `ahead_m` is how far ahead of the axle the camera is said to be.

    What is said is used for the yaw only; the axle is found without it.
    """
    distance_m = np.abs(steps.forward_m)
    straight_m = float(distance_m[np.abs(steps.curvature_per_m) < STRAIGHT_PER_M].sum())
    if len(distance_m) < FEWEST or straight_m < LEAST_WAY_M:
        return Travel(None, None, straight_m)
    line, covariance = _line(steps, AHEAD_M, AHEAD_SIGMA_M)
    ahead_sigma_m = math.hypot(math.sqrt(covariance[1, 1]), AHEAD_FLOOR_M)
    found = MeasuredValue(float(line[1]), ahead_sigma_m)
    if ahead_m is not None:
        line, covariance = _line(steps, ahead_m, SAID_SIGMA_M)
    yaw_sigma_deg = math.hypot(math.degrees(math.sqrt(covariance[0, 0])), FLOOR_DEG)
    yaw = MeasuredValue(-math.degrees(line[0]), yaw_sigma_deg)
    return Travel(
        yaw if yaw_sigma_deg < TOLD_SIGMA_DEG else None,
        found if ahead_sigma_m < TOLD_SIGMA_M else None,
        straight_m,
    )


def _line(steps: Ways, ahead_m: float, ahead_sigma_m: float) -> tuple[Float64, Float64]:
    """Direction (rad) straight on and metres ahead of the axle, with their covariance [2, 2]."""
    distance_m, turn = np.abs(steps.forward_m), np.radians(steps.turn_deg)
    direction = np.radians(steps.direction_deg)
    sigma = np.sqrt(
        (NOISE_M / distance_m) ** 2 + math.radians(NOISE_DEG) ** 2 + (NOISE_SHARE * turn) ** 2
    )
    columns = np.column_stack([np.ones_like(distance_m), steps.curvature_per_m])
    prior = np.diag([0.0, 1.0 / ahead_sigma_m**2])
    line: Float64 = np.zeros(2)
    weights = 1.0 / sigma**2
    normal = np.eye(2)
    for _ in range(ROUNDS):
        normal = columns.T @ (columns * weights[:, None])
        right = columns.T @ (weights * direction) + prior @ [0.0, ahead_m]
        line = np.asarray(np.linalg.solve(normal + prior, right), dtype=np.float64)
        off = np.abs(direction - columns @ line) / sigma
        scale = max(1.4826 * float(np.median(off)), 1.0)
        # Huber's weights: a step that slipped counts for less, and none is left out.
        weights = np.minimum(2.0 * scale / np.maximum(off, 1e-9), 1.0) / sigma**2
    residuals = (direction - columns @ line) / sigma
    excess = max(float(np.mean(residuals**2 * weights * sigma**2)), 0.25) * repeated(residuals)
    covariance = np.asarray(np.linalg.inv(normal / excess + prior), dtype=np.float64)
    return line, covariance
