"""Copies, and several maps as one."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from fieldgrid.errors import ConfigError, DatumError, MapError, MapExistsError
from fieldgrid.geodesy import Datum
from fieldgrid.mapfile import create_map, merge_maps, open_map
from fieldgrid.transfer import Transfer
from tests.mapfile.content import content
from tests.mapfile.maps import DATUM, drive, track, write_map, write_session


@pytest.fixture
def north(tmp_path: Path) -> Path:
    return write_map(
        tmp_path / "north.gpkg", [drive(5), drive(3, heading_deg=99.0)], trajectory=track(5)
    )


def test_a_copy_is_the_map(north: Path, tmp_path: Path) -> None:
    merged = merge_maps([north], tmp_path / "copy.gpkg")
    assert [(one.was, one.name, one.twin) for one in merged] == [("0", "0", None), ("1", "1", None)]
    assert content(tmp_path / "copy.gpkg") == content(north)
    with open_map(north) as a, open_map(tmp_path / "copy.gpkg") as b:
        assert a.sessions() == b.sessions()
        assert list(a.frames()) == list(b.frames())
        assert b.verify().sound


def test_a_copy_leaves_removed_sessions_behind(north: Path, tmp_path: Path) -> None:
    with open_map(north, writable=True) as universal:
        universal.remove_session("0")
    merge_maps([north], tmp_path / "copy.gpkg")
    assert content(tmp_path / "copy.gpkg") == content(north)
    with open_map(tmp_path / "copy.gpkg") as copy:
        assert [info.name for info in copy.sessions()] == ["1"]
    with open_map(north, writable=True) as universal:
        universal.remove_session("1")
    with pytest.raises(ConfigError, match="no session to copy"):
        merge_maps([north], tmp_path / "none.gpkg")
    assert not (tmp_path / "none.gpkg").exists()


def test_two_maps_together_are_the_map_of_all_their_sessions(north: Path, tmp_path: Path) -> None:
    with create_map(tmp_path / "south.gpkg", DATUM, cell_m=0.1) as universal:
        write_session(universal, "x", drive(4, heading_deg=-150.0))
        write_session(universal, "0", drive(2, heading_deg=11.0))
        write_session(universal, "same", drive(3, heading_deg=99.0), track(5))
    merged = merge_maps([north, tmp_path / "south.gpkg"], tmp_path / "farm.gpkg")
    assert [(one.was, one.name, one.twin) for one in merged] == [
        ("0", "0", None),
        ("1", "1", None),
        ("x", "x", None),
        ("0", "0 (south)", None),
        ("same", "1", "1"),
    ]
    with create_map(tmp_path / "at_once.gpkg", DATUM, cell_m=0.1) as universal:
        write_session(universal, "0", drive(5), track(5))
        write_session(universal, "1", drive(3, heading_deg=99.0), track(5))
        write_session(universal, "x", drive(4, heading_deg=-150.0))
        write_session(universal, "0 (south)", drive(2, heading_deg=11.0))
    assert content(tmp_path / "farm.gpkg") == content(tmp_path / "at_once.gpkg")


def test_a_merged_map_can_have_other_cells_and_another_rule(north: Path, tmp_path: Path) -> None:
    out = tmp_path / "coarse.gpkg"
    merge_maps([north], out, cell_m=0.37, transfer=Transfer.AREA)
    with open_map(north) as fine, open_map(out) as coarse:
        assert (coarse.cell_m, coarse.transfer) == (0.37, Transfer.AREA)
        bounds = coarse.bounds
        expected = fine.read(bounds, 0.37, transfer=Transfer.AREA)
        view = coarse.read(bounds)
        np.testing.assert_array_equal(view.density, expected.density)
        np.testing.assert_array_equal(view.observed, expected.observed)
    with pytest.raises(ConfigError, match="smaller than the local cells"):
        merge_maps([north], tmp_path / "fine.gpkg", cell_m=0.05)
    assert not (tmp_path / "fine.gpkg").exists()


def test_maps_of_two_datums_do_not_merge(north: Path, tmp_path: Path) -> None:
    elsewhere = Datum(DATUM.lat_deg + 1e-5, DATUM.lon_deg, DATUM.height_m)
    with create_map(tmp_path / "south.gpkg", elsewhere, cell_m=0.1) as universal:
        write_session(universal, "0", drive(2))
    with pytest.raises(DatumError, match=r"south\.gpkg has the datum .*--datum-from .*north"):
        merge_maps([north, tmp_path / "south.gpkg"], tmp_path / "farm.gpkg")
    assert not (tmp_path / "farm.gpkg").exists()


def test_what_is_not_there_or_in_the_way_is_said(north: Path, tmp_path: Path) -> None:
    with pytest.raises(MapError, match="There is no map"):
        merge_maps([north, tmp_path / "none.gpkg"], tmp_path / "farm.gpkg")
    with pytest.raises(ConfigError, match="no map to merge"):
        merge_maps([], tmp_path / "farm.gpkg")
    with pytest.raises(MapExistsError):
        merge_maps([north], north)
    before = north.read_bytes()
    with pytest.raises(MapExistsError, match="is read here and never replaced"):
        merge_maps([north], north, overwrite=True)
    assert north.read_bytes() == before


def test_one_drive_in_two_places_is_not_merged(north: Path, tmp_path: Path) -> None:
    shutil.copy(north, tmp_path / "south.gpkg")
    with open_map(tmp_path / "south.gpkg", writable=True) as universal:
        universal.set_transform("1", 0.5, 0.0)
    maps = [north, tmp_path / "south.gpkg"]
    with pytest.raises(ConfigError, match=r"'1' of .*south.*is the same drive as '1'.*--shift"):
        merge_maps(maps, tmp_path / "farm.gpkg")
    assert not (tmp_path / "farm.gpkg").exists()
    with open_map(north, writable=True) as universal:
        universal.set_transform("1", 0.5, 0.0)
    assert [one.twin for one in merge_maps(maps, tmp_path / "farm.gpkg")] == [None, None, "0", "1"]
