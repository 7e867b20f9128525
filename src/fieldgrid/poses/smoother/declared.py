"""What was declared of antenna and clocks, and what the receiver states: what the drive says of it,
and how unsure it leaves poses.

Some numbers may be off: each is usually off by little, and sometimes, where somebody measured or
typed it wrong or a solution is wrong, by much. A drive says how likely each choice is of those that
are wrong; what survives counts in its sigmas. Nothing of it is applied.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64
from fieldgrid.poses.smoother.envelope import STATES, backward, forward
from fieldgrid.poses.smoother.equations import CONSTANTS
from fieldgrid.poses.smoother.model import (
    ACROSS_NOISE,
    BIAS_E,
    BIAS_N,
    CAMERA_SCALE,
    CAMERA_YAW,
    KAPPA,
    NO_BIAS_M,
    PHI,
    SLIP_ANGLE,
    E,
    N,
    V,
    step_rows,
)
from fieldgrid.poses.smoother.rounds import Linear, SmoothingProblem, Solution, inverse
from fieldgrid.poses.smoother.slow_error import TOLD_SHARE

ASIDE, AHEAD, LATE, IMAGES, SLIP, DRIFT = range(6)
"""The antenna's place to the right and ahead, metres; the delay of the fixes, and what the stamps
of images lack, seconds; the slip angle of the axle that does not steer, rad per m/s² across; how
the fixes drift beside a camera, metres."""

SHAPES = 3
"""The drift is a sum of so many cosines, of 1, 2 and 3 halves of a period over the drive, east and
north. What changes faster is the slow error's."""

USUAL_SIGMAS = np.array([0.05, 0.05, 0.02, 0.02, SLIP_ANGLE, 0.0])
"""How far off they usually are: a place that was measured, the stamps of two clocks, tyres. Fixes
drift as much as they state."""

WRONG_SIGMAS = np.array([1.0, 1.0, 0.5, 0.5, SLIP_ANGLE, 0.3])
"""How far off they are where they are wrong."""

WRONG_NATS = math.log(0.02)
"""How likely each of them is wrong before the drive. No slip angle is wrong: no one declares it."""

SURVIVING = 0.05
"""What is less likely after the drive, as a share of the likeliest, counts no more."""

LIKELY = 0.9
"""What is said to be wrong is so by this probability at least."""

EDGE_S = 0.5
"""What bends a turn is unsure for so long before it and after it, too."""

MOST_MISFIT = 4.0
"""Numbers that are as usual are more sigmas away once in 100,000 drives; with those of a camera,
once in 1,000."""

SEEN_SIGMAS = 3.0
"""A drift of so many sigmas would be seen."""


class Constant(NamedTuple):
    """A constant of the drive, with its 1-sigma error."""

    value: float
    sigma: float


class Hypothesis(NamedTuple):
    """Which of the numbers are `wrong`, how much likelier the drive makes that than that none is,
    nats, and what the numbers are then: their means [k] and covariance [k, k]."""

    wrong: tuple[int, ...]
    nats: float
    mean: Float64
    covariance: Float64


