"""Forward or reverse, from the track: legs between cusps, and the likeliest gear of each.

A vehicle that stops and drives back leaves a cusp: the course turns by half a circle and the
nose does not. The path is cut wherever it turns sharply; whether a cut is a cusp, and which of
two legs is the reverse one, is decided for the whole drive at once, by what it costs a nose to
turn at each cut, by what gyro and wheels saw, and by the habit of driving forward.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64
from fieldgrid.geometry import first_beyond, heading_deg, wrap_deg
from fieldgrid.poses.gears.course import runs_of
from fieldgrid.poses.gears.habits import Habits
from fieldgrid.poses.gears.holes import back_m, carried_on_nats, edge_mps, tight_nats

CUT_DEG = 75.0
"""A path whose direction before and after a point differs by more may have turned back there."""

ALIKE_DEG = 15.0
"""Turnings that differ by less are equally sharp."""

REACH_M, REACH_SIGMAS = 0.3, 8.0
"""How far around a point its turning and its course are looked at: at least this, and beyond the
noise."""

TANGENT_REACH_M = 1.5
"""The direction in which a leg begins or ends is that of this much of it."""

NOSE_TURN_DEG = 30.0
"""How far a nose turns within a tangent's reach of a cut: 1.5 m at a radius of 3 m."""

GYRO_TURN_DEG = 12.0
"""How far a nose turns within a tangent's reach of a cut, beyond what a gyro saw it turn."""

LEAST_TURN_DPS, MOST_TURN_DPS, USUAL_TURN_DPS = 10.0, 45.0, 20.0
"""How fast a vehicle may turn while nobody sees it, degrees a second: as fast as the fastest of
its turns that were seen, within these, or as is usual."""

FEWEST_TURNS = 20

FASTEST_SHARE = 0.98
"""The fastest turns are taken to be those above this share of all."""

UNSEEN_TURN_SHARE = 0.5
"""A turn that nobody sees is mostly not the fastest, and does not last throughout."""

LOOSEST_M, TIGHTEST_M, TIGHTER_SHARE = 3.0, 1.0, 0.7
"""Unseen, a vehicle turns no tighter than at this share of the smallest radius that was seen, which
is taken to be within these."""

SWITCH_COST, TURN_COST_CAP = 2.0, 12.0
"""In nats: for a change of gear that is usual and seen, and the most that a turn can cost."""

UNMOVED_MPS = 1.0
"""The speed of a vehicle that is never seen to drive."""

_SURE = 700.0
"""Nats beyond which nothing is in doubt, and whose exponential is a number still."""

FIRST_FORWARD_NATS = 2.0
"""How much likelier a drive begins forward."""

WANDER_M, WANDER_SIGMAS = 0.5, 15.0
"""A standing vehicle's positions wander about this far; such a leg may be skipped."""

MAX_SKIPPED, SKIP_CAP_NATS = 4, 12.0
"""Largest number of legs in a row that may be skipped, and the largest cost of skipping them."""

REVERSE_CAP_NATS = 15.0
"""What a single leg's length can say at most of its gear."""


class Gears(NamedTuple):
    """For each of n points: `gear` +1 forward or -1 reverse, `doubt` 0..1, the probability
    that it is the other one, and `leg`, which numbers the stretches between cuts. `driven` is
    False where the vehicle rather stood and its positions wandered, or nobody can tell."""

    gear: Int64
    doubt: Float64
    leg: Int64
    driven: Bool


class GearEvidence(NamedTuple):
    """What the gears are told from, n points in order of time.

    `points_m` [n, 2] is east, north at `time_s`. `gap_s` is for how long the drive was not seen
    before a point: 0 nearly everywhere, infinite at the first one. `turned_deg` is what a gyro saw
    the vehicle turn on the way to each point, NaN where none did. `forward_nats` is the log odds,
    of forward over reverse, that wheels or camera saw on the way to each point; 0 without them.
    """

    points_m: Float64
    time_s: Float64
    gap_s: Float64
    sigma_m: Float64
    turned_deg: Float64
    forward_nats: Float64


class _Join(NamedTuple):
    """A way from leg `one` to leg `two`: what it costs in the same gear, and in the other, beside
    the habit. `hole_m` is how far it drives meanwhile, if that is a hole, and `carried` the nats by
    which positions say that it drove on in it."""

    one: int
    two: int
    stay: float
    change: float
    hole_m: float = 0.0
    carried: float = 0.0

    def weights(self, habits: Habits) -> tuple[Float64, Float64]:
        """Log weights [h, 2] of the same gear, from forward and from reverse, and [h, 1] of the
        other one."""
        if self.hole_m > 0.0:
            stay, change = habits.hole(self.hole_m, self.carried)
        else:
            change = habits.cusp() - SWITCH_COST
            stay = np.zeros((len(change), 2))
        return stay - self.stay, change[:, None] - self.change


