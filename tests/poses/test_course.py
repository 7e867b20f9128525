"""Heading and gear from positions alone, on paths of which both are known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import wrap_deg
from fieldgrid.poses.gears.course import Course, course, stations
from tests.scenes import Leg, Path, drive

_Float64 = npt.NDArray[np.float64]


def course_of(
    path: Path, baseline_m: float = 3.0, sigma_m: float = 0.02, noise: _Float64 | None = None
) -> Course:
    n = len(path.east_m)
    noise = np.zeros((2, n)) if noise is None else noise
    return course(
        path.east_m + noise[0],
        path.north_m + noise[1],
        np.full(n, sigma_m),
        np.zeros(n, dtype=np.int64),
        baseline_m,
    )


def error_deg(found: Course, path: Path) -> _Float64:
    return np.abs(wrap_deg(found.heading_deg - path.heading_deg))


@settings(deadline=None, max_examples=40)
@given(
    st.floats(-180.0, 180.0),
    st.sampled_from([0.1, 0.3, 0.7]),
    st.sampled_from([3.0, 12.0]),
    st.floats(-3000.0, 3000.0),
)
def test_straight_in_any_direction(
    heading: float, step_m: float, baseline_m: float, east_m: float
) -> None:
    path = drive([Leg(20.0)], heading, step_m, east_m)
    found = course_of(path, baseline_m)
    assert error_deg(found, path).max() < 1e-3
    assert (found.gear == 1).all()
    assert (found.heading_deg > -180.0).all()
    assert (found.heading_deg <= 180.0).all()
    assert (found.sigma_deg < 1.0).all()
    assert (found.span_m >= baseline_m * 0.99).all()


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize("radius_m", [5.0, 10.0, 40.0])
def test_the_course_in_an_arc_is_its_tangent(turn: int, radius_m: float) -> None:
    path = drive([Leg(25.0, turn / radius_m)], heading_deg=70.0, step_m=0.2)
    found = course_of(path)
    error = error_deg(found, path)
    assert (found.gear == 1).all()
    assert error[8:-8].max() < 0.5  # inside: the window is centred
    assert (error <= 3.0 * found.sigma_deg).all()  # the ends say that they are worse


@pytest.mark.parametrize("heading", [10.0, 175.0, -100.0])
def test_a_fishtail_is_forward_reverse_forward(heading: float) -> None:
    legs = [Leg(18.0), Leg(4.5, 0.15), Leg(7.5, -0.15, gear=-1), Leg(18.0, 0.02)]
    path = drive(legs, heading)
    found = course_of(path)
    wrong = found.gear != path.gear
    cusp = np.flatnonzero(np.diff(path.gear))
    away = np.abs(np.arange(len(wrong))[:, None] - cusp[None, :]).min(axis=1)
    assert not wrong[away > 1].any()
    assert sorted(set(found.gear.tolist())) == [-1, 1]
    # Heading is continuous through the cusps, whichever way the vehicle moves.
    assert error_deg(found, path).max() < 6.0
    assert np.median(error_deg(found, path)) < 0.3


def test_a_drive_mostly_in_reverse_is_read_from_its_longer_gear() -> None:
    """Positions alone cannot tell; the longer gear is taken to be forward, as documented."""
    path = drive([Leg(9.0), Leg(30.0, gear=-1)], heading_deg=20.0)
    found = course_of(path)
    assert (found.gear[:28] == -1).all()
    assert (found.gear[35:] == 1).all()


@pytest.mark.parametrize(("baseline_m", "row_m"), [(3.0, 6.0), (3.0, 10.0), (12.0, 10.0)])
@pytest.mark.parametrize("turn", [1, -1])
def test_a_turn_into_the_next_row_is_no_cusp(baseline_m: float, row_m: float, turn: int) -> None:
    path = drive([Leg(30.0), Leg(np.pi * row_m / 2.0, 2.0 * turn / row_m), Leg(30.0)], 80.0)
    found = course_of(path, baseline_m)
    assert (found.gear == 1).all()
    straight = np.r_[0:80, -80:0]
    assert error_deg(found, path)[straight].max() < 1.0


@pytest.mark.parametrize("turn", [1, -1])
def test_a_narrow_turn_is_no_cusp_with_the_long_baseline_of_poor_fixes(turn: int) -> None:
    """Rows 6 m apart, and the baseline of 12 m that fixes of 10 cm and worse are given."""
    row_m = 6.0
    path = drive([Leg(30.0), Leg(np.pi * row_m / 2.0, 2.0 * turn / row_m), Leg(30.0)], 80.0)
    found = course_of(path, baseline_m=12.0, sigma_m=0.1)
    assert (found.gear == 1).all()
    straight = np.r_[0:80, -80:0]
    assert error_deg(found, path)[straight].max() < 1.0


@pytest.mark.parametrize(("sigma_m", "noise_m"), [(0.25, 0.1), (0.5, 0.17)])
def test_poor_fixes_do_not_turn_a_straight_drive_around(sigma_m: float, noise_m: float) -> None:
    path = drive([Leg(60.0)], 10.0)
    for seed in range(10):
        noise = np.random.default_rng(seed).normal(0.0, noise_m, (2, len(path.east_m)))
        found = course_of(path, 12.0, sigma_m, noise)
        assert (found.gear == 1).all()
        assert error_deg(found, path).max() < 15.0


def test_standing_in_the_middle_changes_nothing() -> None:
    path = drive([Leg(15.0), Leg(15.0)], 35.0)
    stop = np.repeat(
        np.arange(len(path.east_m)), np.where(np.arange(len(path.east_m)) == 50, 60, 1)
    )
    standing = Path(*(column[stop] for column in path))
    noise = np.random.default_rng(1).normal(0.0, 0.02, (2, len(stop)))
    found = course_of(standing, noise=noise)
    assert (found.gear == 1).all()
    error = error_deg(found, standing)
    assert error.max() < 3.0
    assert error[50:110].max() < 2.0
    assert (error <= 4.0 * found.sigma_deg).all()


@pytest.mark.parametrize(
    ("sigma_m", "baseline_m", "curvature"),
    [
        (0.02, 3.0, 0.1),
        (0.1, 12.0, 0.0),
        pytest.param(0.02, 3.0, 0.0, marks=pytest.mark.long),
        pytest.param(0.1, 12.0, 0.1, marks=pytest.mark.long),
    ],
)
def test_the_stated_error_is_honest(sigma_m: float, baseline_m: float, curvature: float) -> None:
    path = drive([Leg(12.0), Leg(12.0, curvature), Leg(6.0)], -60.0, step_m=0.4)
    inside, total, relative = 0, 0, []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0.0, sigma_m, (2, len(path.east_m)))
        found = course_of(path, baseline_m, sigma_m, noise)
        known = np.isfinite(found.sigma_deg)
        assert known.all()
        error = error_deg(found, path)[known]
        inside += np.count_nonzero(error <= 3.0 * found.sigma_deg[known])
        total += error.size
        relative.append(error / found.sigma_deg[known])
    assert inside >= 0.95 * total
    # Honest in the other direction too: not so large that it says nothing.
    assert np.median(np.concatenate(relative)) > 0.2


def test_fixes_worse_than_stated_are_noticed() -> None:
    path = drive([Leg(30.0)], -60.0, step_m=0.4)
    error, sigma = [], []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0.0, 0.15, (2, len(path.east_m)))
        found = course_of(path, 6.0, 0.01, noise)
        error.append(error_deg(found, path)[20:-20])
        sigma.append(found.sigma_deg[20:-20])
    assert (np.array(error) <= 3.0 * np.array(sigma)).mean() > 0.97
    assert np.median(sigma) > 0.7 * np.sqrt(np.mean(np.square(error)))


def test_a_turn_is_less_sure_than_a_straight() -> None:
    straight, turn = (course_of(drive([Leg(20.0, c)], step_m=0.2)) for c in (0.0, 0.2))
    middle = slice(30, 70)
    assert (turn.sigma_deg[middle] > 1.5 * straight.sigma_deg[middle]).all()


def test_parts_are_not_bridged() -> None:
    first, second = drive([Leg(12.0)], 0.0), drive([Leg(15.0, 0.05)], 120.0, east_m=2.0)
    both = Path(*(np.concatenate(columns) for columns in zip(first, second, strict=True)))
    n = len(first.east_m)
    part = np.repeat([4, 9], [n, len(second.east_m)])
    found = course(both.east_m, both.north_m, np.full(len(part), 0.02), part, 3.0)
    for rows, alone in ((slice(None, n), first), (slice(n, None), second)):
        for together, separate in zip(found, course_of(alone), strict=True):
            assert np.array_equal(together[rows], separate)
    assert error_deg(found, both)[n - 1] < 1e-3  # the last before the interruption


def test_the_gear_starts_anew_in_each_part() -> None:
    there, back = drive([Leg(12.0)], 0.0), drive([Leg(12.0)], 180.0)
    both = Path(*(np.concatenate(columns) for columns in zip(there, back, strict=True)))
    part = np.repeat([0, 1], [len(there.east_m), len(back.east_m)])
    found = course(both.east_m, both.north_m, np.full(len(part), 0.02), part, 3.0)
    assert (found.gear == 1).all()
    assert error_deg(found, both).max() < 1e-3


@pytest.mark.parametrize("length_m", [0.0, 0.6, 1.2])
def test_too_short_a_path_has_no_heading(length_m: float) -> None:
    found = course_of(drive([Leg(length_m)]))
    assert np.isnan(found.heading_deg).all()
    assert np.isinf(found.sigma_deg).all()
    assert (found.span_m < 1.5).all()


def test_standing_still_has_no_heading() -> None:
    n = 40
    noise = np.random.default_rng(0).normal(0.0, 0.02, (2, n))
    still = Path(np.zeros(n), np.zeros(n), np.zeros(n), np.ones(n, dtype=np.int64))
    assert np.isnan(course_of(still, noise=noise).heading_deg).all()


def test_a_high_antenna_is_less_sure() -> None:
    path = drive([Leg(20.0)])
    n = len(path.east_m)
    columns = (path.east_m, path.north_m, np.full(n, 0.02), np.zeros(n, dtype=np.int64), 3.0)
    low, high = course(*columns, 0.0), course(*columns, 3.0)
    assert (high.sigma_deg > 1.2 * low.sigma_deg).all()
    assert np.array_equal(low.heading_deg, high.heading_deg)


def test_waiting_adds_no_stations() -> None:
    """An hour at a gate is one place; a part always begins with a station."""
    rng = np.random.default_rng(5)
    driven = np.stack([np.arange(100) * 0.3, np.zeros(100)], axis=1)
    waited = driven[50] + rng.normal(0.0, 0.005, (36_000, 2))
    points = np.concatenate([driven[:51], waited, driven[51:]])
    part = np.zeros(len(points), dtype=np.int64)
    part[-1] = 1
    standing = np.zeros(len(points), dtype=np.bool_)
    at = stations(points, part, standing, 0.05)
    assert at[0] == 0
    assert at[-1] == len(points) - 1
    assert set(range(51)) <= set(at.tolist())
    assert 100 <= at.size < 110
    gaps = np.hypot(*np.diff(points[at], axis=0).T)
    assert (gaps >= 0.05).all()
    standing[51:36_051] = True
    wandering = points.copy()
    wandering[51:36_051, 1] += 0.7 * np.sin(np.linspace(0.0, 60.0, 36_000))
    assert stations(wandering, part, standing, 0.05).size == 100
