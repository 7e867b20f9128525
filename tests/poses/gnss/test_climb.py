"""Heights that run away."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from fieldgrid.core import GateLimits
from fieldgrid.geometry import Fix
from fieldgrid.poses import Gate
from fieldgrid.poses.gates import conditioning as climb
from fieldgrid.poses.gates.conditioning import climb_mps, running_median, spoilt
from tests.poses.gnss.judged import judge

SECOND = 1_000_000_000


def drive(height_m: np.ndarray, hz: int = 5) -> list[Fix]:
    """Northward at 2 m/s with these heights."""
    return [
        Fix(k * SECOND // hz, 41.0 + 2.0 * k / hz / 111_195.0, -4.0, float(h), 4)
        for k, h in enumerate(height_m)
    ]


@pytest.mark.parametrize("hz", [1, 5, 20])
def test_the_rate_is_that_of_the_slope(hz: int) -> None:
    k = np.arange(20 * hz)
    rate = climb_mps(k * SECOND // hz, -1.5 * k / hz)
    np.testing.assert_allclose(rate[3 * hz : -3 * hz], -1.5, atol=1e-6)


@pytest.mark.parametrize("size", [3, 5, 21, 101])
@pytest.mark.parametrize("count", [3, 50, 1000])
def test_the_running_median_is_that_of_scipy(
    size: int, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(climb, "VALUES_AT_ONCE", 700)
    values = np.round(np.random.default_rng(size).normal(0.0, 1.0, count), 1)
    expected = ndimage.median_filter(values, size, mode="nearest")
    np.testing.assert_array_equal(running_median(values, size), expected)


def test_steep_ground_and_noise_are_driven_over() -> None:
    k = np.arange(200)
    noise = np.random.default_rng(4).normal(0.0, 0.8, len(k))
    hill = 30.0 * np.sin(2.0 * np.pi * k / 5.0 / 120.0)  # up to 1.6 m/s
    assert all(v.ok for v in judge(drive(hill + noise)))


def test_a_spike_is_no_climb() -> None:
    height = np.zeros(100)
    height[50] = 40.0
    assert {v.gate for v in judge(drive(height))} == {Gate.NONE}


def test_a_runaway_height_is_rejected_with_its_surroundings() -> None:
    height = np.concatenate([np.zeros(200), 1.2 * np.arange(50), np.full(200, 60.0)])
    verdicts = judge(drive(height))
    kinds = [verdict.gate for verdict in verdicts]
    assert set(kinds) == {Gate.NONE, Gate.CLIMB}
    assert set(kinds[160:290]) == {Gate.CLIMB}
    assert set(kinds[:130]) == set(kinds[320:]) == {Gate.NONE}
    assert verdicts[225].reason == "height climbs at 6.0 m/s: the solution has come apart"
    assert verdicts[170].reason == "height runs away within 10 s: the solution has come apart"


def test_a_solution_that_has_come_apart_most_of_the_time_is_not_trusted_afterwards() -> None:
    """Where it comes to rest is as far off as it ran away."""
    height = np.concatenate([-1.2 * np.arange(300), np.full(200, -360.0)])
    verdicts = judge(drive(height))
    assert {verdict.gate for verdict in verdicts} == {Gate.CLIMB}
    assert (
        verdicts[499].reason == "height runs away in most of the log: the solution has come apart"
    )


def test_the_limit_is_settable() -> None:
    height = 1.2 * np.arange(100)
    verdicts = judge(drive(height), GateLimits(max_climb_mps=10.0))
    assert {verdict.gate for verdict in verdicts} == {Gate.NONE}


def test_what_is_near_a_climb_is_spoilt() -> None:
    time_ns = np.arange(30, dtype=np.int64) * SECOND
    climbing = time_ns == 15 * SECOND
    np.testing.assert_array_equal(np.flatnonzero(spoilt(time_ns, climbing)), range(5, 26))
    assert not spoilt(time_ns, np.zeros(30, dtype=np.bool_)).any()
