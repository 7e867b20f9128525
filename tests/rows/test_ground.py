"""Outlines of areas of cells."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.evidence import Evidence
from fieldgrid.rows.ground import polygons_of
from tests.rows.fields import straight, view_of


def test_cells_that_meet_in_a_corner_are_two_valid_areas() -> None:
    evidence = Evidence.of(view_of(straight(2, 10.0)), 100)
    mask = np.zeros(evidence.cells.shape, dtype=np.uint8)
    mask[10:20, 10:20] = mask[20:30, 20:30] = 1
    mask[10:20, 50:60] = mask[20:30, 40:50] = 1
    found = polygons_of(evidence, mask, 0.01)
    assert len(found) == 4
    assert all(shape.is_valid for shape in found)
    assert [shape.area for shape in found] == pytest.approx([1.0] * 4, abs=0.2)


def test_a_hole_that_meets_the_outside_in_a_corner_is_open() -> None:
    evidence = Evidence.of(view_of(straight(2, 10.0)), 100)
    mask = np.zeros(evidence.cells.shape, dtype=np.uint8)
    mask[10:40, 10:40] = 1
    mask[30:40, 30:40] = mask[20:30, 20:30] = 0
    (shape,) = polygons_of(evidence, mask, 0.01)
    assert shape.is_valid
    assert not shape.interiors
    assert shape.area == pytest.approx(7.0, abs=0.4)
