"""What a drive measures of its attitude, as rows at nodes and from node to node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import Inertial, R_enu_level, R_level_vehicle, Steps, to_vectors
from fieldgrid.poses.attitude import model
from fieldgrid.poses.attitude.attitude import TERRAIN_NOISE_RAD
from fieldgrid.poses.attitude.axes import AxisTilt, lasting
from fieldgrid.poses.attitude.ground import ExpectedGround
from fieldgrid.poses.attitude.increments import increments, sample_noise
from fieldgrid.poses.attitude.model import Rows, States
from fieldgrid.poses.attitude.track import WANDER_SHARE, AntennaTrack
from fieldgrid.poses.nodes import filled

LEAST_STEP_NS = 190_000_000
"""Fixes that are closer to each other add little."""

WANDER_S = 300.0
"""The slow part of a receiver's error changes in minutes."""

GYRO_NOISE = np.radians(0.05)
"""Noise of an integrated gyro with a vehicle's vibrations, rad/√s: never less."""

GYRO_SQUARENESS = 0.004
"""By how much the axes of gyro and accelerometer are out of square, and the gyro's scale off: in
a turn by a radian, this share of it seems to be a tilt."""

FORCE_NOISE = 0.02
"""White noise of an accelerometer, (m/s²)·√s."""

STEP_TURN_SIGMA, STEP_WAY_SHARE = np.radians(0.015), 0.004
"""What the covariance of a camera's step does not know: errors of calibration and mounting."""

BENT_MPS2 = 1.0
"""An antenna between two fixes is off their chord as this acceleration makes it."""

ACCELERATION_NOISE, COASTING_NOISE_M = 1.0, 0.02
"""Without an accelerometer: change of speed, (m/s)/√s; and way beyond the mean speed, m/√s."""

SEEN_ELSEWHERE_M = 1.0
"""How little velocities say of a way that the camera saw."""

GROUND_MPS, GROUND_SHARE, GROUND_S = 0.03, 0.02, 5.0
"""How fast a sensor leaves the ground that it drives on, also as a share of its speed, and for how
long it does: on a crest, and when springs give."""

LEAST_HEADING_SIGMA_RAD = np.radians(0.5)

SLOPE_S = 10.0
"""A vehicle that nothing watches is for so long on one slope. One whose turns are known is on the
drive's slope all the time: it says so once."""


class Evidence(NamedTuple):
    """Rows at n nodes, by what they are, and the states to start from: level, along the fixes."""

    node_ns: Int64
    rows: dict[str, Rows]
    start: States


def evidence(
    track: AntennaTrack,
    antenna_m: Float64,
    wanted_ns: Int64,
    sensed: Inertial | None,
    steps: Steps | None,
    axes: Sequence[AxisTilt],
    ground: ExpectedGround,
) -> Evidence:
    """All that was measured, with nodes at `wanted_ns` and where else something was."""
    if sensed is not None and sensed.feels_force():
        # The camera's motion says no more than gyro and accelerometer together, and it is of longer
        # intervals.
        steps = None
    node_ns, fixed_ns = _nodes(track, wanted_ns, sensed is not None, steps)
    every, step_s = np.arange(len(node_ns)), np.diff(node_ns) / 1e9
    spacing_s = np.maximum(np.gradient(node_ns / 1e9), 1e-3) if len(node_ns) > 1 else np.ones(1)
    rows, turn_rad, watched = _motion(track, node_ns, sensed, steps)
    turned = _beside(np.isfinite(turn_rad[:, 0]))
    turn_rad = np.nan_to_num(turn_rad)
    # With nothing to tell how the vehicle turns, its roll would explain what fixes err aside.
    lever_m = np.tile(antenna_m if turned.any() else np.zeros(3), (len(node_ns), 1))
    at = np.flatnonzero(np.isin(node_ns, fixed_ns))
    place_m, sigma_m = _antenna_at(track, node_ns)
    said = lever_m[at], place_m[at]
    rows["fixes"] = Rows(model.sees_antenna, at, sigma_m[at], said, robust=True)
    heading_rad, heading_sigma = np.radians(track.headings.at(node_ns))
    start = _start(node_ns, heading_rad, heading_sigma, turn_rad[:, 2], place_m, lever_m)
    sigma = np.maximum(heading_sigma, LEAST_HEADING_SIGMA_RAD) * lasting(GROUND_S, spacing_s)
    rows["headings"] = Rows(model.heads, every, sigma[:, None], (heading_rad,))
    # A camera tells the way in the vehicle's axes: nothing needs to be taken from the ground.
    at = every[~_beside(watched)]
    speed = np.linalg.norm(start.velocity_mps[at], axis=1)
    sigma = (GROUND_MPS + GROUND_SHARE * speed) * lasting(GROUND_S, spacing_s[at])
    said = (turned[at].astype(float),)
    rows["wheels"] = Rows(model.follows_ground, at, sigma[:, None], said, robust=True)
    drive_s = float(step_s.sum())
    vertical, sigma = ground.seen_from(heading_rad)
    sigma = sigma * lasting(np.where(turned, max(drive_s, SLOPE_S), SLOPE_S), spacing_s)[:, None]
    own = np.eye(len(axes))
    for k, name in enumerate(("slope across", "slope along")):
        said = _rise(np.eye(2)[k], vertical[:, k], 0.0, np.zeros(len(axes)))
        rows[name] = Rows(model.rises, every, sigma[:, k, None], said)
    for k, axis in enumerate(axes):
        sine, sigma = axis.at(node_ns)
        at = np.flatnonzero(np.isfinite(sigma))
        framed = float(axis.frame_sigma_deg > 0.0)  # one frame leans, and not what gravity levels
        said = _rise(axis.direction, sine[at], framed, own[k])
        rows[f"axis {k}"] = Rows(model.rises, at, sigma[at, None], said, robust=True)
    return Evidence(node_ns, rows, start)


