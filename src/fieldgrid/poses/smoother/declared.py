"""What was declared of antenna, clock and gyro, tested by the drive; nothing of it is applied."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.smoother.envelope import STATES, solve
from fieldgrid.poses.smoother.model import BIAS_E, BIAS_N, GYRO, GYRO_NOISE, KAPPA, PHI, E, N, V
from fieldgrid.poses.smoother.rounds import Linear, SmoothingProblem, Solution, inverse

AHEAD, LATE, SCALE = 1, 2, 3
"""Which of the constants that are tested are the antenna's place ahead, the delay of the fixes and
the gyro's scale."""

TESTED_SIGMAS = np.array([5.0, 5.0, 5.0, 2.0])
"""What each could be off by, before the drive."""

UNVERIFIED_SIGMAS = np.array([0.1, 0.1, 0.2, 0.04])
"""How far off they usually are where nobody verified them: a measured place of the antenna, the
stamps of two clocks, and a gyro's scale with its mounting."""

TOLD_SHARE = 0.5
"""Of what a drive tells of them: the noise of its fixes is known to a third."""

FLEETING_S, FLEETING_SHARE = 30.0, 0.1
"""A slow error that lasts no longer is that of a solution that converges. It changes within a turn,
and how fast it does is a guess: of the gyro's scale such fixes tell less."""

TURN_EDGE_S = 0.5
"""A gyro that is late is wrong for so long before and after a turn, too."""

MOST_MISFIT = 5.0
"""Four numbers that are right are more sigmas away once in 20,000 drives."""


class Constant(NamedTuple):
    """A constant of the drive, with its 1-sigma error."""

    value: float
    sigma: float


class DeclaredCorrection(NamedTuple):
    """What the drive would have added to what was declared: to the antenna's place, to the right
    and ahead (metres), to how late the fixes are stamped (seconds), and to the gyro's scale (a
    share; of a gyro that is upside down it is near -2).

    `misfit` is how many sigmas all of them together are from nothing. `alone` is what each of them
    would be if the others were as declared, in this order, and `left` how many sigmas would be left
    then.
    """

    right_m: Constant
    ahead_m: Constant
    late_s: Constant
    gyro_scale: Constant
    misfit: float
    alone: tuple[float, float, float, float]
    left: tuple[float, float, float, float]

    @property
    def contradicts(self) -> bool:
        """Whether sensors and declarations do not fit together."""
        return self.misfit > MOST_MISFIT

    @property
    def misfit_but_scale(self) -> float:
        """How many sigmas are left with the gyro's scale as the drive has it, and as far as that is
        from the usual: no scale is quite right."""
        unusual = self.alone[SCALE] / float(UNVERIFIED_SIGMAS[SCALE])
        return min(math.hypot(self.left[SCALE], unusual), self.misfit)

    @property
    def unsure_late_s(self) -> float:
        """How late the stamps of fixes or gyro may be, 1-sigma: as usual clocks are, as far as the
        drive leaves it open, and as it would explain a contradiction alone."""
        told = 1.0 / self.late_s.sigma**2 - 1.0 / TESTED_SIGMAS[LATE] ** 2
        usual = 1.0 / UNVERIFIED_SIGMAS[LATE] ** 2
        unverified_s = 1.0 / math.sqrt(usual + TOLD_SHARE * max(told, 0.0))
        return math.hypot(unverified_s, self.alone[LATE] if self.contradicts else 0.0)

    def explains(self, k: int) -> bool:
        """Whether most of what does not fit together would with the k-th of them alone."""
        return self.left[k] < self.misfit / 2.0

    @property
    def blames_gyro(self) -> bool:
        """Whether they do not, and the gyro explains it better than anything else."""
        *others, gyro = self.left
        return self.contradicts and gyro < min(self.misfit / 2.0, *others)


class HeadingResponse(NamedTuple):
    """How headings [n] would change, radians: with an antenna a metre farther ahead than was
    declared; and at most with what is tested as the drive has it, all of it or what explains the
    misfit alone. `unverified` is their 1-sigma error by a gyro whose clock and scale are usual
    ones (:data:`UNVERIFIED_SIGMAS`), as far as the drive leaves them open, in the clock of the
    fixes."""

    per_ahead_m: Float64
    at_most: Float64
    unverified: Float64


