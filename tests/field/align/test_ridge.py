"""Along walls that are all alike nothing tells a shift, and chance is not believed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fieldgrid.field import align_map
from fieldgrid.field.align.ridge import across_alone
from fieldgrid.maps import Transform, open_map
from tests.field.align.field import Field, left_m, write_field


@pytest.mark.parametrize(
    ("east_m", "north_m", "seed", "even"),
    [
        (0.0, -0.5, 1, False),
        (0.2, 1.0, 2, True),
        pytest.param(0.0, -0.5, 1, True, marks=pytest.mark.long),
        pytest.param(0.2, 1.0, 2, False, marks=pytest.mark.long),
    ],
)
def test_a_shift_along_even_walls_is_left_to_the_receivers(
    tmp_path: Path, east_m: float, north_m: float, seed: int, even: bool
) -> None:
    field = Field(seed, even=even)
    drives = {
        "a": field.drive([0.0], sigma_m=0.02, seed=seed),
        "b": field.drive([0.0], by=Transform(east_m, north_m), seed=seed + 10, start_s=1e5),
    }
    true = dict(drives, b=field.drive([0.0], seed=seed + 10, start_s=1e5))
    with open_map(write_field(tmp_path / "map.gpkg", drives, 0.5)) as universal:
        found = align_map(universal)
    (pair,) = found.pairs
    east, north = np.diff(left_m(found.transforms, drives, true), axis=0)[0]
    assert pair.doubt is None
    assert abs(east) < 0.05
    if even:
        assert north == pytest.approx(north_m, abs=0.05)  # as it was
        assert pair.sigma_m > 0.3
        assert abs((pair.weak_axis_deg + 90.0) % 180.0 - 90.0) < 1.0
        assert not np.isfinite(pair.weak_sigma_m) or pair.weak_sigma_m > 1.0
    else:
        assert abs(north) < 0.05
        assert pair.sigma_m < 0.05


def test_what_is_told_across_a_ridge_stays() -> None:
    along, across = np.array([0.6, 0.8]), np.array([0.8, -0.6])
    some = [
        9e3 * np.outer(across, across) + 40.0 * n * np.outer(along, along) for n in (0.5, 1.0, 2.0)
    ]
    for one in across_alone(some, along):
        assert along @ one @ along == pytest.approx(0.0, abs=1e-6)
        assert across @ one @ across == pytest.approx(9e3)
    kept = across_alone(some, np.zeros(2))
    assert all(np.array_equal(one, other) for one, other in zip(kept, some, strict=True))