def _rise(
    direction: Float64, sine: Float64, framed: float, own: Float64
) -> tuple[Float64, Float64, Float64, Float64]:
    """What `model.rises` takes, of an axis at m nodes."""
    m = len(sine)
    return np.tile(direction, (m, 1)), sine, np.full(m, framed), np.tile(own, (m, 1))


def _motion(
    track: AntennaTrack, node_ns: Int64, sensed: Inertial | None, steps: Steps | None
) -> tuple[dict[str, Rows], Float64, Bool]:
    """The rows between nodes, the rotation vectors from each node to the next [n - 1, 3], NaN where
    nothing tells them, and where a camera saw the way [n - 1]."""
    step_s = np.diff(node_ns)[:, None] / 1e9
    n = len(step_s)
    every, zeros = np.arange(n), np.zeros((n, 3))
    # How much the receiver's slow error may change.
    wander_m = np.interp(node_ns[:-1], track.time_ns, track.wander_m)[:, None] * WANDER_SHARE
    wander_m = wander_m * np.sqrt(2.0 * step_s / WANDER_S)
    turn_rad, gyro_s = np.full((n, 3), np.nan), np.zeros(n)
    turn_sigma = TERRAIN_NOISE_RAD * np.sqrt(step_s)
    push_mps, felt_s = zeros, np.zeros(n)
    push_sigma = np.tile(ACCELERATION_NOISE * np.sqrt(step_s), 3)
    way_sigma = np.hypot(COASTING_NOISE_M * np.sqrt(step_s), wander_m)
    if sensed is not None:
        turn_rad, push_mps = increments(sensed, node_ns)
        noise = np.hypot(GYRO_NOISE, sample_noise(sensed.rate_rad_s, sensed.time_ns))
        angle_rad = np.linalg.norm(turn_rad, axis=1, keepdims=True)
        sigma = np.sqrt(noise**2 * step_s + GYRO_SQUARENESS**2 * angle_rad)
        turn_sigma = np.where(np.isfinite(turn_rad), sigma, turn_sigma)
        gyro_s = np.where(np.isfinite(turn_rad[:, 0]), step_s[:, 0], 0.0)
        noise = np.hypot(FORCE_NOISE, sample_noise(sensed.force_mps2, sensed.time_ns))
        push_sigma = np.where(np.isfinite(push_mps), noise * np.sqrt(step_s), push_sigma)
        felt_s = np.where(np.isfinite(push_mps[:, 0]), step_s[:, 0], 0.0)
    watched = np.zeros(n, dtype=np.bool_)
    rows = {}
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
        rows["camera"] = _between(model.moves, at, sigma, way_m, np.zeros(len(at)), robust=True)
        way_sigma[at] = SEEN_ELSEWHERE_M
    rows["turns"] = _between(model.turns, every, turn_sigma, np.nan_to_num(turn_rad), gyro_s)
    rows["pushes"] = _between(
        model.pushes, every, push_sigma, np.nan_to_num(push_mps), felt_s, robust=True
    )
    rows["ways"] = _between(model.moves, every, way_sigma, zeros, step_s[:, 0])
    return rows, turn_rad, watched


def _between(
    law: model.Law, at: Int64, sigma: Float64, *said: Float64, robust: bool = False
) -> Rows:
    return Rows(law, at, sigma, said, between=True, robust=robust)


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
    heading_sigma: Float64,
    right_rad: Float64,
    place_m: Float64,
    lever_m: Float64,
) -> States:
    """Level, along the fixes, with the known headings; between these it turns as was measured."""
    known = np.isfinite(heading_sigma)
    turned_rad = np.append(0.0, np.cumsum(-right_rad))
    rest_rad = (heading_rad - turned_rad)[known]
    R = R_enu_level(np.degrees(turned_rad + np.interp(node_ns, node_ns[known], rest_rad)))
    place_m = place_m - (R @ lever_m[:, :, None])[:, :, 0]
    speed_mps = np.gradient(place_m, node_ns / 1e9, axis=0) if len(node_ns) > 1 else 0.0 * place_m
    return States(place_m, speed_mps, R, np.zeros(0))


def _beside(between: Bool) -> Bool:
    """Nodes [n] with such an interval [n - 1] before or after them."""
    return np.append(between, False) | np.insert(between, 0, False)
