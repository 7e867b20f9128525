"""Point clouds: how dense they are, and their points above the ground's plane."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import CalibrationError
from fieldgrid.geometry import Mount
from fieldgrid.perception import points_per_sr
from fieldgrid.perception.cloud import FEWEST_POINTS
from tests.scenes import Box, Ground, sweep


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([60_000, 200_000]), st.floats(0.5, 80.0))
def test_points_all_around_are_counted(seed: int, count: int, range_m: float) -> None:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    dense = points_per_sr(range_m * directions)
    assert dense == pytest.approx(count / (4.0 * math.pi), rel=0.1)


@pytest.mark.parametrize("step_deg", [0.2, 0.4])
def test_a_lidar_is_as_dense_as_its_beams(step_deg: float) -> None:
    mount = Mount(2.0, 0.0)
    street = [Ground(), Box((-20.0, 20.0), (12.0, 13.0), (0.0, 30.0))]
    points = sweep(mount, street, step_deg)
    # A beam for each step across and up, which near the horizon is a square.
    assert points_per_sr(points) == pytest.approx(math.radians(step_deg) ** -2, rel=0.15)


def test_what_does_not_come_back_from_the_sky_does_not_count() -> None:
    mount = Mount(2.0, 0.0)
    walled = [Ground(), Box((-50.0, 50.0), (12.0, 13.0), (0.0, 30.0))]
    dense = points_per_sr(sweep(mount, walled, elevations_deg=(-40.0, 60.0)))
    open_ = points_per_sr(sweep(mount, [Ground()], elevations_deg=(-40.0, 60.0)))
    assert open_ == pytest.approx(dense, rel=0.15)


def test_the_order_of_points_does_not_matter() -> None:
    points = sweep(Mount(2.0, 0.0), [Ground()])
    turned = points[np.random.default_rng(1).permutation(len(points))]
    assert points_per_sr(points) == points_per_sr(turned)


def test_points_that_are_none_do_not_count() -> None:
    points = sweep(Mount(2.0, 0.0), [Ground()])
    nothing = np.array([[0.0, 0.0, 0.0], [np.nan, 1.0, 1.0]] * 500)
    assert points_per_sr(np.vstack([points, nothing])) == points_per_sr(points)


def test_few_points_say_nothing() -> None:
    with pytest.raises(CalibrationError, match="of 99 points does not tell"):
        points_per_sr(np.ones((FEWEST_POINTS - 1, 3)))
    assert points_per_sr(np.ones((FEWEST_POINTS, 3))) > 0.0
    with pytest.raises(CalibrationError, match="of 0 points"):
        points_per_sr(np.zeros((0, 3)))
