from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fieldgrid.geodesy import Datum
from fieldgrid.lattice import Lattice, Window
from fieldgrid.mapfile.base_cells import peak_and_seen
from fieldgrid.mapfile.view import MapView

BASE = Lattice(0.05)
SIZES_M = st.sampled_from([0.03, 0.05, 0.06, 0.075, 0.08, 0.1, 0.12, 0.13, 0.26, 0.4])


@given(
    density=arrays.arrays(np.uint8, (24, 31), elements=st.sampled_from([0, 0, 0, 60, 200])),
    observed=arrays.arrays(np.bool_, (24, 31)),
    cell_m=SIZES_M,
    corner=st.tuples(st.integers(-40, 9), st.integers(-40, 9)),
)
def test_each_cell_has_the_worst_of_the_base_cells_that_it_touches(
    density: np.ndarray, observed: np.ndarray, cell_m: float, corner: tuple[int, int]
) -> None:
    """By comparing every cell with every base cell, in exact units of a tenth of a millimetre."""
    density[~observed] = 0
    i0, j0 = corner
    base = MapView(BASE, Window(i0, j0, 31, 24), density, observed, DATUM, is_base=True)
    lattice = Lattice(cell_m)
    window = lattice.window(base.bounds)
    peak, seen = peak_and_seen(base, lattice, window)
    large, small = round(cell_m * 10_000), 500
    for row in range(window.height):
        for column in range(window.width):
            south, west = (window.j0 + row) * large, (window.i0 + column) * large
            highest, area = 0, 0
            for j in range(24):
                high = min(south + large, (j0 + j + 1) * small) - max(south, (j0 + j) * small)
                if high <= 0:
                    continue
                for i in range(31):
                    wide = min(west + large, (i0 + i + 1) * small) - max(west, (i0 + i) * small)
                    if wide > 0 and observed[j, i]:
                        highest = max(highest, int(density[j, i]))
                        area += wide * high
            assert peak[row, column] == highest
            assert abs(seen[row, column] - area / large**2) < 1e-5


DATUM = Datum(41.0, 2.0, 100.0)
