"""Whether the drive shows which way a gyro turns.

A gyro that is upside down turns the nose the other way. Positions tell a nose's direction but for
its gear, so of each course only the line counts, whichever way it was driven: with the right sense
all lines of a stretch, turned back by the gyro, are one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import Gyro, Steps, first_beyond
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.faults.leaps.leaps import HOLE_PERIODS, usual_period_s
from fieldgrid.poses.nodes import GYRO_HOLE_NS

LEAST_CHORD_M, CHORD_NOISES, MOST_CHORD_S = 1.0, 6.0, 10.0
"""A line joins two fixes that are farther apart than this, and than this multiple of their noise,
within this time."""

STRETCH_S, MOST_LINES, FEWEST_LINES = 40.0, 60, 3
"""Lines are compared within stretches, over which a gyro's bias is constant."""

LINE_SIGMA_RAD, STEP_SIGMA_RAD, SCALE_SIGMA = np.radians(5.0), np.radians(1.0), 0.1
"""What a line and a step of the camera may be off beside their noise, and a gyro's turn by its
scale."""

FREEDOM = 2.0
"""Of Student's distribution: a line across a cusp means nothing."""

BIAS_SIGMA_RAD_S = np.radians(1.0)
_BIASES = np.radians(np.linspace(-2.0, 2.0, 21))
_LINES = np.radians(np.arange(0.0, 180.0, 5.0))

CLEAR_NATS, ENOUGH_NATS = 4.0, 30.0
"""The sense is known from the first log likelihood ratio on; from the second on no further evidence
is sought."""

LITTLE_TURN_RAD, LITTLE_TURN_S = np.radians(10.0), 10.0
"""Where a gyro never turns by more in this time, its sense hardly matters."""


class GyroSense(NamedTuple):
    """How much likelier the drive is with the gyro as it is than with it upside down (the logarithm
    of the ratio), and whether the gyro turns at all."""

    nats: float
    turns: bool

    @property
    def is_wrong(self) -> bool:
        """Whether the gyro is upside down."""
        return self.nats < -CLEAR_NATS

    @property
    def is_unknown(self) -> bool:
        """Whether the drive turns, and does not show which way."""
        return self.turns and abs(self.nats) < CLEAR_NATS


class _GyroAngle(NamedTuple):
    """The angle of a gyro since its first sample, and the integral of that."""

    time_s: Float64
    angle: Float64
    integral: Float64

    @classmethod
    def of(cls, gyro: Gyro) -> _GyroAngle:
        time_s = (gyro.time_ns - gyro.time_ns[0]) / 1e9
        step_s = np.diff(time_s)
        angle = np.concatenate([[0.0], np.cumsum(step_s * _between(gyro.rate_rad_s))])
        return cls(time_s, angle, np.concatenate([[0.0], np.cumsum(step_s * _between(angle))]))

    def at(self, time_s: Float64, values: Float64) -> Float64:
        return np.asarray(np.interp(time_s, self.time_s, values))


def _between(values: Float64) -> Float64:
    return (values[1:] + values[:-1]) / 2.0


def gyro_sense(fixes: AcceptedFixes, steps: Steps | None, gyro: Gyro) -> GyroSense:
    """What fixes and camera say of the way in which a gyro of two samples or more turns."""
    turned = _GyroAngle.of(gyro)
    nats = 0.0 if steps is None else _by_steps(steps, gyro, turned)
    if abs(nats) < ENOUGH_NATS:
        nats += _by_lines(fixes, gyro, turned)
    rate_bias = float(np.median(gyro.rate_rad_s))
    later = np.minimum(turned.time_s + LITTLE_TURN_S, turned.time_s[-1])
    by = turned.at(later, turned.angle) - turned.angle - rate_bias * (later - turned.time_s)
    return GyroSense(nats, bool(np.abs(by).max() > LITTLE_TURN_RAD))


def _by_steps(steps: Steps, gyro: Gyro, turned: _GyroAngle) -> float:
    start_s, stop_s = ((ns - gyro.time_ns[0]) / 1e9 for ns in (steps.start_ns, steps.stop_ns))
    inside = (start_s >= 0.0) & (stop_s <= turned.time_s[-1])
    told = turned.at(stop_s, turned.angle) - turned.at(start_s, turned.angle)
    variance = np.radians(steps.sigma_deg) ** 2 + STEP_SIGMA_RAD**2 + (SCALE_SIGMA * told) ** 2
    bias = _BIASES[:, None]

    def likeliest(sense: float) -> float:
        off = np.radians(steps.turn_deg) - sense * (told - bias * (stop_s - start_s))
        return _most(off[:, inside], variance[inside], _BIASES)

    return likeliest(1.0) - likeliest(-1.0)


