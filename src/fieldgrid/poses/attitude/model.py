"""The laws between attitude, motion and positions, as weighted residuals with their slopes.

The state of a node is where the receiver would see the sensor (its slow error included), its
velocity, and the vehicle's axes. The biases of gyro and accelerometer are shared by all nodes of a
stretch of some minutes. Changes of the axes are small rotations about them: R · exp([a]x).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Index
from fieldgrid.geometry import cross_matrices, from_vectors, heading_rad, to_vectors

STATES = 9
P, V, A = slice(0, 3), slice(3, 6), slice(6, 9)
"""Position (m), velocity (m/s) and axes (rad) among the states of a node."""

SHARED = 9
GYRO, GYRO_DRIFT, FORCE = slice(0, 3), slice(3, 6), slice(6, 9)
"""Bias of the gyro in the middle of the stretch (rad/s), its drift (rad/s²), and bias of the
accelerometer (m/s²) among the shared unknowns. Constant errors of recorded axes follow them: first
the lean of the frame that they were recorded in, toward east and north, then one each."""

FRAME = slice(SHARED, SHARED + 2)

GRAVITY_MPS2 = np.array([0.0, 0.0, -9.80665])


class States(NamedTuple):
    """The states of n nodes, [n, 3] each, `R` [n, 3, 3] from the vehicle's axes to ENU, and the
    `shared` unknowns [9 or more]; `since_s` [n] is the time since the middle of the stretch."""

    position_m: Float64
    velocity_mps: Float64
    R: Float64
    shared: Float64
    since_s: Float64

    def moved(self, change: Float64, shared: Float64) -> States:
        """The states after a change [n, 9] of the nodes and one of what they share."""
        return States(
            self.position_m + change[:, P],
            self.velocity_mps + change[:, V],
            self.R @ from_vectors(change[:, A]),
            self.shared + shared,
            self.since_s,
        )


class Law(NamedTuple):
    """m instances of one law of r residuals, at nodes `node` [m] or between them and the next.

    `slope` [m, r, 9 or 18] is by the states of the node, or of both; `shared` [m, r, 9 or more] by
    the first shared unknowns, None where they do not enter; `weight` [m, r] is 1 / sigma².
    """

    node: Index
    residual: Float64
    slope: Float64
    weight: Float64
    shared: Float64 | None = None


def _later(part: slice) -> slice:
    return slice(part.start + STATES, part.stop + STATES)


def _times(R: Float64, vectors: Float64) -> Float64:
    rotated: Float64 = np.einsum("mij,mj->mi", R, vectors)
    return rotated


def turns(x: States, at: Index, turn_rad: Float64, weight: Float64, gyro_s: Float64) -> Law:
    """The axes turn as the camera (`gyro_s` 0) or a gyro over `gyro_s` seconds saw it."""
    h = gyro_s[:, None]
    late = x.since_s[at][:, None] + h / 2.0
    bias = x.shared[GYRO] + x.shared[GYRO_DRIFT] * late
    between = x.R[at].swapaxes(1, 2) @ x.R[at + 1]
    measured = from_vectors(turn_rad - bias * h)
    slope, shared = np.zeros((len(at), 3, 2 * STATES)), np.zeros((len(at), 3, SHARED))
    slope[:, :, A], slope[:, :, _later(A)] = -between.swapaxes(1, 2), np.eye(3)
    shared[:, :, GYRO] = np.eye(3) * h[:, :, None]
    shared[:, :, GYRO_DRIFT] = np.eye(3) * (h * late)[:, :, None]
    return Law(at, to_vectors(measured.swapaxes(1, 2) @ between), slope, weight, shared)


def pushes(
    x: States, at: Index, step_s: Float64, speed_mps: Float64, way_m: Float64, weight: Float64
) -> Law:
    """Specific force and gravity change the velocity, and both of them the position."""
    h = step_s[:, None]
    R = x.R[at]
    push = speed_mps - x.shared[FORCE] * h
    way = way_m - x.shared[FORCE] * (h * h / 2.0)
    speed_off = x.velocity_mps[at + 1] - x.velocity_mps[at] - GRAVITY_MPS2 * h - _times(R, push)
    way_off = x.position_m[at + 1] - x.position_m[at] - x.velocity_mps[at] * h
    way_off -= GRAVITY_MPS2 * (h * h / 2.0) + _times(R, way)
    slope, shared = np.zeros((len(at), 6, 2 * STATES)), np.zeros((len(at), 6, SHARED))
    one, h = np.eye(3), h[:, :, None]
    slope[:, :3, V], slope[:, :3, _later(V)] = -one, one
    slope[:, 3:, P], slope[:, 3:, _later(P)], slope[:, 3:, V] = -one, one, -one * h
    slope[:, :3, A], slope[:, 3:, A] = R @ cross_matrices(push), R @ cross_matrices(way)
    shared[:, :3, FORCE], shared[:, 3:, FORCE] = R * h, R * (h * h / 2.0)
    # A gyro's bias turns the axes on the way, by half of it on average.
    shared[:, :3, GYRO] = -slope[:, :3, A] * (h / 2.0)
    return Law(at, np.hstack([speed_off, way_off]), slope, weight, shared)


def coasts(x: States, at: Index, step_s: Float64, weight: Float64) -> Law:
    """Without an accelerometer: velocities change little, and positions by their mean."""
    h = step_s[:, None]
    speed_off = x.velocity_mps[at + 1] - x.velocity_mps[at]
    mean_mps = (x.velocity_mps[at + 1] + x.velocity_mps[at]) / 2.0
    way_off = x.position_m[at + 1] - x.position_m[at] - mean_mps * h
    slope, one = np.zeros((len(at), 6, 2 * STATES)), np.eye(3)
    slope[:, :3, V], slope[:, :3, _later(V)] = -one, one
    slope[:, 3:, P], slope[:, 3:, _later(P)] = -one, one
    slope[:, 3:, V] = slope[:, 3:, _later(V)] = -one * (h / 2.0)[:, :, None]
    return Law(at, np.hstack([speed_off, way_off]), slope, weight)


def moves(x: States, at: Index, way_m: Float64, weight: Float64) -> Law:
    """The sensor moved as the camera saw it, `way_m` [m, 3] in the axes at the earlier node."""
    off = x.position_m[at + 1] - x.position_m[at] - _times(x.R[at], way_m)
    slope = np.zeros((len(at), 3, 2 * STATES))
    slope[:, :, P], slope[:, :, _later(P)] = -np.eye(3), np.eye(3)
    slope[:, :, A] = x.R[at] @ cross_matrices(way_m)
    return Law(at, off, slope, weight)


def sees_antenna(x: States, at: Index, antenna_m: Float64, fix_m: Float64, weight: Float64) -> Law:
    """The receiver sees the antenna, `antenna_m` [3] from the sensor in the vehicle's axes."""
    R = x.R[at]
    slope = np.zeros((len(at), 3, STATES))
    slope[:, :, P], slope[:, :, A] = np.eye(3), -R @ cross_matrices(antenna_m)
    return Law(at, x.position_m[at] + R @ antenna_m - fix_m, slope, weight)


