"""A view over several maps is a view of the map that merging them would make."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.core import ConfigError, DatumError, MapError
from fieldgrid.geometry import Bounds, Datum
from fieldgrid.maps import (
    Costmap,
    Farm,
    HeightCorrection,
    MapView,
    Mark,
    MarkKind,
    Readable,
    Selection,
    Transform,
    create_map,
    merge_maps,
    open_map,
)
from fieldgrid.maps.farm.maps import Maps
from tests.maps.file.maps import DATUM, drive, write_session

ELSEWHERE = Datum(DATUM.lat_deg + 2e-4, DATUM.lon_deg - 3e-4, DATUM.height_m + 4.0)
ALL = ("count", "max", "sessions", "persistence", "variance", "peak", "seen_share", "lasting")


FRAMES = {"june": 5, "july": 6, "august": 7, "may": 8}


def write(
    path: Path, headings: dict[str, float], datum: Datum = DATUM, cell_m: float = 0.1
) -> None:
    """A map of drives that begin in one place."""
    with create_map(path, datum, cell_m=cell_m) as universal:
        for name, heading_deg in headings.items():
            write_session(universal, name, drive(FRAMES[name], heading_deg=heading_deg))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three maps that cross each other near the datum."""
    found = tmp_path_factory.mktemp("farm")
    write(found / "a.gpkg", {"june": 37.3, "july": 99.0})
    write(found / "b.gpkg", {"june": -150.0})
    write(found / "c.gpkg", {"august": 170.0})
    with open_map(found / "b.gpkg", writable=True) as universal:
        corners = ((-8.0, 0.0), (-4.0, 0.0), (-4.0, 6.0))
        universal.add_marks([Mark(MarkKind.KEEPOUT, corners), Mark(MarkKind.FREE, corners)])
    return found


@pytest.fixture(scope="module")
def merged(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("merged") / "merged.gpkg"
    merge_maps(sorted(folder.glob("*.gpkg")), out)
    return out


@pytest.fixture
def farm(folder: Path) -> Iterator[Farm]:
    with Farm(folder) as opened:
        yield opened


def assert_same(one: MapView, other: MapView) -> None:
    assert (one.lattice, one.window, one.datum) == (other.lattice, other.window, other.datum)
    for name in ("density", "observed", *other.layers):
        np.testing.assert_array_equal(one.layer(name), other.layer(name), name)


@pytest.mark.parametrize("cell_m", [None, 0.2, 0.3, 0.8, 1.6, 0.13])
@pytest.mark.parametrize("at", [None, "june"])
def test_cells_of_any_size_are_those_of_the_merged_map(
    farm: Farm, merged: Path, cell_m: float | None, at: str | None
) -> None:
    with open_map(merged) as universal:
        assert farm.bounds == universal.bounds
        assert [i.name for i in farm.sessions()] == [i.name for i in universal.sessions()]
        for layers in (), ALL:
            one = farm.read(cell_m=cell_m, layers=layers, at=at, decide="density")
            other = universal.read(cell_m=cell_m, layers=layers, at=at, decide="density")
            assert_same(one, other)
            for ours, theirs in zip(one.decision(), other.decision(), strict=True):
                np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("cell_m", [None, 0.2])
@pytest.mark.parametrize("east_m", [-6.0, -4.0, -2.0, 0.0, 2.0, 4.0])
def test_a_window_inside_of_maps_is_that_of_the_merged_map(
    farm: Farm, merged: Path, east_m: float, cell_m: float | None
) -> None:
    part = Bounds(east_m, -0.8, east_m + 1.6, 0.8)
    with open_map(merged) as universal:
        one = farm.read(part, cell_m=cell_m, layers=ALL)
        assert_same(one, universal.read(part, cell_m=cell_m, layers=ALL))


def test_blocks_and_overviews_are_those_of_the_merged_map(farm: Farm, merged: Path) -> None:
    part = Bounds(-9.0, -3.0, 7.0, 9.0)
    with open_map(merged) as universal:
        with farm.read_blocks(part, 0.2) as ours, universal.read_blocks(part, 0.2) as theirs:
            for one, other in zip(ours.views, theirs.views, strict=True):
                assert_same(one, other)
        asked = Selection(part)
        with (
            asked.blocks(farm, smallest_px=32) as ours,
            asked.blocks(universal, smallest_px=32) as theirs,
        ):
            assert len(ours.levels) > 1
            for one, other in zip(ours.views, theirs.views, strict=True):
                assert_same(one, other)


def test_what_takes_a_map_takes_a_farm(farm: Farm, merged: Path) -> None:
    def costs(of: Readable) -> Costmap:
        return Costmap.from_map(of, Bounds(-9.0, -3.0, 7.0, 9.0), 0.2, layer="lasting")

    with open_map(merged) as universal:
        np.testing.assert_array_equal(costs(farm).costs, costs(universal).costs)


def test_few_maps_are_open_at_a_time(folder: Path, merged: Path) -> None:
    with Farm(folder) as farm, open_map(merged) as universal:
        farm._maps = maps = Maps(most=1)
        assert_same(farm.read(layers=ALL), universal.read(layers=ALL))
        assert len(maps._open) == 1
        farm.close()
        assert not maps._open
        assert_same(farm.read(), universal.read())


def test_only_maps_that_a_window_touches_are_opened(folder: Path) -> None:
    with Farm(folder) as farm:
        alone = Bounds(2.0, 16.0, 4.0, 18.0)  # at the end of the first drive of a
        assert len(farm.marks()) == 2
        farm.close()
        assert farm.read(alone).observed.any()
        assert [path.name for path in farm._maps._open] == ["a.gpkg"]


def test_maps_of_other_datums_and_cells_are_laid_into_one_plane(
    folder: Path, tmp_path: Path
) -> None:
    shutil.copy(folder / "a.gpkg", tmp_path)
    write(tmp_path / "b.gpkg", {"may": -150.0}, ELSEWHERE)
    write(tmp_path / "c.gpkg", {"august": 170.0}, cell_m=0.15)
    with open_map(tmp_path / "b.gpkg", writable=True) as universal:
        universal.add_marks([Mark(MarkKind.KEEPOUT, ((-8.0, 0.0), (-4.0, 0.0), (-4.0, 6.0)))])
    with Farm(tmp_path) as farm:
        with pytest.raises(DatumError, match=r"b\.gpkg has the datum .*--datum-from .*a\.gpkg"):
            farm.read()
        assert [block.problem for block in farm.blocks] == ["", "", ""]
    out = tmp_path / "out" / "merged.gpkg"
    out.parent.mkdir()
    merge_maps(sorted(tmp_path.glob("*.gpkg")), out, datum=DATUM, cell_m=0.15)
    with Farm(tmp_path, datum=DATUM) as farm, open_map(out) as universal:
        (moved,) = farm.moved
        assert (moved.block.name, round(moved.distance_m)) == ("b", 34)
        assert 0.0 < moved.height_error_m < 1e-3
        for cell_m in (None, 0.3, 0.6):
            assert_same(
                farm.read(universal.bounds, cell_m, layers=("count", "max", "height")),
                universal.read(universal.bounds, cell_m, layers=("count", "max", "height")),
            )
        ours, theirs = farm.marks(), universal.marks()
        np.testing.assert_allclose(ours[0].corners, theirs[0].corners, atol=1e-6)


def test_a_farm_that_reaches_too_far_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "a.gpkg", {"june": 37.3})
    write(tmp_path / "b.gpkg", {"june": 37.3}, Datum(DATUM.lat_deg + 0.6, DATUM.lon_deg, 700.0))
    with (
        Farm(tmp_path, datum=DATUM) as farm,
        pytest.raises(DatumError, match=r"b\.gpkg lies 67 km from the datum.*give a datum between"),
    ):
        farm.read()


