"""The laws between attitude, motion and positions, as residuals with their slopes.

The state of a node is where the receiver would see the sensor (its slow error included), its
velocity, and the vehicle's axes, of which changes are small rotations: R · exp([a]x). All nodes of
a stretch of some minutes share the biases of the IMU and the constant errors of recorded axes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Index
from fieldgrid.geometry import cross_matrices, from_vectors, to_vectors

STATES = 9
P, V, A = slice(0, 3), slice(3, 6), slice(6, 9)
"""Position (m), velocity (m/s) and axes (rad) of a node among the columns of a slope."""

NEXT_P, NEXT_V, NEXT_A = slice(9, 12), slice(12, 15), slice(15, 18)
"""The same of the node after it."""

SHARED = 2 * STATES
GYRO, FORCE, OWN = slice(18, 21), slice(21, 24), 24
"""Shared unknowns: bias of the gyro (rad/s) and of the accelerometer (m/s²); then the lean of the
frame that axes were recorded in, toward east and north (rad), and an error of each of the axes."""

GRAVITY_MPS2 = np.array([0.0, 0.0, -9.80665])


class States(NamedTuple):
    """The states of n nodes, [n, 3] each, `R` [n, 3, 3] from the vehicle's axes to ENU, and the
    `shared` unknowns."""

    position_m: Float64
    velocity_mps: Float64
    R: Float64
    shared: Float64

    def of(self, unknown: slice) -> Float64:
        """Shared unknowns by their columns."""
        return self.shared[unknown.start - SHARED : unknown.stop - SHARED]

    def moved(self, change: Float64, shared: Float64) -> States:
        """The states after a change [n, 9] of the nodes and one of what they share."""
        return States(
            self.position_m + change[:, P],
            self.velocity_mps + change[:, V],
            self.R @ from_vectors(change[:, A]),
            self.shared + shared,
        )


Law = Callable[..., tuple[Float64, Float64]]
"""Residuals [m, r] of states at nodes [m] by what was measured there, and their slopes [m, r, c] by
the columns above."""


class AttitudeRows(NamedTuple):
    """m measurements that follow one law, at different nodes `at`, or `between` these and the next.

    `said` is what the law takes, m long each; `sigma` [m, r] the errors. Those of `robust` ones are
    Student's: outliers are believed the less.
    """

    law: Law
    at: Index
    sigma: Float64
    said: tuple[Float64, ...]
    between: bool = False
    robust: bool = False

    def part(self, start: int, stop: int) -> AttitudeRows:
        """Those of the nodes from `start` to before `stop`, which are counted from there."""
        own = (self.at >= start) & (self.at + self.between < stop)
        said = tuple(column[own] for column in self.said)
        return self._replace(at=self.at[own] - start, sigma=self.sigma[own], said=said)

    def sigmas_off(self, x: States) -> Float64:
        """How many sigmas each is off, [m, r]."""
        return np.asarray(self.law(x, self.at, *self.said)[0] / self.sigma)


def _blank(x: States, at: Index, residuals: int) -> Float64:
    return np.zeros((len(at), residuals, SHARED + len(x.shared)))


def _times(R: Float64, vectors: Float64) -> Float64:
    return np.asarray((R @ vectors[:, :, None])[:, :, 0])


def turns(x: States, at: Index, turn_rad: Float64, gyro_s: Float64) -> tuple[Float64, Float64]:
    """The axes turn as a gyro saw it over `gyro_s` seconds, or (0 s) the camera."""
    h = gyro_s[:, None]
    between = x.R[at].swapaxes(1, 2) @ x.R[at + 1]
    measured = from_vectors(turn_rad - x.of(GYRO) * h)
    slope = _blank(x, at, 3)
    slope[:, :, A], slope[:, :, NEXT_A] = -between.swapaxes(1, 2), np.eye(3)
    slope[:, :, GYRO] = np.eye(3) * h[:, :, None]
    return to_vectors(measured.swapaxes(1, 2) @ between), slope


def pushes(x: States, at: Index, push_mps: Float64, felt_s: Float64) -> tuple[Float64, Float64]:
    """Specific force over `felt_s` seconds, and gravity, change the velocity."""
    h, R = felt_s[:, None], x.R[at]
    push = push_mps - x.of(FORCE) * h
    off = x.velocity_mps[at + 1] - x.velocity_mps[at] - GRAVITY_MPS2 * h - _times(R, push)
    slope, h = _blank(x, at, 3), h[:, :, None]
    slope[:, :, V], slope[:, :, NEXT_V] = -np.eye(3), np.eye(3)
    slope[:, :, A], slope[:, :, FORCE] = R @ cross_matrices(push), R * h
    # A gyro's bias turns the axes on the way, by half of it on average.
    slope[:, :, GYRO] = -slope[:, :, A] * (h / 2.0)
    return off, slope


def moves(x: States, at: Index, way_m: Float64, rolled_s: Float64) -> tuple[Float64, Float64]:
    """The sensor moves by its mean velocity over `rolled_s` seconds and a way [m, 3] in the axes at
    the earlier node."""
    R, half = x.R[at], rolled_s[:, None] / 2.0
    off = x.position_m[at + 1] - x.position_m[at] - _times(R, way_m)
    off = off - (x.velocity_mps[at] + x.velocity_mps[at + 1]) * half
    slope = _blank(x, at, 3)
    slope[:, :, P], slope[:, :, NEXT_P] = -np.eye(3), np.eye(3)
    slope[:, :, V] = slope[:, :, NEXT_V] = -np.eye(3) * half[:, :, None]
    slope[:, :, A] = R @ cross_matrices(way_m)
    return off, slope


def sees_antenna(
    x: States, at: Index, antenna_m: Float64, fix_m: Float64
) -> tuple[Float64, Float64]:
    """The receiver sees the antenna, `antenna_m` [m, 3] from the sensor in the vehicle's axes."""
    R, slope = x.R[at], _blank(x, at, 3)
    slope[:, :, P], slope[:, :, A] = np.eye(3), -R @ cross_matrices(antenna_m)
    return x.position_m[at] + _times(R, antenna_m) - fix_m, slope


