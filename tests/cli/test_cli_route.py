"""`fieldgrid route`: tables, files, and what it answers where there is no way."""

from __future__ import annotations

import csv
import json
import re
import shlex
import xml.etree.ElementTree as ElementTree
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import fieldgrid as fg
import fieldgrid.field as fieldgrid_field
from benchmarks.planting import DATUM, Sight
from fieldgrid.field.coverage.plan import OmittedLane
from fieldgrid.geometry import Feature, write_features
from tests.cli.conftest import Run
from tests.field.route.test_plan import field as free_field
from tests.field.rows.fields import straight, view_of, write_map

TRUTH = Path(__file__).parents[2] / "examples" / "two_lanes" / "truth"
START, GOAL = "1.25,-3,0", "1.25,33"


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four rows of 30 m to the north, seen without noise; a thing stands in the second lane."""
    sight = Sight(noise_per_m2=0.0, hole_share=0.0, margin_m=6.0, headland_m=6.0)
    view = view_of(straight(4, 30.0, 2.5), sight, things=[(3.75, 10.0, 0.5)])
    return write_map(tmp_path_factory.mktemp("route") / "field.gpkg", view)


def test_the_table_and_the_file(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    out = tmp_path / "route.csv"
    text = fieldgrid("route", field, "--from", START, "--to", GOAL, "-o", out).output()
    assert text.startswith("route")
    for word in ("length", "36.0 m", "turning", "least clearance", str(out)):
        assert word in text
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert (rows[0]["east_m"], rows[0]["north_m"]) == ("1.250000", "-3.000000")
    assert all(float(row["clearance_m"]) >= 0.1 for row in rows)
    fieldgrid("show", field, "-o", tmp_path / "route.png", "--route", out).output()


def test_json_says_the_same_as_python(fieldgrid: Run, field: Path) -> None:
    told = json.loads(fieldgrid("route", field, "--from", START, "--to", GOAL, "--json").output())
    route = fg.plan_route(field, (1.25, -3.0, 0.0), (1.25, 33.0))
    assert told["found"] is True
    assert told["length_m"] == pytest.approx(route.length_m)
    assert told["turning_share"] == pytest.approx(route.turning_share)
    assert told["least_clearance_m"] == pytest.approx(route.least_clearance_m)
    assert told["poses"] == len(route.east_m)


def test_no_route_is_an_answer_with_a_place(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    """The lane is blocked and the vehicle too wide for the headland; nothing is written."""
    vehicle, out = tmp_path / "wide.toml", tmp_path / "route.csv"
    vehicle.write_text("width_m = 1.2\nturning_radius_m = 20\nclearance_m = 0\nreverse = false\n")
    asked = ("route", field, "--from", "3.75,5,0", "--to", "3.75,15,0", "--vehicle", vehicle)
    sentence = fieldgrid(*asked, "-o", out).sentence()
    assert "path" in sentence
    assert not out.exists()
    failed = fieldgrid(*asked, "--json")
    assert failed.status == 1
    told = json.loads(failed.out)
    assert told["found"] is False
    assert told["reason"] in failed.err
    assert 0.0 < told["blocked_at"]["north_m"] < 15.0


def test_covering_says_what_is_left_out(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    """The second lane is blocked: the others are written, and the status is that of a refusal."""
    out = tmp_path / "work.csv"
    done = fieldgrid("route", field, "--cover", "-o", out)
    assert done.status == 1
    for words in (
        "lanes covered",
        "2 of 3",
        "not covered: B1-L2: There is no path along the lane",
        "stopped by an obstacle",
        str(out),
    ):
        assert words in done.out
    assert "1 of 3 lanes is not covered; of B1-L2: There is no path along the lane" in done.err
    assert "--lanes B1-L1,B1-L3 asks for the others alone" in done.err
    with out.open(newline="") as file:
        named = [row["lane"] for row in csv.DictReader(file)]
    assert set(named) == {"B1-L1", "B1-L3", ""}
    fieldgrid("show", field, "-o", tmp_path / "work.png", "--route", out).output()


def test_covering_names_the_weak_cell_that_closes_a_lane(fieldgrid: Run, tmp_path: Path) -> None:
    sight = Sight(noise_per_m2=0.0, hole_share=0.0, margin_m=6.0, headland_m=6.0)
    view = view_of(straight(3, 20.0, 2.5), sight)
    i, j = (int(index) for index in view.lattice.index(1.28, 10.05))
    view.density[j - view.window.j0, i - view.window.i0] = 140
    universal = write_map(tmp_path / "rows.gpkg", view)
    done = fieldgrid("route", universal, "--cover")
    assert done.status == 1
    assert "of B1-L1: There is no path along the lane" in done.err
    assert "1.25,10.05 (density 140, seen by 1 of 1 frame: june-03 " in done.err
    named = re.search("`(fieldgrid mark rows.gpkg [^`]*)`", done.err)
    assert named is not None
    _, command, _, *options = shlex.split(named[1])
    fieldgrid(command, universal, *options).output()
    assert "2 of 2" in fieldgrid("route", universal, "--cover").output()


def test_covering_the_lanes_that_can_be(fieldgrid: Run, field: Path) -> None:
    asked = ("route", field, "--cover", "--lanes", "B1-L3, B1-L1", "--from", "0,-4", "--json")
    told = json.loads(fieldgrid(*asked).output())
    coverage = fg.plan_coverage(field, lanes=["B1-L1", "B1-L3"], start=(0.0, -4.0))
    assert told["found"] is True
    assert told["left_out"] == []
    assert [lane["lane"] for lane in told["lanes"]] == [lane.lane for lane in coverage.lanes]
    assert told["length_m"] == pytest.approx(coverage.route.length_m)
    assert told["turning_share"] == pytest.approx(coverage.turning_share)
    assert 0.1 < told["turning_share"] < 0.5


def test_no_lane_at_all(fieldgrid: Run, field: Path) -> None:
    failed = fieldgrid("route", field, "--cover", "--lanes", "B1-L2", "--json")
    assert failed.status == 1
    told = json.loads(failed.out)
    assert told["found"] is False
    assert told["reason"] in failed.err
    assert "No lane can be covered; of B1-L2" in failed.err


def test_lanes_are_for_covering_only(fieldgrid: Run, field: Path) -> None:
    asked = ("route", field, "--from", START, "--to", GOAL)
    for options, why in (
        (("--lanes", "B1-L1"), "--cover only"),
        (("--spacing", "1:3"), "lanes only"),
        (("--crop", "orchard"), "lanes only"),
        (("--swaths", "lanes.osm"), "--cover and --survey only"),
        (("--needs", "needs.kml"), "--survey only"),
    ):
        assert f"for {options[0]}: it is for {why}" in fieldgrid(*asked, *options).usage()
    assert "no lane 'B9-L9'" in fieldgrid("route", field, "--cover", "--lanes", "B9-L9").sentence()
    sentence = fieldgrid("route", field, "--cover", "--spacing", "20:30").sentence()
    assert "No lanes were found" in sentence


@pytest.fixture(scope="module")
def meadow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Free ground of 14 x 10 m without rows, with a thing in it."""
    view = free_field((14.0, 10.0), [(8.0, 5.0, 8.6, 5.6)])
    return write_map(tmp_path_factory.mktemp("meadow") / "meadow.gpkg", view)


