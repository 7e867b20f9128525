"""Terrain is kept in blocks of cells: what several maps tell of one is what a merged map tells."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.geometry import Datum, LocalGrid, Pose
from fieldgrid.maps import Farm, MapView, create_map, merge_maps, open_map
from tests.maps.file.maps import DATUM
from tests.maps.file.terrain import (
    LAYERS,
    SPEC,
    assert_parts_are_those_of_the_whole,
    relief,
    write_drives,
)

ELSEWHERE = Datum(DATUM.lat_deg + 2e-6, DATUM.lon_deg - 3e-6, DATUM.height_m + 4.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Maps that cross each other, and whose extents end within blocks."""
    found = tmp_path_factory.mktemp("farm")
    write_drives(found / "a.gpkg", {"june": 0.0, "july": 37.0})
    write_drives(found / "b.gpkg", {"august": -60.0})
    write_drives(found / "c.gpkg", {"may": 100.0})
    return found


@pytest.fixture(scope="module")
def merged(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("merged") / "merged.gpkg"
    merge_maps(sorted(folder.glob("*.gpkg")), out)
    return out


def assert_same(one: MapView, other: MapView) -> None:
    assert one.window == other.window
    for name in ("density", "observed", *LAYERS):
        np.testing.assert_array_equal(one.layer(name), other.layer(name), name)


@pytest.mark.parametrize("cell_m", [None, 0.1, 0.15, 0.25, 0.4, 0.07, 0.123])
@pytest.mark.parametrize("sessions", [None, ("july", "august")])
def test_cells_of_any_size_are_those_of_the_merged_map(
    folder: Path, merged: Path, cell_m: float | None, sessions: tuple[str, ...] | None
) -> None:
    with Farm(folder) as farm, open_map(merged) as universal:
        one = farm.read(cell_m=cell_m, layers=LAYERS, sessions=sessions)
        other = universal.read(cell_m=cell_m, layers=LAYERS, sessions=sessions)
    assert_same(one, other)


@pytest.mark.parametrize("cell_m", [None, 0.2, 0.09])
def test_maps_of_other_cells_and_datums_are_folded_in_whole_blocks(
    folder: Path, tmp_path: Path, cell_m: float | None
) -> None:
    for name in ("a.gpkg", "b.gpkg"):
        shutil.copy(folder / name, tmp_path)
    write_drives(tmp_path / "c.gpkg", {"may": 100.0}, cell_m=0.06)
    write_drives(tmp_path / "d.gpkg", {"april": 200.0}, datum=ELSEWHERE)
    out = tmp_path / "out" / "merged.gpkg"
    out.parent.mkdir()
    merge_maps(sorted(tmp_path.glob("*.gpkg")), out, datum=DATUM, cell_m=0.06)
    with Farm(tmp_path, datum=DATUM) as farm, open_map(out) as universal:
        assert_same(
            farm.read(universal.bounds, cell_m, layers=LAYERS),
            universal.read(universal.bounds, cell_m, layers=LAYERS),
        )
        assert_parts_are_those_of_the_whole(farm, cell_m)


@pytest.mark.parametrize(
    ("border_m", "cell_m"), [(0.15, None), (0.1, 0.1), (0.15, 0.15), (0.55, 0.123)]
)
def test_maps_that_share_blocks_but_no_cell_tell_of_whole_blocks(
    tmp_path: Path, border_m: float, cell_m: float | None
) -> None:
    folder, out = tmp_path / "farm", tmp_path / "merged.gpkg"
    folder.mkdir()
    east = SPEC.centres_m()[0] + border_m
    for k, seen in enumerate((east < border_m, east > border_m)):
        observed = np.broadcast_to(seen, SPEC.shape)
        grid = LocalGrid(SPEC, np.zeros(SPEC.shape, np.uint8), observed)
        pose = Pose(k, border_m, 0.01, 0.7 - 0.31 * k, 0.0, 0.02, 0.3, 1.0)
        with (
            create_map(folder / f"{k}.gpkg", DATUM, cell_m=SPEC.cell_m) as universal,
            universal.add_session(str(k)) as session,
        ):
            session.add(grid, pose, frame_id="0", channels=relief(k))
    merge_maps(sorted(folder.glob("*.gpkg")), out)
    with Farm(folder) as farm, open_map(out) as universal:
        one, other = (of.read(cell_m=cell_m, layers=LAYERS) for of in (farm, universal))
        assert_same(one, other)
