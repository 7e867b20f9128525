"""What the drive makes of what was declared, beside residuals written anew and differenced."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from fieldgrid.core import Float64
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.declared import AHEAD, ASIDE, IMAGES, LATE, SLIP, couplings
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.equations import CONSTANTS
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.model import KAPPA, PHI, E, N, V
from fieldgrid.poses.smoother.rounds import (
    CurvatureChange,
    SmoothingProblem,
    Solution,
    stated_weights,
)
from tests.poses.smoother.test_model import SEEDS, dense, empty, states

STEP_S = 0.2
NUMBERS = np.array([ASIDE, AHEAD, LATE, IMAGES, SLIP])


def drive(seed: int, *, fixes: bool, steps: bool) -> tuple[SmoothingProblem, Solution]:
    """Three nodes, the first and the last with a fix, and a step of a camera over all of them."""
    random, x = np.random.default_rng(seed), states(seed, 3)
    none, fix = np.full(3, np.nan), x[:, :2] + random.normal(size=(3, 2))
    fix_sigma = random.uniform(0.6, 1.5, (3, 2))
    fix_sigma[1] = np.nan
    measured = Measurements(
        time_s=STEP_S * np.arange(3.0),
        fix_m=fix,
        fix_sigma_m=fix_sigma if fixes else np.full((3, 2), np.nan),
        bias_m=np.ones(3),
        bias_s=np.full(3, 300.0),
        heading_rad=none,
        heading_sigma_rad=none,
        speed_mps=none,
        speed_sigma_mps=none,
        turned_rad=none[1:],
        seen=np.ones(2, np.bool_),
        standing=np.zeros(3, np.bool_),
        step_nodes=np.array([[0, 2]]) if steps else np.zeros((0, 2), np.int64),
        step=random.normal(size=(1 if steps else 0, 3)),
        step_sigma=random.uniform(0.5, 2.0, (1 if steps else 0, 2)),
    )
    lever = (float(random.normal()), float(random.normal()))
    problem = SmoothingProblem.of(measured, lever, float(random.normal()))
    weights = stated_weights(measured, CurvatureChange(np.ones(2), np.ones(2)))
    return problem, Solution(x, np.zeros(CONSTANTS), weights, 0, np.zeros_like(x))


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_how_fixes_depend_on_lever_and_clock(seed: int) -> None:
    """Beside fixes of an antenna elsewhere, taken a little earlier than they are stamped."""
    problem, found = drive(seed, fixes=True, steps=False)
    x, fix, weight, lever = found.x, problem.measured.fix_m, found.weights.fix, problem.lever_m
    border, _, corner, right = couplings(problem, found, NUMBERS)

    def away(right_m: float, ahead_m: float, late_s: float) -> Float64:
        """Residuals ahead and right [4] in axes that stand still."""
        found = []
        for k in (0, 2):
            heading = 1j * np.exp(-1j * x[k, PHI])
            now = x[k, E] + x[k, model.BIAS_E] + 1j * (x[k, N] + x[k, model.BIAS_N])
            before = now - late_s * x[k, V] * heading
            turned = heading * np.exp(1j * late_s * x[k, V] * x[k, KAPPA])
            lever_now = (lever[1] + ahead_m) - 1j * (lever[0] + right_m)
            off = before + lever_now * turned - (fix[k, 0] + 1j * fix[k, 1])
            found += [(off * np.conj(heading)).real, (off * np.conj(-1j * heading)).real]
        return np.array(found)

    step = 1e-6
    jacobian = np.stack(
        [(away(*(step * e)) - away(*(-step * e))) / (2.0 * step) for e in np.eye(3)], axis=1
    )
    w = weight[[0, 2]].ravel()
    assert corner[:3, :3] == pytest.approx(jacobian.T @ (w[:, None] * jacobian), rel=1e-4, abs=1e-4)
    assert right[:3] == pytest.approx(-jacobian.T @ (w * away(0.0, 0.0, 0.0)), rel=1e-4, abs=1e-4)
    # The coupling is with the states that add_fixes has.
    system = empty(3)
    model.add_fixes(system, x, model.fixes_off(x, fix, weight, lever), weight, lever)
    full = dense(system)[: x.size, : x.size]
    for k in (0, 2):
        # A place farther east is the same as one axis' share of an antenna elsewhere.
        sin, cos = np.sin(x[k, PHI]), np.cos(x[k, PHI])
        along = sin * full[STATES * k + E] + cos * full[STATES * k + N]
        assert border[:, 1][STATES * k : STATES * (k + 1)] == pytest.approx(
            along[STATES * k : STATES * (k + 1)]
        )
    assert not border[STATES : 2 * STATES, :IMAGES].any()
    assert not border[:, IMAGES].any()


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_how_steps_depend_on_the_clock_of_images(seed: int) -> None:
    """A step of images that are later is one between nodes that have gone on by as much."""
    problem, found = drive(seed, fixes=False, steps=True)
    x, measured = found.x, problem.measured
    border, beside, corner, right = couplings(problem, found, NUMBERS)
    turning = np.gradient(x[:, PHI], measured.time_s)
    weight = found.weights.step[0, [0, 0, 1]]

    def off(later_s: float, x: Float64 = x, constants: tuple[float, float] = (0.0, 0.0)) -> Float64:
        moved = x.copy()
        moved[:, E] += later_s * found.x[:, V] * np.sin(found.x[:, PHI])
        moved[:, N] += later_s * found.x[:, V] * np.cos(found.x[:, PHI])
        moved[:, PHI] += later_s * turning
        ends, step = measured.step_nodes, measured.step
        return model.step_rows(moved, constants, ends, step, problem.step_ahead_m)[2][0]

    tiny = 1e-6
    slope = (off(tiny) - off(-tiny)) / (2.0 * tiny)
    assert corner[IMAGES, IMAGES] == pytest.approx(weight @ slope**2, rel=1e-4)
    assert right[IMAGES] == pytest.approx(-weight @ (slope * off(0.0)), rel=1e-4, abs=1e-6)
    for k, constants in ((model.CAMERA_SCALE, (tiny, 0.0)), (model.CAMERA_YAW, (0.0, tiny))):
        by = (off(0.0, constants=constants) - off(0.0)) / tiny
        assert beside[k, IMAGES] == pytest.approx(weight @ (slope * by), rel=1e-3, abs=1e-3)
    for state in (E, N, PHI):
        for node in (0, 2):
            moved = x.copy()
            moved[node, state] += tiny
            by = (off(0.0, moved) - off(0.0)) / tiny
            told = border[STATES * node + state, IMAGES]
            assert told == pytest.approx(weight @ (slope * by), rel=1e-3, abs=1e-3)


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_how_motion_depends_on_the_slip_angle(seed: int) -> None:
    problem, found = drive(seed, fixes=False, steps=False)
    border, _, corner, right = couplings(problem, found, NUMBERS)

    def across(x: Float64, more: float = 0.0) -> Float64:
        """What the vehicle moves across its heading beyond its slip, in sigmas, [2]."""
        middle, speed = (x[1:, PHI] + x[:-1, PHI]) / 2.0, (x[1:, V] + x[:-1, V]) / 2.0
        bend = (x[1:, KAPPA] + x[:-1, KAPPA]) / 2.0
        east, north = np.diff(x[:, E]), np.diff(x[:, N])
        slide = -(model.SLIP_ANGLE + more) * bend * speed * np.abs(speed)
        off = east * np.cos(middle) - north * np.sin(middle) - STEP_S * speed * slide
        return np.asarray(off / (model.ACROSS_NOISE * np.sqrt(STEP_S)))

    by_slip = across(found.x, 1.0) - across(found.x)  # it is linear
    assert corner[SLIP, SLIP] == pytest.approx(by_slip @ by_slip)
    assert right[SLIP] == pytest.approx(-by_slip @ across(found.x))
    assert not corner[[ASIDE, AHEAD, LATE]].any()
    for state in (E, N):
        for node in range(3):
            moved = found.x.copy()
            moved[node, state] += 1.0
            told = by_slip @ (across(moved) - across(found.x))
            assert border[STATES * node + state, SLIP] == pytest.approx(told, rel=1e-6, abs=1e-6)