def test_tracks_over_ground_without_rows(fieldgrid: Run, meadow: Path, tmp_path: Path) -> None:
    """In a boundary, in all files; the sentence about missing lanes names the flag."""
    out, swaths, folder = tmp_path / "work.csv", tmp_path / "swaths.geojson", tmp_path / "agopen"
    corners = [(101.0, -49.0), (113.0, -49.0), (113.0, -41.0), (101.0, -41.0)]
    write_features(
        tmp_path / "edge.geojson", [Feature("field", shapely.Polygon(corners), {})], DATUM
    )
    asked = ("route", meadow, "--cover", "--tracks", "--width", "1.6", "--overlap", "0.1",
             "--headland-passes", "1", "--boundary", tmp_path / "edge.geojson")  # fmt: skip
    text = fieldgrid(
        *asked, "--direction", "90", "-o", out, "--swaths", swaths, "--agopengps", folder
    ).output()
    for words in ("tracks driven", "90.0 °", "of what can be reached", str(swaths), str(folder)):
        assert words in text
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    named = {row["lane"] for row in rows} - {""}
    assert {"F1-T1", "F1-H1.1"} <= named
    assert all(101.0 < float(row["east_m"]) < 113.0 for row in rows)
    written = json.loads(swaths.read_text())["features"]
    lanes = {f["properties"]["id"] for f in written if f["properties"]["kind"] == "lane"}
    assert lanes == named
    assert "F1-T1" in (folder / "TrackLines.txt").read_text()
    # An inner boundary about the thing.
    assert (folder / "Boundary.txt").read_text().count("False") == 2
    # Beside the same line as a file, and as JSON.
    (tmp_path / "line.csv").write_text("east_m,north_m\n102,-46\n112,-45\n")
    along = fieldgrid(*asked, "--along", tmp_path / "line.csv", "--json").output()
    told = json.loads(along)
    assert told["swaths"]["worked_m2"] > 0.8 * told["swaths"]["reachable_m2"]
    assert "--tracks" in fieldgrid("route", meadow, "--cover").sentence()