class DeclaredCorrection(NamedTuple):
    """What a drive says of the numbers: `of` [k] is what each is of, the `information` [k, k] and
    the `right` side [k] are their normal equations, all states following; `usual` [k] is how far
    off they usually are."""

    of: Int64
    information: Float64
    right: Float64
    usual: Float64

    def _sigma(self, wrong: Sequence[int]) -> Float64:
        """How far off each number may be, [k]."""
        return np.where(np.isin(self.of, wrong), WRONG_SIGMAS[self.of], self.usual)

    def hypothesis(self, wrong: Sequence[int]) -> Hypothesis:
        """The numbers when some of them are wrong: Laplace's approximation."""
        sigma = self._sigma(wrong)
        precision = self.information + np.diag(1.0 / sigma**2)
        covariance: Float64 = np.asarray(np.linalg.inv(precision), np.float64)
        mean = covariance @ self.right
        _, spread = np.linalg.slogdet(precision * np.outer(sigma, sigma))
        nats = 0.5 * float(self.right @ mean) - 0.5 * float(spread) + len(wrong) * WRONG_NATS
        return Hypothesis(tuple(wrong), nats, mean, covariance)

    def hypotheses(self) -> list[tuple[Hypothesis, float]]:
        """Each choice of what is wrong, of the numbers that the drive tells anything of, with its
        probability."""
        may = ASIDE, AHEAD, LATE, IMAGES, DRIFT
        told = [k for k in may if self.information[self.of == k].any()]
        # Numbers that do not fit together are not all as usual.
        sizes = range(int(bool(told) and self.contradicts), len(told) + 1)
        every = [self.hypothesis(wrong) for k in sizes for wrong in combinations(told, k)]
        nats = np.array([one.nats for one in every])
        shares = np.exp(nats - nats.max())
        return list(zip(every, (shares / shares.sum()).tolist(), strict=True))

    def nats(self) -> float:
        """How much likelier the drive is with numbers that may be off than with exact ones."""
        return float(np.logaddexp.reduce([one.nats for one, _ in self.hypotheses()]))

    def probability(self, *some: int) -> float:
        """How likely any of some numbers is wrong."""
        return sum(share for one, share in self.hypotheses() if set(some) & set(one.wrong))

    def second_moment(self) -> Float64:
        """The mean square [k, k] of what the numbers are off, over all that may be wrong."""
        every = self.hypotheses()
        least = SURVIVING * max(share for _, share in every)
        kept = [(one, share) for one, share in every if share >= least]
        return np.asarray(
            sum(share * (one.covariance + np.outer(one.mean, one.mean)) for one, share in kept)
            / sum(share for _, share in kept)
        )

    def off(self, k: int, *beside: int) -> Constant:
        """What the k-th is off if it is wrong, with others `beside` it."""
        found = self.hypothesis((k, *beside))
        at = int(np.argmax(self.of == k))
        return Constant(float(found.mean[at]), math.sqrt(found.covariance[at, at]))

    def extent_m(self, time_s: Float64) -> float:
        """How far apart fixes lie by their drift, if they do."""
        drift = self.hypothesis((DRIFT,)).mean[self.of == DRIFT]
        return (
            float(np.hypot(*np.ptp(shapes(time_s) @ drift.reshape(-1, 2), axis=0)))
            if len(drift)
            else 0.0
        )

    def tells_drift(self, most_m: float) -> bool:
        """Whether it would be seen that fixes drift by so much from one end to the other."""
        variances = np.diagonal(self.hypothesis((DRIFT,)).covariance)[self.of == DRIFT]
        return len(variances) > 0 and 2.0 * SEEN_SIGMAS * math.sqrt(variances.max()) < most_m

    def misfit(self, *wrong: int) -> float:
        """How many sigmas the numbers are from what is usual, but for those that are `wrong`."""
        sigma = self._sigma(wrong)
        spread = self.information + self.information @ np.diag(sigma**2) @ self.information
        return math.sqrt(
            max(float(self.right @ np.linalg.pinv(spread, hermitian=True) @ self.right), 0.0)
        )

    @property
    def contradicts(self) -> bool:
        """Whether sensors and declarations do not fit together."""
        return self.misfit() > MOST_MISFIT

    @property
    def unsure_late_s(self) -> float:
        """How late the stamps of fixes or gyro may be, 1-sigma, also where the place of the antenna
        explains a contradiction better."""
        late_s = self.off(LATE).value if self.contradicts else 0.0
        return math.hypot(math.sqrt(self.second_moment()[LATE, LATE]), late_s)

    def explains(self, k: int) -> bool:
        """Whether most of what does not fit together would with the k-th of them alone."""
        return self.misfit(k) < self.misfit() / 2.0


class Unsure(NamedTuple):
    """How unsure the numbers leave the nodes [n], 1-sigma: headings in radians; places in
    metres along one axis, of the axle and, of a log alone, of the antenna."""

    heading_rad: Float64
    axle_m: Float64
    antenna_m: Float64


