"""Quality of rows, and rows against a survey."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.planting import DATUM
from fieldgrid.errors import ConfigError
from fieldgrid.rows import Planting as Found
from fieldgrid.rows import rows_of_view
from fieldgrid.rows.report import against_survey, block_quality, read_survey, row_quality
from tests.rows.fields import straight, view_of

ROWS = straight(4, 25.0, 2.4, 30.0)


@pytest.fixture(scope="module")
def found() -> Found:
    return rows_of_view(view_of(ROWS))


@pytest.fixture(scope="module")
def posts() -> np.ndarray:
    """A post each 5 m of each row."""
    along = np.linspace(0.02, 0.98, 6)[:, None]
    return np.concatenate([row[0] + along * (row[1] - row[0]) for row in ROWS])


def test_a_good_block_is_parallel_straight_and_equally_spaced(found: Found) -> None:
    (block,) = block_quality(found)
    assert block.spacing_m == pytest.approx(2.4, abs=0.02)
    assert block.spacing_sd_m < 0.05
    assert block.parallel_deg < 0.2
    assert block.bend_m < 0.02
    assert [q.row for q in row_quality(found)] == [r.id for r in found.rows]


def test_one_turned_row_stands_out() -> None:
    rows = [*ROWS[:3], ROWS[3] + np.array([[0.0, 0.0], [0.6, -0.3]])]
    found = rows_of_view(view_of(rows))
    turns = [q.turn_deg for q in row_quality(found)]
    assert int(np.argmax(np.abs(turns))) in (0, 3)
    assert block_quality(found)[0].parallel_deg > 0.3


def test_a_survey_tells_the_offset_with_its_sign(found: Found, posts: np.ndarray) -> None:
    exact = against_survey(found, posts)
    assert exact.rows == 4
    assert exact.points >= 20
    assert abs(exact.offset_m) < 0.03
    assert exact.rms_m < 0.04
    along = np.subtract(*(found.rows[0].line.coords[k] for k in (-1, 0)))
    left = np.array([-along[1], along[0]]) / np.hypot(*along)
    moved = against_survey(found, posts + 0.3 * left)
    assert moved.offset_m - exact.offset_m == pytest.approx(0.3, abs=0.02)
    assert moved.within_3_sigma < 0.2


@pytest.mark.parametrize("name", ["posts.csv", "degrees.csv", "posts.geojson"])
def test_surveys_are_read_from_csv_and_geojson(
    name: str, posts: np.ndarray, tmp_path: Path
) -> None:
    lat, lon, _ = DATUM.to_geodetic(posts[:, 0], posts[:, 1], np.zeros(len(posts)))
    path = tmp_path / name
    if name == "posts.csv":
        path.write_text("east_m,north_m\n" + "".join(f"{e},{n}\n" for e, n in posts.tolist()))
    elif name == "degrees.csv":
        rows = "".join(f"p,{a:.10f},{b:.10f}\n" for a, b in zip(lat, lon, strict=True))
        path.write_text("Vine ID,Latitude,Longitude\n" + rows, encoding="utf-8-sig")
    else:
        points = [{"type": "Point", "coordinates": [b, a]} for a, b in zip(lat, lon, strict=True)]
        features = [{"type": "Feature", "properties": {}, "geometry": p} for p in points]
        path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    assert np.abs(read_survey(path, DATUM) - posts).max() < 0.001


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "", "a.csv is empty"),
        ("a.csv", "\n \n", "a.csv is empty"),
        ("a.csv", "lat,lon\n" + "9" * 200_000 + ",7\n", "line 2, is no line of a CSV"),
        ("a.csv", "x,y\n1,2\n", "needs latitude"),
        ("a.csv", "lat,lon\n1\n", "line 2: lon is nothing; give a number"),
        ("a.csv", "lat,lon\n\n41.6,7\n41.6,\n", "line 4: lon is nothing; give a number"),
        ("a.csv", "lat,Lon\n41.6,seven\n", "line 2: Lon is 'seven', which is no number"),
        ("a.csv", "lat,lon\n141.6,7\n", r"not on Earth \(latitude 141.6, longitude 7\)"),
        ("a.csv", "lat,lon\n", "has no points"),
        ("a.csv", "east_m,north_m\nnan,2\n", "line 2: east_m is 'nan', which is no number"),
        ("a.csv", "east_m,north_m\n", "has no points"),
        ("a.geojson", "{", "is no GeoJSON"),
        ("a.geojson", "[1]", "is no GeoJSON"),
        ("a.geojson", '{"features": [{"geometry": {"type": "Point"}}]}', "is no GeoJSON"),
        ("a.geojson", '{"features": []}', "has no points"),
        ("a.geojson", '{"features": [{"geometry": null}]}', "is no GeoJSON"),
        ("a.geojson", '{"features": null}', "is no GeoJSON"),
    ],
)
def test_a_survey_that_cannot_be_read_is_one_sentence(
    name: str, text: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_survey(path, DATUM)


def test_a_missing_survey_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read as a survey"):
        read_survey(tmp_path / "none.csv", DATUM)


def test_a_survey_elsewhere_is_refused(found: Found, posts: np.ndarray) -> None:
    with pytest.raises(ConfigError, match="lies within 1 m of a row"):
        against_survey(found, posts + 500.0)
