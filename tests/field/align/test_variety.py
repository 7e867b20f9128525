"""Drives that differ: other sensors and cells, one side of a row, what grew or came meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import Bool, Float64
from fieldgrid.field import MapAlignment, align_map
from fieldgrid.geometry import GridSpec, LocalGrid
from fieldgrid.maps import Transform, open_map, to_universal
from tests.field.align.field import Drive, Field, left_m, write_field

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


def with_more(frames: Drive, is_there: Callable[[Float64, Float64], Bool]) -> Drive:
    """What was seen, and obstacles more at places east and north."""
    found = []
    for grid, pose in frames:
        east, north = to_universal(*np.meshgrid(*grid.spec.centres_m()), pose)
        more = is_there(east, north) & grid.observed
        density = np.where(more, 200, grid.density).astype(np.uint8)
        found.append((LocalGrid(grid.spec, density, grid.observed), pose))
    return found


def weeds(frames: Drive) -> Drive:
    """Weeds of 0.2 m, on a tenth of the ground between rows."""
    there = np.random.default_rng(8).random((400, 400)) < 0.1

    def is_there(east: Float64, north: Float64) -> Bool:
        cells = np.floor(north / 0.2).astype(np.int64) % 400, np.floor(east / 0.2).astype(np.int64)
        return np.asarray(there[cells])

    return with_more(frames, is_there)


def trailer(frames: Drive) -> Drive:
    """A trailer of 2 m by 5 m beside the lane, and a person who walks ahead of the vehicle."""
    parked = with_more(
        frames, lambda east, north: (abs(east - 1.8) < 1.0) & (abs(north - 15.0) < 2.5)
    )
    found = []
    for grid, pose in parked:
        here = pose.east_m, pose.north_m + 5.0
        found += with_more(
            [(grid, pose)],
            lambda east, north, at=here: np.hypot(east - at[0], north - at[1]) < 0.3,
        )
    return found


def aligned(path: Path, drives: dict[str, Drive]) -> MapAlignment:
    """A map of drives, aligned."""
    with open_map(write_field(path, drives, 0.5)) as universal:
        return align_map(universal)


SEEN = {
    "cells of 20 cm": lambda d: coarser(d, 2), "lidar": sparse, "one side": one_side,
    "lidar in cells of 20 cm": lambda d: coarser(sparse(d), 2),
    "growth": lambda d: d, "weeds": weeds, "a trailer and a person": trailer,
    "growth, weeds, a trailer and a person": lambda d: trailer(weeds(d)),
}  # fmt: skip
ALONE = {"cells of 20 cm", "lidar", "growth", "weeds", "a trailer and a person"}
"""Other cases have them in combination."""


@pytest.mark.parametrize(
    "differs",
    [pytest.param(one, marks=pytest.mark.long) if one in ALONE else one for one in SEEN],
)
def test_drives_come_together_though_they_differ(tmp_path: Path, differs: str) -> None:
    field, later = Field(), Field(wide_m=0.8 if "growth" in differs else 0.5)
    true = {"good": field.drive([0.0], sigma_m=0.02, seed=1), "poor": later.drive([0.0], seed=2)}
    poor = SEEN[differs](later.drive([0.0], seed=2, start_s=1e5))
    drives = {"good": true["good"], "poor": [(grid, OFF.pose(pose)) for grid, pose in poor]}
    found = aligned(tmp_path / "map.gpkg", drives)
    (pair,) = found.pairs
    assert pair.doubt is None
    off = float(np.hypot(*left_m(found.transforms, drives, true)[1]))
    assert off < 0.1
    assert off < 3.0 * pair.sigma_m