def tested(
    problem: SmoothingProblem, found: Solution, linear: Linear
) -> tuple[DeclaredCorrection, HeadingResponse]:
    """What would have to be added to what was declared for the drive to fit best, and what the
    headings would be then: one step of Gauss and Newton with all states following."""
    measured = problem.measured
    followed, information, right = _told(problem, found, linear)
    schur = information + np.diag(1.0 / TESTED_SIGMAS**2)
    values = np.linalg.solve(schur, right)
    sigmas = np.sqrt(np.diagonal(np.linalg.inv(schur)))
    together = float(values @ right)
    left = np.sqrt(np.maximum(together - right**2 / np.diagonal(schur), 0.0))
    right_m, ahead_m, late_s, gyro = map(Constant, values.tolist(), sigmas.tolist())
    alone = right / np.diagonal(schur)
    misfit = math.sqrt(max(together, 0.0))
    declared = DeclaredCorrection(
        *(right_m, ahead_m, late_s, gyro), misfit, tuple(alone.tolist()), tuple(left.tolist())
    )
    heading = -followed[PHI::STATES]
    at_most = np.abs(heading @ values)
    # A curvature and a speed do not say it: with a gyro they follow only loosely.
    turned = np.gradient(found.x[:, PHI], measured.time_s) if len(measured.time_s) > 1 else 0.0
    for k in range(len(alone)):
        if declared.explains(k):
            # Nobody knows whose stamps are late: those of the gyro are late by as much as those of
            # the fixes seem early, and headings with them.
            late = np.abs(turned) if k == LATE else 0.0
            at_most = np.maximum(at_most, np.abs((late + np.abs(heading[:, k])) * alone[k]))
    prior = np.diag(1.0 / UNVERIFIED_SIGMAS**2)
    expected = np.linalg.solve(TOLD_SHARE * information + prior, TOLD_SHARE * right)
    # The scale is confused with a wander that changes within a turn, the others hardly are.
    fleeting = float(np.median(measured.bias_s)) < FLEETING_S
    told = np.sqrt([*3 * (TOLD_SHARE,), FLEETING_SHARE if fleeting else TOLD_SHARE])
    usual = np.linalg.inv(np.outer(told, told) * information + prior)
    second_moment = (usual + np.outer(expected, expected))[LATE:, LATE:]
    by_gyro = heading[:, LATE:].copy()
    by_gyro[:, 0] -= turned  # in the clock of the fixes
    variance = np.einsum("na,ab,nb->n", by_gyro, second_moment, by_gyro)
    # At each node the largest variance within :data:`TURN_EDGE_S` of it.
    values = np.maximum(variance, 0.0)
    near_s = np.linspace(-TURN_EDGE_S, TURN_EDGE_S, 9)
    at = np.searchsorted(measured.time_s, measured.time_s + near_s[:, None], side="right") - 1
    unverified = np.sqrt(np.max(values[np.clip(at, 0, len(values) - 1)], axis=0))
    return declared, HeadingResponse(heading[:, 1], at_most, unverified)


def _told(
    problem: SmoothingProblem, found: Solution, linear: Linear
) -> tuple[Float64, Float64, Float64]:
    """Response, information and right side of the tested declarations: see :func:`told_by`."""
    measured = problem.measured
    fixes = measured.fix_m, found.weights.fix, problem.lever_m
    return told_by(
        linear, *couplings(found.x, *fixes, measured.turned_rad, np.diff(measured.time_s))
    )


def told_by(
    linear: Linear, border: Float64, corner: Float64, right: Float64
) -> tuple[Float64, Float64, Float64]:
    """Response of all states [states, k] to k tested numbers, the information matrix [k, k] of
    these numbers, and their right side [k]; from the coupling of the numbers with the states
    [states, k], and the corner [k, k] and right side [k] of their residuals."""
    followed = border.copy()
    solve(linear.system.shape, linear.system.values, followed)
    if len(linear.active):
        shared = linear.coupling.T @ border
        followed -= linear.coupling @ (inverse(linear.schur) @ shared)
    information = corner - border.T @ followed
    return followed, information, right - followed.T @ linear.system.right


def unverified_nats(problem: SmoothingProblem, found: Solution, linear: Linear) -> float:
    """How much likelier a drive is when what was declared may be off by
    :data:`UNVERIFIED_SIGMAS`, than when it is exact: Laplace's approximation."""
    _, information, right = _told(problem, found, linear)
    known = information + np.diag(1.0 / UNVERIFIED_SIGMAS**2)
    explained = 0.5 * float(right @ np.linalg.solve(known, right))
    _, spread = np.linalg.slogdet(known * np.outer(UNVERIFIED_SIGMAS, UNVERIFIED_SIGMAS))
    return explained - 0.5 * float(spread)


def couplings(
    x: Float64, fix_en: Float64, weight: Float64, lever: Float64, turned: Float64, step_s: Float64
) -> tuple[Float64, Float64, Float64]:
    """How the residuals of fixes and gyro depend on what is tested.

    Returns the coupling with the states [states, 4], the corner [4, 4], the right side [4].
    """
    border, corner, right = np.zeros((len(x), STATES, 4)), np.zeros((4, 4)), np.zeros(4)
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
    constants = np.array([[none, none + 1.0, late[0]], [none + 1.0, none, late[1]]])
    for a in range(3):
        scaled = weight * constants[:, a].T
        right[a] = -_in_order(scaled * off)
        for b in range(3):
            corner[a, b] = _in_order(scaled * constants[:, b].T)
        for axis in range(2):
            for state, slope in zip((E, N, PHI), states[axis], strict=True):
                border[at, state, a] += scaled[:, axis] * slope
    border[:, BIAS_E, :3], border[:, BIAS_N, :3] = border[:, E, :3], border[:, N, :3]
    known = np.flatnonzero(~np.isnan(turned))
    turned, step_s = turned[known], step_s[known]
    missed = x[known + 1, PHI] - x[known, PHI] - (turned - x[known, GYRO] * step_s)
    scaled = -turned / (GYRO_NOISE**2 * step_s)
    right[3], corner[3, 3] = -_in_order(scaled * missed), -_in_order(scaled * turned)
    border[known + 1, PHI, 3] += scaled
    border[known, PHI, 3] -= scaled
    border[known, GYRO, 3] += scaled * step_s
    return border.reshape(-1, 4), corner, right


def _in_order(terms: Float64) -> float:
    """The sum of terms one after the other, which tells the same bits on every machine."""
    return float(np.cumsum(np.append(0.0, terms))[-1])
