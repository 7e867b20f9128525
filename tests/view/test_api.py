"""What the server answers, held against what the map says."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import zipfile
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
import shapely
from PIL import Image

from fieldgrid.core import FOUND, ConfigError, UInt8
from fieldgrid.core.palette import SESSIONS
from fieldgrid.field import find_changes
from fieldgrid.geometry import Bounds, TileIndex
from fieldgrid.maps import LAYERS, open_map
from fieldgrid.view import view_maps, write_report
from fieldgrid.view.maps import version_of
from tests.maps.file.maps import drive, track, write_map, write_session
from tests.view.serving import Server, serving


def grey_alpha(body: bytes) -> UInt8:
    """A tile [rows, columns, 2], row 0 in the south."""
    image = Image.open(io.BytesIO(body))
    assert image.mode == "LA"
    return np.asarray(image)[::-1]


def tile_of(path: Path, level: int) -> tuple[TileIndex, Bounds, float]:
    """A tile in the middle of the map."""
    with open_map(path) as universal:
        bounds, cell_m = universal.bounds, universal.cell_m * 2**level
    side_m = 256 * cell_m
    tile = TileIndex(
        int((bounds.south_m + bounds.north_m) / 2 // side_m),
        int((bounds.west_m + bounds.east_m) / 2 // side_m),
    )
    west, south = tile.tx * side_m, tile.ty * side_m
    return tile, Bounds(west, south, west + side_m, south + side_m), cell_m


def test_a_map_is_described(server: Server, vineyard: Path) -> None:
    (about,) = server.json("/api/maps")["maps"]
    with open_map(vineyard) as universal:
        infos = universal.sessions()
        assert about["bounds"] == list(universal.bounds)
        assert about["cell_m"] == universal.cell_m
        assert about["datum"]["lat_deg"] == universal.datum.lat_deg
    assert [layer["name"] for layer in about["layers"]] == list(LAYERS)
    assert [one["name"] for one in about["sessions"]] == [info.name for info in infos]
    assert about["order"] == [0, 1]
    assert about["sessions"][0]["accepted"] == 50


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize("sessions", [None, "0", "1"])
def test_a_tile_of_density_is_what_the_map_says(
    server: Server, vineyard: Path, level: int, sessions: str | None
) -> None:
    tile, bounds, cell_m = tile_of(vineyard, level)
    names = None if sessions is None else [["two_lanes", "august"][int(sessions)]]
    with open_map(vineyard) as universal:
        view = universal.read(bounds, cell_m, sessions=names)
    query = "" if sessions is None else f"?sessions={sessions}"
    answer = server.get(f"/api/maps/0/tiles/density/{level}/{tile.ty}/{tile.tx}{query}")
    assert answer.status == 200
    found = grey_alpha(answer.body)
    np.testing.assert_array_equal(found[..., 1] > 0, view.observed)
    np.testing.assert_array_equal(found[..., 0][view.observed], view.density[view.observed])


@pytest.mark.parametrize("layer", [name for name in LAYERS if name != "density"])
def test_a_tile_of_any_layer_lies_on_its_scale(server: Server, vineyard: Path, layer: str) -> None:
    tile, bounds, cell_m = tile_of(vineyard, 0)
    with open_map(vineyard) as universal:
        view = universal.read(bounds, cell_m, layers=[layer])
    scale = server.json(f"/api/maps/0/scales/{layer}")
    found = grey_alpha(server.get(f"/api/maps/0/tiles/{layer}/0/{tile.ty}/{tile.tx}").body)
    values = view.layer(layer).astype(np.float64)
    known = view.observed & np.isfinite(values)
    np.testing.assert_array_equal(found[..., 1] > 0, known)
    shown = scale["low"] + found[..., 0] / 255.0 * (scale["high"] - scale["low"])
    step = (scale["high"] - scale["low"]) / 255.0
    within = known & (values <= scale["high"]) & (values >= scale["low"])
    # 1.8 % of the cells are on steps above the scale's 0.4 m. All are of the first drive, as the
    # second tells of none, and in three places. It was 0.9 % with a value for each cell: a block
    # has its step in all of its cells, those included of which no frame could tell any.
    assert within.sum() > 0.98 * known.sum()
    np.testing.assert_allclose(shown[within], values[within], atol=0.51 * step)
    np.testing.assert_array_equal(found[..., 0][known & (values > scale["high"])], 255)
    np.testing.assert_array_equal(found[..., 0][known & (values < scale["low"])], 0)


def test_a_tile_of_changes(server: Server, vineyard: Path) -> None:
    tile, bounds, cell_m = tile_of(vineyard, 0)
    with open_map(vineyard) as universal:
        change = universal.diff("two_lanes", "august", bounds, cell_m).change
    found = grey_alpha(
        server.get(f"/api/maps/0/tiles/change/0/{tile.ty}/{tile.tx}?from=0&to=1").body
    )
    np.testing.assert_array_equal(found[..., 0], change)


def test_objects_that_changed_are_those_of_diff(with_crate: Server) -> None:
    (told,) = with_crate.json("/api/maps/0/changes?from=0&to=1")["objects"]
    with open_map(with_crate.folder / "map.gpkg") as universal:
        (crate,) = find_changes(universal, "first", "second")
    assert (told["id"], told["kind"], told["from"]) == ("c1", "appeared", None)
    assert (told["stood"], told["freed"]) == (["second"], ["first"])
    assert told["confidence"] == pytest.approx(crate.confidence, abs=1e-3)
    assert told["area_m2"] == pytest.approx(crate.area_m2, abs=1e-3)
    drawn = [shapely.Polygon(rings[0], rings[1:]) for _, rings in told["geometry"]]
    assert shapely.union_all(drawn).symmetric_difference(crate.area).area < 0.01
    for bounds, count in (("-3,3,0,6", 1), ("-3,8,0,11", 0)):
        found = with_crate.json(f"/api/maps/0/changes?from=0&to=1&bounds={bounds}")["objects"]
        assert len(found) == count
    for query, words in (
        ("from=0&to=1&bounds=-90000,-90000,90000,90000", "zoom in"),
        ("from=0", "is no session"),
        ("from=1&to=0", "first"),
    ):
        answer = with_crate.get(f"/api/maps/0/changes?{query}")
        assert (answer.status, words in answer.json()["error"]) == (400, True), answer.body


def test_what_was_found_has_colours_that_no_session_has(server: Server) -> None:
    """Those of figures, by the tables that `rows --keep` makes."""
    (about,) = server.json("/api/maps")["maps"]
    colours = about["colours"]
    assert colours["found"]["found_headland"] == FOUND["headland"]
    assert not {*colours["found"].values(), colours["route"]} & set(SESSIONS)
    built = files("fieldgrid.view").joinpath("static", "viewer.js").read_text()
    assert SESSIONS[2] not in built  # in which they were drawn


def test_a_route_is_a_feature_of_each_map(vineyard: Path, tmp_path: Path) -> None:
    route = tmp_path / "spraying.csv"
    route.write_text("east_m,north_m\n1,2\n3,4\n")
    with serving(vineyard, routes=(route,)) as running:
        table = running.json("/api/maps/0/features")["tables"][-1]
    assert (table["table"], table["cut"]) == ("spraying.csv", False)
    (feature,) = table["features"]
    assert feature == {
        "geometry": [[2, [[[1.0, 2.0], [3.0, 4.0]]]]],
        "attributes": {"name": "spraying"},
    }
    write_report([vineyard], tmp_path / "report.html", routes=[route])
    assert b"spraying" in (tmp_path / "report.html").read_bytes()
    route.write_text("east_m\n1\n")
    with pytest.raises(ConfigError, match=r"spraying\.csv is no table of poses"):
        view_maps([vineyard], routes=[route])


def test_tiles_of_nothing_are_empty_and_those_of_a_state_are_kept(server: Server) -> None:
    (about,) = server.json("/api/maps")["maps"]
    far = server.get("/api/maps/0/tiles/density/0/500/500")
    assert (far.status, far.body) == (204, b"")
    assert server.get("/api/maps/0/tiles/count/0/0/0?sessions=").status == 204
    kept = server.get(f"/api/maps/0/tiles/density/0/500/500?v={about['version']}")
    assert "immutable" in kept.headers["cache-control"]
    assert far.headers["cache-control"] == "no-store"


def test_why_a_cell_is_what_it_is(server: Server, vineyard: Path) -> None:
    with open_map(vineyard) as universal:
        view = universal.read()
        rows, columns = np.nonzero(view.density > 150)
        east, north = view.lattice.centres(view.window)
        place = float(east[columns[7]]), float(north[rows[7]])
        expected = universal.query(*place)
    found = server.json(f"/api/maps/0/cell?east={place[0]}&north={place[1]}")
    assert found["values"]["density"] == expected.density
    assert found["bounds"] == list(expected.bounds)
    assert [(f["frame_id"], f["density"]) for f in found["frames"]] == [
        (one.frame_id, pytest.approx(one.density, abs=0.06)) for one in expected.contributions
    ]
    only = server.json(f"/api/maps/0/cell?east={place[0]}&north={place[1]}&sessions=1")
    assert {frame["session"] for frame in only["frames"]} <= {1}
    nowhere = server.json("/api/maps/0/cell?east=4000&north=4000")
    assert (nowhere["values"], nowhere["frames"]) == ({}, [])
    assert (found["verdict"], nowhere["verdict"]) == ("Obstacle", "Never seen")


def test_why_says_what_a_cell_counts_as(server: Server, vineyard: Path) -> None:
    """Ground below the first frame, which no frame saw, was driven over."""
    with open_map(vineyard) as universal:
        pose = next(iter(universal.frames())).pose
    found = server.json(f"/api/maps/0/cell?east={pose.east_m}&north={pose.north_m}")
    assert (found["verdict"], found["values"]) == ("Free: driven over", {})


def test_the_track_of_a_drive(server: Server, vineyard: Path) -> None:
    with open_map(vineyard) as universal:
        track = universal.trajectory("two_lanes")
        # Between them are estimates, of poses at rest and in holes.
        fixes = len(universal.session_inputs("two_lanes")["fix.time_ns"])
    found = server.json("/api/maps/0/tracks/0")
    assert found["rows"] == found["of"] == len(track)
    np.testing.assert_allclose(found["east_m"], track.east_m, atol=6e-4)
    np.testing.assert_allclose(found["heading_deg"], track.heading_deg, atol=6e-3)
    residual = np.array([v for v in found["residual_m"] if v is not None])
    # The receiver's sigma is 1.4 cm, and the pose follows the fix.
    assert len(residual) == fixes > 400
    assert 0.002 < np.median(residual) < 0.05
    assert server.json("/api/maps/0/tracks/1")["rows"] == 0  # none was stored with it


def test_frames_within_bounds(server: Server, vineyard: Path) -> None:
    with open_map(vineyard) as universal:
        frames = list(universal.frames())
    everywhere = server.json("/api/maps/0/frames?bounds=-1000,-1000,1000,1000")
    assert everywhere["of"] == len(everywhere["frame_id"]) == len(frames)
    assert server.json("/api/maps/0/frames?bounds=500,500,600,600")["of"] == 0
    first = server.json("/api/maps/0/frames?bounds=-1000,-1000,1000,1000&sessions=0")
    assert first["of"] == 50


def test_a_session_is_taken_out_and_put_back(own_server: Server) -> None:
    path = own_server.folder / "vineyard.gpkg"
    for action, active in (("remove", False), ("restore", True)):
        version = own_server.json("/api/maps")["maps"][0]["version"]
        asked = {"version": version, "action": action, "session": "august"}
        assert own_server.post("/api/maps/0/sessions", asked).status == 200
        with open_map(path) as universal:
            assert [info.active for info in universal.sessions()] == [True, active]
            assert universal.verify(deep=True).sound
        # The page that asked has not seen what another one made of the map.
        stale = own_server.post("/api/maps/0/sessions", asked)
        assert stale.status == 400
        assert "has changed" in stale.json()["error"]
    for asked in (
        {"version": version, "action": "drop", "session": "august"},
        {"version": version, "action": "remove", "session": 7},
        {"version": version, "action": "remove", "session": "august", "more": 1},
        ["remove"],
    ):
        assert own_server.post("/api/maps/0/sessions", asked).status == 400
    version = own_server.json("/api/maps")["maps"][0]["version"]
    unknown = {"version": version, "action": "remove", "session": "nobody's"}
    answer = own_server.post("/api/maps/0/sessions", unknown)
    assert answer.status == 400
    assert "nobody's" in answer.json()["error"]


def test_nothing_is_changed_read_only(vineyard: Path) -> None:
    before = vineyard.read_bytes()
    with serving(vineyard, writable=False) as running:
        about = running.json("/api/maps")
        assert about["writable"] is False
        asked = {"version": about["maps"][0]["version"], "action": "remove", "session": "august"}
        assert running.post("/api/maps/0/sessions", asked).status == 404
    assert vineyard.read_bytes() == before


def test_what_is_seen_is_exported(server: Server, vineyard: Path) -> None:
    bounds = Bounds(-10.0, 50.0, -5.0, 56.0)
    asked = {"format": "npz", "layer": "count", "bounds": list(bounds), "cell_m": 0.1}
    answer = server.post("/api/maps/0/export", asked)
    assert answer.status == 200, answer.body
    assert 'filename="vineyard.npz"' in answer.headers["content-disposition"]
    with open_map(vineyard) as universal:
        view = universal.read(bounds, 0.1, layers=["count"])
    with np.load(io.BytesIO(answer.body)) as arrays:
        np.testing.assert_array_equal(arrays["count"], view.layer("count"))
    # Several files come as one archive.
    answer = server.post("/api/maps/0/export", asked | {"format": "nav2", "layer": "density"})
    with zipfile.ZipFile(io.BytesIO(answer.body)) as archive:
        assert "vineyard.yaml" in archive.namelist()
    for wrong in ({"format": "exe"}, {"cell_m": 0.0}, {"bounds": [0, 0, 1]}, {"layer": "nothing"}):
        assert server.post("/api/maps/0/export", asked | wrong).status == 400
    huge = server.post("/api/maps/0/export", asked | {"bounds": [-9e5, -9e5, 9e5, 9e5]})
    assert huge.status == 400
    assert "million cells" in huge.json()["error"]


def test_a_drive_that_is_appended_shows_after_a_reload(own_server: Server) -> None:
    path = own_server.folder / "vineyard.gpkg"
    before = own_server.json("/api/maps")["maps"][0]
    with open_map(path, writable=True) as universal:
        frame = next(universal.frames(with_grid=True))
        with universal.add_session("october") as session:
            session.add(frame.grid(), frame.pose)
            # While another program writes, the page goes on.
            assert own_server.json("/api/maps")["maps"][0] == before
    after = own_server.json("/api/maps")["maps"][0]
    assert [one["name"] for one in after["sessions"]][-1] == "october"
    assert after["version"] != before["version"]


ASKED = (
    "tiles/density/0/0/0",
    "tiles/variance/0/0/0",
    "tiles/change/0/0/0?from=0&to=0",
    "scales/count",
    "tracks/0",
    "frames?bounds=0,0,9,9",
    "cell?east=1&north=1",
    "image?session=0&frame=x&image=0",
    "features",
)
"""What a page asks for that was loaded before."""


def test_a_page_gets_nothing_of_a_map_that_was_removed(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    with serving(path) as running:
        assert running.get("/api/maps").status == 200
        path.unlink()
        for asked in ("/api/maps", *(f"/api/maps/0/{one}" for one in ASKED)):
            answer = running.get(asked)
            assert answer.status == 409, asked
            assert "map.gpkg is no longer there; put it back" in answer.json()["error"]
        path.write_text("no map at all")
        assert "is not a fieldgrid map" in running.get("/api/maps/0/features").json()["error"]


def test_a_page_gets_nothing_of_another_map(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    other = write_map(tmp_path / "other.gpkg", [drive(2), drive(3)])
    with serving(path) as running:
        version = running.json("/api/maps")["maps"][0]["version"]
        shutil.copyfile(other, path)
        for asked in (*ASKED, f"tiles/density/0/0/0?v={version}"):
            answer = running.get(f"/api/maps/0/{asked}")
            assert answer.status == 409, asked
            assert "is another map than the page was loaded with" in answer.json()["error"]
            assert "no-store" in answer.headers["cache-control"]
        assert len(running.json("/api/maps")["maps"][0]["sessions"]) == 2
        assert running.get("/api/maps/0/features").status == 200


def test_a_page_goes_on_when_a_drive_is_appended(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)])
    with serving(path) as running:
        before = running.json("/api/maps/0/frames?bounds=-90,-90,90,90")["of"]
        with open_map(path, writable=True) as universal:
            write_session(universal, "1", drive(3))
        assert running.json("/api/maps/0/frames?bounds=-90,-90,90,90")["of"] > before


def test_a_map_that_is_built_again_shows_after_a_reload(tmp_path: Path) -> None:
    path = write_map(tmp_path / "map.gpkg", [drive(2)], trajectory=track(4))
    with serving(path) as running:
        old = running.json("/api/maps")["maps"][0]
        assert running.json("/api/maps/0/frames?bounds=-99,-99,99,99")["of"] == 2
        shutil.move(write_map(tmp_path / "new.gpkg", [drive(3), drive(1)]), path)
        new = running.json("/api/maps")["maps"][0]
        assert (len(old["sessions"]), len(new["sessions"])) == (1, 2)
        assert running.json("/api/maps/0/frames?bounds=-99,-99,99,99")["of"] == 4


def test_maps_of_hardly_anything(tmp_path: Path) -> None:
    """Without a session that has cells, and with positions and headings that are not known."""
    path = tmp_path / "map.gpkg"
    write_map(path, [drive(1)], trajectory=track(7))
    with open_map(path, writable=True) as universal:
        write_session(universal, "empty", [])
        universal.remove_session("0")
    with serving(path) as running:
        (about,) = running.json("/api/maps")["maps"]
        assert about["bounds"] is None
        assert running.get("/api/maps/0/tiles/density/0/0/0").status == 204
        found = running.json("/api/maps/0/tracks/0")
        assert None in found["heading_deg"]
        assert found["reasons"] == ["the implied speed is 40 m/s", "stands"]
        assert running.get("/api/maps/0/scales/count").status in (400, 409)
        assert running.json("/api/maps/0/features") == {"tables": []}


def test_the_command_serves_until_it_is_told_to_stop(vineyard: Path) -> None:
    command = [sys.executable, "-c", "from fieldgrid.cli import main; main()", "view"]
    started = subprocess.Popen(
        [*command, str(vineyard), "--no-browser"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert started.stdout is not None
    line = started.stdout.readline()
    assert line.startswith("view http://127.0.0.1:")
    link = line.split()[1].partition("#")[0]
    with urlopen(f"{link}api/maps", timeout=60) as answer:
        assert json.loads(answer.read())["maps"][0]["name"] == "vineyard"
    started.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)
    _, problems = started.communicate(timeout=60)
    assert "Traceback" not in problems
    assert started.returncode in (0, 130)


@pytest.mark.skipif(os.name == "nt", reason="locks belong to the file, not to the process")
def test_looking_for_a_new_version_keeps_the_locks_of_who_reads(vineyard: Path) -> None:
    write = (
        "import sqlite3, sys\n"
        "connection = sqlite3.connect(sys.argv[1], timeout=0.0)\n"
        "connection.execute('PRAGMA locking_mode = EXCLUSIVE')\n"
        "connection.execute('BEGIN EXCLUSIVE')\n"
    )
    with closing(sqlite3.connect(vineyard)) as reader:
        rows = reader.execute("SELECT name FROM sqlite_master")
        assert rows.fetchone() is not None  # more are to come: the lock is held
        version_of(vineyard)
        done = subprocess.run(
            [sys.executable, "-c", write, str(vineyard)], capture_output=True, text=True
        )
    assert "database is locked" in done.stderr
