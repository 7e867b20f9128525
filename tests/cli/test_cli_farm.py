"""`fieldgrid farm`, and commands that take a folder of maps."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio

from fieldgrid.core import MapError
from fieldgrid.export import formats, stac
from fieldgrid.geometry import Datum
from fieldgrid.maps import MapFile, create_map, merge_maps, open_map
from tests.cli.conftest import Run
from tests.export.nav2_loader import load
from tests.maps.file.maps import DATUM, drive, write_map, write_session


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("maps")
    write_map(folder / "north.gpkg", [drive(5), drive(4, heading_deg=99.0)])
    write_map(folder / "south.gpkg", [drive(6, heading_deg=-150.0)])
    return folder


@pytest.fixture(scope="module")
def merged(maps: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("merged") / "merged.gpkg"
    merge_maps(sorted(maps.glob("*.gpkg")), out)
    return out


def test_what_repair_has_kept_of_a_map_is_no_map_of_a_farm(
    fieldgrid: Run, maps: Path, tmp_path: Path
) -> None:
    """Its drives would count twice."""
    farm = tmp_path / "farm"
    farm.mkdir()
    shutil.copy(maps / "north.gpkg", farm)
    for _ in range(2):
        fieldgrid("repair", farm / "north.gpkg").output()
    assert len(list(farm.iterdir())) == 3
    (only,) = json.loads(fieldgrid("farm", farm, "--json").output())["maps"]
    assert Path(only["map"]).name == "north.gpkg"
    assert "is no folder" in fieldgrid("farm", farm / "north.gpkg").sentence()


def test_the_list_is_a_table_or_json(fieldgrid: Run, maps: Path) -> None:
    lines = fieldgrid("farm", maps).output().splitlines()
    assert [line.split()[0] for line in lines] == ["map", "north.gpkg", "south.gpkg", "2"]
    assert lines[1].split()[-1] == "opens"
    found = json.loads(fieldgrid("farm", maps, "--verify", "--json").output())
    north, south = found["maps"]
    with open_map(maps / "north.gpkg") as universal:
        assert north["bounds_m"] == pytest.approx(list(universal.bounds))
        assert north["root_sha256"] == universal.root_sha256
    assert (north["sessions"], south["sessions"]) == (
        ["1", "0"],
        ["0"],
    )  # in the order of their drives
    assert (north["health"], south["health"]) == ("sound", "sound")
    assert north["first"] == "1970-01-01T00:00:00Z"


def test_a_damaged_map_is_listed_and_left_out(fieldgrid: Run, maps: Path, tmp_path: Path) -> None:
    whole = (maps / "south.gpkg").read_bytes()
    for name, content in (("south", whole), ("cut", whole[:-60_000]), ("text", b"no map")):
        (tmp_path / f"{name}.gpkg").write_bytes(content)
    done = fieldgrid("farm", tmp_path)
    assert done.status == 1
    assert f"cut.gpkg has {len(whole) - 60_000} of {len(whole)} bytes" in done.out
    assert "text.gpkg is not a fieldgrid map" in done.out
    done = fieldgrid("export", tmp_path, tmp_path / "x.npz")
    assert done.status == 0
    assert "fieldgrid: cut.gpkg is left out: " in done.err
    (tmp_path / "cut.gpkg").unlink()
    assert fieldgrid("farm", tmp_path).status == 0
    assert "none does not exist" in fieldgrid("farm", tmp_path / "none").sentence()


def test_exports_of_a_farm_are_those_of_the_merged_map(
    fieldgrid: Run, maps: Path, merged: Path, tmp_path: Path
) -> None:
    for name, flags in (
        ("x.tif", ["--cell", "0.2", "--layer", "count"]),
        ("x.png", []),
        ("x.npz", ["--cell", "0.13"]),
        ("x.nc", []),
        ("x.zarr", []),
    ):
        for source, out in ((maps, "ours"), (merged, "theirs")):
            (tmp_path / out).mkdir(exist_ok=True)
            fieldgrid("export", source, tmp_path / out / name, *flags).output()
        ours, theirs = tmp_path / "ours" / name, tmp_path / "theirs" / name
        if name in ("x.tif", "x.png"):
            with rasterio.open(ours) as one, rasterio.open(theirs) as other:
                np.testing.assert_array_equal(one.read(), other.read())
                assert (one.transform, one.tags(), one.overviews(1)) == (
                    other.transform,
                    other.tags(),
                    other.overviews(1),
                )
        elif name == "x.npz":
            with np.load(ours) as one, np.load(theirs) as other:
                for key in other:
                    np.testing.assert_array_equal(one[key], other[key])
    for source, out in ((maps, "ours"), (merged, "theirs")):
        fieldgrid("export", source, tmp_path / out / "x.yaml", "--cell", "0.2").output()
    one, other = (load(tmp_path / out / "x.yaml") for out in ("ours", "theirs"))
    np.testing.assert_array_equal(one.data, other.data)
    assert one[1:] == other[1:]


def test_formats_of_one_map_are_refused(fieldgrid: Run, maps: Path, tmp_path: Path) -> None:
    for one in formats().values():
        if not one.several:
            out = tmp_path / f"x{one.endings[0]}"
            assert "is of one map; export the maps one by one" in (
                fieldgrid("export", maps, out, "--format", one.name).sentence()
            )
            assert not out.exists()


def test_maps_of_two_datums_need_one(fieldgrid: Run, maps: Path, tmp_path: Path) -> None:
    (tmp_path / "a.gpkg").write_bytes((maps / "north.gpkg").read_bytes())
    elsewhere = Datum(DATUM.lat_deg + 1e-3, DATUM.lon_deg, DATUM.height_m)
    with create_map(tmp_path / "b.gpkg", elsewhere, cell_m=0.1) as universal:
        write_session(universal, "0", drive(3, heading_deg=-150.0))
    out = tmp_path / "x.npz"
    said = fieldgrid("export", tmp_path, out).sentence()
    assert f"--datum-from {tmp_path / 'a.gpkg'}" in said
    done = fieldgrid("export", tmp_path, out, "--datum-from", tmp_path / "a.gpkg")
    assert done.status == 0
    assert "b.gpkg comes from a datum 111 m away: its ground is up to 0.3 mm" in done.err
    one = fieldgrid("export", tmp_path / "a.gpkg", out, "--datum-from", tmp_path / "b.gpkg")
    assert "is no folder of maps" in one.usage()


def test_a_stac_catalogue_is_written(fieldgrid: Run, maps: Path, tmp_path: Path) -> None:
    pytest.importorskip("pystac")
    assert "--stac" in fieldgrid("farm", maps, "--cog").usage()
    found = json.loads(fieldgrid("farm", maps, "--stac", tmp_path / "c", "--json").output())
    assert found["stac"]["items"] == ["north", "south"]
    assert (tmp_path / "c" / "maps" / "north" / "north.json").is_file()
    assert "--overwrite" in fieldgrid("farm", maps, "--stac", tmp_path / "c").sentence()


def test_one_picture_of_a_farm(fieldgrid: Run, maps: Path, tmp_path: Path) -> None:
    out = tmp_path / "farm.svg"
    fieldgrid("show", maps, "-o", out, "--figure", "grid", "--cell", "0.4").output()
    assert "cells of 40 cm" in out.read_text()
    done = fieldgrid("show", maps, "-o", tmp_path / "x.png", "--averaging", "paper")
    assert (done.status, "it is of one map" in done.err) == (2, True)
    assert not (tmp_path / "x.png").exists()


def test_a_map_that_cannot_be_in_a_catalogue_is_told(
    fieldgrid: Run, maps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pystac")
    farm = tmp_path / "maps"
    farm.mkdir()
    for name in ("bad", "what? now"):
        shutil.copy(maps / "south.gpkg", farm / f"{name}.gpkg")
    outline = stac._footprint

    def vanishing(universal: MapFile) -> object:
        if universal.path.name == "bad.gpkg":
            raise MapError("It went.")
        return outline(universal)

    monkeypatch.setattr(stac, "_footprint", vanishing)
    result = fieldgrid("farm", farm, "--stac", tmp_path / "out")
    assert result.status == 1
    assert "bad.gpkg is not in the catalogue: It went." in result.out
    assert "catalog.json: 1 maps" in result.out
    assert (tmp_path / "out" / "maps" / "what_now" / "what_now.json").is_file()
