from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import ConfigError
from fieldgrid.geometry import FREE_UP_TO, OBSTACLE_ABOVE
from fieldgrid.maps import CostCurve


@st.composite
def curves(draw: st.DrawFn) -> CostCurve:
    free = draw(st.integers(0, 254))
    return CostCurve(free, draw(st.integers(free, 254)), draw(st.floats(0.1, 10.0)))


@given(curves())
def test_a_curve_is_monotone_and_keeps_its_three_parts_apart(curve: CostCurve) -> None:
    table = curve.table()
    assert table.dtype == np.int8
    assert np.all(np.diff(table.astype(int)) >= 0)
    density = np.arange(256)
    np.testing.assert_array_equal(table == 0, density <= curve.free_up_to)
    np.testing.assert_array_equal(table == 100, density > curve.obstacle_above)


def test_the_usual_curve_in_numbers() -> None:
    table = CostCurve().table()
    assert (FREE_UP_TO, OBSTACLE_ABOVE) == (50, 100)
    # 100 * (75 - 50) / 51 = 49.02
    assert [table[d] for d in (0, 50, 51, 75, 100, 101, 255)] == [0, 0, 2, 49, 98, 100, 100]


def test_the_shape_makes_doubt_cheap_or_dear() -> None:
    cheap, line, dear = (CostCurve(shape=shape).table().astype(int) for shape in (3.0, 1.0, 0.3))
    doubt = slice(FREE_UP_TO + 1, OBSTACLE_ABOVE + 1)
    assert np.all(cheap[doubt] <= line[doubt])
    assert np.all(line[doubt] <= dear[doubt])
    assert cheap[75] == round(100 * (25 / 51) ** 3)


def test_unknown_is_neither_free_nor_an_obstacle() -> None:
    density = np.array([[0, 75, 255], [0, 75, 255]], dtype=np.uint8)
    observed = np.array([[True] * 3, [False] * 3])
    assert CostCurve().occupancy(density, observed).tolist() == [[0, 49, 100], [-1, -1, -1]]
    assert CostCurve().cost(density, observed).tolist() == [[0, 124, 254], [255, 255, 255]]
    assert density.tolist() == [[0, 75, 255], [0, 75, 255]]


@given(curves())
def test_costs_are_those_of_the_static_layer(curve: CostCurve) -> None:
    """Its rule, written out: lethal from 100 on, else value / 100 * 254, cut to a whole number."""
    density = np.arange(256, dtype=np.uint8)
    cost = curve.cost(density, np.ones(256, dtype=np.bool_))
    expected = [254 if v >= 100 else int(v / 100 * 254) for v in curve.table().tolist()]
    assert cost.tolist() == expected
    assert cost.dtype == np.uint8


@pytest.mark.parametrize(
    ("free", "obstacle", "shape"),
    [(-1, 100, 1.0), (101, 100, 1.0), (50, 255, 1.0), (50, 100, 0.0), (50, 100, float("nan"))],
)
def test_what_is_no_curve_is_refused(free: int, obstacle: int, shape: float) -> None:
    with pytest.raises(ConfigError, match=r"no curve|outside 0\.1\.\.10"):
        CostCurve(free, obstacle, shape)