@pytest.mark.parametrize("datum", [DATUM, ELSEWHERE])
def test_a_drive_that_two_maps_have_counts_once(folder: Path, tmp_path: Path, datum: Datum) -> None:
    shutil.copy(folder / "a.gpkg", tmp_path)
    merge_maps([folder / "a.gpkg", folder / "c.gpkg"], tmp_path / "b.gpkg", datum=datum)
    with Farm(tmp_path, datum=DATUM) as farm:
        assert [info.name for info in farm.sessions()] == ["june", "july", "august"]
        with Farm(folder) as other, open_map(folder / "b.gpkg") as left_out:
            whole, less = (one.read(other.bounds, layers=["count"]) for one in (other, farm))
            without = left_out.read(other.bounds, layers=["count"]).layer("count")
        np.testing.assert_array_equal(less.layer("count"), whole.layer("count") - without)
    for elsewhere, why in (
        (Transform(0.5), "lies up to 0.50 m aside"),
        (Transform(heights=HeightCorrection((0,), (0.3,))), "lies up to 0.30 m higher or lower"),
    ):
        with open_map(tmp_path / "b.gpkg", writable=True) as universal:
            universal.set_transforms({"july": elsewhere})
        with (
            Farm(tmp_path, datum=DATUM) as farm,
            pytest.raises(
                ConfigError, match=rf"'july' of .*b\.gpkg is the same drive.*{why}.*--shift"
            ),
        ):
            farm.read()


def test_a_map_that_changes_is_noticed(folder: Path, tmp_path: Path) -> None:
    for file in folder.glob("*.gpkg"):
        shutil.copy(file, tmp_path)
    with Farm(tmp_path) as farm:
        assert farm.read().observed.any()
        with open_map(tmp_path / "a.gpkg", writable=True) as universal:
            universal.remove_session("june")
        with pytest.raises(MapError, match=r"a\.gpkg has changed since the farm was opened"):
            farm.read()
    with Farm(tmp_path) as farm:
        assert [info.name for info in farm.sessions()] == ["july", "june", "august"]
