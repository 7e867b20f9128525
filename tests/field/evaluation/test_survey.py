"""A map against a plain survey: what is found, missed, not seen and false, and how far off."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from fieldgrid.core import TruthError
from fieldgrid.field import evaluate_survey, read_survey
from fieldgrid.field.evaluation.against_survey import SurveyScores
from fieldgrid.geometry import GridSpec, LocalGrid, Pose
from fieldgrid.maps import create_map, open_map
from tests.export.asymmetric import DATUM, geodetic

# Rows at -3, 0 and 3 m east, a post, and what no survey names; from 8 m on nothing is seen.
ROWS = {f"r{k}": ((east, 2.0), (east, 18.0)) for k, east in enumerate((-3.0, 0.0, 3.0))}
POST, STRANGER, MISSING, UNSEEN = (6.0, 10.0), (6.0, 5.0), (6.0, 14.0), (9.0, 10.0)
SPEC = GridSpec(20.0, 20.0, 0.05)
AREA = shapely.box(-9.0, 1.0, 7.5, 19.0)

Thing = tuple[str, str, Any]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    east, north = np.meshgrid(*SPEC.centres_m())
    density = np.zeros(east.shape, dtype=np.uint8)
    for (at, first), (_, last) in ROWS.values():
        density[(np.abs(east - at) < 0.2) & (north > first) & (north < last)] = 200
    for at_east, at_north in (POST, STRANGER):
        density[(np.abs(east - at_east) < 0.1) & (np.abs(north - at_north) < 0.1)] = 220
    found = tmp_path_factory.mktemp("map") / "m.gpkg"
    with (
        create_map(found, DATUM, cell_m=0.05) as universal,
        universal.add_session("s") as session,
    ):
        for k in range(2):
            pose = Pose(1_780_000_000_000_000_000 + k, 0.0, 0.0, 0.0, 0.0, 0.02, 0.5, 1.0)
            session.add(LocalGrid(SPEC, density, east < 8.0), pose)
    return found


def lines(move: tuple[float, float] = (0.0, 0.0)) -> list[Thing]:
    return [("row", name, shapely.LineString(np.add(ends, move))) for name, ends in ROWS.items()]


def point(at: tuple[float, float], name: str = "p", kind: str = "post") -> Thing:
    return kind, name, shapely.Point(at)


def in_degrees(shape: Any) -> dict[str, Any]:
    def turned(places: Any) -> Any:
        lat, lon, _ = geodetic(places[:, 0], places[:, 1])
        return np.column_stack([lon, lat])

    found: dict[str, Any] = json.loads(shapely.to_geojson(shapely.transform(shape, turned)))
    return found


def geojson(file: Path, things: Sequence[Thing], **more: float) -> Path:
    features = [
        {
            "type": "Feature",
            "properties": {"kind": kind, "id": name, **more},
            "geometry": in_degrees(shape),
        }
        for kind, name, shape in things
    ]
    file.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return file


def table(file: Path, things: Sequence[Thing]) -> Path:
    with file.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["kind", "id", "east_m", "north_m"])
        for kind, name, shape in things:
            corners = shape.exterior if kind == "area" else shape
            for east, north in corners.coords:
                writer.writerow([kind, name, east, north])
    return file


def scored(path: Path, survey: Path, **options: Any) -> SurveyScores:
    with open_map(path) as universal:
        return evaluate_survey(universal, read_survey(survey, universal.datum), **options)


@pytest.mark.parametrize("write", [geojson, table])
def test_a_shift_is_told_by_posts_and_across_rows(path: Path, tmp_path: Path, write: Any) -> None:
    move = (0.1, -0.05)
    file = tmp_path / ("s.geojson" if write is geojson else "s.csv")
    things = [point((POST[0] + move[0], POST[1] + move[1])), *lines(move)]
    kinds = {kind.kind: kind for kind in scored(path, write(file, things)).kinds}
    post, row = kinds["post"], kinds["row"]
    assert (post.surveyed, post.found, post.missed, post.not_seen) == (1, 1, 0, 0)
    assert (row.surveyed, row.found, row.missed, row.not_seen) == (3, 3, 0, 0)
    assert post.shift_east_m == pytest.approx(-0.1, abs=0.01)
    assert post.shift_north_m == pytest.approx(0.05, abs=0.01)
    assert post.error_max_m == pytest.approx(np.hypot(*move), abs=0.01)
    assert row.shift_east_m == pytest.approx(-0.1, abs=0.03)
    assert row.error_median_m == pytest.approx(0.1, abs=0.03)


def test_what_is_missed_unseen_and_false(path: Path, tmp_path: Path) -> None:
    things = [point(POST, "a"), point(MISSING, "b"), point(UNSEEN, "c"), *lines()[:2]]
    without = scored(path, geojson(tmp_path / "s.geojson", things))
    (post,) = (kind for kind in without.kinds if kind.kind == "post")
    assert (post.surveyed, post.found, post.missed, post.not_seen) == (3, 1, 1, 1)
    assert {t.id: (t.seen, t.found) for t in without.things if t.kind == "post"} == {
        "a": (True, True),
        "b": (True, False),
        "c": (False, False),
    }
    assert without.false is None  # nobody said that the survey is complete
    whole = [*things, ("area", "field", AREA)]
    for file in (geojson(tmp_path / "w.geojson", whole), table(tmp_path / "w.csv", whole)):
        false = scored(path, file).false
        assert false is not None
        assert false.rows == 1
        assert false.obstacles == 2  # the third row, and what nobody surveyed
        assert false.obstacles_m2 == pytest.approx(16.0 * 0.4 + 0.04, abs=0.1)
    # Ground that the survey does not cover is not judged.
    part = [*things, ("area", "field", shapely.box(-9.0, 1.0, 1.5, 19.0))]
    false = scored(path, geojson(tmp_path / "p.geojson", part)).false
    assert false is not None
    assert (false.rows, false.obstacles) == (0, 0)


def test_a_radius_belongs_to_the_thing(path: Path, tmp_path: Path) -> None:
    beside = [point((POST[0] + 0.5, POST[1]))]
    (kind,) = scored(path, geojson(tmp_path / "a.geojson", beside)).kinds
    assert (kind.found, kind.missed) == (0, 1)
    (kind,) = scored(path, geojson(tmp_path / "b.geojson", beside, radius_m=0.4)).kinds
    assert kind.found == 1
    assert kind.error_max_m == pytest.approx(0.1, abs=0.03)


def test_what_chance_would_find(path: Path, tmp_path: Path) -> None:
    corners = [point(at, str(at)) for at in ((4.0, 8.0), (7.5, 8.0), (7.5, 12.0), (4.0, 12.0))]
    result = scored(path, geojson(tmp_path / "s.geojson", corners), within_m=0.5)
    # The post of 0.2 m, and 0.5 m around it, of the ground between the corners, widened by 0.5 m,
    # in which the row ends 0.2 m to the west of the seen part.
    ground = shapely.box(4.0, 8.0, 7.5, 12.0).buffer(0.5)
    near = shapely.box(5.9, 9.9, 6.1, 10.1).buffer(0.5).area
    near += ground.intersection(shapely.box(2.8, 2.0, 3.2, 18.0).buffer(0.5)).area
    assert result.by_chance == pytest.approx(near / ground.area, abs=0.01)


def test_the_list_of_a_receiver(path: Path, tmp_path: Path) -> None:
    lat, lon, _ = geodetic(np.array([POST[0]]), np.array([POST[1]]))
    file = tmp_path / "poles.csv"
    file.write_text(f"Pole,Lat,Long\nROW01POLE01,{lat[0]:.9f},{lon[0]:.9f}\n")
    (thing,) = scored(path, file).things
    assert (thing.kind, thing.id, thing.found) == ("pole", "ROW01POLE01", True)
    assert thing.error_m == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("s.csv", "a,b\n1,2\n", "no position; name them lat_deg"),
        ("s.csv", "lat,lon\n1,x\n", "line 2 has no position"),
        ("s.csv", "lat,lon\n95,3\n", "no latitude"),
        ("s.csv", "lat,lon\n", "no post, row or obstacle"),
        ("s.csv", "lat,lon\n41.0,2.0\n", "km from the map's datum"),
        ("s.csv", "kind,id,east_m,north_m\nrow,1,0,0\n", "has 1 points; it needs 2"),
        ("s.csv", "kind,east_m,north_m,radius_m\npost,0,0,-1\n", "a radius_m of -1 cannot be"),
        ("s.csv", "kind,wkt_m\npost,POINT (nan 0)\n", "has no place"),
        ("s.csv", "kind,wkt_m\npost,PONT (0 0)\n", "cannot be read"),
        ("s.csv", "", "columns none, and no position"),
        ("s.csv", "lat,lon\n" + "9" * 200_000 + ",7\n", "no CSV after line 1"),
        ("s.csv", "lat,lon\n1\n", "line 2 has no position"),
        ("s.csv", "lat,lon\n\n41.6,7\n41.6,\n", "line 4 has no position"),
        ("s.csv", "kind,wkt_m,radius_m\npost,POINT (0 0),x\n", "a radius_m of x cannot be"),
        ("s.geojson", '{"features": [{"geometry": {"type": "Point"}}]}', "no GeoJSON"),
        ("s.geojson", '{"features": [{"geometry": null}]}', "no GeoJSON"),
        ("s.geojson", '{"features": null}', "no GeoJSON"),
        ("s.geojson", '{"features": []}', "no post, row or obstacle"),
        ("s.geojson", "[]", "no GeoJSON FeatureCollection"),
        ("s.geojson", "{", "no GeoJSON FeatureCollection"),
    ],
)
def test_bad_surveys(path: Path, tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(TruthError, match=says) as caught:
        read_survey(tmp_path / name, DATUM)
    assert str(tmp_path / name) in str(caught.value)


@pytest.mark.parametrize("name", ["metres.csv", "degrees.csv", "posts.geojson"])
def test_points_are_read_from_csv_and_geojson(name: str, tmp_path: Path) -> None:
    posts = np.array([[0.0, 0.0], [12.5, -40.0], [-300.0, 7.25]])
    lat, lon, _ = DATUM.to_geodetic(posts[:, 0], posts[:, 1], np.zeros(len(posts)))
    path = tmp_path / name
    if name == "metres.csv":
        path.write_text("east_m,north_m\n" + "".join(f"{e},{n}\n" for e, n in posts.tolist()))
    elif name == "degrees.csv":
        rows = "".join(f"p,{a:.10f},{b:.10f}\n" for a, b in zip(lat, lon, strict=True))
        path.write_text("Vine ID,Lat [deg],Longitude\n" + rows, encoding="utf-8-sig")
    else:
        points = [{"type": "Point", "coordinates": [b, a]} for a, b in zip(lat, lon, strict=True)]
        features = [{"type": "Feature", "properties": {}, "geometry": p} for p in points]
        path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert np.abs(read_survey(path, DATUM).points_m - posts).max() < 0.001


def test_a_survey_in_metres_is_no_geojson(tmp_path: Path) -> None:
    feature = {"properties": {}, "geometry": {"type": "Point", "coordinates": [500_000.0, 4e6]}}
    (tmp_path / "s.geojson").write_text(json.dumps({"features": [feature]}))
    with pytest.raises(TruthError, match="export it in WGS84"):
        read_survey(tmp_path / "s.geojson", DATUM)


def test_a_place_that_is_no_number_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    path.write_text("kind,id,east_m,north_m\nrow,r,inf,0\nrow,r,5,nan\n")
    with pytest.raises(TruthError, match="is no place"):
        read_survey(path, DATUM)
