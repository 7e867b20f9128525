"""Roll and pitch of a drive against gravity, from all that it carries, by least squares.

An accelerometer sees gravity and the vehicle's own acceleration; fixes tell the latter, and a
gyro carries the axes from fix to fix. Without an accelerometer the camera's motion is laid along
the antenna's way in three dimensions: its climb shows the pitch, and a turn of the vehicle makes
roll of it. Without either, the climb of the fixes is the pitch, and the roll is what slopes of the
drive's size allow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import (
    Inertial,
    R_enu_level,
    RecordedTilt,
    Steps,
    heading_rad,
    roll_pitch_deg,
)
from fieldgrid.poses.attitude import model
from fieldgrid.poses.attitude.attitude import TERRAIN_NOISE_RAD, Attitude
from fieldgrid.poses.attitude.axes import AxisTilt, agreed
from fieldgrid.poses.attitude.ground import ExpectedGround, expected_ground
from fieldgrid.poses.attitude.measurements import AntennaTrack, AttitudeMeasurements, measure
from fieldgrid.poses.attitude.model import Law, States
from fieldgrid.poses.attitude.solver import AttitudeEquations, covariances, normal_equations, solved

STRETCH_S, OVERLAP_S = 240.0, 20.0
"""Longer drives are estimated stretch by stretch: a gyro's bias drifts evenly only so long."""

MOST_ROUNDS, ENOUGH_RAD = 12, 2e-4

FREEDOM = 4.0
"""Of Student's distribution, by which fixes and pushes err: outliers are believed the less."""

SHARED_SIGMA = np.repeat([np.radians(1.0), np.radians(0.002), 0.2], 3)
"""Bias of a gyro (rad/s), its drift (rad/s²), and bias of an accelerometer with what it is out
of the vehicle's axes (m/s²): 0.2 m/s² is a degree."""

ACCELERATION_NOISE, COASTING_NOISE_M = 1.0, 0.02
"""Without an accelerometer: change of speed, (m/s)/√s, and way beyond the mean speed, m/√s."""

SEEN_ELSEWHERE_M = 1.0
"""How little velocities say of a way that the camera saw."""

LEAST_WAY_SIGMA_M = 1e-4

GROUND_MPS, GROUND_SHARE, GROUND_S = 0.03, 0.02, 5.0
"""How fast a sensor leaves the ground that it drives on, also as a share of its speed, and for how
long it does: on a crest, and when springs give."""

LEAST_HEADING_SIGMA_RAD = np.radians(0.5)

SLOPE_S = 10.0
"""A vehicle that nothing watches is for so long on one slope. One whose turns are known is on the
drive's slope all the time: it says so once."""

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
    *,
    wanted_ns: Int64 | None = None,
    sensed: Inertial | None = None,
    steps: Steps | None = None,
    tilt: RecordedTilt | None = None,
    axes: Sequence[AxisTilt] = (),
) -> Attitude:
    """Roll and pitch over a drive of at least two fixes.

    `antenna_m` [3] is the antenna as seen from the sensor, in the vehicle's axes (right, forward,
    up). `wanted_ns` are instants at which the attitude must be known as exactly as may be: those
    of images. `axes` that contradict the rest of the drive are left out, which the notes tell. The
    same input gives the same bits.
    """
    wanted = np.zeros(0, dtype=np.int64) if wanted_ns is None else np.unique(wanted_ns)
    said = track, antenna_m, wanted, sensed, steps, tilt
    if not axes:
        return _estimate(*said, ())
    without = _estimate(*said, ())
    kept, notes = agreed(axes, [without.rise_at(axis) for axis in axes])
    attitude = _estimate(*said, kept) if kept else without
    return attitude._replace(notes=notes, bodies=frozenset(axis.body for axis in kept))


def _estimate(
    track: AntennaTrack,
    antenna_m: Float64,
    wanted_ns: Int64,
    sensed: Inertial | None,
    steps: Steps | None,
    tilt: RecordedTilt | None,
    axes: Sequence[AxisTilt],
) -> Attitude:
    """Roll and pitch by all of this."""
    node_ns, seen = measure(track, wanted_ns, sensed, steps, tilt, axes)
    ground = expected_ground(track)
    # With nothing to tell how the vehicle turns, its roll would explain what fixes err aside.
    lever_m = antenna_m if seen.moved.turned.any() else np.zeros(3)
    parts = [
        _estimated(seen.part(*outer), lever_m, ground, axes, inner)
        for outer, inner in _stretches(seen.time_s)
    ]
    columns = np.concatenate([part for part, _ in parts], axis=1)
    roll, pitch, roll_sigma, pitch_sigma, heading, up = columns
    heading = np.degrees(np.unwrap(heading))
    pushed = np.concatenate([off for _, off in parts])
    return Attitude(
        *(node_ns, roll, pitch, roll_sigma, pitch_sigma, heading, up, ground.sigma_deg()),
        _rms(pushed) if len(pushed) else math.nan,
    )


