"""The geometry and the values of a vehicle-fixed grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fieldgrid.core import ConfigError
from fieldgrid.geometry import GridSpec, LocalGrid


def test_the_paper_s_grid_is_133_x_280_cells() -> None:
    spec = GridSpec(6.65, 14.0, 0.05)
    assert (spec.n_x, spec.n_y) == (133, 280)
    assert spec.shape == (280, 133)


def test_centres_are_symmetric_and_start_at_the_vehicle() -> None:
    spec = GridSpec(2.0, 3.0, 0.5)
    x, y = spec.centres_m()
    assert x.tolist() == [-0.75, -0.25, 0.25, 0.75]
    assert y.tolist() == [0.25, 0.75, 1.25, 1.75, 2.25, 2.75]
    odd, _ = GridSpec(6.65, 14.0, 0.05).centres_m()
    assert odd[66] == pytest.approx(0.0, abs=1e-12)
    assert odd[0] == pytest.approx(-3.3)


def test_the_reach_is_to_the_farthest_corner() -> None:
    assert GridSpec(6.0, 4.0, 0.05).reach_m == pytest.approx(5.0)
    paper = GridSpec(6.65, 14.0, 0.05)
    assert paper.reach_m - 14.0 == pytest.approx(0.39, abs=0.005)


@pytest.mark.parametrize(
    ("values", "quoted"),
    [
        ((10.0, 15.0, 0.001), "0.001"),
        ((10.0, 15.0, math.nan), "nan"),
        ((0.01, 15.0, 0.05), "width of 0.01"),
        ((10.0, 300.0, 0.05), "length of 300.0"),
        ((math.inf, 15.0, 0.05), "width of inf"),
        ((6.66, 14.0, 0.05), "width of 6.66"),
        ((10.0, 15.02, 0.05), "length of 15.02"),
        ((200.0, 200.0, 0.05), "4000 x 4000"),
    ],
)
def test_a_grid_that_cannot_be_is_refused(values: tuple[float, ...], quoted: str) -> None:
    with pytest.raises(ConfigError, match=quoted):
        GridSpec(*values)


@pytest.mark.parametrize("wrong", ["density", "observed"])
def test_arrays_must_fit_the_geometry(wrong: str) -> None:
    spec = GridSpec(2.0, 3.0, 0.5)
    arrays = {"density": np.zeros(spec.shape, np.uint8), "observed": np.zeros(spec.shape, bool)}
    arrays[wrong] = arrays[wrong].T
    with pytest.raises(ConfigError, match=rf"{wrong} has shape \(4, 6\)"):
        LocalGrid(spec, **arrays)
