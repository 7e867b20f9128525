"""Which fixes of a drive belong together: those that one vehicle can have driven through.

A fix cannot be judged by the one before it, which may be the wrong one. So the drive is followed
as a whole: of all sequences of fixes, the one is taken that keeps the most fixes with the least
strain between neighbours. It can leave out any number of fixes, and for a price it can go on
elsewhere, where the solution has moved; it is never locked out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, GateLimits, Int64, kernel, part_of_kernel
from fieldgrid.poses.gates.scatter import short_term_sigma_m

_AROUND_S = 1.0
_LEAST_AROUND, _MOST_AROUND = 5, 12  # steps on either side of a fix that tell its velocity
_GAP_S, _GAP_STEPS = 1.5, 3.0
_LOOK_BACK = 1000
_SIGMA_DOUBT = 10.0  # how many times the stated sigma the measured noise may raise it to
_ANYWHERE_M = 1e7  # a sigma that says no more than "on Earth"
_LEAST_WORTH = 0.25


class MotionEnvelope(NamedTuple):
    """How the vehicle can have moved: row by row, all of length n, and the price of a seam.

    `distance_*_m` is the way driven from the first row by the velocity around each row, which jumps
    of the position do not enter; `slack_m` is a running sum, too: how far off that way it can have
    come. `worth` is 1 for a fix as good as most of the log, less for worse ones.
    """

    time_ns: Int64
    east_m: Float64
    north_m: Float64
    distance_east_m: Float64
    distance_north_m: Float64
    slack_m: Float64
    noise_m: Float64
    worth: Float64
    seam_price: float


class Transition(NamedTuple):
    """What lies between two rows: how far apart, how far off the way, and what is explained."""

    seconds: float
    moved_m: float
    off_m: float
    explained_m: float
    strain: float
    along_m: float
    across_m: float
    distance_m: float


def motion_envelope(
    time_ns: Int64,
    east_m: Float64,
    north_m: Float64,
    sigma_m: Float64,
    limits: GateLimits,
) -> MotionEnvelope:
    """The motion around each row. Rows are ordered by time."""
    step_s = np.diff(time_ns) / 1e9
    period_s = float(np.median(step_s[step_s > 0.0])) if np.any(step_s > 0.0) else 1.0
    half = int(np.clip(math.ceil(_AROUND_S / period_s), _LEAST_AROUND, _MOST_AROUND))
    gap_s = max(_GAP_S, _GAP_STEPS * period_s)
    velocity = np.stack(
        [
            _around(np.diff(axis), step_s, gap_s, half, limits.max_speed_mps)
            for axis in (east_m, north_m)
        ]
    )
    pace_mps = np.minimum(np.hypot(*velocity), limits.max_speed_mps)
    velocity *= pace_mps / np.maximum(np.hypot(*velocity), 1e-9)
    way = _running(0.5 * (velocity[:, 1:] + velocity[:, :-1]) * step_s)
    free_m = limits.speed_margin_mps * step_s + np.minimum(
        0.5 * limits.max_acceleration_mps2 * step_s**2, limits.max_speed_mps * step_s
    )
    # The stated sigma, raised to the noise that the log has, but no more than tenfold.
    measured_m = short_term_sigma_m(east_m, north_m, time_ns, 0.0)
    sigma_m = np.minimum(sigma_m, _ANYWHERE_M)
    sigma_m = np.maximum(sigma_m, np.minimum(measured_m, _SIGMA_DOUBT * sigma_m))
    noise_m = limits.sigmas * math.sqrt(2.0) * sigma_m
    return MotionEnvelope(
        time_ns,
        east_m,
        north_m,
        way[0],
        way[1],
        _running(free_m),
        noise_m + limits.timing_s * pace_mps,
        np.clip(np.sqrt(np.median(sigma_m) / sigma_m), _LEAST_WORTH, 1.0),
        max(limits.moved_fixes, math.ceil(limits.moved_s / period_s)) - 1.0,
    )


def follow(envelope: MotionEnvelope) -> tuple[Bool, Bool]:
    """The sequence of rows that keeps the most of them with the least strain: rows that are kept,
    and those of them at which the solution has moved."""
    n = len(envelope.time_ns)
    kept, seam = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    if n:
        score, before, moved = envelope.worth.copy(), np.full(n, -1), seam.copy()
        _follow(*envelope, _LOOK_BACK, score, score.copy(), before, moved)
        row = int(np.argmax(score))
        while row >= 0:
            kept[row], seam[row] = True, moved[row]
            row = int(before[row])
    return kept, seam


def transition(envelope: MotionEnvelope, a: int, b: int) -> Transition:
    """What lies between rows `a` and `b`, of which `a` is the earlier one."""
    east_m, north_m = (
        envelope.east_m[b] - envelope.east_m[a],
        envelope.north_m[b] - envelope.north_m[a],
    )
    way_e, way_n = (
        axis[b] - axis[a] for axis in (envelope.distance_east_m, envelope.distance_north_m)
    )
    off_e, off_n, distance_m = east_m - way_e, north_m - way_n, math.hypot(way_e, way_n)
    noise_m = max(envelope.noise_m[a], envelope.noise_m[b])
    unit_e, unit_n = (way_e / distance_m, way_n / distance_m) if distance_m > 0.0 else (0.0, 1.0)
    return Transition(
        seconds=float(envelope.time_ns[b] - envelope.time_ns[a]) / 1e9,
        moved_m=math.hypot(east_m, north_m),
        off_m=math.hypot(off_e, off_n),
        explained_m=float(envelope.slack_m[b] - envelope.slack_m[a] + noise_m),
        strain=float(_strain(*envelope[:7], a, b)),
        along_m=off_e * unit_e + off_n * unit_n,
        across_m=off_e * unit_n - off_n * unit_e,
        distance_m=distance_m,
    )


def _running(steps: Float64) -> Float64:
    """Sums from the first row to each row, along the last axis."""
    start = np.zeros((*steps.shape[:-1], 1))
    return np.concatenate([start, np.cumsum(steps, axis=-1)], axis=-1)


@kernel
def _around(moved_m: Float64, step_s: Float64, gap_s: float, half: int, top_mps: float) -> Float64:
    """The median velocity of the steps around each row, on one axis, without crossing gaps.

    A jump that lasts is one wrong step among many, so it does not show in it.
    """
    n = len(moved_m) + 1
    found = np.empty(n)
    some = np.empty(2 * half)
    for k in range(n):
        found[k], count = 0.0, 0
        for direction in (-1, 1):
            at = k - 1 if direction < 0 else k
            for _ in range(half):
                if at < 0 or at >= n - 1 or step_s[at] > gap_s:
                    break
                # A step that nothing drives tells of no motion.
                if step_s[at] > 0.0 and abs(moved_m[at]) <= top_mps * step_s[at]:
                    # Kept in order: NumPy's median takes three seconds to compile.
                    one, place = moved_m[at] / step_s[at], count
                    while place > 0 and some[place - 1] > one:
                        some[place] = some[place - 1]
                        place -= 1
                    some[place] = one
                    count += 1
                at += direction
        if count:
            found[k] = (some[(count - 1) // 2] + some[count // 2]) / 2.0
    return found


@part_of_kernel
def _strain(
    time_ns: Int64,
    east_m: Float64,
    north_m: Float64,
    distance_east_m: Float64,
    distance_north_m: Float64,
    slack_m: Float64,
    noise_m: Float64,
    a: int,
    b: int,
) -> float:
    """How far row `b` is from where `a` leads, over what explains it: a drive is 1 at most."""
    if time_ns[b] <= time_ns[a]:
        return np.inf
    east, north = east_m[b] - east_m[a], north_m[b] - north_m[a]
    off_east = east - (distance_east_m[b] - distance_east_m[a])
    off_north = north - (distance_north_m[b] - distance_north_m[a])
    noise = max(noise_m[a], noise_m[b])
    return float(np.hypot(off_east, off_north) / (slack_m[b] - slack_m[a] + noise))


@kernel
def _follow(
    time_ns: Int64,
    east_m: Float64,
    north_m: Float64,
    distance_east_m: Float64,
    distance_north_m: Float64,
    slack_m: Float64,
    noise_m: Float64,
    worth: Float64,
    seam_price: float,
    look_back: int,
    score: Float64,
    peak: Float64,
    before: Int64,
    seam: Bool,
) -> None:
    """Fill in the score of the best sequence that ends in each row, the row before it, and if it is
    a seam. At first `score` and `peak`, which is room, are the worth of each, `before` is -1 and
    nothing a seam.

    A row counts its worth less the square of the strain that leads to it, so one that is barely
    possible counts nothing; a bad fix before a good one does not make that a bad one, so the
    strain counts by the lesser of the two. After a seam it counts its worth less the price.
    """
    for k in range(len(time_ns)):
        for j in range(k - 1, max(-1, k - 1 - look_back), -1):
            if score[k] >= peak[j] + worth[k] and before[k] >= 0:
                break  # nothing earlier can lead to more
            if time_ns[k] <= time_ns[j]:
                continue
            strain = _strain(
                time_ns, east_m, north_m, distance_east_m, distance_north_m,
                slack_m, noise_m, j, k,
            )  # fmt: skip
            joined = strain <= 1.0
            loss = strain * strain * min(worth[j], worth[k]) if joined else seam_price
            total = score[j] + worth[k] - loss
            if total > score[k] or (total == score[k] and before[k] < 0):
                score[k], before[k], seam[k] = total, j, not joined
        peak[k] = max(score[k], peak[k - 1]) if k else score[k]
