"""The commands that keep a map over years: sessions, verify, repair, merge, query, diff, --at."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
import shapely

from fieldgrid.core import BuildSettings
from fieldgrid.core.palette import CHANGED, rgb
from fieldgrid.maps import Change, open_map, read_datum
from fieldgrid.pipeline import build_map
from tests.cli.conftest import Run
from tests.conftest import make_small_drive
from tests.field.changes.worlds import Box, Drive, lane, world_map
from tests.maps.file.content import content
from tests.maps.file.maps import one_cell, write_map
from tests.maps.file.test_cells import later
from tests.once import made_once

MakeDrive = Callable[..., Path]


@pytest.fixture(scope="module")
def small_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of a few frames of the example; copy it."""

    def build(folder: Path) -> None:
        drive = make_small_drive(folder / "two_lanes", range(20, 24))
        build_map([drive], folder / "vineyard.gpkg", BuildSettings())

    return made_once(tmp_path_factory, "small_map", build)[0] / "vineyard.gpkg"


@pytest.fixture
def path(small_map: Path, tmp_path: Path) -> Path:
    """The map of a few frames of the example, to be changed."""
    copy = tmp_path / "maps" / "vineyard.gpkg"
    copy.parent.mkdir()
    shutil.copy(small_map, copy)
    return copy


