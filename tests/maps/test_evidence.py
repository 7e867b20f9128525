"""Evidence: strips of cells along a line."""

from __future__ import annotations

import numpy as np

from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import UNSEEN, Evidence


def test_a_strip_holds_the_cells_that_enclose_its_points() -> None:
    """Along a line to the north-east that leaves the window; left of it is north-west."""
    rng = np.random.default_rng(0)
    cells = rng.integers(0, 3, (30, 40)).astype(np.uint8)
    evidence = Evidence(Lattice(0.1), Window(-15, -7, 40, 30), cells)
    line = np.array([[-1.6, -0.9], [0.4, 0.6], [2.4, 2.1]])
    strip = evidence.strip(line, 0.5, 0.3, 0.08, 0.07)
    along, left = np.array([0.8, 0.6]), np.array([-0.6, 0.8])
    points = line[0] + strip.along_m[:, None, None] * along + strip.across_m[:, None] * left
    assert strip.across_m[0] < 0.0 < strip.across_m[-1]
    i, j = (np.floor(points * 10.0).astype(int) - (-15, -7)).transpose(2, 0, 1)
    inside = (i >= 0) & (j >= 0) & (i < 40) & (j < 30)
    expected = np.where(inside, cells[j.clip(0, 29), i.clip(0, 39)], UNSEEN)
    assert 0.0 < inside.mean() < 1.0
    # A point on an edge of cells may be taken for either.
    assert (strip.cells == expected).mean() > 0.999
