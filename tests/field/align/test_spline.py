"""Splines through scores, against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from fieldgrid.field.align.score import between_cells


@pytest.mark.parametrize("beyond", [0.0, 3.0, 10.0])
def test_it_is_what_scipy_reads_at_the_crossings(beyond: float) -> None:
    """Between cells, and beyond the border, where all is as at it."""
    random = np.random.default_rng(2)
    values = random.normal(size=(13, 17))
    rows = random.uniform(-beyond, 12.0 + beyond, 21)
    columns = random.uniform(-beyond, 16.0 + beyond, 9)
    expected = ndimage.map_coordinates(
        values, np.meshgrid(rows, columns, indexing="ij"), order=3, mode="nearest"
    )
    assert between_cells(values, rows, columns) == pytest.approx(expected, abs=1e-12)
