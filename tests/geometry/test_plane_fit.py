"""A plane through most of the points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import Float64
from fieldgrid.geometry import narrowing, robust_plane


def points(seed: int, count: int = 200) -> tuple[Float64, Float64, Float64]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-5.0, 5.0, (2, count))
    return x, y, rng.normal(0.0, 0.03, count)


@given(st.integers(0, 1000), st.floats(-0.1, 0.1), st.floats(-0.03, 0.03), st.floats(-0.03, 0.03))
def test_what_stands_on_the_plane_does_not_lift_it(
    seed: int, c0: float, c1: float, c2: float
) -> None:
    x, y, noise = points(seed)
    z = c0 + c1 * x + c2 * y + noise
    z[:50] += 1.5  # a canopy along one side
    x[:50] = np.abs(x[:50])
    sigma = np.full(200, 0.03)

    def cutoff(round_: int, _: Float64) -> Float64 | float:
        return narrowing(round_, sigma, first=0.6)

    c, agreeing = robust_plane(x, y, z, sigma, cutoff)
    assert c == pytest.approx([c0, c1, c2], abs=0.02)
    assert 125 <= agreeing <= 150


def test_without_outliers_it_is_least_squares() -> None:
    x, y, z = points(3)
    c, agreeing = robust_plane(x, y, z, np.full(200, 1e3))
    columns = np.column_stack([np.ones_like(x), x, y])
    assert c == pytest.approx(np.linalg.lstsq(columns, z, rcond=None)[0], abs=1e-6)
    assert agreeing == 200


def test_few_points_leave_the_prior() -> None:
    nothing = np.zeros(0)
    c, agreeing = robust_plane(nothing, nothing, nothing, nothing)
    assert c.tolist() == [0.0, 0.0, 0.0]
    assert agreeing == 0
    one = np.ones(1)
    c, _ = robust_plane(one, 0.0 * one, 0.1 * one, 0.1 * one, prior_sigma=(0.1, 1e-9, 1e-9))
    assert c == pytest.approx([0.05, 0.0, 0.0], abs=0.005)
