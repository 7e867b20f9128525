"""`fieldgrid rows`: tables, files, surveys, and what it answers to wrong input."""

from __future__ import annotations

import json
import shutil
import xml.etree.ElementTree as ElementTree
import zipfile
from pathlib import Path

import cv2
import geopandas
import numpy as np
import pytest

import fieldgrid as fg
from benchmarks.planting import DATUM
from fieldgrid.geometry import Bounds, Lattice
from fieldgrid.maps import MapView, open_map
from tests.cli.conftest import Run
from tests.field.rows.fields import straight, view_of, write_map
from tests.field.rows.test_worked import add_drive

POSE = fg.Pose(10**18, 0.0, 0.0, 0.0, 0.0, 0.02, 0.5, 1.0)
ROWS = straight(4, 30.0, 2.5, 25.0)


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    view = view_of(ROWS, missing=[(1, 10.0, 13.0)], things=[(9.3, 11.1, 0.3)])
    return write_map(tmp_path_factory.mktemp("rows") / "field.gpkg", view)


def test_tables_tell_of_blocks_rows_and_lanes(fieldgrid: Run, field: Path) -> None:
    text = fieldgrid("rows", field).output()
    assert text.startswith("block  rows  lanes")
    assert "B1-R4" in text
    assert "B1-R2 B1-R3" in text