def course_lines(fixes: AcceptedFixes, gyro: Gyro) -> tuple[Float64, Float64]:
    """The direction of the path between fixes, good to 14° of noise, radians, and its instants,
    seconds since the first sample of the gyro; either way round, as in reverse."""
    points, time_s = fixes.points_m(), (fixes.time_ns - gyro.time_ns[0]) / 1e9
    a, b = _noisy_chords(fixes, points, time_s)
    way = points[b] - points[a]
    return np.arctan2(way[:, 0], way[:, 1]), _middle(time_s, a, b)


def _noisy_chords(fixes: AcceptedFixes, points: Float64, time_s: Float64) -> tuple[Int64, Int64]:
    noise_m = float(np.median(fixes.noise.across_m))
    return _chords(points, time_s, max(LEAST_CHORD_M, CHORD_NOISES * noise_m))


def _by_lines(fixes: AcceptedFixes, gyro: Gyro, turned: _GyroAngle) -> float:
    points, time_s = fixes.points_m(), (fixes.time_ns - gyro.time_ns[0]) / 1e9
    noise_m = float(np.median(fixes.noise.across_m))
    a, b = _noisy_chords(fixes, points, time_s)
    use = (time_s[a] >= 0.0) & (time_s[b] <= turned.time_s[-1])
    a, b = a[use], b[use]
    way, span_s, middle_s = points[b] - points[a], time_s[b] - time_s[a], _middle(time_s, a, b)
    line = np.arctan2(way[:, 0], way[:, 1])
    variance = 2.0 * noise_m**2 / (way**2).sum(axis=1) + LINE_SIGMA_RAD**2
    nose = (turned.at(time_s[b], turned.integral) - turned.at(time_s[a], turned.integral)) / span_s
    holes = np.cumsum(np.diff(gyro.time_ns, prepend=gyro.time_ns[0]) > GYRO_HOLE_NS)
    hole = holes[np.searchsorted(gyro.time_ns, fixes.time_ns[a]).clip(max=len(holes) - 1)]
    stretch = np.unique(
        np.stack([hole, np.floor(middle_s / STRETCH_S)]), axis=1, return_inverse=True
    )[1].ravel()
    nats = 0.0
    for one in range(int(stretch.max(initial=-1)) + 1):
        at = np.flatnonzero(stretch == one)
        at = at[:: max(1, len(at) // MOST_LINES)]
        if len(at) >= FEWEST_LINES:
            told, since_s = nose[at] - np.median(nose[at]), middle_s[at] - middle_s[at].mean()
            nats += _by_stretch(line[at], told, since_s, variance[at])
        if abs(nats) > ENOUGH_NATS:
            break
    return nats


def _middle(time_s: Float64, a: Int64, b: Int64) -> Float64:
    return (time_s[a] + time_s[b]) / 2.0


def _by_stretch(line: Float64, told: Float64, since_s: Float64, variance: Float64) -> float:
    variance = variance + (SCALE_SIGMA * told) ** 2
    bias = _BIASES[:, None, None]

    def likeliest(sense: float) -> float:
        off = line - _LINES[:, None] - sense * (told - bias * since_s)
        return _most(off - np.pi * np.round(off / np.pi), variance, _BIASES[:, None])

    return likeliest(1.0) - likeliest(-1.0)


def _most(off: Float64, variance: Float64, bias: Float64) -> float:
    """The largest logarithm of the likelihood over biases (the first axis), but for a constant."""
    nats = -(FREEDOM + 1.0) / 2.0 * np.log1p(off**2 / variance / FREEDOM).sum(axis=-1)
    return float((nats - (bias / BIAS_SIGMA_RAD_S) ** 2 / 2.0).max())


def _chords(points: Float64, time_s: Float64, reach_m: float) -> tuple[Int64, Int64]:
    """The first and the last fix of lines that follow each other, none of them across a hole."""
    step_s = np.diff(time_s)
    part = np.concatenate([[0], np.cumsum(step_s > HOLE_PERIODS * usual_period_s(step_s))])
    ends = np.searchsorted(part, part, side="right").tolist()
    far = first_beyond(points, reach_m, 1).tolist()
    found, at = [], 0
    while at < len(points):
        to = far[at]
        if not at < to < ends[at]:
            at = ends[at]
            continue
        if time_s[to] - time_s[at] < MOST_CHORD_S:
            found.append((at, to))
        at = to
    pairs = np.array(found, dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]
