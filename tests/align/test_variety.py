"""Drives that differ: other sensors and cells, one side of a row."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.align import MapAlignment, align_map
from fieldgrid.grids import GridSpec, LocalGrid
from fieldgrid.mapfile import Transform, open_map
from tests.align.field import Drive, Field, left_m, write_field

OFF = Transform(0.9, -0.7)


def coarser(frames: Drive, cells: int) -> Drive:
    """What a sensor of larger cells saw: the highest density of each few, where half were seen."""
    found = []
    for grid, pose in frames:
        spec = GridSpec(grid.spec.width_m, grid.spec.length_m, round(grid.spec.cell_m * cells, 3))
        shape = spec.n_y, cells, spec.n_x, cells
        density = grid.density.reshape(shape).max(axis=(1, 3))
        seen = grid.observed.reshape(shape).mean(axis=(1, 3)) >= 0.5
        found.append((LocalGrid(spec, np.where(seen, density, 0).astype(np.uint8), seen), pose))
    return found


def one_side(frames: Drive) -> Drive:
    """What was seen to the right of the vehicle alone."""
    found = []
    for grid, pose in frames:
        x, _ = np.meshgrid(*grid.spec.centres_m())
        seen = grid.observed & (x > 0.0)
        found.append(
            (LocalGrid(grid.spec, np.where(seen, grid.density, 0).astype(np.uint8), seen), pose)
        )
    return found


def sparse(frames: Drive, seed: int = 5) -> Drive:
    """What a lidar of few beams hits: a third of the cells, full or free."""
    random = np.random.default_rng(seed)
    found = []
    for grid, pose in frames:
        seen = grid.observed & (random.random(grid.observed.shape) < 0.35)
        density = np.where(seen & (grid.density > 100), 255, 0).astype(np.uint8)
        found.append((LocalGrid(grid.spec, density, seen), pose))
    return found


def aligned(path: Path, drives: dict[str, Drive]) -> MapAlignment:
    """A map of drives, aligned."""
    with open_map(write_field(path, drives, 0.5)) as universal:
        return align_map(universal)


@pytest.mark.parametrize(
    "seen", [lambda d: coarser(d, 2), lambda d: sparse(d), lambda d: one_side(d)],
    ids=["cells of 20 cm", "lidar", "one side"],
)  # fmt: skip
def test_drives_of_other_sensors_come_together(
    tmp_path: Path, seen: Callable[[Drive], Drive]
) -> None:
    field = Field()
    true = {"good": field.drive([0.0], sigma_m=0.02, seed=1), "poor": field.drive([0.0], seed=2)}
    drives = {
        "good": true["good"],
        "poor": seen(field.drive([0.0], by=OFF, seed=2, start_s=1e5)),
    }
    found = aligned(tmp_path / "map.gpkg", drives)
    (pair,) = found.pairs
    assert pair.doubt is None
    off = float(np.hypot(*left_m(found.transforms, drives, true)[1]))
    assert off < 0.1
    assert off < 3.0 * pair.sigma_m