def test_json_and_the_file_say_the_same(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    out = tmp_path / "rows.geojson"
    told = json.loads(fieldgrid("rows", field, "-o", out, "--json").output())
    written = json.loads(out.read_text())["features"]
    kinds = [f["properties"]["kind"] for f in written]
    for kind in ("row", "lane", "gap", "headland", "block", "obstacle"):
        assert kinds.count(kind) == len(told[f"{kind}s"]) > 0
    rows = [f["properties"] for f in written if f["properties"]["kind"] == "row"]
    assert len(rows) == 4
    for row in rows:
        assert {"id", "block", "length_m", "sigma_m", "spacing_m", "sessions"} <= set(row)
        assert row["sessions"] == ["june-03"]
        assert row["sigma_m"] >= 0.02
    (gap,) = [f["properties"] for f in written if f["properties"]["kind"] == "gap"]
    assert gap["row"] in {row["id"] for row in rows}
    assert gap["length_m"] == pytest.approx(3.0, abs=0.5)
    lanes = [f["properties"] for f in written if f["properties"]["kind"] == "lane"]
    assert all(lane["known"] > 0.9 for lane in lanes)
    assert out.read_text().count("NaN") == 0


def test_everything_says_what_it_rests_on(fieldgrid: Run, field: Path) -> None:
    found = json.loads(fieldgrid("rows", field, "--json").out)
    for kind in ("row", "lane", "gap", "headland", "block", "obstacle"):
        for one in found[f"{kind}s"]:
            assert one["sessions"] == ["june-03"], (kind, one)
            assert one["cells"] > 0, (kind, one)
            # The poses of the map are of 2 cm.
            assert 0.02 <= one["sigma_m"] < 0.3, (kind, one)
    rows = {row["id"]: row for row in found["rows"]}
    (block,) = found["blocks"]
    assert block["cells"] == sum(row["cells"] for row in rows.values())
    for lane in found["lanes"]:
        sigma = sum(rows[name]["sigma_m"] for name in lane["rows"]) / 2.0
        assert lane["sigma_m"] == pytest.approx(sigma, abs=1e-4)
        # Seen ground between the canopies, which are 1.8 m apart.
        assert lane["cells"] * 0.01 == pytest.approx(
            lane["known"] * lane["length_m"] * 1.8, rel=0.1
        )
    (obstacle,) = found["obstacles"]
    assert obstacle["cells"] * 0.01 == pytest.approx(obstacle["area_m2"])
    (gap,) = found["gaps"]
    assert gap["sigma_m"] == rows[gap["row"]]["sigma_m"]


def test_a_field_of_agopengps(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    folder = tmp_path / "north"
    assert str(folder) in fieldgrid("rows", field, "--agopengps", folder).output()
    tracks = (folder / "TrackLines.txt").read_text().splitlines()
    assert [name for name in tracks if name.startswith("B1-")] == ["B1-L1", "B1-L2", "B1-L3"]
    assert "exists already" in fieldgrid("rows", field, "--agopengps", folder).sentence()


@pytest.mark.parametrize("suffix", ["gpkg", "csv", "kml", "dxf"])
def test_the_ending_picks_the_format(
    fieldgrid: Run, field: Path, tmp_path: Path, suffix: str
) -> None:
    out = tmp_path / f"rows.{suffix}"
    fieldgrid("rows", field, "-o", out)
    assert out.stat().st_size > 1000
    assert fieldgrid("rows", field, "-o", out).status == 1
    assert fieldgrid("rows", field, "-o", out, "--overwrite").status == 0


def test_a_map_is_never_replaced_by_its_rows(fieldgrid: Run, field: Path) -> None:
    before = field.read_bytes()
    assert fieldgrid("rows", field, "-o", field, "--overwrite").status == 1
    assert field.read_bytes() == before


def test_rows_are_kept_in_the_map_and_shown(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    path, bare, out = tmp_path / "field.gpkg", tmp_path / "bare.png", tmp_path / "rows.png"
    shutil.copy(field, path)
    show = ("show", path, "--figure", "grid", "--cell", "0.2", "-o")
    refused = fieldgrid(*show, out, "--rows")
    assert refused.status == 1
    assert "fieldgrid rows field.gpkg --keep" in refused.err
    assert not out.exists()

    told = json.loads(fieldgrid("rows", path, "--keep", "--json").output())
    with open_map(path) as universal:
        kept = universal.kept_features()
        assert kept is not None
        kinds = [one.kind for one in kept.features]
        assert all(kinds.count(kind) == len(told[f"{kind}s"]) for kind in set(kinds))
    assert fieldgrid(*show, bare).status == 0
    assert fieldgrid(*show, out, "--rows").err == ""
    differs = (cv2.imread(str(bare)) != cv2.imread(str(out))).any(axis=2)
    assert 0.005 < differs.mean() < 0.5

    fieldgrid("sessions", path, "--rename", "june-03", "june-04")
    assert (
        "has changed since its rows were found"
        in fieldgrid(*show, out, "--rows", "--overwrite").err
    )


def test_rows_of_an_older_state_are_not_kept(fieldgrid: Run, field: Path) -> None:
    result = fieldgrid("rows", field, "--keep", "--at", "june-03")
    assert result.status == 2
    assert "leave --at out" in result.err


def test_a_survey_is_compared(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    posts = np.concatenate([r[0] + np.array([[0.1], [0.5], [0.9]]) * (r[1] - r[0]) for r in ROWS])
    path = tmp_path / "posts.csv"
    path.write_text("east_m,north_m\n" + "".join(f"{e},{n}\n" for e, n in posts.tolist()))
    told = json.loads(fieldgrid("rows", field, "--truth", path, "--json").output())["survey"]
    assert told["points"] == 12
    assert told["rms_m"] < 0.05
    assert "points on rows" in fieldgrid("rows", field, "--truth", path).output()


def test_python_finds_the_same_rows(fieldgrid: Run, field: Path) -> None:
    told = json.loads(fieldgrid("rows", field, "--json").output())
    planting = fg.find_rows(field)
    assert [row.id for row in planting.rows] == [row["id"] for row in told["rows"]]
    part = fg.find_rows(field, bounds=Bounds(-5.0, 0.0, 8.0, 14.0))
    assert 0 < max(row.length_m for row in part.rows) < 16.0


def test_a_map_without_rows_says_what_to_change(fieldgrid: Run, tmp_path: Path) -> None:
    lattice = Lattice(0.1)
    window = lattice.window(Bounds(0.0, 0.0, 16.0, 16.0))
    seen = np.ones(window.shape, dtype=np.bool_)
    view = MapView(
        lattice, window, np.zeros(window.shape, dtype=np.uint8), seen, DATUM, is_base=True
    )
    path = write_map(tmp_path / "bare.gpkg", view)
    assert "no rows found; check --crop" in fieldgrid("rows", path).output()
    assert json.loads(fieldgrid("rows", path, "--json").output())["rows"] == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--crop", "hops"], "no crop"),
        (["--obstacle-above", "300"], "outside 0..254"),
        (["--spacing", "4:2"], "smaller one first"),
        (["--min-gap", "-1"], "outside 0..1000"),
        (["--truth", "missing.csv"], "There is no survey"),
        (["-o", "rows.shp"], "ends in none of"),
        (["--at", "may"], "may"),
    ],
)
def test_what_cannot_be_is_one_sentence(
    fieldgrid: Run, field: Path, arguments: list[str], message: str
) -> None:
    assert message in fieldgrid("rows", field, *arguments).sentence()


def test_a_spacing_that_is_none_is_a_usage_error(fieldgrid: Run, field: Path) -> None:
    fieldgrid("rows", field, "--spacing", "wide").usage()


@pytest.fixture
def driven(field: Path, tmp_path: Path) -> Path:
    """The field with a drive up its first lane."""
    path = tmp_path / "field.gpkg"
    shutil.copy(field, path)
    (start, stop), (other, _) = ROWS[0], ROWS[1]
    middle = 0.5 * (start + other)
    way = middle + np.linspace(-0.1, 1.1, 60)[:, None] * (stop - start)
    add_drive(path, [(east, north, 25.0, 1) for east, north in way.tolist()])
    return path


def test_what_a_drive_worked_is_told(fieldgrid: Run, driven: Path) -> None:
    asked = ("rows", driven, "--worked", "work", "--width", "1.2")
    told = json.loads(fieldgrid(*asked, "--json").output())
    assert told["worked_m2"] == pytest.approx(1.2 * 36.0, rel=0.01)
    assert (told["driven_m"], told["again_m2"]) == (pytest.approx(36.0), 0.0)
    first, *others = told["lanes"]
    assert first["share"] == pytest.approx(1.2 / 1.8, abs=0.06)
    assert [lane["share"] for lane in others] == [0.0, 0.0]
    assert [lane["missed"] for lane in told["lanes"]] == [2, 1, 1]
    (block,) = told["blocks"]
    assert block["missed"] == 4
    text = fieldgrid(*asked).output()
    assert text.startswith("worked")
    for part in ("36.0 m", "43.2 m²", "B1-L1", f"{100.0 * first['share']:.1f} %"):
        assert part in text
    behind = json.loads(fieldgrid(*asked, "--behind", "5", "--json").output())
    assert behind["lanes"][0]["share"] < first["share"] - 0.03


def test_what_a_drive_worked_as_polygons(fieldgrid: Run, driven: Path, tmp_path: Path) -> None:
    asked = ("rows", driven, "--worked", "work", "--width", "1.2", "-o")
    names = ("worked.geojson", "worked.gpkg", "worked.taskdata.zip")
    for name in names:
        assert str(tmp_path / name) in fieldgrid(*asked, tmp_path / name).output()
    features = json.loads((tmp_path / names[0]).read_text())["features"]
    assert {one["geometry"]["type"] for one in features} == {"Polygon"}
    kinds = [one["properties"]["kind"] for one in features]
    assert (kinds.count("worked"), kinds.count("missed")) == (1, 4)
    layer = geopandas.read_file(tmp_path / names[1], layer="missed")
    assert layer["lane"].tolist().count("B1-L1") == 2
    assert layer.area.sum() == pytest.approx(layer["area_m2"].sum())
    with zipfile.ZipFile(tmp_path / names[2]) as archive:
        root = ElementTree.fromstring(archive.read("TASKDATA/TASKDATA.XML"))
    areas = [one.get("B") for one in root.iterfind("PFD/PLN") if one.get("A") == "8"]
    assert areas == ["worked 1 x", "missed B1-L1", "missed B1-L1", "missed B1-L2", "missed B1-L3"]
    refused = fieldgrid(*asked, tmp_path / "worked.osm").sentence()
    assert "worked.osm ends in none of" in refused


def test_work_that_cannot_be_told(fieldgrid: Run, driven: Path, tmp_path: Path) -> None:
    out = tmp_path / "worked.geojson"
    said = fieldgrid("rows", driven, "--worked", "june-99", "-o", out).sentence()
    assert "no session 'june-99'" in said
    assert "no trajectory" in fieldgrid("rows", driven, "--worked", "june-03").sentence()
    assert not out.exists()
    for more in (("--width", "2"), ("--behind", "1")):
        assert "--worked" in fieldgrid("rows", driven, *more).usage()
    for more in (("--keep",), ("--agopengps", tmp_path / "north")):
        assert "leave --worked out" in fieldgrid("rows", driven, "--worked", "work", *more).usage()


def test_work_on_a_map_without_rows(fieldgrid: Run, tmp_path: Path) -> None:
    path = tmp_path / "bare.gpkg"
    add_drive(path, [(0.0, 0.4 * k, 0.0, 1) for k in range(51)])
    with open_map(path, writable=True) as universal, universal.add_session("seen") as session:
        spec = fg.GridSpec(4.0, 4.0, 0.1)
        seen = np.ones(spec.shape, np.bool_)
        session.add(fg.LocalGrid(spec, np.zeros(spec.shape, np.uint8), seen), POSE)
    done = fieldgrid("rows", path, "--worked", "work", "--width", "2")
    assert done.status == 0
    assert "40.0 m²" in done.out
    assert "no rows found" in done.err
