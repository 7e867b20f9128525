"""A folder of maps in the viewer: all of them on one page."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fieldgrid.core import ConfigError, DatumError, MapError
from fieldgrid.geometry import Bounds, Datum, TileIndex
from fieldgrid.maps import Farm, Mark, MarkKind, create_map, open_map
from fieldgrid.view import write_report
from fieldgrid.view.farms import MOST_MAPS, ShownFarm, shown_at
from fieldgrid.view.layers import tile_bounds
from tests.maps.file.maps import DATUM, drive, write_session
from tests.view.serving import Server, serving

ELSEWHERE = Datum(DATUM.lat_deg + 4e-4, DATUM.lon_deg, DATUM.height_m)


def write(path: Path, name: str, heading_deg: float, datum: Datum = DATUM) -> None:
    with create_map(path, datum, cell_m=0.1) as universal:
        write_session(universal, name, drive(5, heading_deg=heading_deg))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two maps of which both have a drive called june, and a file that is none."""
    found = tmp_path_factory.mktemp("fields")
    write(found / "north.gpkg", "june", 0.0)
    write(found / "south.gpkg", "june", 180.0)
    (found / "torn.gpkg").write_bytes(b"no map")
    with open_map(found / "south.gpkg", writable=True) as universal:
        universal.add_marks([Mark(MarkKind.PLACE, ((0.0, -3.0),), "gate")])
    return found


@pytest.fixture(scope="module")
def farm_server(folder: Path) -> Iterator[Server]:
    with serving(folder) as running:
        yield running