def gears(track: GearEvidence) -> Gears:
    """The gear at each point of a drive, and how sure it is."""
    n = len(track.points_m)
    if n == 0:
        none = np.zeros(0, np.int64)
        return Gears(none, np.zeros(0), none, np.zeros(0, np.bool_))
    starts = _cut(track)
    legs = list(zip(starts, [*starts[1:], n], strict=True))
    habits = Habits.usual()
    # By its length, and by what wheels or camera saw, each leg has weights [h, 2] in either gear.
    way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(track.points_m, axis=0).T)))
    seen = [float(track.forward_nats[a + 1 : b].sum()) for a, b in legs]
    own = np.array([habits.leg(way_m[b - 1] - way_m[a], REVERSE_CAP_NATS) for a, b in legs])
    own += np.array(seen)[:, None, None] * [0.5, -0.5]
    own[0, :, 0] += FIRST_FORWARD_NATS
    gear, doubt, driven = _likeliest(own, _joins(track, legs), habits)
    lengths = [b - a for a, b in legs]
    leg = np.repeat(np.arange(len(legs), dtype=np.int64), lengths)
    return Gears(
        np.repeat(gear, lengths), np.repeat(doubt, lengths), leg, np.repeat(driven, lengths)
    )


def _cut(track: GearEvidence) -> list[int]:
    """Where legs begin: after each gap, and at each point where the path turns sharply, or
    otherwise than the gyro: who turns back on the spot and goes on in reverse leaves no cusp."""
    points = track.points_m
    reach_m = max(REACH_M, REACH_SIGMAS * float(np.median(track.sigma_m)))
    part = np.cumsum(track.gap_s > 0.0, dtype=np.int64)
    before, after = (first_beyond(points, reach_m, step, part) for step in (-1, 1))
    turn = turn_between(points, before, after)
    # How differently from the path the gyro saw the vehicle turn, from the middle of the way to
    # each point to that of the way on; 0 where it did not see all.
    at = np.flatnonzero((before >= 0) & (after >= 0))
    first, last = (before[at] + at) // 2, (at + after[at]) // 2
    blind, in_all_deg = np.cumsum(~np.isfinite(track.turned_deg)), np.nancumsum(track.turned_deg)
    slip = np.abs(wrap_deg(turn[at] - in_all_deg[last] + in_all_deg[first]))
    seen = np.where(blind[last] == blind[first], slip, 0.0)
    turning = np.maximum(np.abs(turn), np.bincount(at, seen, len(turn)).astype(np.float64))
    starts = {0, *np.flatnonzero(track.gap_s).tolist()}
    for start, stop in runs_of(turning > CUT_DEG):
        starts |= set(_tips(points, turning, start, stop, reach_m))
    return sorted(starts)


def _tips(points: Float64, turning: Float64, first: int, last: int, reach_m: float) -> list[int]:
    """The sharpest points of a run of sharp ones, each `reach_m` from the next.

    Within reach of a cusp every point turns by about half a circle, and noise makes one of them
    the sharpest: the tip is the middle one of those, or the rest of them would be a second tip.
    """
    run = points[first:last]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(run, axis=0).T))])
    left = turning[first:last].copy()
    tips = []
    while left.max() > CUT_DEG:
        peak = int(np.argmax(left))
        alike = left >= left[peak] - ALIKE_DEG
        near = np.flatnonzero(alike & (np.abs(along - along[peak]) < 2.0 * reach_m))
        middle_m = (along[near[0]] + along[near[-1]]) / 2.0
        tip = int(near[np.argmin(np.abs(along[near] - middle_m))])
        tips.append(first + tip)
        left[np.hypot(*(run - run[tip]).T) < reach_m] = 0.0
        left[peak] = 0.0
    return tips


def turn_between(points: Float64, before: Int64, after: Int64) -> Float64:
    """Clockwise turn of a path [n, 2] at each point, degrees, between the points `before` and
    `after` it; 0 where one of them is -1, which is none."""
    turning = np.zeros(len(points))
    at = np.flatnonzero((before >= 0) & (after >= 0))
    come, go = points[at] - points[before[at]], points[after[at]] - points[at]
    cross = come[:, 1] * go[:, 0] - come[:, 0] * go[:, 1]
    dot = come[:, 0] * go[:, 0] + come[:, 1] * go[:, 1]
    turning[at] = np.degrees(list(map(math.atan2, cross.tolist(), dot.tolist())))
    return turning


