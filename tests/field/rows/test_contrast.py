"""Lines through noise are no rows, however many cells there are; rows in noise are."""

from __future__ import annotations

import dataclasses
from typing import NoReturn

import cv2
import numpy as np
import pytest
import shapely

from benchmarks.planting import DATUM
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.field.rows.measuring import measure
from fieldgrid.field.rows.measuring.contrast import Contrast, chances_of_noise, stand_out
from fieldgrid.geometry import Bounds, Lattice
from fieldgrid.maps import MapView
from tests.field.rows.fields import QUIET, line_of, rms_m, straight, view_of


def noise(per_m2: float, heap_m: float, seed: int, side_m: float = 35.0) -> MapView:
    """Seen ground with obstacle cells, or heaps of them, at random places."""
    rng, lattice = np.random.default_rng(seed), Lattice(0.1)
    window = lattice.window(Bounds(0.0, 0.0, side_m, side_m))
    cells = (rng.random(window.shape) < per_m2 * 0.1**2).astype(np.uint8)
    size = round(heap_m / 0.1) | 1
    cells = cv2.dilate(cells, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    return MapView(
        lattice, window, cells * np.uint8(200), np.ones(window.shape, np.bool_), DATUM, is_base=True
    )


@pytest.mark.parametrize(
    ("per_m2", "heap_m", "crop"),
    [
        (3.0, 0.0, "vineyard"),
        (0.2, 0.8, "vineyard"),
        (5.0, 0.0, "orchard"),
        (20.0, 0.0, "bushes"),
        *[
            pytest.param(per_m2, heap_m, "vineyard", marks=pytest.mark.long)
            for per_m2, heap_m in (
                (1, 0.0),
                (5, 0.0),
                (10, 0.0),
                (40, 0.0),
                (0.1, 0.3),
                (0.5, 0.3),
                (0.05, 0.8),
                (0.5, 0.8),
            )
        ],
    ],
)
def test_there_are_no_rows_in_noise(per_m2: float, heap_m: float, crop: str) -> None:
    found = rows_of_view(noise(per_m2, heap_m, seed=3), crop=crop)
    assert found.rows == found.lanes == found.blocks == ()


def test_rows_in_noise_are_found_alone() -> None:
    rows = straight(4, 30.0, 2.5, 20.0)
    view = view_of(rows, dataclasses.replace(QUIET, noise_per_m2=3.0))
    found = rows_of_view(view)
    assert len(found.rows) == 4
    for row in rows:
        assert rms_m(line_of(found, row), row) < 0.08


def test_fewer_candidates_have_to_be_surer() -> None:
    assert stand_out(np.array([9e-5, 1e-9, 5e-5])).tolist() == [True, True, True]
    assert stand_out(np.array([9e-5, 0.3, 1.0])).tolist() == [False, False, False]
    assert stand_out(np.array([0.3, 1e-5, 1.0])).tolist() == [False, True, False]
    assert stand_out(np.zeros(0)).tolist() == []


@pytest.mark.parametrize("side_m", [16.0, pytest.param(40.0, marks=pytest.mark.long)])
def test_lines_without_order_have_an_area(side_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """GEOS cannot triangulate the outline of those on 40 m for a concave hull."""
    asked: list[object] = []

    def fail(outline: object, ratio: float) -> NoReturn:
        asked.append(outline)
        raise shapely.GEOSException

    if side_m < 40.0:
        monkeypatch.setattr(shapely, "concave_hull", fail)
    monkeypatch.setattr(measure, "stand_out", lambda chances: np.ones(len(chances), np.bool_))
    found = rows_of_view(noise(5.0, 0.0, seed=0, side_m=side_m), crop="bushes")
    assert len(found.rows) > 3
    assert len(asked) > 0 or side_m == 40.0
    assert all(block.area.area > 0.0 for block in found.blocks)


def trees(on: list[int]) -> Contrast:
    """A line with so many cells in its parts, and specks in one of ten parts beside it."""
    return Contrast(1e-3, np.array(on), np.array([0, 0, 0, 0, 0, 0, 0, 0, 0, 1] * 4))


def test_plants_in_every_part_are_no_chance_and_one_heap_is() -> None:
    row, heap, specks = chances_of_noise([trees([9] * 8), trees([90] + [0] * 7), trees([1] * 8)])
    assert row < 1e-6 < 1e-3 < heap
    assert specks > 100.0 * row
    hedge = Contrast(0.2, np.zeros(0, np.int64), np.zeros(0, np.int64))
    assert chances_of_noise([hedge]).tolist() == [0.2]
