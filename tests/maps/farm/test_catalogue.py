"""The list of a folder's maps, and the STAC catalogue of them."""

from __future__ import annotations

import json
import os
import re
import shutil
import sqlite3
import urllib.parse
import warnings
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import shapely

from fieldgrid.core import ConfigError, MapError, MapExistsError
from fieldgrid.export import write_stac
from fieldgrid.geometry import Datum
from fieldgrid.maps import Farm, Health, create_map, open_map
from tests.maps.file import maps
from tests.maps.file.maps import DATUM, drive, write_map


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map, one that is cut short, one whose list of sessions was changed, one whose frame was,
    one without sessions, another GeoPackage's like, and a text."""
    folder = tmp_path_factory.mktemp("farm")
    whole = write_map(folder / "whole.gpkg", [drive(5), drive(40, heading_deg=99.0)])
    (folder / "cut.gpkg").write_bytes(whole.read_bytes()[:-70_000])
    for name, change in (
        ("frame", "UPDATE fieldgrid_grid SET data = zeroblob(length(data)) WHERE frame IN (3, 5)"),
        ("list", "UPDATE fieldgrid_session SET accepted = accepted - 1"),
    ):
        shutil.copy(whole, folder / f"{name}.gpkg")
        with closing(sqlite3.connect(folder / f"{name}.gpkg")) as database, database:
            database.execute(change)
    with closing(sqlite3.connect(folder / "other.gpkg")) as database, database:
        database.execute("CREATE TABLE gpkg_contents (x)")
    (folder / "text.gpkg").write_text("no database")
    (folder / "notes.txt").write_text("no map")
    with open_map(whole, writable=True) as universal:
        universal.remove_session("0")
    shutil.copy(whole, folder / "empty.gpkg")
    with open_map(folder / "empty.gpkg", writable=True) as universal:
        universal.remove_session("1")
    return folder


def test_every_file_is_a_row_with_its_reason(made: Path) -> None:
    with Farm(made) as farm:
        found = {block.name: block for block in farm.blocks}
        with open_map(made / "whole.gpkg") as universal:
            seen = int(np.count_nonzero(universal.read().observed))
            bounds, root = universal.bounds, universal.root_sha256
    assert list(found) == ["cut", "empty", "frame", "list", "other", "text", "whole"]
    whole = found["whole"]
    assert whole.area_m2 == pytest.approx(seen * 0.01)
    assert (whole.bounds, whole.root_sha256, whole.removed) == (bounds, root, 1)
    assert [info.name for info in whole.sessions] == ["1"]
    assert whole.first == datetime(1970, 1, 1, tzinfo=UTC)
    assert whole.last == datetime(1970, 1, 1, 0, 0, 39, tzinfo=UTC)
    assert (found["empty"].problem, found["empty"].bounds, found["empty"].area_m2) == ("", None, 0)
    assert {name: block.health for name, block in found.items()} == {
        "cut": Health.DAMAGED,
        "empty": Health.OPENS,
        "frame": Health.OPENS,  # its frames are not read
        "list": Health.DAMAGED,
        "other": Health.FOREIGN,
        "text": Health.FOREIGN,
        "whole": Health.OPENS,
    }
    assert "list of sessions" in found["list"].problem
    assert all(str(block.path) in block.problem for block in farm.problems)


def test_verify_finds_what_a_look_does_not(made: Path, tmp_path: Path) -> None:
    for name in ("frame.gpkg", "empty.gpkg"):
        shutil.copy(made / name, tmp_path)
    empty, frame = Farm(tmp_path, verify=True, jobs=1).blocks
    assert (empty.health, empty.problem) == (Health.SOUND, "")
    assert (frame.health, frame.header) == (Health.DAMAGED, None)
    assert "problems more" in frame.problem


def test_a_map_of_one_tile_has_its_area(tmp_path: Path) -> None:
    write_map(tmp_path / "small.gpkg", [drive(1)])
    with open_map(tmp_path / "small.gpkg") as universal:
        seen = int(np.count_nonzero(universal.read().observed))
    assert Farm(tmp_path).blocks[0].area_m2 == pytest.approx(seen * 0.01)