@pytest.mark.parametrize(("passes", "fewer"), [("0", False), ("1", True)])
def test_fewer_passes_are_advised_where_there_can_be_fewer(
    passes: str, fewer: bool, fieldgrid: Run, meadow: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def one_is_left_out(*asked: Any, **how: Any) -> Any:
        return replace(
            cover(*asked, **how),
            left_out=(OmittedLane("F1-T1", "There is no path to the track", 1.0, 2.0),),
            remedy="give a smaller vehicle",
        )

    cover = fg.plan_coverage
    monkeypatch.setattr(fieldgrid_field, "plan_coverage", one_is_left_out)
    asked = ("route", meadow, "--cover", "--tracks", "--width", "2", "--headland-passes", passes)
    said = fieldgrid(*asked).err
    assert "the others are driven; give a smaller vehicle" in said
    assert ("fewer --headland-passes" in said) == fewer


def test_tracks_and_lanes_for_terminals_and_lanelet2(
    fieldgrid: Run, meadow: Path, field: Path, tmp_path: Path
) -> None:
    usb, osm, rows = (tmp_path / name for name in ("t.taskdata.zip", "t.osm", "rows.taskdata.zip"))
    asked = ("route", meadow, "--cover", "--tracks", "--width", "2", "--headland-passes", "0")
    fieldgrid(*asked, "--direction", "45", "--swaths", usb).output()
    lines = patterns(usb)
    assert len(lines) > 3
    assert all("F1-T" in name for name in lines)
    fieldgrid(*asked, "--direction", "45", "--swaths", osm, "--speed-limit", "5").output()
    assert all(osm.read_text().count(f'v="{name}"') == 1 for name in lines)
    assert "swaths" in fieldgrid("export", field, rows, "--guidance", "lanes").output()
    assert set(patterns(rows)) == {"B1-L1", "B1-L2", "B1-L3"}
    wrong = fieldgrid("export", meadow, tmp_path / "no.taskdata.zip", "--guidance", "lanes")
    assert "No lanes were found" in wrong.sentence()
    assert "for networks" in fieldgrid(*asked, "--swaths", tmp_path / "t.kml",
                                       "--speed-limit", "5").sentence()  # fmt: skip


def patterns(usb: Path) -> set[str]:
    """The names of the guidance patterns of task data."""
    with zipfile.ZipFile(usb) as archive:
        root = ElementTree.fromstring(archive.read("TASKDATA/TASKDATA.XML"))
    return {str(pattern.get("B")) for pattern in root.iterfind("PFD/GGP/GPN")}


def test_options_of_tracks_that_cannot_be(fieldgrid: Run, meadow: Path, tmp_path: Path) -> None:
    cover = ("route", meadow, "--cover")
    assert "for --width: it is for --tracks only" in fieldgrid(*cover, "--width", "2").usage()
    assert "for --crop: it is for lanes" in fieldgrid(*cover, "--tracks", "--crop", "x").usage()
    gone, text, large = tmp_path / "gone.csv", tmp_path / "text.geojson", tmp_path / "far.geojson"
    text.write_text("no")
    large.write_text('{"type": "Point", "coordinates": [500000, 4600000]}')
    for flag, value, words in (
        ("--along", gone, "gone.csv cannot be read"),
        ("--boundary", text, "is no GeoJSON in longitude and latitude"),
        ("--boundary", large, "not in longitude and latitude"),
        ("--overlap", "0.9", "over half of the working width"),
        ("--width", "-1", "width_m of tracks of -1"),
    ):
        assert words in fieldgrid(*cover, "--tracks", flag, value).sentence()


def test_a_thing_in_the_start(fieldgrid: Run, field: Path) -> None:
    sentence = fieldgrid("route", field, "--from", "3.75,10", "--to", GOAL).sentence()
    assert "not free" in sentence
    assert "an obstacle at 3." in sentence


@pytest.mark.parametrize(("density", "cells"), [(130, 1), (130, 3), (200, 1)])
def test_a_refusal_names_the_weak_cells_that_block_and_the_mark_that_frees_them(
    fieldgrid: Run, tmp_path: Path, density: int, cells: int
) -> None:
    """A cell stands in the gap of a wall, or several, or one that is seen clearly."""
    view = free_field(obstacles=[(10.0, 0.0, 10.2, 4.0), (10.0, 6.0, 10.2, 10.0)])
    side = slice(25 - cells // 2, 26 + cells // 2)
    view.density[side, slice(50 - cells // 2, 51 + cells // 2)] = density
    universal, vehicle = write_map(tmp_path / "gap.gpkg", view), tmp_path / "wide.toml"
    vehicle.write_text("width_m = 1.2\nfront_m = 0.8\nrear_m = 0.4\n")
    asked = ("route", universal, "--from", "105,-45", "--to", "115,-45", "--vehicle", vehicle)
    sentence = fieldgrid(*asked).sentence()
    assert ("110.10,-44.90 (density 130, seen by 1 of 1 frame: june-03 " in sentence) == (
        (density, cells) == (130, 1)
    )
    named = re.search("`(fieldgrid mark gap.gpkg [^`]*)`", sentence)
    if named is None:
        assert "give another start or goal" in sentence
        return
    _, command, _, *options = shlex.split(named[1])
    fieldgrid(command, universal, *options).output()
    told = json.loads(fieldgrid(*asked, "--json").output())
    assert told["length_m"] == pytest.approx(10.0, abs=0.5)


def test_larger_cells_keep_the_obstacles_of_the_map(fieldgrid: Run, field: Path) -> None:
    for cell in ("0.1", "0.5"):
        asked = ("route", field, "--from", "3.75,10", "--to", GOAL, "--cell", cell)
        assert "an obstacle" in fieldgrid(*asked).sentence()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--from", "1,2,3,4", "--to", GOAL), "'1,2,3,4' is not E,N or E,N,HEADING"),
        (("--from", "x", "--to", GOAL), "'x' is not E,N or E,N,HEADING"),
        (("--from", START), "Invalid value for --to: it is needed"),
    ],
)
def test_places_that_are_none(
    fieldgrid: Run, field: Path, options: tuple[str, ...], words: str
) -> None:
    assert words in " ".join(fieldgrid("route", field, *options).usage().split())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--vehicle", "none.toml"), "There is no vehicle file none.toml"),
        (("-o", "route.xyz"), "ends in none of .geojson"),
        (("--least-seen", "2"), "least share seen of 2"),
        (("--obstacle-above", "300"), "300"),
        (("--to", START), "give two places"),
    ],
)
def test_bad_options_get_one_sentence(
    fieldgrid: Run, field: Path, options: tuple[str, ...], words: str
) -> None:
    asked = ("route", field, "--from", START, "--to", GOAL, *options)
    assert words in fieldgrid(*asked).sentence()