def follows_ground(x: States, at: Index, weight: Float64, turned: Bool) -> Law:
    """A vehicle on wheels leaves the ground neither upward nor downward: its way is its pitch.

    Where it is not known how the vehicle turns, no roll follows from it: it would stand for a
    heading that is a little off.
    """
    own = _times(x.R[at].swapaxes(1, 2), x.velocity_mps[at])
    slope = np.zeros((len(at), 1, STATES))
    slope[:, :, V] = x.R[at].swapaxes(1, 2)[:, 2:]
    slope[:, :, A] = cross_matrices(own)[:, 2:]
    slope[~turned, :, A.start + 1] = 0.0
    return Law(at, own[:, 2:], slope, weight)


def heads(x: States, at: Index, known_rad: Float64, weight: Float64) -> Law:
    """The heading is known: where the forward axis points. A turn about that axis leaves it."""
    R = x.R[at]
    off = heading_rad(R) - known_rad
    off -= 2.0 * np.pi * np.round(off / (2.0 * np.pi))
    slope = np.zeros((len(at), 1, STATES))
    right, ahead, up = R[:, :2, 0], R[:, :2, 1], R[:, :2, 2]
    level2 = (ahead**2).sum(axis=1)
    slope[:, 0, A.start] = (up[:, 0] * ahead[:, 1] - up[:, 1] * ahead[:, 0]) / level2
    slope[:, 0, A.start + 2] = (right[:, 1] * ahead[:, 0] - right[:, 0] * ahead[:, 1]) / level2
    return Law(at, off[:, None], slope, weight)


def leans(x: States, at: Index, vertical: Float64, weight: Float64) -> Law:
    """The vertical is known as the vehicle sees it: its right and forward part [m, 2]."""
    own = x.R[at][:, 2]
    slope = np.zeros((len(at), 2, STATES))
    slope[:, :, A] = cross_matrices(own)[:, :2]
    return Law(at, own[:, :2] - vertical, slope, weight)


def rises(
    x: States,
    at: Index,
    direction: Float64,
    sine: Float64,
    weight: Float64,
    own: int,
    framed: bool,
) -> Law:
    """A level axis of the vehicle, `direction` [2] right and forward, rises by a recorded sine [m],
    but for the constant error number `own` of the axis and, of a `framed` one, for the lean of the
    frame."""
    R = x.R[at]
    axis = R[:, :, :2] @ direction
    along = axis[:, :2] * float(framed)
    slope, shared = np.zeros((len(at), 1, STATES)), np.zeros((len(at), 1, len(x.shared)))
    slope[:, 0, A] = direction @ cross_matrices(R[:, 2])[:, :2]
    shared[:, 0, FRAME], shared[:, 0, FRAME.stop + own] = along, 1.0
    off = axis[:, 2] + along @ x.shared[FRAME] + x.shared[FRAME.stop + own] - sine
    return Law(at, off[:, None], slope, weight[:, None], shared)
