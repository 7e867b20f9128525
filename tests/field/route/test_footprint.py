"""Distances to cells as shapely has them, and hulls that hold what is swept."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st

from fieldgrid.field import Vehicle
from fieldgrid.field.route.footprint import BULGE_M, CURVATURES, STANDING, Shape, gap_m
from fieldgrid.field.route.ground import _to_blocked_m

CELL_M = 0.2


def placed(corners: np.ndarray, x: float, y: float, yaw: float) -> shapely.Polygon:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return shapely.Polygon(corners @ np.array([[cos, sin], [-sin, cos]]) + (x, y))


@settings(max_examples=150)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.8))
def test_the_gap_is_that_of_polygons(seed: int, reach: float) -> None:
    rng = np.random.default_rng(seed)
    vehicle = Vehicle(
        front_m=rng.uniform(0.2, 1.5), rear_m=rng.uniform(0.0, 1.0), width_m=rng.uniform(0.2, 1.2),
        implement_width_m=rng.choice([0.0, 1.6]),
    )  # fmt: skip
    shape = Shape.of(vehicle)
    blocked = (rng.random((50, 50)) < rng.choice([0.0, 0.01, 0.05])).astype(np.uint8)
    x, y, yaw = *rng.uniform(3.0, 7.0, 2), rng.uniform(-4.0, 4.0)
    found = gap_m(
        x, y, yaw, shape.hulls[STANDING], shape.discs[STANDING], reach, 0.0, blocked,
        _to_blocked_m(blocked, CELL_M), CELL_M,
    )  # fmt: skip
    j, i = np.nonzero(blocked)
    squares = shapely.box(i * CELL_M, j * CELL_M, (i + 1) * CELL_M, (j + 1) * CELL_M)
    true = shapely.distance(placed(vehicle.footprint(), x, y, yaw), squares).min(initial=1e9)
    if true < reach:
        assert found == pytest.approx(true, abs=1e-6)
    else:
        assert reach - 1e-9 <= found <= true + 1e-6


def test_beyond_the_window_there_is_no_gap() -> None:
    shape, blocked = Shape.of(Vehicle()), np.zeros((50, 50), dtype=np.uint8)
    field = _to_blocked_m(blocked, CELL_M)
    hull, discs = shape.hulls[STANDING], shape.discs[STANDING]
    assert gap_m(0.3, 5.0, 0.0, hull, discs, 0.1, 0.0, blocked, field, CELL_M) == -1.0
    assert gap_m(5.0, 5.0, 0.0, hull, discs, 0.1, 0.0, blocked, field, CELL_M) > 1.0


@pytest.mark.parametrize("index", range(len(CURVATURES)))
@pytest.mark.parametrize("radius_m", [0.3, 2.0, 20.0])
def test_a_hull_holds_all_that_a_step_sweeps(index: int, radius_m: float) -> None:
    vehicle = Vehicle(turning_radius_m=radius_m, implement_width_m=2.5)
    shape = Shape.of(vehicle)
    hull = shapely.Polygon(shape.hulls[index]).buffer(BULGE_M)
    discs = shapely.union_all([shapely.Point(x, y).buffer(r, 64) for x, y, r in shape.discs[index]])
    assert discs.buffer(1e-3).covers(shapely.Polygon(shape.hulls[index]))
    curvature = CURVATURES[index] / radius_m
    for d in np.linspace(0.0, shape.step_m, 9):
        yaw = curvature * d
        x, y = d, 0.0
        if curvature:
            x, y = np.sin(yaw) / curvature, (1.0 - np.cos(yaw)) / curvature
        assert hull.covers(placed(vehicle.footprint(), x, y, yaw))
