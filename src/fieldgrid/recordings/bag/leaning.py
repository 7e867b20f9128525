"""How the vehicle leans by orientations in messages: of an IMU's own estimate, odometry or poses.

An orientation turns a body's axes into those of a frame whose z axis is up (REP 103, REP 145), so
its third row is the vertical as the body has it. The heading that it holds is not used.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import Orientation
from fieldgrid.recordings.poses.pose_files import OFF_UNIT
from fieldgrid.recordings.tables.motion_files import R_VEHICLE_FLU, in_order

UNSTATED_SIGMA_DEG, LEAST_SIGMA_DEG, MOST_SIGMA_DEG = 1.0, 0.5, 15.0
"""The error of an orientation that states none, and of none less. One that states more says that
it does not know: odometry in the plane has a large variance there."""

ODOMETRY_FRAME_SIGMA_DEG = 2.0
"""By how much the frame of odometry may lean: that of a vehicle that did not start level."""

LEVEL = math.radians(0.01)
"""A vertical that moves less throughout belongs to poses in the plane, or to an IMU that estimates
nothing."""

UPRIGHT = math.cos(math.radians(30.0))
"""A vehicle leans less on average."""

LEAST_STEP_NS = 40_000_000
"""Nearer values add little, and a map keeps them all."""

_OF_POSE, _OF_IMU = [21, 28], [0, 4]
"""The variances of roll and pitch in a covariance of x, y, z and the turns about them, and in one
of the turns alone."""

_UNTOLD = (math.nan,) * 4


def lean_of(message: Any) -> tuple[float, float, float, float]:
    """The vertical in a body's axes, and its stated 1-sigma error (degrees; NaN for none), by a
    sensor_msgs/Imu, nav_msgs/Odometry, or pose with or without a covariance; NaN if it tells none.
    """
    if hasattr(message, "orientation_covariance"):
        variances, turn = message.orientation_covariance[_OF_IMU].tolist(), message.orientation
        if variances[0] == -1.0:  # by its definition: it has no orientation
            return _UNTOLD
    elif hasattr(message.pose, "covariance"):
        variances = message.pose.covariance[_OF_POSE].tolist()
        turn = message.pose.pose.orientation
    else:
        variances, turn = [0.0], message.pose.orientation
    x, y, z, w = turn.x, turn.y, turn.z, turn.w
    length2 = x * x + y * y + z * z + w * w
    most = max(variances)
    sigma_deg = math.degrees(math.sqrt(most)) if 0.0 < most < math.inf else math.nan
    if sigma_deg > MOST_SIGMA_DEG or not abs(length2 - 1.0) < 2.0 * OFF_UNIT:
        return _UNTOLD
    return (
        2.0 * (x * z - w * y) / length2,
        2.0 * (y * z + w * x) / length2,
        (w * w - x * x - y * y + z * z) / length2,
        sigma_deg,
    )


class Untold(NamedTuple):
    """Why orientations tell no roll and pitch; `by_axes` where it is how the body sits that is not
    known."""

    why: str
    by_axes: bool = False


def orientation_of(
    times_ns: Int64,
    values: Float64,
    R_flu_body: Float64,
    frame_sigma_deg: float,
    *,
    axes_known: bool,
) -> Orientation | Untold:
    """Roll and pitch by verticals and sigmas [n, 4] of a body that sits so in its vehicle.

    Where that is taken and not known (`axes_known`), a vertical downward is none: a frame north,
    east, down and a body forward, right, down look the same, and their pitches are opposite.
    """
    (time_ns, kept), _ = in_order(times_ns, values, 3)
    if len(time_ns) < 2:
        return Untold("fewer than two messages have an orientation")
    up = kept[:, :3] @ (R_VEHICLE_FLU @ R_flu_body).T
    if np.ptp(up, axis=0).max() < LEVEL:
        return Untold("its orientation never leans otherwise, as that of poses in the plane")
    mean_up = float(up[:, 2].mean())
    if abs(mean_up) < UPRIGHT:
        return Untold("by its orientation the vehicle lies on its side", by_axes=True)
    if mean_up < 0.0 and not axes_known:
        return Untold("by its orientation the vehicle is upside down", by_axes=True)
    up = up * np.sign(mean_up)  # frames whose z axis points down: north, east, down
    rows, k = [], 0
    while k < len(time_ns):
        rows.append(k)
        k = int(np.searchsorted(time_ns, time_ns[k] + LEAST_STEP_NS))
    return stated_orientation(time_ns[rows], up[rows], kept[rows, 3], frame_sigma_deg)


def stated_orientation(
    time_ns: Int64, up: Float64, sigma_deg: Float64, frame_sigma_deg: float
) -> Orientation:
    """Roll and pitch by verticals [n, 3] in the vehicle's axes, with their stated 1-sigma errors
    [n], NaN for none."""
    right, forward, above = up.T
    sigma = np.maximum(np.where(sigma_deg > 0.0, sigma_deg, UNSTATED_SIGMA_DEG), LEAST_SIGMA_DEG)
    return Orientation(
        time_ns,
        np.degrees(np.arctan2(-right, above)),
        np.degrees(np.arctan2(forward, np.hypot(right, above))),
        sigma,
        np.full(len(time_ns), frame_sigma_deg),
    )