def test_inputs_are_never_overwritten(fieldgrid: Run, field: Path) -> None:
    before = field.read_bytes()
    asked = ("route", field, "--from", START, "--to", GOAL, "-o", field, "--overwrite")
    fieldgrid(*asked).sentence()
    assert field.read_bytes() == before


def test_the_example_drive(fieldgrid: Run, two_lanes_map: Path, tmp_path: Path) -> None:
    """From the first lane over the headland, as the pictures of the documentation show it."""
    out = tmp_path / "route.csv"
    asked = ("route", two_lanes_map, "--from", "-14,50,37", "--to", "6,76", "-o", out)
    told = json.loads(fieldgrid(*asked, "--json").output())
    assert 32.5 < told["length_m"] < 35.0
    assert told["gear_changes"] == 0
    assert told["least_clearance_m"] >= 0.1
    cover = ("route", two_lanes_map, "--cover", "--lanes", "B1-L1,B1-L2", "--allow-unknown")
    told = json.loads(fieldgrid(*cover, "--json").output())
    assert told["left_out"] == []
    assert told["length_m"] < 70.0
    ends = ("--from", "-20,42", "--to", "-17,40")
    assert json.loads(fieldgrid(*cover, *ends, "--json").output())["length_m"] < 90.0


def test_where_to_drive_next_on_the_example(
    fieldgrid: Run, two_lanes_map: Path, tmp_path: Path
) -> None:
    """Its two lanes were driven: the ones on both sides of them are next, from end to end."""
    out, needs, folder = tmp_path / "next.csv", tmp_path / "needs.geojson", tmp_path / "agopen"
    usb = tmp_path / "next.taskdata.zip"
    asked = ("route", two_lanes_map, "--survey", "-o", out, "--needs", needs, "--swaths", usb,
             "--agopengps", folder, "--json")  # fmt: skip
    told = json.loads(fieldgrid(*asked).output())
    with out.open(newline="") as file:
        worked = [row for row in csv.DictReader(file) if row["lane"]]
    way = shapely.MultiPoint([(float(row["east_m"]), float(row["north_m"])) for row in worked])
    truth = json.loads((TRUTH / "rows.geojson").read_text())["features"]
    rows = [shapely.LineString(feature["geometry"]["coordinates"]) for feature in truth]
    for beside, unseen in ((2, 1), (4, 5)):  # the row whose other side was seen, and the next one
        middle = shapely.LineString(
            (0.5 * (a + b) for a, b in zip(*(np.array(rows[k].coords) for k in (beside, unseen)),
                                           strict=True))
        )  # fmt: skip
        points = [middle.interpolate(share, normalized=True) for share in np.linspace(0.05, 0.95)]
        assert max(point.distance(way) for point in points) < 0.6
    assert {"B1-R1-left", "B1-L3"} <= {lane["lane"] for lane in told["lanes"]}
    assert told["sees_share"] > 0.8
    features = json.loads(needs.read_text())["features"]
    areas = [f["properties"]["area_m2"] for f in features]
    assert areas == pytest.approx([n["area_m2"] for n in told["needs"]], abs=1e-3)
    unseen_m2 = {n["lane"]: n["area_m2"] for n in told["needs"] if n["kind"] == "unseen"}
    assert min(unseen_m2["B1-R1-left"], unseen_m2["B1-L3"]) > 45.0
    assert "old" not in {need["kind"] for need in told["needs"]}
    older = ("route", two_lanes_map, "--survey", "--older-than", "30", "--json")
    told = json.loads(fieldgrid(*older).output())
    old = {need["lane"] for need in told["needs"] if need["kind"] == "old"}
    assert {"B1-L1", "B1-L2"} <= old <= {"B1-L1", "B1-L2", "B1-L3", "B1-L4"}
    assert {"B1-L1", "B1-L2"} <= {lane["lane"] for lane in told["lanes"]}
    assert {"B1-R1-left", "B1-L3"} <= patterns(usb)
    assert "B1-R1-left" in (folder / "TrackLines.txt").read_text()


def test_from_lane_to_lane(fieldgrid: Run, field: Path, tmp_path: Path) -> None:
    """From the middle of one to that of another, around the end of the row between."""
    asked = ("route", field, "--from", "B1-L1", "--to", "B1-L3", "-o", tmp_path / "way.csv")
    fieldgrid(*asked).output()
    with (tmp_path / "way.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    ends = [(float(row["east_m"]), float(row["north_m"])) for row in (rows[0], rows[-1])]
    assert ends[0] == pytest.approx((1.25, 15.0), abs=0.3)
    assert ends[1] == pytest.approx((6.25, 15.0), abs=0.3)
    assert "no lane 'B1-L9'" in fieldgrid(*asked[:3], "B1-L9", *asked[4:6]).sentence()
    assert "is not E,N" in fieldgrid(*asked[:3], "here", *asked[4:6]).usage()
    both = ("route", field, "--cover", "--survey")
    assert "leave --cover out" in fieldgrid(*both).usage()
    wrong = ("route", field, "--survey", "--needs", tmp_path / "needs.osm")
    assert "ends in none of .geojson" in fieldgrid(*wrong).usage()
