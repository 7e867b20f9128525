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
import numpy.typing as npt

from fieldgrid.core import Bool, Float64, GateLimits, Int64, kernel
from fieldgrid.poses.faults.leaps.leaps import HOLE_PERIODS, HOLE_S
from fieldgrid.poses.gates.scatter import SECOND_S, short_term_sigma_m

Complex = npt.NDArray[np.complex128]

_LEAST_AROUND, _MOST_AROUND = 5, 12  # steps on either side of a fix that tell its velocity
_LOOK_BACK = 1000
_SIGMA_DOUBT = 10.0  # how many times the stated sigma the measured noise may raise it to
_ANYWHERE_M = 1e7  # a sigma that says no more than "on Earth"
_LEAST_WORTH = 0.25


class MotionEnvelope(NamedTuple):
    """How the vehicle can have moved: row by row, all of length n, and the price of a seam.

    `way_m` is the way driven from the first row by the velocity around each row, which jumps of the
    position do not enter, and `off_m` how far the row lies off it, both east + i north; `slack_m`
    is a running sum, too: how far off that way it can have come. `worth` is 1 for a fix as good as
    most of the log, less for worse ones.
    """

    time_ns: Int64
    off_m: Complex
    slack_m: Float64
    noise_m: Float64
    worth: Float64
    way_m: Complex
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
    half = int(np.clip(math.ceil(SECOND_S / period_s), _LEAST_AROUND, _MOST_AROUND))
    gap_s = max(HOLE_S, HOLE_PERIODS * period_s)
    east_mps, north_mps = (
        _around(np.diff(axis), step_s, gap_s, half, limits.max_speed_mps)
        for axis in (east_m, north_m)
    )
    velocity = east_mps + 1j * north_mps
    pace_mps = np.minimum(abs(velocity), limits.max_speed_mps)
    velocity *= pace_mps / np.maximum(abs(velocity), 1e-9)
    way_m = np.append(0.0, np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * step_s))
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
        east_m + 1j * north_m - way_m,
        np.append(0.0, np.cumsum(free_m)),
        noise_m + limits.timing_s * pace_mps,
        np.clip(np.sqrt(np.median(sigma_m) / sigma_m), _LEAST_WORTH, 1.0),
        way_m,
        max(limits.moved_fixes, math.ceil(limits.moved_s / period_s)) - 1.0,
    )


def follow(envelope: MotionEnvelope) -> tuple[Bool, Bool]:
    """The sequence of rows that keeps the most of them with the least strain: rows that are kept,
    and those of them at which the solution has moved."""
    n = len(envelope.time_ns)
    kept, seam = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    score, before, moved = envelope.worth.copy(), np.full(n, -1), seam.copy()
    _follow(*envelope[:5], envelope.seam_price, score, score.copy(), before, moved)
    row = int(np.argmax(score))
    while row >= 0:
        kept[row], seam[row] = True, moved[row]
        row = int(before[row])
    return kept, seam


def transition(envelope: MotionEnvelope, a: int, b: int) -> Transition:
    """What lies between rows `a` and `b`, of which `a` is the earlier one."""
    off, way = (complex(c[b] - c[a]) for c in (envelope.off_m, envelope.way_m))
    ahead = off * way.conjugate() / abs(way) if way else off * -1j
    seconds = float(envelope.time_ns[b] - envelope.time_ns[a]) / 1e9
    noise_m = max(envelope.noise_m[a], envelope.noise_m[b])
    explained_m = float(envelope.slack_m[b] - envelope.slack_m[a] + noise_m)
    return Transition(
        seconds=seconds,
        moved_m=abs(off + way),
        off_m=abs(off),
        explained_m=explained_m,
        strain=abs(off) / explained_m if seconds > 0.0 else math.inf,
        along_m=ahead.real,
        across_m=-ahead.imag,
        distance_m=abs(way),
    )


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


@kernel
def _follow(
    time_ns: Int64,
    off_m: Complex,
    slack_m: Float64,
    noise_m: Float64,
    worth: Float64,
    seam_price: float,
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
        for j in range(k - 1, max(-1, k - 1 - _LOOK_BACK), -1):
            if score[k] >= peak[j] + worth[k] and before[k] >= 0:
                break  # nothing earlier can lead to more
            if time_ns[k] <= time_ns[j]:
                continue
            # How far the row is from where the other leads, over what explains it.
            noise = max(noise_m[j], noise_m[k])
            strain = abs(off_m[k] - off_m[j]) / (slack_m[k] - slack_m[j] + noise)
            joined = strain <= 1.0
            loss = strain * strain * min(worth[j], worth[k]) if joined else seam_price
            total = score[j] + worth[k] - loss
            if total > score[k] or (total == score[k] and before[k] < 0):
                score[k], before[k], seam[k] = total, j, not joined
        peak[k] = max(score[k], peak[k - 1]) if k else score[k]
