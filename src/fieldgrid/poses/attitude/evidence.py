"""What a drive measures of its attitude, as rows at nodes and from node to node."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import Inertial, R_enu_level, R_level_vehicle, Steps, to_vectors
from fieldgrid.poses.attitude import model
from fieldgrid.poses.attitude.attitude import TERRAIN_NOISE_RAD
from fieldgrid.poses.attitude.axes import AxisTilt, lasting
from fieldgrid.poses.attitude.ground import ExpectedGround
from fieldgrid.poses.attitude.increments import increments, sample_noise
from fieldgrid.poses.attitude.model import AttitudeRows, States
from fieldgrid.poses.attitude.track import WANDER_SHARE, AntennaTrack
from fieldgrid.poses.measured import BIAS_S
from fieldgrid.poses.nodes import filled
from fieldgrid.poses.smoother.model import ACCELERATION_NOISE, GYRO_NOISE

RIGHT, AHEAD, UP = np.eye(3)

LEAST_STEP_NS = 190_000_000
"""Fixes that are closer to each other add little."""

GYRO_SQUARENESS = 0.004
"""By how much the axes of gyro and accelerometer are out of square, and the gyro's scale off: in
a turn by a radian, this share of it seems to be a tilt."""

FORCE_NOISE = 0.02
"""White noise of an accelerometer, (m/s²)·√s."""

STEP_TURN_SIGMA, STEP_WAY_SHARE = np.radians(0.015), 0.004
"""What the covariance of a camera's step does not know: errors of calibration and mounting."""

BENT_MPS2 = 1.0
"""An antenna between two fixes is off their chord as this acceleration makes it."""

COASTING_NOISE_M = 0.02
"""Without an accelerometer: way beyond the mean speed, m/√s."""

SEEN_ELSEWHERE_M = 1.0
"""How little velocities say of a way that the camera saw."""

GROUND_MPS, GROUND_SHARE, GROUND_S = 0.03, 0.02, 5.0
"""How fast a sensor leaves the ground that it drives on, also as a share of its speed, and for how
long it does: on a crest, and when springs give."""

LEAST_HEADING_SIGMA_RAD = np.radians(0.5)

SLOPE_S = 10.0
"""A vehicle is for so long on one slope."""


def evidence(
    track: AntennaTrack,
    antenna_m: Float64,
    wanted_ns: Int64,
    sensed: Inertial | None,
    steps: Steps | None,
    axes: Sequence[AxisTilt],
    ground: ExpectedGround,
) -> tuple[Int64, dict[str, AttitudeRows], States]:
    """All that was measured: nodes, at `wanted_ns` and where else something was, the rows by what
    they are, and the states to start from: level, along the fixes."""
    if sensed is not None and sensed.feels_force():
        # The camera's motion says no more than gyro and accelerometer together, and it is of longer
        # intervals.
        steps = None
    node_ns, fixed_ns = _nodes(track, wanted_ns, sensed is not None, steps)
    every, none = np.arange(len(node_ns)), np.zeros(len(axes) + 2)
    spacing_s = np.gradient(node_ns / 1e9)
    rows, turn_rad, watched = _motion(track, node_ns, sensed, steps)
    turned = _beside(np.isfinite(turn_rad[:, 0]))
    # With nothing to tell how the vehicle turns, its roll would explain what fixes err aside.
    lever_m = np.tile(antenna_m if turned.any() else np.zeros(3), (len(node_ns), 1))
    place_m, sigma_m = _antenna_at(track, node_ns)
    at = np.flatnonzero(np.isin(node_ns, fixed_ns))
    rows["fixes"] = _rows(
        model.sees_antenna, at, sigma_m[at], lever_m[at], place_m[at], robust=True
    )
    heading_rad, sigma = np.radians(track.headings.at(node_ns))
    start = _start(node_ns, heading_rad, np.isfinite(sigma), turn_rad[:, 2], place_m, lever_m)
    sigma = np.maximum(sigma, LEAST_HEADING_SIGMA_RAD) * lasting(GROUND_S, spacing_s)
    aside = np.stack([np.cos(heading_rad), -np.sin(heading_rad), 0.0 * heading_rad], axis=1)
    rows["headings"] = _pointing(every, sigma, AHEAD, aside, 0.0 * heading_rad, none)
    # A camera tells the way in the vehicle's axes: nothing needs to be taken from the ground.
    at = every[~_beside(watched)]
    sigma = GROUND_MPS + GROUND_SHARE * np.linalg.norm(start.velocity_mps[at], axis=1)
    sigma = sigma * lasting(GROUND_S, spacing_s[at])
    rows["wheels"] = _rows(model.follows_ground, at, sigma, turned[at].astype(float), robust=True)
    # A vehicle that nothing watches is for some seconds on one slope. One whose turns are known is
    # on the drive's slope all the time: it says so once.
    vertical, sigmas = ground.seen_from(heading_rad)
    slope_s = np.where(turned, max((node_ns[-1] - node_ns[0]) / 1e9, SLOPE_S), SLOPE_S)
    for k, toward in enumerate((RIGHT, AHEAD)):
        sigma = sigmas[:, k] * lasting(slope_s, spacing_s)
        rows[f"slope {k}"] = _pointing(every, sigma, toward, UP, vertical[:, k], none)
    for k, axis in enumerate(axes):
        sine, sigma = axis.at(node_ns)
        at = np.flatnonzero(np.isfinite(sigma))
        own = none.copy()
        own[:2], own[2 + k] = axis.frame_sigma_deg > 0.0, 1.0  # what gravity levels has no frame
        risen = _pointing(at, sigma[at], axis.direction, UP, sine[at], own)
        rows[f"axis {k}"] = risen._replace(robust=True)
    return node_ns, rows, start


