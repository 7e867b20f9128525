"""What is expected of a vehicle in a hole of its fixes, and where they return."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import Bool, Float64
from fieldgrid.geometry import wrap_deg
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.smoother import model
from fieldgrid.poses.smoother.holes import (
    ShownBends,
    Unseen,
    leaving,
    seen_way_m,
)
from fieldgrid.poses.smoother.measurements import Measurements
from fieldgrid.poses.smoother.steering import usual_steering
from tests.simulated import DATUM, Command, Drive, fixes_of, simulate, time_ns

SEEDS = st.integers(0, 10**6)


def measured_at(time_s: Float64, has: Bool | None = None) -> Measurements:
    """Nodes with fixes at some of them."""
    n = len(time_s)
    unknown, zero = np.full(n, np.nan), np.zeros(n)
    has = np.ones(n, np.bool_) if has is None else has
    sigma_m = np.where(has[:, None], 0.02, np.nan) * np.ones(2)
    return Measurements(
        time_s=time_s,
        fix_m=np.zeros((n, 2)),
        fix_sigma_m=sigma_m,
        bias_m=zero + 0.02,
        bias_s=zero + 300.0,
        heading_rad=unknown,
        heading_sigma_rad=unknown,
        speed_mps=unknown,
        speed_sigma_mps=unknown,
        turned_rad=unknown[1:],
        seen=np.diff(time_s) <= 10.0,
        standing=zero > 0.0,
        step_nodes=np.empty((0, 2), np.int64),
        step=np.empty((0, 3)),
        step_sigma=np.empty((0, 2)),
    )


@settings(deadline=None)
@given(st.lists(st.floats(0.01, 2.0), max_size=30), st.data())
def test_steps_far_from_every_fix_or_in_a_hole_are_blind(
    gaps: list[float], data: st.DataObject
) -> None:
    time_s = np.cumsum([5.0, *gaps])
    n = len(time_s)
    has = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    fixes = time_s[has]
    found = Unseen.of(measured_at(time_s, has))
    assert found.blind.shape == found.holes.shape == found.between.shape == (n - 1,)
    period_s = np.percentile(np.diff(fixes), 25) if len(fixes) > 1 else 0.0
    for k, middle in enumerate(((time_s[1:] + time_s[:-1]) / 2.0).tolist()):
        before = max(fixes[fixes <= middle], default=-np.inf)
        after = min(fixes[fixes > middle], default=np.inf)
        hole = after - before > max(2.0, 2.5 * period_s)
        assert found.holes[k] == hole
        assert found.between[k] == (hole and np.isfinite(after - before))
        assert found.blind[k] == (min(middle - before, after - middle) > 0.75 or found.between[k])


def test_only_the_steps_of_holes_are_in_holes() -> None:
    """A fix that a receiver of 1 Hz misses is none."""
    time_s = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 6.5, 9.0, 10.0])
    found = Unseen.of(measured_at(time_s, np.arange(len(time_s)) != 6))
    assert found.holes.tolist() == [False] * 5 + [True, True, False]
    assert found.exits().tolist() == [6]


def test_where_one_fix_lies_between_two_holes_the_way_is_not_seen_again() -> None:
    time_s = np.array([0.0, 0.2, 0.4, 5.0, 10.0, 10.2, 25.0, 25.2])
    found = Unseen.of(measured_at(time_s))
    assert found.holes.tolist() == [False, False, True, True, False, True, False]
    # Where the way is not estimated, it begins anew.
    assert found.between.tolist() == [False, False, True, True, False, False, False]
    assert found.exits().tolist() == [3]


# --- the curvatures that a drive shows


def states(drive: Drive) -> Float64:
    """The true states of a drive."""
    x = np.zeros((len(drive.time_s), 8))
    x[:, model.PHI], x[:, model.V] = drive.heading_rad, drive.speed_mps
    x[:, model.KAPPA] = drive.curvature_per_m
    return x


TURNING = [Command(40.0, 1.5), Command(10.0, 1.0, -0.4), Command(40.0, 1.5), Command(8.0, 0.0)]


def test_the_shown_curvatures_are_those_of_the_way() -> None:
    drive = simulate(TURNING, speed_mps=1.5).every(0.2)
    measured, x = measured_at(drive.time_s), states(drive)
    measured = measured._replace(standing=drive.speed_mps < 0.01)
    shown = ShownBends.of(measured, x)
    way_m = seen_way_m(measured, x)
    assert way_m.sum() == pytest.approx(131.0, abs=2.0)
    assert shown.share.sum() == pytest.approx(1.0)
    assert (shown.bend >= 0.0).all()
    bend = (x[1:, model.KAPPA] + x[:-1, model.KAPPA]) / 2.0
    seen = np.average(bend**2, weights=way_m)
    # Beside ten metres of the usual ones, since a short drive shows few.
    usual = ShownBends.usual()
    mixed = (way_m.sum() * seen + 10.0 * usual.share @ usual.bend**2) / (way_m.sum() + 10.0)
    assert shown.share @ shown.bend**2 == pytest.approx(mixed, rel=0.02)
    # What an estimate makes of a hole is not seen, and neither is it at rest.
    x[100:150, model.KAPPA] = 5.0
    x[drive.speed_mps < 0.01, model.KAPPA] = 5.0
    has = np.ones(len(x), np.bool_)
    has[99:151] = False
    hidden = ShownBends.of(measured._replace(fix_sigma_m=measured_at(x[:, 0], has).fix_sigma_m), x)
    assert hidden.bend.max() < 0.6


def test_a_drive_that_shows_nothing_bends_as_is_usual() -> None:
    usual = ShownBends.usual()
    assert usual.share @ usual.bend**2 == pytest.approx(model.CURVATURE_SIGMA**2, rel=0.01)
    standing = measured_at(np.arange(20) * 0.2)._replace(standing=np.ones(20, np.bool_))
    shown = ShownBends.of(standing, np.zeros((20, 8)))
    assert shown.share @ shown.bend**2 == pytest.approx(usual.share @ usual.bend**2)


@settings(deadline=None, max_examples=40)
@given(SEEDS, st.integers(1, 20))
def test_the_curvatures_that_fit_are_weighted_by_how_likely_they_make_what_is_measured(
    seed: int, size: int
) -> None:
    """Beside the normal densities themselves, of a turn to the left and to the right."""
    random = np.random.default_rng(seed)
    shown = ShownBends(random.uniform(0.0, 1.0, size), random.dirichlet(np.ones(size)))
    mean, sigma = random.normal(0.0, 0.5, 7), random.uniform(0.05, 2.0, 7)
    found = shown.expected_squared(1.0 / sigma**2, mean / sigma**2)
    for k in range(7):
        density = [
            np.exp(-0.5 * ((mean[k] - side * shown.bend) / sigma[k]) ** 2) for side in (1.0, -1.0)
        ]
        weight = shown.share * (density[0] + density[1])
        assert found[k] == pytest.approx(weight @ shown.bend**2 / weight.sum(), rel=1e-6)


def test_without_a_measurement_the_drive_is_a_fair_sample() -> None:
    shown = ShownBends(np.array([0.0, 0.5]), np.array([0.9, 0.1]))
    unknown, straight, turning, absurd = shown.expected_squared(
        np.array([0.0, 400.0, 400.0, 1e6]), np.array([0.0, 0.0, 200.0, 1e9])
    )
    assert unknown == pytest.approx(0.1 * 0.5**2)
    assert straight < 1e-9
    assert turning == pytest.approx(0.5**2)
    assert absurd == pytest.approx(0.5**2)


# --- out of holes


@given(st.floats(0.02, 2.0), st.floats(0.02, 2.0), st.floats(0.05, 2.0))
def test_out_of_a_hole_each_side_keeps_its_own_sigma(
    inside: float, outside: float, step_s: float
) -> None:
    """From one end of the step to the other, and back."""
    usual = usual_steering(np.full(3, step_s))
    found = leaving(usual, np.array([1]), np.array([inside]), np.array([outside]))
    covariance = found.kept[1] * inside**2
    assert found.kept[1] * covariance + found.variance[1] == pytest.approx(outside**2)
    back = covariance / outside**2
    mirrored = leaving(usual, np.array([1]), np.array([outside]), np.array([inside]))
    assert back == pytest.approx(mirrored.kept[1])
    others = [0, 2]
    assert np.array_equal(found.kept[others], usual.kept[others])
    assert np.array_equal(found.variance[others], usual.variance[others])
    if inside == outside:
        assert found.variance[1] == pytest.approx(outside**2 * (1.0 - usual.kept[1] ** 2))


# --- drives with holes

ROWS = [
    command
    for side in (1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
    for command in (Command(50.0, 1.5), Command(7.0, 1.2, 0.4 * side))
]


def test_between_holes_a_tractor_in_its_rows_is_used() -> None:
    """Two seconds of every ten are seen. In rows their edges are, too; that it turns tightly in the
    holes is not held against them."""
    drive = simulate(ROWS, 20.0, speed_mps=1.5)
    off, sigma, accepted, turning = [], [], [], []
    for seed in range(2):
        fixes = fixes_of(drive, 0.125, 0.01, seed=seed)
        at_s = (fixes.time_ns - time_ns(np.zeros(1))[0]) / 1e9
        fixes = fixes[np.flatnonzero(at_s % 10.0 > 8.0)]
        found = estimate_poses(fixes, None, DATUM)
        row, track = found.fix_row, found.trajectory
        truth = drive.at((track.time_ns[row] - time_ns(np.zeros(1))[0]) / 1e9)
        off.append(np.abs(wrap_deg(track.heading_deg[row] - np.degrees(truth.heading_rad))))
        sigma.append(track.heading_sigma_deg[row])
        accepted.append(track.accepted[row])
        turning.append(np.abs(truth.curvature_per_m) > 0.1)
    used, turns = np.concatenate(accepted), np.concatenate(turning)
    inside = np.concatenate(off) <= 3.0 * np.concatenate(sigma)
    assert used[~turns].mean() > 0.9
    assert inside[used].mean() > 0.98
    assert inside.mean() > 0.97
