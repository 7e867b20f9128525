"""What is expected of a vehicle just before its fixes end and just after they return."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import Float64, Int64
from fieldgrid.geometry import wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.edges import (
    EDGE_S,
    FEW_AND_LARGE,
    UNTOLD,
    FixEdges,
    expected_squared,
    freed,
    shown_changes,
    units,
)
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.holes import DOUBT_M, ShownBends, Unseen
from fieldgrid.poses.smoother.rounds import CurvatureChange
from tests.poses.smoother.test_holes import measured_at, states
from tests.simulated import DATUM, Command, fixes_of, simulate, time_ns

SEEDS = st.integers(0, 10**6)
HOLES_S = np.concatenate(
    [np.arange(0.0, 4.0, 0.2), np.arange(8.0, 8.5, 0.2), np.arange(13.0, 18.0, 0.2)]
)
"""Fixes of 4 s, of less than :data:`EDGE_S`, and of 5 s."""


def test_edges_are_where_fixes_begin_and_end() -> None:
    begin, end = FixEdges.of(HOLES_S, Unseen.of(measured_at(HOLES_S)))
    # Where the drive itself begins and ends is no hole.
    assert begin.at.tolist() == [20, 23]
    assert end.at.tolist() == [19, 22]
    # A second away, or at the other end of the stretch.
    assert HOLES_S[begin.inner] == pytest.approx([8.4, 14.0])
    assert HOLES_S[end.inner] == pytest.approx([2.8, 8.0])
    assert [one.tolist() for one in begin.steps()] == [[20, 23], [22, 28]]
    assert [one.tolist() for one in end.steps()] == [[14, 20], [19, 22]]


def test_the_covariances_with_the_curvature_of_each_edge_are_asked_for() -> None:
    sides = FixEdges.of(HOLES_S, Unseen.of(measured_at(HOLES_S)))
    right = units(sides, STATES * len(HOLES_S))
    for edges, column in zip(sides, right.T, strict=True):
        assert np.flatnonzero(column).tolist() == (STATES * edges.at + model.KAPPA).tolist()
        assert set(column) == {0.0, 1.0}


def test_the_shown_changes_are_those_outside_of_holes() -> None:
    """Of 90 s at 1.5 m/s the curvature changes by 0.4 within 2 s at one place."""
    drive = simulate([Command(60.0, 1.5), Command(30.0, 1.5, 0.4)], speed_mps=1.5).every(0.2)
    measured, x = measured_at(drive.time_s), states(drive)
    shown = shown_changes(measured, x, Unseen.of(measured))
    assert shown.share.sum() == pytest.approx(1.0)
    k = round(EDGE_S / 0.2)
    change = x[k:, model.KAPPA] - x[:-k, model.KAPPA]
    doubt = DOUBT_M / (1.5 * (drive.time_s[-1] - EDGE_S) + DOUBT_M)
    usual = model.CURVATURE_SIGMA**2 * (1.0 - np.exp(-2.0 * EDGE_S / model.CURVATURE_S))
    expected = (1.0 - doubt) * np.mean(change**2) + doubt * usual
    assert shown.share @ shown.bend**2 == pytest.approx(expected, rel=0.03)
    # What an estimate makes of a hole shows nothing, and neither does what leads into it.
    has = (drive.time_s < 57.0) | (drive.time_s > 66.0)
    hidden = measured_at(drive.time_s, has)
    straight = shown_changes(hidden, x, Unseen.of(hidden))
    assert straight.bend[: -len(ShownBends.usual().bend)].max() < 1e-9


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.integers(1, 20))
def test_changes_are_weighted_by_how_likely_they_make_what_is_measured(
    seed: int, size: int
) -> None:
    """Beside the normal densities themselves, of a change to the left and to the right."""
    random = np.random.default_rng(seed)
    shown = ShownBends(random.uniform(0.01, 1.0, size), random.dirichlet(np.ones(size)))
    prior = random.uniform(0.01, 0.5, 7)
    own_noise = random.uniform(0.01, 0.3, 7)
    measured = random.normal(0.0, 0.5, 7)
    noise = UNTOLD * prior + own_noise
    variance = 1.0 / (1.0 / noise + 1.0 / prior)
    found = expected_squared(shown, measured * variance / noise, variance, prior)
    for k in range(7):
        spread = UNTOLD * shown.bend**2 + own_noise[k]
        density = sum(
            np.exp(-0.5 * (measured[k] - side * shown.bend) ** 2 / spread) for side in (1.0, -1.0)
        ) / np.sqrt(spread)
        weight = shown.share * density
        assert found[k] == pytest.approx(weight @ shown.bend**2 / weight.sum(), rel=1e-6)


def test_what_a_position_leaves_open_is_no_proof_of_going_straight() -> None:
    """It tells 5/9 of a change that comes at random up to it, however exact it is."""
    random = np.random.default_rng(1)
    steps = random.normal(0.0, 1.0, (4000, 100)) / 10.0
    curvature = np.cumsum(steps, axis=1)
    way = np.cumsum(np.cumsum(curvature, axis=1), axis=1)[:, -1]
    told = np.corrcoef(curvature[:, -1], way)[0, 1] ** 2
    assert told == pytest.approx(5.0 / 9.0, abs=0.03)
    assert pytest.approx((1.0 - 5.0 / 9.0) / (5.0 / 9.0)) == UNTOLD
    shown = ShownBends(np.array([0.001, 0.1]), np.array([0.9, 0.1]))
    # With little expected little is found, and a turn-in in the last moment is as open.
    prior = np.array([0.02**2])
    found = expected_squared(shown, np.array([0.005]), 4.0 / 9.0 * prior, prior)
    assert found[0] > 0.1 * 0.1**2
    # Where nothing is measured, all are as likely as the drive shows them.
    nothing = expected_squared(shown, np.zeros(1), prior, prior)
    assert nothing[0] == pytest.approx(shown.share @ shown.bend**2, rel=0.01)
    # Many exact positions leave nothing open.
    sure = expected_squared(shown, np.zeros(1), np.array([1e-8]), np.array([1e-2]))
    assert sure[0] < 1e-5


def test_beside_edges_at_least_the_shown_changes_are_expected() -> None:
    time_s = np.arange(0.0, 10.0, 0.2)
    end = FixEdges(np.array([49]), np.array([44]))
    calm = np.full(len(time_s) - 1, 1e-5)
    calm[-2] = 1.0
    zero = np.zeros(len(time_s))
    prior = CurvatureChange(np.ones(len(calm)), calm)
    shown = ShownBends(np.array([0.001, 0.2]), np.array([0.5, 0.5]))
    # That the neighbours share their error leaves the change known.
    known = np.where(time_s > 9.7, 0.2, 0.0), zero + 1.0, zero + 1.0
    most = np.ones(len(calm))
    found = freed(calm, most, end, shown, known, prior, time_s)
    at_least = FEW_AND_LARGE * 0.2**2 / EDGE_S * 0.2
    assert found[-6:] == pytest.approx([1e-5, *3 * [at_least], 1.0, at_least])
    assert (found[:-5] == 1e-5).all()
    assert calm[-1] == 1e-5
    # Where no fix is near, all is expected that the vehicle can do.
    most[-1] = at_least / 3.0
    found = freed(calm, most, end, shown, known, prior, time_s)
    assert found[-3:] == pytest.approx([at_least, 1.0, at_least / 3.0])


# --- drives whose fixes end in a turn-in


STRAIGHT_S, TURN_S, SEEN_S = 13.4, 4.6, 0.6
"""Of each turn, :data:`SEEN_S` are seen before a hole, or after it."""


@pytest.mark.parametrize("period_s", [0.1, 1.0])
@pytest.mark.parametrize("backward", [False, True])
def test_a_turn_in_at_an_edge_of_fixes_is_within_three_sigma(
    period_s: float, backward: bool
) -> None:
    """A car turns in at once, and fixes end; or they return as it turns out at once."""
    turns = [
        command
        for k in range(8)
        for command in (Command(STRAIGHT_S, 6.0), Command(TURN_S, 6.0, 0.07 * (-1) ** (k // 2)))
    ]
    drive = simulate(turns, 20.0, speed_mps=6.0)
    start_s = STRAIGHT_S + TURN_S - SEEN_S - 6.4 if backward else STRAIGHT_S + SEEN_S
    every_s = 2.0 * (STRAIGHT_S + TURN_S)

    def since_start_s(at_ns: Int64) -> Float64:
        at_s = (at_ns - time_ns(np.zeros(1))[0]) / 1e9
        return np.asarray((at_s - start_s + every_s / 2.0) % every_s - every_s / 2.0)

    inside = []
    for seed in range(2):
        fixes = fixes_of(drive, period_s, 0.01, seed=seed)
        since_s = since_start_s(fixes.time_ns)
        fixes = fixes[np.flatnonzero((since_s < 1e-6) | (since_s > 6.4 - 1e-6))]
        found = estimate_poses(fixes, None, DATUM)
        row, track = found.fix_row, found.trajectory
        since_s = since_start_s(track.time_ns[row])
        row = row[(np.abs(since_s) < 1.0) | (np.abs(since_s - 6.4) < 1.0)]
        truth = drive.at((track.time_ns[row] - time_ns(np.zeros(1))[0]) / 1e9)
        off = np.abs(wrap_deg(track.heading_deg[row] - np.degrees(truth.heading_rad)))
        inside += (off <= 3.0 * track.heading_sigma_deg[row]).tolist()
    assert len(inside) >= 16
    assert np.mean(inside) >= 0.98