def _stretches(time_s: Float64) -> list[tuple[tuple[int, int], slice]]:
    """Nodes (start, stop) of each stretch with its overlap, and which of them it speaks for."""
    count = max(round(float(time_s[-1]) / STRETCH_S), 1)
    edges_s = np.linspace(0.0, float(time_s[-1]), count + 1)
    found = []
    for first_s, last_s in pairwise(edges_s.tolist()):
        start, stop = np.searchsorted(time_s, [first_s - OVERLAP_S, last_s + OVERLAP_S])
        own, after = np.searchsorted(time_s, [first_s, last_s])
        if last_s == time_s[-1]:
            stop = after = len(time_s)
        if after > own:  # nobody drives at night
            found.append(((int(start), int(stop)), slice(int(own - start), int(after - start))))
    return found


def _estimated(
    seen: AttitudeMeasurements,
    antenna_m: Float64,
    ground: ExpectedGround,
    axes: Sequence[AxisTilt],
    own: slice,
) -> tuple[Float64, Float64]:
    """Roll, pitch and their sigmas, degrees, heading, radians, and height, metres, [6, own nodes]
    of one stretch, and how many sigmas each push of the accelerometer is off."""
    lasting = _lasting_sigma(axes)
    x = _first_guess(seen, antenna_m, len(lasting))
    robust = False
    for k in range(MOST_ROUNDS):
        change, shared = solved(_system(x, seen, antenna_m, ground, axes, robust))
        x, robust = x.moved(change, shared), True
        if k > 1 and np.abs(change[:, model.A]).max() < ENOUGH_RAD:
            break
    blocks, _ = covariances(_system(x, seen, antenna_m, ground, axes, robust))
    roll, pitch = roll_pitch_deg(x.R)
    variance = np.stack([blocks[:, 7, 7], blocks[:, 6, 6]])  # about the forward axis, the right one
    # How many sigmas each push of the accelerometer is off, and how much less sure than by the
    # sigmas of its measurements all of a stretch is: pushes with all their outliers, as those of
    # wrong axes are, fixes without.
    push, *_ = _moves(x, seen, robust=False)
    fix, *_ = _at_nodes(x, seen, antenna_m, ground, robust=False)
    pushed = (np.sqrt(push.weight) * push.residual)[:, :3]
    misfit = max(_rms(pushed), _rms(np.sqrt(_student(fix).weight) * fix.residual))
    misfit = misfit if misfit > USUAL_MISFIT else 1.0
    sigma = np.hypot(np.degrees(np.sqrt(variance)) * misfit, LEAST_SIGMA_DEG)
    return np.vstack([roll, pitch, sigma, heading_rad(x.R), x.position_m[:, 2]])[:, own], pushed


def _rms(values: Float64) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _lasting_sigma(axes: Sequence[AxisTilt]) -> Float64:
    """Sigmas of the shared unknowns."""
    if not axes:
        return SHARED_SIGMA
    frame = np.radians([max(max(axis.frame_sigma_deg for axis in axes), LEAST_LASTING_DEG)] * 2)
    mount = np.radians([max(axis.mount_sigma_deg, LEAST_LASTING_DEG) for axis in axes])
    return np.concatenate([SHARED_SIGMA, frame, mount])


def _first_guess(seen: AttitudeMeasurements, antenna_m: Float64, shared: int) -> States:
    """Level, along the fixes, with the known headings; between these it turns as was measured."""
    n = len(seen.time_s)
    heading_rad, known = seen.heading_rad, np.isfinite(seen.heading_sigma_rad)
    if known.any():
        turned_rad = np.append(0.0, np.cumsum(-np.nan_to_num(seen.moved.turn_rad[:, 2])))
        rest_rad = (heading_rad - turned_rad)[known]
        heading_rad = turned_rad + np.interp(seen.time_s, seen.time_s[known], rest_rad)
    R = R_enu_level(np.degrees(heading_rad))
    place, known = np.zeros((n, 3)), np.isfinite(seen.fix_m[:, 0])
    for axis in range(3 if known.any() else 0):
        place[:, axis] = np.interp(seen.time_s, seen.time_s[known], seen.fix_m[known, axis])
    place = place - R @ antenna_m
    speed = np.asarray(np.gradient(place, seen.time_s, axis=0)) if n > 1 else np.zeros((n, 3))
    since_s = seen.time_s - (seen.time_s[0] + seen.time_s[-1]) / 2.0
    return States(place, speed, R, np.zeros(shared), since_s)


def _system(
    x: States,
    seen: AttitudeMeasurements,
    antenna_m: Float64,
    ground: ExpectedGround,
    axes: Sequence[AxisTilt],
    robust: bool,
) -> AttitudeEquations:
    """The normal equations of all that is known, linearised at `x`."""
    moved = seen.moved
    at, hidden = np.flatnonzero(moved.turned), np.flatnonzero(~moved.turned)
    terrain = 1.0 / (TERRAIN_NOISE_RAD**2 * np.diff(seen.time_s)[hidden, None])
    still = np.zeros((len(hidden), 3))
    weight = moved.turn_sigma_rad[at] ** -2.0
    laws = [
        model.turns(x, at, moved.turn_rad[at], weight, moved.gyro_s[at]),
        model.turns(x, hidden, still, terrain, np.zeros(len(hidden))),
        *_moves(x, seen, robust),
        *_at_nodes(x, seen, antenna_m, ground, robust),
        *_rises(x, seen, axes),
    ]
    return normal_equations(laws, len(seen.time_s), x.shared, _lasting_sigma(axes))


