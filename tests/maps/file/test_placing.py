"""How the frames of a session are divided into squares of tiles, and what that must not change."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.geometry import TILE_CELLS, GridSpec, Lattice
from fieldgrid.maps import GROUPS, FrameCells, Transfer
from fieldgrid.maps.writing import placing
from fieldgrid.maps.writing.placing import (
    PlacedFrame,
    TileSquares,
)
from tests.maps.file.content import content
from tests.maps.file.maps import CELL_M, drive, grid_of, pose_at, write_map

TILE_M = TILE_CELLS * CELL_M
GROUPS_OF_ALL = tuple(group for group in GROUPS.values() if not group.derived)


def frames_along(heading_deg: float, tiles: int, *, from_m: float = 3.0) -> list[PlacedFrame]:
    """A row of frames through so many tiles, from the datum north or east."""
    grid = grid_of(0, GridSpec(2.0, 4.0, CELL_M))
    poses = [
        pose_at(from_m, from_m + k * TILE_M, heading_deg)
        if heading_deg == 0.0
        else pose_at(from_m + k * TILE_M, from_m, heading_deg)
        for k in range(tiles)
    ]
    return [PlacedFrame(pose, grid.spec, lambda: FrameCells(grid, {})) for pose in poses]


def squares_along(heading_deg: float, tiles: int, *, from_m: float = 3.0) -> TileSquares:
    """The squares of such a row."""
    frames = frames_along(heading_deg, tiles, from_m=from_m)
    return TileSquares(frames, Lattice(CELL_M), Transfer.CENTRE, GROUPS_OF_ALL)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0])
def test_a_small_session_is_folded_in_one_piece(heading_deg: float) -> None:
    assert len(squares_along(heading_deg, 9).places()) == 1
    assert len(squares_along(heading_deg, 10).places()) == 3  # of four tiles


def test_squares_begin_where_the_session_does() -> None:
    far = squares_along(0.0, 9, from_m=3.0 - 2.0 * TILE_M)  # from -2 tiles on, across the datum
    assert len(far.places()) == 1
    found = far.fold(far.places()[0], lambda tile, _: tile)
    assert [tuple(tile) for tile in found] == [(ty, -2) for ty in range(-2, 7)]


def test_without_frames_there_are_no_squares() -> None:
    assert TileSquares([], Lattice(CELL_M), Transfer.CENTRE, GROUPS_OF_ALL).places() == []


@pytest.mark.parametrize("heading_deg", [0.0, 37.3, 91.0])
def test_a_session_has_the_same_tiles_however_it_is_divided(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, heading_deg: float
) -> None:
    frames = drive(12, step_m=9.0, heading_deg=heading_deg)
    whole = write_map(tmp_path / "whole.gpkg", [frames])
    monkeypatch.setattr(placing, "BLOCK_TILES", 1)
    monkeypatch.setattr(placing, "ALONE_TILES", 1)
    divided = write_map(tmp_path / "divided.gpkg", [frames])
    assert content(divided) == content(whole)


def test_frames_far_apart_cost_no_squares_in_between() -> None:
    grid = grid_of(0, GridSpec(2.0, 4.0, CELL_M))
    poses = [pose_at(value, -value, 10.0) for value in (-40_000.0, 3.0, 40_000.0)]
    frames = [PlacedFrame(pose, grid.spec, lambda: FrameCells(grid, {})) for pose in poses]
    squares = TileSquares(frames, Lattice(CELL_M), Transfer.CENTRE, GROUPS_OF_ALL)
    assert 3 <= len(squares.places()) <= 12
    found = [tile for place in squares.places() for tile in squares.fold(place, lambda t, _: t)]
    assert len(found) == len(set(found)) >= 3