def _rows(
    law: model.Law, at: Int64, sigma: Float64, *said: Float64, robust: bool = False
) -> AttitudeRows:
    sigma = sigma[:, None] if sigma.ndim == 1 else sigma
    return AttitudeRows(law, at, sigma, said, robust=robust)


def _pointing(
    at: Int64, sigma: Float64, toward: Float64, along: Float64, sine: Float64, own: Float64
) -> AttitudeRows:
    """The rows of one axis, [3] in the vehicle."""
    said = (np.broadcast_to(one, (len(at), one.shape[-1])) for one in (toward, along, own))
    toward, along, own = said
    return _rows(model.points, at, sigma, toward, along, sine, own)


def _motion(
    track: AntennaTrack, node_ns: Int64, sensed: Inertial | None, steps: Steps | None
) -> tuple[dict[str, AttitudeRows], Float64, Bool]:
    """The rows between nodes, the rotation vectors from each node to the next [n - 1, 3], NaN where
    nothing tells them, and where a camera saw the way [n - 1]."""
    step_s = np.diff(node_ns)[:, None] / 1e9
    n = len(step_s)
    every, zeros, rows = np.arange(n), np.zeros((n, 3)), {}
    # How much the receiver's slow error may change.
    wander_m = np.interp(node_ns[:-1], track.time_ns, track.wander_m)[:, None] * WANDER_SHARE
    wander_m = wander_m * np.sqrt(2.0 * step_s / BIAS_S)
    turn_rad, push_mps = np.full((2, n, 3), np.nan)
    turn_sigma = TERRAIN_NOISE_RAD * np.sqrt(step_s)
    push_sigma = np.tile(ACCELERATION_NOISE * np.sqrt(step_s), 3)
    way_sigma = np.hypot(COASTING_NOISE_M * np.sqrt(step_s), wander_m)
    if sensed is not None:
        turn_rad, push_mps = increments(sensed, node_ns)
        noise = np.hypot(GYRO_NOISE, sample_noise(sensed.rate_rad_s, sensed.time_ns))
        angle_rad = np.linalg.norm(turn_rad, axis=1, keepdims=True)
        sigma = np.sqrt(noise**2 * step_s + GYRO_SQUARENESS**2 * angle_rad)
        turn_sigma = np.where(np.isfinite(turn_rad), sigma, turn_sigma)
        noise = np.hypot(FORCE_NOISE, sample_noise(sensed.force_mps2, sensed.time_ns))
        push_mps[:] = push_mps if sensed.feels_force() else np.nan
        push_sigma = np.where(np.isfinite(push_mps), noise * np.sqrt(step_s), push_sigma)
    gyro_s, felt_s = (
        np.where(np.isfinite(known[:, 0]), step_s[:, 0], 0.0) for known in (turn_rad, push_mps)
    )
    watched = np.zeros(n, dtype=np.bool_)
    if steps is not None:
        joins, at = _joined(steps, node_ns)
        watched[at], gyro_s[at] = True, 0.0
        R = R_enu_level(steps.turn_deg) @ R_level_vehicle(steps.roll_deg, steps.pitch_deg)
        turn_rad[at] = to_vectors(R[joins])
        sigma = np.hypot(np.radians(steps.tilt_sigma_deg[joins]), STEP_TURN_SIGMA)
        turn_sigma[at] = sigma[:, None]
        way_m = np.stack([steps.right_m, steps.forward_m, steps.up_m], axis=1)[joins]
        sigma = np.hypot(steps.sigma_m[joins], STEP_WAY_SHARE * np.linalg.norm(way_m, axis=1))
        sigma = np.hypot(sigma[:, None], wander_m[at])
        rows["camera"] = _rows(model.moves, at, sigma, way_m, 0.0 * step_s[at, 0], robust=True)
        way_sigma[at] = SEEN_ELSEWHERE_M
    rows["turns"] = _rows(model.turns, every, turn_sigma, np.nan_to_num(turn_rad), gyro_s)
    rows["pushes"] = _rows(
        model.pushes, every, push_sigma, np.nan_to_num(push_mps), felt_s, robust=True
    )
    rows["ways"] = _rows(model.moves, every, way_sigma, zeros, step_s[:, 0])
    return {name: one._replace(between=True) for name, one in rows.items()}, turn_rad, watched


