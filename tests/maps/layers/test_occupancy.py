"""Occupancy: clamped log-odds of what frames say, a frame once in a cell, a drive at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.geometry import Lattice, Window
from fieldgrid.maps import GROUPS, FrameCells, MapView, Transfer, WindowFold, land, open_map
from tests.maps.file.maps import CELL_M, Frame, drive, one_cell, write_map

LAYER = "occupancy"


def read(path: Path, **options: object) -> MapView:
    with open_map(path) as universal:
        return universal.read(layers=[LAYER], **options)  # type: ignore[arg-type]


def probability(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-min(max(log_odds, -2.0), 3.5)))


@pytest.mark.parametrize(
    ("drives", "log_odds"),
    [
        ([[0]], -0.4),
        ([[50, 51, 100]], -0.4),
        ([[101]], 0.85),
        ([[255, 0, 0]], 0.05),
        ([[0] * 9], -2.0),
        ([[200] * 9], 3.5),
        # A drive is clamped by itself: nine frames of one do not outweigh two later drives.
        ([[200] * 9, [0] * 9], 1.5),
        ([[200] * 9, [0] * 9, [0] * 5], -0.5),
    ],
)
def test_frames_add_up_to_log_odds(
    tmp_path: Path, drives: list[list[int]], log_odds: float
) -> None:
    frames = [[one_cell(2.05, 3.05, density) for density in one] for one in drives]
    view = read(write_map(tmp_path / "map.gpkg", frames))
    (found,) = view.layer(LAYER)[view.observed]
    assert found == pytest.approx(probability(log_odds), rel=1e-6)
    assert np.isnan(view.layer(LAYER)[~view.observed]).all()


@pytest.mark.parametrize("transfer", Transfer)
@pytest.mark.parametrize("cell_m", [CELL_M, 0.3])
def test_a_frame_says_the_strongest_thing_once(transfer: Transfer, cell_m: float) -> None:
    """Against the rule, cell by cell and frame by frame."""
    frames, lattice, window = drive(4, step_m=0.7), Lattice(cell_m), Window(-200, -200, 400, 400)
    fold = WindowFold(lattice, window, transfer, (GROUPS["density"], GROUPS[LAYER]))
    expected: npt.NDArray[np.int64] = np.zeros(window.width * window.height, np.int64)
    for grid, pose in frames:
        fold.add(FrameCells(grid, {}), pose)
        landing = land(grid, pose, lattice, window, transfer)
        parts = np.repeat(np.repeat(grid.density, 1 << landing.shift, 0), 1 << landing.shift, 1)
        said: npt.NDArray[np.int64] = np.full(expected.size, -1, np.int64)
        inside = landing.cell >= 0
        np.maximum.at(said, landing.cell[inside], parts[inside].astype(np.int64))
        expected += np.where(said > 100, 17, np.where((said >= 0) & (said <= 50), -8, 0))
    found = fold.cells()["log_odds"].view(np.int64).ravel()
    np.testing.assert_array_equal(found, np.clip(expected, -40, 70))
    assert len(np.unique(found)) > 5


def test_it_does_not_depend_on_order_and_leaves_without_a_trace(tmp_path: Path) -> None:
    drives: Sequence[Sequence[Frame]] = [drive(5, step_m=0.7), drive(4, heading_deg=-60.0)]
    shuffled = [drives[1][::-1], [drives[0][k] for k in (3, 0, 4, 1, 2)]]
    view = read(write_map(tmp_path / "one.gpkg", drives))
    other = read(write_map(tmp_path / "two.gpkg", shuffled))
    np.testing.assert_array_equal(view.layer(LAYER), other.layer(LAYER))
    path = write_map(tmp_path / "more.gpkg", [*drives, drive(3, heading_deg=100.0)])
    with open_map(path, writable=True) as universal:
        universal.remove_session("2")
        assert universal.verify(deep=True).problems == ()
        undone = universal.read(layers=[LAYER])
    np.testing.assert_array_equal(view.layer(LAYER), undone.layer(LAYER))


@pytest.mark.parametrize("factor", [2, 4, 5])
def test_a_larger_cell_is_as_likely_occupied_as_the_likeliest_in_it(
    tmp_path: Path, factor: int
) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(5, step_m=0.7), drive(4, heading_deg=-60.0)])
    fine, coarse = read(path), read(path, cell_m=CELL_M * factor)
    found = dict(zip(map(tuple, np.argwhere(coarse.observed)), coarse.layer(LAYER)[coarse.observed],
                     strict=True))  # fmt: skip
    expected: dict[tuple[int, int], float] = {}
    for j, i in np.argwhere(fine.observed):
        place = (
            (fine.window.j0 + j) // factor - coarse.window.j0,
            (fine.window.i0 + i) // factor - coarse.window.i0,
        )
        expected[place] = max(expected.get(place, 0.0), fine.layer(LAYER)[j, i])
    assert found == expected
