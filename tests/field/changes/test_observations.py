"""What one frame says of cells."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.field.changes.cells import SideCells, seen_by
from fieldgrid.field.changes.observations import _range_sigma_1pm, hidden, observers
from fieldgrid.geometry import GridSpec, Lattice, LocalGrid, Window
from fieldgrid.maps import open_map
from tests.field.changes.worlds import pose, world_map
from tests.scenes import paper_rig

SPEC = GridSpec(width_m=4.0, length_m=6.0, cell_m=0.1)


def test_what_lies_shortly_behind_an_obstacle_is_hidden() -> None:
    density = np.zeros(SPEC.shape, dtype=np.uint8)
    density[30, 18:22] = 200  # 3 m ahead
    seen = hidden(LocalGrid(SPEC, density, np.ones(SPEC.shape, dtype=np.bool_)))
    ahead = seen[:, 20]
    assert not ahead[:31].any()
    assert ahead[32:37].all()  # as far as 3.05 m / 0.8
    assert not ahead[39:].any()
    assert not seen[:, :10].any()
    assert not seen[:, 30:].any()


def test_an_unsure_cell_hides_nothing_nor_does_an_unseen_one() -> None:
    density = np.full(SPEC.shape, 100, dtype=np.uint8)
    assert not hidden(LocalGrid(SPEC, density, np.ones(SPEC.shape, dtype=np.bool_))).any()
    density[:] = 200
    assert not hidden(LocalGrid(SPEC, density, np.zeros(SPEC.shape, dtype=np.bool_))).any()


def test_how_unsure_ranges_are_comes_from_the_session() -> None:
    """R² · sigma_d / (f · b), with f = 780 px and b = 0.2 m."""
    config: dict[str, Any] = {
        "rig": paper_rig().as_dict(), "settings": {"stereo": {"disparity_sigma_px": 0.25}},
    }  # fmt: skip
    assert _range_sigma_1pm(config) == pytest.approx(0.25 / (780.0 * 0.2))


@pytest.mark.parametrize(
    "config", [{}, {"rig": None}, {"rig": {"camera": 3}}, {"rig": [], "settings": "no"}]
)
def test_a_session_that_does_not_say_has_exact_ranges(config: dict[str, Any]) -> None:
    assert _range_sigma_1pm(config) == 0.0


def test_how_unsure_a_place_is_grows_with_range(tmp_path: Path) -> None:
    at = pose(0.0, 0.0, 0.0, sigma_m=0.05)
    lattice, everywhere = Lattice(0.1), Window(-100, -100, 200, 200)
    with open_map(world_map(tmp_path / "map.gpkg", {"one": ([], [at])})) as universal:
        frames, (info,) = list(universal.frames(with_grid=True)), universal.sessions()
        (one,) = observers(frames, info, lattice, [everywhere], None)
        look = one._replace(range_sigma_1pm=0.01).observe(lattice, Window(0, 40, 1, 1))
    assert look is not None
    assert look.free.all()
    turned_m = 4.05 * math.radians(at.heading_sigma_deg)
    assert look.pose_m2[0, 0] == pytest.approx(0.05**2 + turned_m**2, rel=1e-3)
    assert look.range_m2[0, 0] == pytest.approx((0.01 * 4.05**2) ** 2, rel=0.01)


def test_errors_of_ranges_average_out_and_those_of_poses_do_not() -> None:
    def one(value: float) -> Any:
        return np.full((1, 1), value, dtype=np.float32)

    seen = SideCells(one(3.0), one(1.0), one(0), one(1), one(0.01), one(0.04), one(0))
    assert seen.variance_m2[0, 0] == pytest.approx(0.01 + 0.04 / 4.0)


def test_of_several_looks_the_mean_counts(tmp_path: Path) -> None:
    poses = [pose(0.0, 0.0, 0.0, sigma_m=0.05), pose(0.0, 1.0, 0.0, sigma_m=0.09, time_ns=1)]
    lattice, cell = Lattice(0.1), Window(0, 40, 1, 1)
    with open_map(world_map(tmp_path / "map.gpkg", {"one": ([], poses)})) as universal:
        frames, (info,) = list(universal.frames(with_grid=True)), universal.sessions()
        both = observers(frames, info, lattice, [cell], None)
        seen = seen_by({"one": both}, lattice, cell)
    looks = [one.observe(lattice, cell) for one in both]
    assert seen.free[0, 0] == 2.0
    assert seen.pose_m2[0, 0] == pytest.approx(
        np.mean([look.pose_m2[0, 0] for look in looks if look is not None])
    )