def _joins(track: GearEvidence, legs: list[tuple[int, int]]) -> list[_Join]:
    """Every way to go on from a leg: to the next, or past a few that may be mere wander."""
    joins = []
    # What it costs, in nats, to say that a vehicle did not drive a leg but stood there.
    wander_m = [max(WANDER_M, WANDER_SIGMAS * float(track.sigma_m[a])) for a, _ in legs]
    size_m = [float(np.hypot(*np.ptp(track.points_m[a:b], axis=0))) for a, b in legs]
    skipping = [1.0 + 2.0 * (a / b) ** 2 for a, b in zip(size_m, wander_m, strict=True)]
    seen = turning_seen(track)
    for i in range(len(legs) - 1):
        skipped = 0.0
        for j in range(i + 1, min(i + 2 + MAX_SKIPPED, len(legs))):
            joins.append(_joined(track, (i, j), (legs[i], legs[j]), seen, skipped))
            skipped += skipping[j]
            if skipped > SKIP_CAP_NATS or track.gap_s[legs[j][0]]:
                break
    return joins


def _joined(
    track: GearEvidence,
    pair: tuple[int, int],
    spans: tuple[tuple[int, int], tuple[int, int]],
    seen: TurningSeen,
    skipped: float,
) -> _Join:
    """The way from one leg to another, past some that are skipped at that cost."""
    one, two = spans
    gap_s = float(track.gap_s[two[0]])
    # A cut belongs to the later leg and ends the earlier one; a gap has two sides.
    end = one[1] if gap_s else one[1] + 1
    before, after = track.points_m[one[0] : end], track.points_m[two[0] : two[1]]
    chords = _chord_deg(before[::-1]), _chord_deg(after)
    (out, out_m, back), (into, into_m, on) = chords
    hole_m, carried = 0.0, 0.0
    if gap_s:
        hole_m = seen.usual_mps * gap_s
        carried = _carried_nats(track, (one[0], end - 1, two[0]), chords, seen)
    if min(out_m, into_m) == 0.0:
        return _Join(*pair, skipped, skipped, hole_m, carried)
    # A chord has the direction of its middle.
    turned = float(track.turned_deg[end - back // 2 : two[0] + on // 2 + 1].sum())
    known = bool(np.isfinite(turned))
    noise_deg = np.degrees(1.5 * track.sigma_m[two[0]] / min(out_m, into_m))
    unseen_deg = 0.0 if known else UNSEEN_TURN_SHARE * seen.fastest_dps * gap_s
    sigma = np.hypot(np.hypot(GYRO_TURN_DEG if known else NOSE_TURN_DEG, noise_deg), unseen_deg)
    beyond_deg = into - (out + 180.0) - (turned if known else 0.0)

    def cost(nose_turn_deg: float) -> float:
        return min(0.5 * (float(wrap_deg(nose_turn_deg)) / float(sigma)) ** 2, TURN_COST_CAP)

    return _Join(
        *pair, skipped + cost(beyond_deg), skipped + cost(beyond_deg + 180.0), hole_m, carried
    )


def _carried_nats(
    track: GearEvidence,
    edge: tuple[int, int, int],
    chords: tuple[tuple[float, float, int], tuple[float, float, int]],
    seen: TurningSeen,
) -> float:
    """The nats by which positions say that a vehicle drove on in a hole: `edge` is where the leg
    before it begins and ends, and where the next one begins."""
    begun, across, arrived = edge
    (out, out_m, back), (into, into_m, on) = chords
    gap_s = float(track.gap_s[arrived])
    speeds_mps = (
        out_m / max(track.time_s[across] - track.time_s[across - back], 1e-3),
        into_m / max(track.time_s[arrived + on] - track.time_s[arrived], 1e-3),
    )
    step_m, sigma_m = track.points_m[arrived] - track.points_m[across], track.sigma_m[arrived]
    path = track.points_m, track.time_s
    at_edges = (
        min(edge_mps(*path, across, max(begun, across - back)), speeds_mps[0]),
        min(edge_mps(*path, arrived, arrived + on), speeds_mps[1]),
    )
    carried = carried_on_nats(
        float(np.hypot(*step_m)),
        sum(speeds_mps) / 2.0 * gap_s,
        back_m(speeds_mps, at_edges, gap_s),
        float(sigma_m),
    )
    if min(out_m, into_m) == 0.0:
        return carried
    bearings, most_m = (out + 180.0, into), max(speeds_mps) * gap_s
    return carried - tight_nats(step_m, bearings, seen.radius_m, most_m, gap_s, float(sigma_m))


class TurningSeen(NamedTuple):
    """How fast a vehicle turns at its fastest, degrees a second, and at its tightest, and how fast
    it mostly drives, as far as its path was seen."""

    fastest_dps: float
    radius_m: float
    usual_mps: float


def turning_seen(track: GearEvidence) -> TurningSeen:
    """The fastest and the tightest of the turns of a path, but for the few that noise makes."""
    points, part = track.points_m, np.cumsum(track.gap_s > 0.0, dtype=np.int64)
    away = [first_beyond(points, TANGENT_REACH_M, step, part) for step in (-1, 1)]
    turn = turn_between(points, away[0], away[1])
    known = (away[0] >= 0) & (away[1] >= 0) & (np.abs(turn) < CUT_DEG)
    driven = np.flatnonzero(track.gap_s[1:] == 0.0)
    step_m = np.hypot(*(points[driven + 1] - points[driven]).T)
    step_s = np.maximum(track.time_s[driven + 1] - track.time_s[driven], 1e-3)
    usual_mps = float(np.median(step_m / step_s)) if driven.size else UNMOVED_MPS
    if np.count_nonzero(known) < FEWEST_TURNS:
        return TurningSeen(USUAL_TURN_DPS, TIGHTEST_M, usual_mps)
    turned_deg = np.abs(turn[known])
    span_s = track.time_s[away[1][known]] - track.time_s[away[0][known]]
    # From the middle of the way in to the middle of the way out.
    fastest = float(np.quantile(turned_deg / np.maximum(span_s / 2.0, 0.05), FASTEST_SHARE))
    bend = float(np.radians(np.quantile(turned_deg, FASTEST_SHARE))) / TANGENT_REACH_M
    return TurningSeen(
        float(np.clip(fastest, LEAST_TURN_DPS, MOST_TURN_DPS)),
        float(np.clip(TIGHTER_SHARE / max(bend, 1e-3), TIGHTEST_M, LOOSEST_M)),
        usual_mps,
    )


def _chord_deg(points: Float64) -> tuple[float, float, int]:
    """Direction from the first of the points to the first beyond a tangent's reach (or to the
    farthest), degrees, how far that is, and which point it is."""
    away = np.hypot(*(points - points[0]).T)
    beyond = np.flatnonzero(away >= TANGENT_REACH_M)
    to = int(beyond[0]) if beyond.size else int(np.argmax(away))
    return float(heading_deg(*(points[to] - points[0]))), float(away[to]), to


def _likeliest(own: Float64, joins: list[_Join], habits: Habits) -> tuple[Int64, Float64, Bool]:
    """The gear of each leg, the probability of the other, and whether it was driven at all:
    sums over all habits and all sequences of gears; `own` [n, h, 2] are the legs' log weights.

    A leg that is rather skipped than driven takes the gear of the one before it, and is in as
    much doubt as it may have been driven in the other after all.
    """
    n = len(own)
    # Log weights of [forward, reverse] by each habit, of all that comes before a leg, and after it.
    left, right = np.full(own.shape, -np.inf), np.full(own.shape, -np.inf)
    left[0], right[n - 1] = habits.share[:, None], 0.0
    weights = [join.weights(habits) for join in joins]
    for join, (stay, change) in zip(joins, weights, strict=True):
        known = left[join.one] + own[join.one]
        reach = np.logaddexp(known + stay, known[:, ::-1] + change)
        left[join.two] = np.logaddexp(left[join.two], reach)
    for join, (stay, change) in zip(reversed(joins), reversed(weights), strict=True):
        known = right[join.two] + own[join.two]
        reach = np.logaddexp(known + stay, known[:, ::-1] + change)
        right[join.one] = np.logaddexp(right[join.one], reach)
    total = np.logaddexp.reduce(left + own + right, axis=1)
    odds = total[:, 0] - total[:, 1]
    every = float(np.logaddexp(*total[0]))
    driven = np.logaddexp(total[:, 0], total[:, 1]) >= every + np.log(0.5)
    at = np.maximum.accumulate(np.where(driven, np.arange(n), 0))
    gear = np.where(odds >= 0.0, 1, -1).astype(np.int64)[at]
    doubt = np.array([1.0 / (1.0 + math.exp(min(abs(one), _SURE))) for one in odds[at].tolist()])
    other = np.exp(np.where(gear > 0, total[:, 1], total[:, 0]) - every)
    return gear, np.where(driven, doubt, np.maximum(doubt, other)), driven