def follows_ground(x: States, at: Index, turned: Float64) -> tuple[Float64, Float64]:
    """A vehicle on wheels leaves the ground neither upward nor downward: its way is its pitch.

    Where it is not known how it turned (0), no roll follows: it would stand for a wrong heading.
    """
    to_vehicle = x.R[at].swapaxes(1, 2)
    own, slope = _times(to_vehicle, x.velocity_mps[at]), _blank(x, at, 1)
    slope[:, :, V], slope[:, :, A] = to_vehicle[:, 2:], cross_matrices(own)[:, 2:]
    slope[:, 0, A.start + 1] *= turned
    return own[:, 2:], slope


def points(
    x: States, at: Index, toward: Float64, along: Float64, sine: Float64, own: Float64
) -> tuple[Float64, Float64]:
    """An axis of the vehicle, `toward` [m, 3] right, forward, up, rises by a sine [m] in a
    direction `along` [m, 3] east, north, up, but for the shared errors `own` [m, k] (1 of those it
    has). The first two of these are the lean of the frame in which the rise is measured."""
    R, slope = x.R[at], _blank(x, at, 1)
    seen, axis = _times(R.swapaxes(1, 2), along), _times(R, toward)
    shared = own * np.hstack([axis[:, :2], np.ones((len(at), own.shape[1] - 2))])
    slope[:, 0, A] = (toward[:, None] @ cross_matrices(seen))[:, 0]
    slope[:, 0, OWN:] = shared
    off = np.sum(seen * toward, axis=1) + shared @ x.shared[OWN - SHARED :] - sine
    return off[:, None], slope