def _joined(steps: Steps, node_ns: Int64) -> tuple[Bool, Int64]:
    """The steps from one node to the next that tell how they rose, and those nodes."""
    start, stop = (np.searchsorted(node_ns, ends) for ends in (steps.start_ns, steps.stop_ns))
    joins = (stop == start + 1) & (stop < len(node_ns)) & np.isfinite(steps.up_m)
    joins &= node_ns[np.minimum(start, len(node_ns) - 1)] == steps.start_ns
    return joins, start[joins]


def _nodes(
    track: AntennaTrack, wanted_ns: Int64, is_sensed: bool, steps: Steps | None
) -> tuple[Int64, Int64]:
    """The nodes, and the instants at which fixes tell where the antenna is.

    Nodes are fixes, the wanted instants, and with an IMU more between them. Within a step of the
    camera none is of use: fixes there say where the antenna was at its ends.
    """
    first_ns, last_ns = track.time_ns[[0, -1]]
    _, apart = np.unique((track.time_ns - first_ns) // LEAST_STEP_NS, return_index=True)
    fixed_ns = track.time_ns[apart]
    node_ns = np.union1d(fixed_ns, wanted_ns)
    node_ns = np.union1d(node_ns[(node_ns >= first_ns) & (node_ns <= last_ns)], last_ns)
    if is_sensed:
        node_ns = filled(node_ns)
    if steps is not None:
        ends_ns = np.union1d(steps.start_ns, steps.stop_ns)
        ends_ns = ends_ns[(ends_ns >= first_ns) & (ends_ns <= last_ns)]
        begun = np.searchsorted(steps.start_ns, node_ns)
        inside = begun > np.searchsorted(steps.stop_ns, node_ns, side="right")
        node_ns, fixed_ns = np.union1d(node_ns[~inside], ends_ns), np.union1d(fixed_ns, ends_ns)
    return node_ns, fixed_ns


def _antenna_at(track: AntennaTrack, node_ns: Int64) -> tuple[Float64, Float64]:
    """The antenna at nodes [n, 3], on the chord between the fixes around, and its sigma."""
    after = np.clip(np.searchsorted(track.time_ns, node_ns), 1, len(track.time_ns) - 1)
    before_ns, after_ns = track.time_ns[after - 1], track.time_ns[after]
    share = ((node_ns - before_ns) / (after_ns - before_ns))[:, None]
    place_m = (1.0 - share) * track.enu_m[after - 1] + share * track.enu_m[after]
    noise_m = np.hypot((1.0 - share) * track.noise_m[after - 1], share * track.noise_m[after])
    gap_s = (after_ns - before_ns)[:, None] / 1e9
    bent_m = BENT_MPS2 * share * (1.0 - share) * gap_s**2 / 2.0
    return place_m, np.hypot(noise_m, bent_m)


def _start(
    node_ns: Int64,
    heading_rad: Float64,
    known: Bool,
    right_rad: Float64,
    place_m: Float64,
    lever_m: Float64,
) -> States:
    """Level, along the fixes, with the `known` headings; between these it turns as was measured."""
    turned_rad = np.append(0.0, np.cumsum(-np.nan_to_num(right_rad)))
    rest_rad = np.interp(node_ns, node_ns[known], (heading_rad - turned_rad)[known])
    R = R_enu_level(np.degrees(turned_rad + rest_rad))
    place_m = place_m - (R @ lever_m[:, :, None])[:, :, 0]
    speed_mps = np.asarray(np.gradient(place_m, node_ns / 1e9, axis=0))
    return States(place_m, speed_mps, R, np.zeros(0))


def _beside(between: Bool) -> Bool:
    """Nodes [n] with such an interval [n - 1] before or after them."""
    return np.append(between, False) | np.insert(between, 0, False)