def test_a_folder_without_maps_is_refused(made: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="does not exist"):
        Farm(tmp_path / "none")
    with pytest.raises(ConfigError, match=r"no file that ends in \.gpkg"):
        Farm(tmp_path)
    shutil.copy(made / "text.gpkg", tmp_path)
    farm = Farm(tmp_path)
    with pytest.raises(MapError, match=r"No map of .* can be read: .*not an SQLite file"):
        farm.read()
    with pytest.raises(ConfigError, match=r"No map of .* can be in a catalogue"):
        write_stac(farm, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_stac_catalogue_is_valid_and_others_read_it(made: Path, tmp_path: Path) -> None:
    pystac = pytest.importorskip("pystac")
    rasterio = pytest.importorskip("rasterio")
    warp = pytest.importorskip("rasterio.warp")
    out = tmp_path / "farms" / "stac"
    out.parent.mkdir()
    with Farm(made) as farm:
        written = write_stac(farm, out, with_cog=True)
        blocks = {block.name: block for block in farm.blocks}
        with pytest.raises(MapExistsError):
            write_stac(farm, out)
        write_stac(farm, out, with_cog=True, overwrite=True)
    assert written.items == ("frame", "whole")
    assert dict(written.left_out)["empty.gpkg"] == "nothing was observed"
    catalog = pystac.Catalog.from_file(written.file)
    (collection,) = catalog.get_children()
    collection.validate()
    items = {item.id: item for item in collection.get_items()}
    assert set(items) == {"frame", "whole"}
    item = items["whole"]
    core = {**item.to_dict(), "stac_extensions": []}  # the schemas that pystac itself carries
    pystac.validation.validate_dict(core)
    assert item.properties["fieldgrid:root_sha256"] == blocks["whole"].root_sha256
    assert item.properties["start_datetime"] == "1970-01-01T00:00:00Z"
    assert Path(item.assets["map"].get_absolute_href()).samefile(made / "whole.gpkg")
    geometry = shapely.geometry.shape(item.geometry)
    with open_map(made / "whole.gpkg") as universal:
        view = universal.read()
        east_m, north_m = view.lattice.centres(view.window)
        j, i = np.nonzero(view.observed)
        lat, lon, _ = universal.datum.to_geodetic(east_m[i], north_m[j], 0.0)
    assert shapely.contains_xy(geometry, lon, lat).all()
    assert geometry.area < 0.9 * shapely.box(*geometry.bounds).area
    with rasterio.open(item.assets["density"].get_absolute_href()) as dataset:
        said = item.assets["density"].extra_fields
        assert list(dataset.shape) == said["proj:shape"]
        assert list(dataset.transform)[:6] == pytest.approx(said["proj:transform"])
        assert list(dataset.bounds) == pytest.approx(said["proj:bbox"])
        assert item.properties["proj:shape"] == list(view.window.shape)
        assert item.properties["proj:bbox"] == pytest.approx(list(view.bounds))
        own = rasterio.crs.CRS.from_wkt(item.properties["proj:wkt2"])
        corner = warp.transform_bounds(own, "EPSG:4326", *view.bounds)
    assert corner == pytest.approx(item.bbox, abs=2e-7)


def test_maps_of_any_name_have_items_that_others_find(made: Path, tmp_path: Path) -> None:
    pystac = pytest.importorskip("pystac")
    maps, out = tmp_path / "#1 100%?", tmp_path / "cat?logue#"
    maps.mkdir()
    names = ["a b", "a?b", "a#b", "a%41b", "a\nb", "A_b", "\x1b[2J", "süd", "..", "x" * 240]
    names += ["<&'\"\\>:*|$x{y}", os.fsdecode(b"\xff")]
    for name in names:
        shutil.copy(made / "whole.gpkg", maps / f"{name}.gpkg")
    with Farm(maps) as farm:
        written = write_stac(farm, out, with_cog=True)
    out = out.rename(tmp_path / "catalogue")  # pystac finds nothing below a ? itself
    assert not written.left_out
    assert len({name.casefold() for name in written.items}) == len(names)
    catalog = pystac.Catalog.from_file(out / "catalog.json")
    (collection,) = catalog.get_children()
    collection.validate()
    found = set()
    for item in collection.get_items():
        pystac.validation.validate_dict({**item.to_dict(), "stac_extensions": []})
        assert item.properties["title"].isprintable()
        assert re.fullmatch(r"[\w.-]+", item.id)
        assert item.get_self_href() == str(out / "maps" / item.id / f"{item.id}.json")
        href = item.assets["map"].href
        assert re.fullmatch(r"[\w./%-]+", href)
        path = urllib.parse.unquote(href, errors="surrogateescape")
        found.add((out / "maps" / item.id / path).resolve())
        assert Path(item.assets["density"].get_absolute_href()).is_file()
    assert found == {(maps / f"{name}.gpkg").resolve() for name in names}


def test_a_map_that_cannot_be_read_to_the_end_is_left_out_and_told(
    made: Path, tmp_path: Path
) -> None:
    pytest.importorskip("pystac")
    for name in ("good", "bad"):
        shutil.copy(made / "whole.gpkg", tmp_path / f"{name}.gpkg")
    with Farm(tmp_path) as farm:
        assert all(block.header for block in farm.blocks)
        (tmp_path / "bad.gpkg").write_bytes(b"half a map")  # since it was looked at
        written = write_stac(farm, tmp_path / "out", with_cog=True)
        assert written.items == ("good",)
        ((name, why),) = written.left_out
        assert name == "bad.gpkg"
        assert "is not an SQLite file" in why
        assert sorted(path.name for path in (tmp_path / "out" / "maps").iterdir()) == [
            "collection.json",
            "good",
        ]
        (tmp_path / "good.gpkg").unlink()
        with pytest.raises(ConfigError, match=r"No map of .* can be in a catalogue"):
            write_stac(farm, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_other_programs_open_the_catalogue(made: Path, tmp_path: Path) -> None:
    client = pytest.importorskip("pystac_client")
    with Farm(made) as farm:
        file = write_stac(farm, tmp_path / "stac").file
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a folder is no server
        opened = client.Client.open(str(file))
        found = [item.id for item in opened.get_items(recursive=True)]
    assert found == ["frame", "whole"]


def test_a_folder_of_somebody_else_is_not_replaced(made: Path, tmp_path: Path) -> None:
    (tmp_path / "stac").mkdir()
    (tmp_path / "stac" / "catalog.json").write_text(json.dumps({"links": []}))
    with Farm(made) as farm, pytest.raises(MapExistsError):
        write_stac(farm, tmp_path / "stac", overwrite=True)
    assert [path.name for path in (tmp_path / "stac").iterdir()] == ["catalog.json"]


def test_a_map_without_a_drive_in_time(tmp_path: Path) -> None:
    with create_map(tmp_path / "a.gpkg", DATUM) as universal, universal.add_session("s"):
        pass
    (block,) = Farm(tmp_path).blocks
    assert (block.problem, block.first, block.last, block.bounds) == ("", None, None, None)


def test_a_field_across_the_meridian_of_180_degrees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """STAC has a box there begin in the east, at a west that is more than its east."""
    farm = tmp_path / "farm"
    farm.mkdir()
    monkeypatch.setattr(maps, "DATUM", Datum(-16.8, 179.99998, 50.0))
    write_map(farm / "taveuni.gpkg", [drive(12, step_m=2.0)])
    with Farm(farm) as opened:
        write_stac(opened, tmp_path / "stac")
    (path,) = (tmp_path / "stac").rglob("taveuni.json")
    item = json.loads(path.read_text())
    west, south, east, north = item["bbox"]
    assert 179.99 < west < 180.0
    assert -180.0 < east < -179.99
    for part in shapely.get_parts(shapely.geometry.shape(item["geometry"])):
        assert part.bounds[2] - part.bounds[0] < 0.001
    (path,) = (tmp_path / "stac").rglob("collection.json")
    (extent,) = json.loads(path.read_text())["extent"]["spatial"]["bbox"]
    assert extent == [-180.0, south, 180.0, north]