@pytest.fixture(scope="module")
def seasons(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four drives, a day each from 2026-06-01, over one cell each, and one that they share."""
    values = ((250, 20), (20, 30), (30, 200), (240, 210))
    return write_map(
        tmp_path_factory.mktemp("seasons") / "map.gpkg",
        [
            later([one_cell(2.05, 3.05, shared), one_cell(12.05 + day, -3.05, own)], day)
            for day, (shared, own) in enumerate(values)
        ],
    )


# --- sessions


def test_a_session_is_removed_and_restored(fieldgrid: Run, path: Path) -> None:
    before = content(path)
    shutil.copy(path, path.with_name("two.gpkg"))
    rows = fieldgrid("sessions", path, "--remove", "two_lanes").output().splitlines()
    assert rows[1].split()[-1] == "removed"
    result = json.loads(fieldgrid("sessions", path, "--json").output())
    assert result["bounds_m"] is None
    assert result["sessions"][0]["removed"].startswith("20")
    sentence = fieldgrid("export", path, path.with_name("x.tif")).sentence()
    assert "all its sessions are removed; restore one" in sentence
    sentence = fieldgrid("sessions", path, "--remove", "two_lanes").sentence()
    assert "is removed already; --restore puts it back" in sentence
    rows = fieldgrid("sessions", path, "--restore", "two_lanes").output().splitlines()
    assert "removed" not in rows[1]
    assert content(path) == before
    assert "is not removed" in fieldgrid("sessions", path, "--restore", "two_lanes").sentence()
    assert "no session 'x'" in fieldgrid("sessions", path, "--restore", "x").sentence()
    both = fieldgrid("sessions", path, "--restore", "x", "--remove", "y").usage()
    assert "value for --remove: give it without --restore" in both


def test_a_session_gets_another_name(fieldgrid: Run, path: Path) -> None:
    with open_map(path) as universal:
        before = universal.sessions()[0].digest
        cells = universal.read().density
    rows = fieldgrid("sessions", path, "--rename", "two_lanes", "lanes, June").output()
    assert "lanes, June" in rows
    assert "two_lanes" not in rows
    assert "sound" in fieldgrid("verify", path).output()
    with open_map(path) as universal:
        (info,) = universal.sessions()
        assert (info.name, info.digest) == ("lanes, June", before)
        np.testing.assert_array_equal(universal.read().density, cells)
        assert {frame.session for frame in universal.frames()} == {"lanes, June"}
    with closing(sqlite3.connect(path)) as database:
        for layer in ("trajectory", "frame_position", "footprint"):
            named = database.execute(f"SELECT DISTINCT session FROM {layer}").fetchall()
            assert named == [("lanes, June",)]
    fieldgrid("sessions", path, "--remove", "lanes, June").output()
    fieldgrid("sessions", path, "--rename", "lanes, June", "b").output()
    fieldgrid("sessions", path, "--restore", "b").output()
    assert "sound" in fieldgrid("verify", path).output()
    for new, message in (("", "cannot be called ''"), ("b\x1b", r"cannot be called 'b\x1b'")):
        assert message in fieldgrid("sessions", path, "--rename", "b", new).sentence()
    assert "no session 'c'" in fieldgrid("sessions", path, "--rename", "c", "d").sentence()


def test_a_name_that_is_taken(fieldgrid: Run, path: Path, make_drive: MakeDrive) -> None:
    fieldgrid("build", make_drive("b"), "-o", path, "--append").output()
    sentence = fieldgrid("sessions", path, "--rename", "b", "two_lanes").sentence()
    assert "has a session 'two_lanes' already" in sentence


def test_sessions_as_json_say_what_made_them(fieldgrid: Run, two_lanes_map: Path) -> None:
    (session,) = json.loads(fieldgrid("sessions", two_lanes_map, "--json").output())["sessions"]
    assert re.fullmatch(r"[0-9a-f]{64}", session["digest"])
    assert re.fullmatch(r"[0-9a-f]{64}", session["source_sha256"])
    assert session["first_time_ns"] < session["last_time_ns"]
    assert session["heading_source"] == "smooth"
    assert session["removed"] is None


# --- verify and repair


def test_verify_and_repair(fieldgrid: Run, path: Path) -> None:
    text = fieldgrid("verify", path).output()
    assert re.search(r"vineyard\.gpkg: sound; 1 session \(0 removed\), 4 frames, \d+ tiles", text)
    expected = content(path)
    database = sqlite3.connect(path, isolation_level=None)
    database.execute(
        "UPDATE fieldgrid_tile SET data = (SELECT data FROM fieldgrid_tile WHERE "
        "channels = 'count' LIMIT 1) WHERE rowid = (SELECT max(rowid) FROM fieldgrid_tile WHERE "
        "channels = 'count' AND zoom = (SELECT min(zoom) FROM fieldgrid_tile))"
    )
    database.close()
    result = fieldgrid("verify", path)
    assert (result.status, result.err.count("has 1 problem; ")) == (1, 1)
    assert "is not what follows from the frames." in result.out
    assert "1 problem; 1 session" in result.out
    result = fieldgrid("verify", path, "--json")
    assert result.status == 1
    assert json.loads(result.out)["sound"] is False
    assert len(json.loads(result.out)["problems"]) == 1
    kept = path.with_name("vineyard.before-repair.gpkg")
    assert fieldgrid("repair", path).output() == f"repaired {path}; as it was: {kept}\n"
    assert fieldgrid("verify", kept).status == 1
    assert fieldgrid("repair", path, "--in-place").output() == f"repaired {path}\n"
    assert [one.name for one in path.parent.glob("*repair*")] == [kept.name]
    assert json.loads(fieldgrid("verify", path, "--json").output())["problems"] == []
    assert content(path) == expected


# --- merge


def test_merge(fieldgrid: Run, path: Path, tmp_path: Path, make_drive: MakeDrive) -> None:
    other, out = tmp_path / "other.gpkg", tmp_path / "farm.gpkg"
    drive = make_drive("two_lanes")
    fieldgrid("build", drive, "-o", other, "--datum-from", path).output()
    with open_map(path) as a, open_map(other) as b:
        assert a.datum == b.datum
    text = fieldgrid("merge", path, other, path, "-o", out).output()
    assert text.splitlines() == [
        f"{path}: session two_lanes",
        f"{other}: session two_lanes, now called two_lanes (other)",
        f"{path}: session two_lanes is in it already as two_lanes",
        f"map {out}",
    ]
    assert "2 sessions" in fieldgrid("verify", out).output()
    assert "exists already" in fieldgrid("merge", path, "-o", out).sentence()
    flags = ["--overwrite", "--cell", "0.25", "--transfer", "area"]
    fieldgrid("merge", path, "-o", out, *flags).output()
    with open_map(out) as universal:
        assert (universal.cell_m, universal.transfer.value) == (0.25, "area")
    assert (
        "neither centre nor area" in fieldgrid("merge", path, "-o", out, "--transfer", "x").usage()
    )


def test_another_datum_is_refused_with_the_way_out(
    fieldgrid: Run, path: Path, tmp_path: Path, make_drive: MakeDrive
) -> None:
    other = tmp_path / "other.gpkg"
    fieldgrid("build", make_drive(), "-o", other, "--datum", "41.6501,-4.72,787.4").output()
    sentence = fieldgrid("merge", path, other, "-o", tmp_path / "farm.gpkg").sentence()
    assert f"--datum-from {path}" in sentence
    farm = tmp_path / "farm.gpkg"
    fieldgrid("merge", path, other, "-o", farm, "--datum-from", path).output()
    assert read_datum(farm) == read_datum(path)
    flags = ["--append", "--name", "b", "--datum", "41.6501,-4.72,787.4"]
    sentence = fieldgrid("build", make_drive("b"), "-o", path, *flags).sentence()
    assert f"--datum-from {path}" in sentence
    both = ["--datum", "1,2,3", "--datum-from", path]
    usage = fieldgrid("build", make_drive("c"), "-o", tmp_path / "c.gpkg", *both).usage()
    assert "exclude each other" in usage


# --- query


def test_query(fieldgrid: Run, two_lanes_map: Path) -> None:
    text = fieldgrid("query", two_lanes_map, "-5.1", "55.3").output()
    first, header, *rows = text.splitlines()
    assert first.startswith("cell -5.100 55.300 -5.050 55.350 (west south east north): density ")
    assert header.split()[:4] == ["session", "frame", "density", "cells"]
    assert {row.split()[0] for row in rows} == {"two_lanes"}
    result = json.loads(fieldgrid("query", two_lanes_map, "-5.1", "55.3", "--json").output())
    assert len(result["contributions"]) == len(rows)
    for one in result["contributions"]:
        assert Path(one["images"][0]).parts[-2:] == ("left", f"{one['frame_id']}.jpg")
        assert re.fullmatch(r"[0-9a-f]{64}", one["images_sha256"][0])
    mean = np.average(
        [one["density"] for one in result["contributions"]],
        weights=[one["cells"] for one in result["contributions"]],
    )
    assert result["density"] == int(mean + 0.5)
    with open_map(two_lanes_map) as universal:
        lat, lon, _ = universal.datum.to_geodetic(-5.08, 55.32, 0.0)
    place = f"{float(lat):.9f},{float(lon):.9f}"
    assert fieldgrid("query", two_lanes_map, place).output() == text
    far = fieldgrid("query", two_lanes_map, "900", "900").output()
    assert far.endswith("not observed\n")


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (["1"], "is neither EAST NORTH in metres"),
        (["1", "2", "3"], "is neither EAST NORTH in metres"),
        (["a", "b"], "is neither EAST NORTH in metres"),
        (["nan", "1"], "is neither EAST NORTH in metres"),
    ],
)
def test_places_that_are_none(
    place: list[str], message: str, fieldgrid: Run, two_lanes_map: Path
) -> None:
    assert message in " ".join(fieldgrid("query", two_lanes_map, *place).usage().split())


def test_a_place_that_is_not_on_earth(fieldgrid: Run, two_lanes_map: Path) -> None:
    assert "are not on Earth" in fieldgrid("query", two_lanes_map, "141.65,-4.72").sentence()


# --- diff


def test_diff(fieldgrid: Run, seasons: Path, tmp_path: Path) -> None:
    text = fieldgrid("diff", seasons, "--from", "0", "--to", "1").output()
    assert text.splitlines()[0].strip() == "1 against 0"
    assert re.search(r"^obstacle that vanished +0\.0$", text, re.MULTILINE)
    flags = ["--from", "2026-06-02", "--to", "2026-06-30", "--json"]
    result = json.loads(fieldgrid("diff", seasons, *flags).output())
    assert (result["before"], result["after"]) == (["0", "1"], ["2", "3"])
    assert result["area_m2"]["appeared"] == pytest.approx(0.01)
    assert result["area_m2"]["new_obstacle"] == pytest.approx(0.02)
    picture, layer = tmp_path / "x.png", tmp_path / "x.tif"
    text = fieldgrid("diff", seasons, "--from", "1", "--to", "3", "-o", picture).output()
    assert text.splitlines()[-1] == f"figure {picture}"
    assert cv2.imread(str(picture)) is not None
    text = fieldgrid("diff", seasons, "--from", "1", "--to", "3", "-o", layer).output()
    assert text.splitlines()[-1] == f"layer {layer}"
    with rasterio.open(layer) as raster:
        ((value,),) = raster.sample([(2.05, 3.05)])
        assert value == Change.APPEARED
        assert raster.nodata == 0
        assert raster.tags()["FIELDGRID_CHANGE_3"] == "obstacle that appeared"
    flags = ["--from", "1", "--to", "3", "-o", layer]
    assert "exists already" in fieldgrid("diff", seasons, *flags).sentence()
    assert (
        "has no session after 3 and up to 1"
        in fieldgrid("diff", seasons, "--from", "3", "--to", "1").sentence()
    )
    assert (
        "neither a session of"
        in fieldgrid("diff", seasons, "--from", "june", "--to", "1").sentence()
    )


def test_diff_of_objects(fieldgrid: Run, tmp_path: Path) -> None:
    crate = Box(-1.5, 4.0, -0.7, 4.6)
    drives: dict[str, Drive] = {"june": ([], lane(0.0)), "july": ([crate], lane(0.04, 100))}
    path = world_map(tmp_path / "map.gpkg", drives)
    asked = ["diff", path, "--from", "june", "--to", "july"]
    text = fieldgrid(*asked).output()
    assert re.search(r"^c1 +appeared +0\.\d\d +-1\.\d\d m +4\.\d\d m .* july, june$", text, re.M)
    assert "no changed object was found" in fieldgrid(*asked, "--min-area", "2").output()
    (told,) = json.loads(fieldgrid(*asked, "--json").output())["objects"]
    assert (told["kind"], told["stood"], told["freed"]) == ("appeared", ["july"], ["june"])
    assert 0.9 < told["confidence"] <= 1.0
    assert told["from_east_m"] is None
    out, picture = tmp_path / "x.geojson", tmp_path / "x.png"
    assert fieldgrid(*asked, "-o", out).output().splitlines()[-1] == f"objects {out}"
    (feature,) = json.loads(out.read_text())["features"]
    assert feature["properties"] == told
    inside = shapely.box(*shapely.geometry.shape(feature["geometry"]).bounds)
    assert inside.contains(shapely.Point(told["lon_deg"], told["lat_deg"]))
    assert "exists already" in fieldgrid(*asked, "-o", out).sentence()
    fieldgrid(*asked, "-o", out, "--overwrite").output()
    fieldgrid(*asked, "-o", picture).output()
    plain = tmp_path / "plain.png"
    fieldgrid(*asked, "-o", plain, "--min-area", "2").output()
    red = [
        (cv2.imread(str(p))[..., ::-1] == rgb(CHANGED["appeared"])).all(2) for p in (picture, plain)
    ]
    assert red[0].sum() > red[1].sum() + 100  # its box and its text
    sentence = fieldgrid(*asked, "--sigmas", "-1").sentence()
    assert "A number of sigmas of -1.0 is outside 0..100" in sentence


# --- as of a date


def test_show_and_export_as_of_a_date(
    fieldgrid: Run, seasons: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for at, value in (("2026-06-01", 250), ("1", 135), ("2026-06-03", 100), ("3", 135)):
        out = tmp_path / "x.tif"
        fieldgrid("export", seasons, out, "--at", at, "--overwrite").output()
        with rasterio.open(out) as raster:
            assert next(raster.sample([(2.05, 3.05)]))[0] == value, at
    from fieldgrid.export import figures

    drawn: list[set[str]] = []
    original = figures.universal_grid

    def spy(view: Any, drives: list[figures.DrawnDrive], **options: Any) -> object:
        drawn.append({drive.name for drive in drives})
        return original(view, drives, **options)

    monkeypatch.setattr(figures, "universal_grid", spy)
    show = ["show", seasons, "-o", tmp_path / "x.png", "--figure", "grid"]
    fieldgrid(*show, "--at", "2026-06-02").output()
    fieldgrid(*show, "--session", "2", "--overwrite").output()
    assert drawn == [{"0", "1"}, {"2"}]
    assert (
        "has no session '2'; it has '0'"
        in fieldgrid(*show, "--session", "2", "--at", "0", "--overwrite").sentence()
    )
    refused = fieldgrid(*show, "--at", "2020-01-01", "--overwrite").sentence()
    assert "no session up to 2020-01-01" in refused


# --- layers


@pytest.mark.parametrize(
    ("layer", "value", "unseen"),
    [
        ("count", 4, 0),
        ("sessions", 4, 0),
        ("persistence", 0.5, None),
        ("variance", 12125.0, None),
        ("max", 250, 0),
    ],
)
def test_export_of_a_layer(
    layer: str, value: float, unseen: float | None, fieldgrid: Run, seasons: Path, tmp_path: Path
) -> None:
    out = tmp_path / "x.tif"
    fieldgrid("export", seasons, out, "--layer", layer).output()
    with rasterio.open(out) as raster:
        assert next(raster.sample([(2.05, 3.05)]))[0] == pytest.approx(value)
        (empty, *_) = next(raster.sample([(4.05, 1.05)]))
        assert np.isnan(empty) if unseen is None else empty == unseen
        assert next(raster.sample([(2.05, 3.05)], masked=True)).mask.sum() == 0
        assert raster.res == (0.1, 0.1)


def test_a_layer_that_is_none(fieldgrid: Run, seasons: Path, tmp_path: Path) -> None:
    sentence = fieldgrid("export", seasons, tmp_path / "x.tif", "--layer", "depth").sentence()
    assert "There is no layer 'depth'; there are density, count" in sentence
    assert list(tmp_path.iterdir()) == []
