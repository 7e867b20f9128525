"""Roll and pitch of a drive against gravity, from all that it carries, by least squares.

An accelerometer sees gravity and the vehicle's own acceleration; fixes tell the latter, and a
gyro carries the axes from fix to fix. Without an accelerometer the camera's motion is laid along
the antenna's way in three dimensions: its climb shows the pitch, and a turn of the vehicle makes
roll of it. Without either, the climb of the fixes is the pitch, and the roll is what slopes of the
drive's size allow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import Inertial, Steps, heading_rad, roll_pitch_deg
from fieldgrid.poses.attitude.attitude import Attitude
from fieldgrid.poses.attitude.axes import AxisTilt, agreed
from fieldgrid.poses.attitude.evidence import evidence
from fieldgrid.poses.attitude.ground import expected_ground
from fieldgrid.poses.attitude.model import GYRO, A, AttitudeRows, States
from fieldgrid.poses.attitude.solver import believed, covariances, normal_equations, solved
from fieldgrid.poses.attitude.track import WANDER_SHARE, AntennaTrack

MOST_NODES, OVERLAP = 1000, 80
"""Longer drives are estimated stretch by stretch: biases of an IMU stay the same for minutes."""

MOST_ROUNDS, ENOUGH_RAD = 12, 2e-4

SHARED_SIGMA = np.repeat([np.radians(1.0), 0.2], 3)
"""Bias of a gyro (rad/s), and of an accelerometer with what it is out of the vehicle's axes (m/s²):
0.2 m/s² is a degree."""

LEAST_LASTING_DEG = 1e-3
"""Constant errors that do not exist are unknowns that are known to be nothing."""

LEAST_SIGMA_DEG = 0.08
"""What no measurement shows: axes of sensors that are not quite square."""

USUAL_MISFIT = 1.5
"""Where the root mean square distance of measurements from the estimate, in sigmas, is larger than
this, the sigmas of the estimate are multiplied by it."""


def estimate_attitude(
    track: AntennaTrack,
    antenna_m: Float64,
    wanted_ns: Int64 | None = None,
    steps: Steps | None = None,
    axes: Sequence[AxisTilt] = (),
    *,
    sensed: Inertial | None = None,
) -> Attitude:
    """Roll and pitch over a drive of at least two fixes.

    `antenna_m` [3] is the antenna as seen from the sensor, in the vehicle's axes (right, forward,
    up). `wanted_ns` are instants at which the attitude must be known as exactly as may be: those
    of images. `axes` that contradict the rest of the drive are left out, which the findings tell.
    The same input gives the same bits.
    """
    wanted = np.zeros(0, dtype=np.int64) if wanted_ns is None else wanted_ns
    said = track, antenna_m, wanted, sensed, steps if steps and len(steps.start_ns) else None
    attitude = _estimate(*said, ())
    kept, findings = agreed(axes, [attitude.rise_at(axis) for axis in axes])
    attitude = _estimate(*said, kept) if kept else attitude
    return attitude._replace(findings=findings, bodies=frozenset(axis.body for axis in kept))


def _estimate(
    track: AntennaTrack,
    antenna_m: Float64,
    wanted_ns: Int64,
    sensed: Inertial | None,
    steps: Steps | None,
    axes: Sequence[AxisTilt],
) -> Attitude:
    """Roll and pitch by all of this."""
    slow_m = float(np.median(track.wander_m)) * WANDER_SHARE[2]
    ground = expected_ground(track.enu_m, slow_m)
    node_ns, rows, x = evidence(track, antenna_m, wanted_ns, sensed, steps, axes, ground)
    frame_deg = max((axis.frame_sigma_deg for axis in axes), default=0.0)
    lasting_deg = [frame_deg, frame_deg, *(axis.mount_sigma_deg for axis in axes)]
    sigma = np.append(SHARED_SIGMA, np.radians(np.maximum(lasting_deg, LEAST_LASTING_DEG)))
    n = len(node_ns)
    edges = np.linspace(0, n, max(round(n / MOST_NODES), 1) + 1).astype(int).tolist()
    parts = []
    for first, last in pairwise(edges):
        start, stop = max(first - OVERLAP, 0), min(last + OVERLAP, n)
        own = {name: one.part(start, stop) for name, one in rows.items()}
        place_m, speed_mps, R = (column[start:stop] for column in x[:3])
        guess = States(place_m, speed_mps, R, np.zeros(len(sigma)))
        parts.append(_estimated(guess, own, sigma)[:, first - start : last - start])
    columns = np.concatenate(parts, axis=1)
    roll, pitch, roll_sigma, pitch_sigma, heading, up, pushed = columns[:7]
    felt = np.isfinite(pushed)
    return Attitude(
        *(node_ns, roll, pitch, roll_sigma, pitch_sigma),
        np.degrees(np.unwrap(heading)),
        up,
        _rms(pushed[felt]) if felt.any() else math.nan,
        gyro_bias_rad_s=columns[7:, -1],
    )


def _estimated(x: States, rows: dict[str, AttitudeRows], shared_sigma: Float64) -> Float64:
    """Roll, pitch and their sigmas, degrees, heading, radians, height, metres, how many sigmas the
    accelerometer's push after it is off, and the bias of the gyro about three axes, rad/s, of the
    nodes of one stretch [10, n]."""
    for k in range(MOST_ROUNDS):
        system = normal_equations(x, rows.values(), shared_sigma, robust=k > 0)
        change, shared = solved(system)
        x = x.moved(change, shared)
        if k > 1 and np.abs(change[:, A]).max() < ENOUGH_RAD:
            break
    blocks = covariances(normal_equations(x, rows.values(), shared_sigma, robust=True))
    roll, pitch = roll_pitch_deg(x.R)
    variance = np.stack([blocks[:, 7, 7], blocks[:, 6, 6]])  # about the forward axis, the right one
    # How much less sure than by the sigmas of its measurements all of a stretch is: by pushes with
    # all their outliers, as those of wrong axes are, and by fixes without.
    pushes, fixes = rows["pushes"], rows["fixes"].sigmas_off(x)
    felt, pushed = pushes.said[1] > 0.0, np.full(len(x.R), np.nan)
    pushed[pushes.at[felt]] = np.sqrt(np.mean(pushes.sigmas_off(x)[felt] ** 2, axis=1))
    misfit = max(_rms(pushed[np.isfinite(pushed)]), _rms(np.sqrt(believed(fixes)) * fixes))
    sigma = np.degrees(np.sqrt(variance)) * (misfit if misfit > USUAL_MISFIT else 1.0)
    sigma = np.hypot(sigma, LEAST_SIGMA_DEG)
    return np.vstack(
        [
            *(roll, pitch, sigma, heading_rad(x.R), x.position_m[:, 2], pushed),
            np.tile(x.of(GYRO)[:, None], len(x.R)),
        ]
    )


def _rms(values: Float64) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