def tested(
    problem: SmoothingProblem, found: Solution, linear: Linear
) -> tuple[DeclaredCorrection, Unsure]:
    """What a drive says of what was declared, and how unsure that leaves it: one step of Gauss and
    Newton with all states following."""
    measured = problem.measured
    of = np.array([ASIDE, AHEAD, LATE, IMAGES, SLIP, *measured.sees_way() * 2 * SHAPES * [DRIFT]])
    followed, information, right = _told(problem, found, linear, of)
    # Positions alone fit any antenna and any stamps; and an antenna aside is the faster one in a
    # turn, which only those see who see the speed.
    turned = measured.sees_turns() or measured.records_headings()
    share = np.full(len(of), TOLD_SHARE)
    share[[AHEAD, LATE]] *= turned
    share[LATE] *= not measured.one_clock
    share[ASIDE] *= turned and measured.sees_speed()
    usual = USUAL_SIGMAS[of]
    usual[AHEAD] = max(usual[AHEAD], problem.ahead_sigma_m)
    usual[DRIFT:] = max(float(np.median(measured.bias_m)), NO_BIAS_M)
    information = np.sqrt(np.outer(share, share)) * information
    declared = DeclaredCorrection(of, information, share * right, usual)
    moment = declared.second_moment()
    response = np.negative(followed, out=followed).reshape(-1, STATES, len(of))
    # Headings in the clock of the fixes.
    if len(measured.time_s) > 1:
        response[:, PHI, LATE] -= np.gradient(found.x[:, PHI], measured.time_s)

    def sigma(axis: int, of: Float64) -> Float64:
        by = response[:, axis]
        return np.asarray(np.sqrt(np.maximum(np.einsum("na,ab,nb->n", by, of, by), 0.0)))

    near_s = np.linspace(-EDGE_S, EDGE_S, 9)
    at = np.searchsorted(measured.time_s, measured.time_s + near_s[:, None], side="right") - 1
    heading_rad = np.max(sigma(PHI, moment)[np.clip(at, 0, None)], axis=0)
    # Nobody knows where fixes that drift were right: any pose may be off by half of the way.
    drift_m = declared.probability(DRIFT) * declared.extent_m(measured.time_s) / 2.0
    moment[of == DRIFT] = moment[:, of == DRIFT] = 0.0
    if problem.ahead_sigma_m:  # an axle that nobody names moves no antenna
        moment[AHEAD] = moment[:, AHEAD] = 0.0
    axle_m = np.hypot(sigma(E, moment), sigma(N, moment)) / math.sqrt(2.0)
    moment[:IMAGES] = moment[:, :IMAGES] = 0.0
    antenna_m = np.hypot(sigma(E, moment), sigma(N, moment)) / math.sqrt(2.0)
    return declared, Unsure(heading_rad, np.hypot(axle_m, drift_m), np.hypot(antenna_m, drift_m))


def shapes(time_s: Float64) -> Float64:
    """The cosines of a drift at some instants [n, shapes]."""
    share = (time_s - time_s[0]) / max(float(time_s[-1] - time_s[0]), 1e-9)
    return np.asarray(np.cos(np.pi * np.outer(share, np.arange(1, SHAPES + 1))))


def _told(
    problem: SmoothingProblem, found: Solution, linear: Linear, of: Int64
) -> tuple[Float64, Float64, Float64]:
    """How all states follow the numbers [states, k], the information matrix [k, k] of these, and
    their right side [k]."""
    system, active = linear.system, linear.active
    followed, beside, corner, right = couplings(problem, found, of)
    # Solved in place, as it is large of a long drive, and not by BLAS, whose sums are in another
    # order where another thread uses it, too.
    forward(system.shape, system.values, followed)
    information = corner - np.einsum("sa,sb->ab", followed, followed)
    backward(system.shape, system.values, followed)
    right = right - np.einsum("sa,s->a", followed, system.right)
    if len(active):
        aside = np.einsum("sc,sa->ca", system.border[:, active], followed) - beside[active]
        constants = inverse(linear.schur) @ aside
        information = information - aside.T @ constants
        followed += np.einsum("sc,ca->sa", linear.coupling, constants)
    return followed, information, right


def couplings(
    problem: SmoothingProblem, found: Solution, of: Int64
) -> tuple[Float64, Float64, Float64, Float64]:
    """How the residuals of fixes, steps and motion depend on what is tested, numbers `of` [k].

    Returns the coupling with the states [states, k] and with the constants [constants, k], the
    corner [k, k], the right side [k].
    """
    measured, x = problem.measured, found.x
    step_s = np.diff(measured.time_s)
    size = len(of)
    border, corner, right = np.zeros((len(x), STATES, size)), np.zeros((size, size)), np.zeros(size)
    _add_fixes(border, corner, right, problem, found)
    # The slip angle: motion across the heading, see `model.add_motion`.
    at = np.flatnonzero(measured.seen)
    here, there, h = x[at], x[at + 1], step_s[at]
    middle, speed = (here[:, PHI] + there[:, PHI]) / 2.0, (here[:, V] + there[:, V]) / 2.0
    sin, cos = np.sin(middle), np.cos(middle)
    east, north = there[:, E] - here[:, E], there[:, N] - here[:, N]
    slid = (here[:, KAPPA] + there[:, KAPPA]) / 2.0 * speed * np.abs(speed)
    by_slip = h * speed * slid
    off = east * cos - north * sin + SLIP_ANGLE * by_slip
    scaled = by_slip / (ACROSS_NOISE**2 * h)
    right[SLIP], corner[SLIP, SLIP] = -_in_order(scaled * off), _in_order(scaled * by_slip)
    for state, slope in ((E, cos), (N, -sin)):
        border[at, state, SLIP] -= scaled * slope
        border[at + 1, state, SLIP] += scaled * slope
    along = east * sin + north * cos
    for state, slope in ((PHI, -along / 2.0), (V, h / 2.0 * SLIP_ANGLE * slid)):
        border[at, state, SLIP] += scaled * slope
        border[at + 1, state, SLIP] += scaled * slope
    flat, beside = border.reshape(-1, size), np.zeros((CONSTANTS, size))
    if len(measured.step_nodes):
        _add_steps(flat, beside, corner, right, problem, found)
    return flat, beside, corner, right