def _rises(x: States, seen: AttitudeMeasurements, axes: Sequence[AxisTilt]) -> Iterator[Law]:
    """The recorded axes."""
    for own, (axis, (sine, sigma)) in enumerate(zip(axes, seen.risen, strict=True)):
        at = np.flatnonzero(np.isfinite(sigma))
        framed = axis.frame_sigma_deg > 0.0  # one frame leans, and not what gravity levels
        yield model.rises(x, at, axis.direction, sine[at], sigma[at] ** -2.0, own, framed)


def _moves(x: States, seen: AttitudeMeasurements, robust: bool) -> list[Law]:
    """How position and velocity go on: by the accelerometer, by the camera, or by themselves."""
    moved, step_s = seen.moved, np.diff(seen.time_s)
    at, alone = np.flatnonzero(moved.pushed), np.flatnonzero(~moved.pushed)
    watched = np.flatnonzero(moved.watched & ~moved.pushed)
    sigma, h = moved.push_sigma[at], step_s[at]
    drift_m = np.maximum(sigma * h / np.sqrt(3.0), LEAST_WAY_SIGMA_M)
    way_sigma = np.hypot(drift_m[:, None], moved.wander_m[at])
    weight = np.hstack([np.repeat(sigma[:, None], 3, axis=1), way_sigma]) ** -2.0
    push = model.pushes(x, at, h, moved.push_mps[at], moved.push_m[at], weight)
    h = step_s[alone, None]
    way_sigma = np.hypot(COASTING_NOISE_M * np.sqrt(h), moved.wander_m[alone])
    way_sigma[moved.watched[alone]] = SEEN_ELSEWHERE_M
    speed_sigma = np.repeat(ACCELERATION_NOISE * np.sqrt(h), 3, axis=1)
    coast = model.coasts(x, alone, h[:, 0], np.hstack([speed_sigma, way_sigma]) ** -2.0)
    way_sigma = np.hypot(moved.way_sigma_m[watched], moved.wander_m[watched])
    camera = model.moves(x, watched, moved.way_m[watched], way_sigma**-2.0)
    return [_student(push) if robust else push, coast, _student(camera) if robust else camera]


def _at_nodes(
    x: States, seen: AttitudeMeasurements, antenna_m: Float64, ground: ExpectedGround, robust: bool
) -> list[Law]:
    """Fixes, headings, recorded tilts, and what ground and slopes are like."""
    every = np.arange(len(seen.time_s))
    spacing_s = np.maximum(np.gradient(seen.time_s), 1e-3) if len(every) > 1 else np.ones(1)
    fixed, recorded = (
        np.flatnonzero(np.isfinite(column)) for column in (seen.fix_m[:, 0], seen.vertical_sigma)
    )
    fix = model.sees_antenna(
        x, fixed, antenna_m, seen.fix_m[fixed], seen.fix_sigma_m[fixed] ** -2.0
    )
    # A camera tells the way in the vehicle's axes: nothing needs to be taken from the ground.
    rolling = every[~_beside(seen.moved.watched)]
    off_mps = GROUND_MPS + GROUND_SHARE * np.linalg.norm(x.velocity_mps[rolling], axis=1)
    weight = off_mps**-2.0 * np.minimum(spacing_s[rolling] / GROUND_S, 1.0)
    turned = _beside(seen.moved.turned)
    rolls = model.follows_ground(x, rolling, weight[:, None], turned[rolling])
    heading_sigma = np.maximum(seen.heading_sigma_rad, LEAST_HEADING_SIGMA_RAD)
    heading = model.heads(
        x,
        every,
        seen.heading_rad,
        (heading_sigma**-2.0 * np.minimum(spacing_s / GROUND_S, 1.0))[:, None],
    )
    lasting_s = np.where(turned, seen.time_s[-1] - seen.time_s[0], SLOPE_S)
    vertical, sigma = ground.seen_from(seen.heading_rad)
    lean_weight = sigma**-2.0 * np.minimum(spacing_s / np.maximum(lasting_s, SLOPE_S), 1.0)[:, None]
    return [
        _student(fix) if robust else fix,
        _student(rolls) if robust else rolls,
        heading,
        model.leans(x, every, vertical, lean_weight),
        model.leans(
            x,
            recorded,
            seen.vertical[recorded],
            np.repeat(seen.vertical_sigma[recorded, None] ** -2.0, 2, axis=1),
        ),
    ]


def _beside(between: Bool) -> Bool:
    """Nodes [n] with such an interval [n - 1] before or after them."""
    return np.append(between, False) | np.insert(between, 0, False)


def _student(law: Law) -> Law:
    """The law with Student's weights: a sigma off costs nothing, ten cost nearly everything."""
    share = (FREEDOM + 1.0) / (FREEDOM + law.weight * law.residual**2)
    return law._replace(weight=law.weight * np.minimum(share, 1.0))
