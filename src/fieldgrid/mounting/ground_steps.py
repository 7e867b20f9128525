"""Steps of the ground point below a sensor, from the visual odometry of the sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fieldgrid.mounting.plane import SensorGround
from fieldgrid.odometry import RigidMotion
from fieldgrid.travel import LEAST_STEP_M, MOST_TURN_DEG, Ways


def ground_steps(motions: Sequence[RigidMotion | None], plane: SensorGround) -> Ways:
    """The steps of the ground point, by the motions of the sensor and the plane it stands on.

    That point, and not the sensor, which sways by centimetres when the vehicle rolls.
    """
    R_level = plane.rotation()
    ground = -plane.height_m * plane.up
    rows = []
    for k, motion in enumerate(motions):
        if motion is None:
            continue
        R, t = motion
        right, forward, _ = (R_level @ (R.T @ (ground - t) - ground)).tolist()
        turned = R_level @ R.T @ R_level.T
        turn = math.atan2(float(turned[0, 1]), float(turned[1, 1]))
        distance_m = math.hypot(right, forward)
        gear = 1.0 if forward >= 0.0 else -1.0
        if distance_m < LEAST_STEP_M or abs(turn) > math.radians(MOST_TURN_DEG):
            continue
        direction = math.atan2(gear * right, gear * forward) - turn / 2.0
        rows.append((k + 1, gear * distance_m, direction, turn, gear * turn / distance_m))
    stop, forwards_m, directions, turns, curvatures = np.array(rows).reshape(-1, 5).T
    return Ways(
        stop.astype(np.int64), forwards_m, np.degrees(directions), np.degrees(turns), curvatures
    )