def _add_steps(
    border: Float64,
    beside: Float64,
    corner: Float64,
    right: Float64,
    problem: SmoothingProblem,
    found: Solution,
) -> None:
    """What the camera's steps say of its stamps, both ends being a little later; and of an axle
    that nobody names, which camera and antenna are as far ahead of."""
    measured, x = problem.measured, found.x
    constants = float(found.constants[CAMERA_SCALE]), float(found.constants[CAMERA_YAW])
    ends = measured.step_nodes
    index, slope, off = step_rows(x, constants, ends, measured.step, problem.step_ahead_m)
    phi = x[:, PHI]
    way = np.stack([np.sin(phi), np.cos(phi)], axis=1)
    rate = np.column_stack([way * x[:, [V]], np.gradient(phi, measured.time_s)])
    later = np.concatenate([rate[ends[:, 0]], rate[ends[:, 1]]], axis=1)
    numbers = {IMAGES: np.einsum("smk,sk->sm", slope[:, :, :6], later)}
    if problem.ahead_sigma_m:
        ahead = np.einsum("smk,sk->sm", slope[:, :, 3:5], way[ends[:, 1]] - way[ends[:, 0]])
        numbers[AHEAD] = ahead
    weight = found.weights.step[:, [0, 0, 1]]
    for a, one in numbers.items():
        scaled = weight * one
        right[a] -= _in_order(scaled * off)
        for b, other in numbers.items():
            corner[a, b] += _in_order(scaled * other)
        shared = np.einsum("sm,smk->sk", scaled, slope)
        np.add.at(border[:, a], index[:, :6], shared[:, :6])
        beside[[CAMERA_SCALE, CAMERA_YAW], a] = np.cumsum(shared[:, 6:], axis=0)[-1]


def _add_fixes(
    border: Float64, corner: Float64, right: Float64, problem: SmoothingProblem, found: Solution
) -> None:
    """What fixes say of the antenna's place, of their own stamps and of their drift."""
    x, weight, fix_en, lever = found.x, found.weights.fix, problem.measured.fix_m, problem.lever_m
    at = np.flatnonzero(weight[:, 0] > 0.0)
    here, weight = x[at], weight[at]
    sin, cos = np.sin(here[:, PHI]), np.cos(here[:, PHI])
    east = here[:, E] + lever[0] * cos + lever[1] * sin + here[:, BIAS_E] - fix_en[at, 0]
    north = here[:, N] - lever[0] * sin + lever[1] * cos + here[:, BIAS_N] - fix_en[at, 1]
    turn, none = here[:, V] * here[:, KAPPA], np.zeros(len(at))
    # Along the heading and across it; a fix that is stamped late is of an earlier place.
    off = np.stack([east * sin + north * cos, east * cos - north * sin], axis=1)
    states = ((sin, cos, none - lever[0]), (cos, -sin, none + lever[1]))
    late = (-(here[:, V] - lever[0] * turn), -lever[1] * turn)
    numbers = [(none, none + 1.0), (none + 1.0, none), late]
    columns = [ASIDE, AHEAD, LATE, *range(DRIFT, len(right))]
    if len(right) > DRIFT:
        by_shape = shapes(problem.measured.time_s)[at].T
        numbers += [
            by for one in by_shape for by in ((sin * one, cos * one), (cos * one, -sin * one))
        ]
    for a, one in zip(columns, numbers, strict=True):
        scaled = weight * np.stack(one, axis=1)
        right[a] = -_in_order(scaled * off)
        for b, other in zip(columns, numbers, strict=True):
            corner[a, b] = _in_order(scaled * np.stack(other, axis=1))
        for axis in range(2):
            for state, slope in zip((E, N, PHI), states[axis], strict=True):
                border[at, state, a] += scaled[:, axis] * slope
    for bias, place in ((BIAS_E, E), (BIAS_N, N)):
        border[:, bias, columns] = border[:, place, columns]


def _in_order(terms: Float64) -> float:
    """The sum of terms one after the other, which tells the same bits on every machine."""
    return float(np.cumsum(np.append(0.0, terms))[-1])
