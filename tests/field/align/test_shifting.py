"""The kernel that shifts pictures is held to SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from fieldgrid.field.align.agreement import shifted_sums


def test_sums_are_those_of_scipy() -> None:
    random = np.random.default_rng(5)
    pictures = random.uniform(0.0, 1.0, (6, 17, 12))
    by = random.uniform(-3.0, 3.0, (2, 4, 6))
    by[:, 0] = 0.0
    by[0, 1], by[1, 1] = np.arange(-3.0, 3.0), 2.0  # whole cells
    by[:, 2, 0] = 30.0  # all of it is outside
    found = shifted_sums(pictures, *by)
    for sums, rows, columns in zip(found, *by, strict=True):
        each = [
            ndimage.shift(one, (down, right), order=1)
            for one, down, right in zip(pictures, rows, columns, strict=True)
        ]
        assert sums == pytest.approx(np.sum(each, axis=0), abs=1e-12)