def seen_place(folder: Path, name: str) -> tuple[float, float]:
    """A cell that one drive of the farm saw, and no other."""
    with Farm(folder) as farm:
        view = farm.read(layers=["sessions"])
        alone = farm.read(sessions=[name])
        east, north = view.lattice.centres(view.window)
    cells = np.argwhere(alone.observed & (view.layer("sessions") == 1))
    j, i = cells[len(cells) // 2]
    return float(east[i]), float(north[j])


def test_a_farm_is_described_with_its_maps(farm_server: Server, folder: Path) -> None:
    (about,) = farm_server.json("/api/maps")["maps"]
    with Farm(folder) as farm:
        assert about["bounds"] == list(farm.bounds)
    assert about["name"] == folder.name
    assert [one["name"] for one in about["sessions"]] == ["june", "june (south)"]
    blocks = {one["name"]: one for one in about["blocks"]}
    assert [blocks[name]["sessions"] for name in ("north", "south")] == [[0], [1]]
    assert "not an SQLite file" in blocks["torn"]["problem"]
    assert blocks["torn"]["bounds"] is None
    assert [mark["name"] for mark in about["marks"]] == ["gate"]


@pytest.mark.parametrize("query", ["", "?sessions=1"])
@pytest.mark.parametrize("layer", ["density", "count"])
def test_a_tile_has_every_map_that_lies_in_it(
    farm_server: Server, folder: Path, layer: str, query: str
) -> None:
    (about,) = farm_server.json("/api/maps")["maps"]
    scale = farm_server.json(f"/api/maps/0/scales/{layer}")
    seen = 0
    for ty, tx in product((-1, 0), repeat=2):
        with Farm(folder) as farm:
            bounds, cell_m = tile_bounds(farm, about["levels"], TileIndex(ty, tx))
            names = ["june (south)"] if query else None
            view = farm.read(bounds, cell_m, layers=[layer], sessions=names)
        path = f"/api/maps/0/tiles/{layer}/{about['levels']}/{ty}/{tx}{query}"
        answer = farm_server.get(path)
        if not view.observed.any():
            assert answer.status == 204
            continue
        seen += 1
        found = np.asarray(Image.open(io.BytesIO(answer.body)))[::-1]
        np.testing.assert_array_equal(found[..., 1] > 0, view.observed)
        shown = scale["low"] + found[..., 0] / 255.0 * (scale["high"] - scale["low"])
        np.testing.assert_allclose(
            shown[view.observed],
            view.layer(layer)[view.observed].astype(float),
            atol=0.51 * (scale["high"] - scale["low"]) / 255.0,
        )
    assert seen


def test_a_cell_tells_the_frames_of_every_map(farm_server: Server, folder: Path) -> None:
    east, north = seen_place(folder, "june (south)")
    found = farm_server.json(f"/api/maps/0/cell?east={east}&north={north}")
    with open_map(folder / "south.gpkg") as universal:
        expected = universal.query(east, north)
    assert [(f["frame_id"], f["session"]) for f in found["frames"]] == [
        (one.frame_id, 1) for one in expected.contributions
    ]
    assert found["values"]["density"] == expected.density
    off = farm_server.json(f"/api/maps/0/cell?east={east}&north={north}&sessions=0")
    assert off["frames"] == []


def test_frames_and_tracks_are_those_of_the_maps(farm_server: Server) -> None:
    everywhere = farm_server.json("/api/maps/0/frames?bounds=-99,-99,99,99")
    assert sorted(everywhere["session"]) == [0] * 5 + [1] * 5
    assert farm_server.json("/api/maps/0/frames?bounds=-99,-99,99,99&sessions=1")["of"] == 5
    assert farm_server.json("/api/maps/0/tracks/1")["rows"] == 0  # none was stored


def test_frames_of_many_maps_are_not_all_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fieldgrid.view import farms

    (shown,) = shown_at([folder])
    assert MOST_MAPS > 1
    with shown.open() as farm:
        assert len(shown.frames(farm.bounds)) == 2
        monkeypatch.setattr(farms, "MOST_MAPS", 1)
        assert shown.frames(farm.bounds) == []


def test_a_farm_is_looked_at_and_not_changed(farm_server: Server) -> None:
    (about,) = farm_server.json("/api/maps")["maps"]
    change = {"version": about["version"], "action": "remove", "session": "june"}
    answer = farm_server.post("/api/maps/0/sessions", change)
    assert (answer.status, "is a folder of maps" in answer.json()["error"]) == (400, True)
    changed = farm_server.get("/api/maps/0/changes?from=0&to=1")
    assert "one map" in changed.json()["error"]


def test_what_is_seen_of_a_farm_is_exported(farm_server: Server, folder: Path) -> None:
    asked = {"format": "npz", "layer": "density", "bounds": [-9.0, -3.0, -5.0, 3.0]}
    answer = farm_server.post("/api/maps/0/export", asked)
    assert answer.status == 200, answer.body
    with Farm(folder) as farm:
        expected = farm.read(Bounds(-9.0, -3.0, -5.0, 3.0))
    found = np.load(io.BytesIO(answer.body))["density"]
    np.testing.assert_array_equal(np.isfinite(found), expected.observed)
    np.testing.assert_array_equal(
        found[expected.observed], expected.density[expected.observed].astype(float)
    )


def test_a_map_that_was_written_to_shows_after_a_reload(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "fields"
    shutil.copytree(folder, copy)
    with serving(copy) as server:
        server.json("/api/maps")
        with open_map(copy / "south.gpkg", writable=True) as universal:
            write_session(universal, "july", drive(6, heading_deg=90.0))
        # The last of the sessions: what the page knows of the others goes on.
        assert server.get("/api/maps/0/tiles/density/0/0/0").status == 200
        with open_map(copy / "north.gpkg", writable=True) as universal:
            write_session(universal, "august", drive(7, heading_deg=45.0))
        assert server.get("/api/maps/0/tiles/density/0/0/0").status == 409
        (about,) = server.json("/api/maps")["maps"]
        assert len(about["sessions"]) == 4
        assert server.get("/api/maps/0/tiles/density/0/0/0").status == 200


def test_maps_of_other_datums_are_shown_where_they_are(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "fields"
    copy.mkdir()
    shutil.copy(folder / "north.gpkg", copy)
    write(copy / "other.gpkg", "may", 90.0, ELSEWHERE)
    with pytest.raises(DatumError, match="--datum-from"):
        shown_at([copy])
    (shown,) = shown_at([copy], DATUM)
    assert isinstance(shown, ShownFarm)
    with shown.open() as farm, open_map(copy / "other.gpkg") as universal:
        own = next(iter(universal.frames("may")))
        moved = next(iter(farm.frames("may")))
        assert moved.pose.north_m == pytest.approx(own.pose.north_m + 44.4, abs=0.2)
        east, north = seen_place_of(farm, "may")
        assert {one.session for one in farm.query(east, north).contributions} == {"may"}
    table = shown.frames(Bounds(-99.0, -99.0, 99.0, 99.0))[1]
    assert table.north_m[0] == pytest.approx(moved.pose.north_m)


def seen_place_of(farm: Farm, name: str) -> tuple[float, float]:
    view = farm.read(sessions=[name])
    east, north = view.lattice.centres(view.window)
    j, i = np.argwhere(view.observed)[0]
    return float(east[i]), float(north[j])


def test_what_cannot_be_shown_is_said(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a page to send is of maps"):
        write_report([folder], tmp_path / "page.html")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ConfigError, match="has no file that ends in"):
        shown_at([empty])
    (empty / "torn.gpkg").write_bytes(b"no map")
    with pytest.raises(MapError, match=r"No map of .* can be read"):
        shown_at([empty])


def test_a_farm_on_a_page(look: Any, farm_server: Server, folder: Path) -> None:
    page = look(farm_server.link)
    assert page.page.title() == f"{folder.name} · fieldgrid"
    listed = page.page.locator("#block-list > li")
    assert [listed.nth(k).locator("strong").text_content() for k in range(3)] == [
        "north",
        "south",
        "torn",
    ]
    assert page.page.locator("#sessions >> text=Remove").count() == 0
    assert page.page.locator("#mark-area").is_hidden()
    pixels = page.map_pixels().astype(int)
    for name in ("june", "june (south)"):
        x, y = page.place(*seen_place(folder, name))
        box = page.page.locator("#map").bounding_box()
        around = pixels[int(y - box["y"]) - 3 :, int(x - box["x"]) - 3 :][:7, :7]
        # What was never seen is bluish; cells are from pale yellow to black.
        assert (around[..., 0] >= around[..., 2]).any(), name
    page.click_map(*seen_place(folder, "june (south)"))
    page.page.wait_for_selector("#of-maps >> text=In the map south.")
    before = page.page.locator("#map").get_attribute("data-extent")
    listed.nth(0).locator("button").click()
    page.settle()
    assert page.page.locator("#map").get_attribute("data-extent") != before
