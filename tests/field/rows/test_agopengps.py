"""Fields of AgOpenGPS, read as it reads them: line by line, in metres of its own plane."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import shapely

from benchmarks.planting import DATUM
from fieldgrid.core import ConfigError, Float64, MapExistsError
from fieldgrid.field import Planting, write_agopengps, write_planting
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import Datum
from tests.field.rows.fields import straight, view_of


class Track(NamedTuple):
    """A track of TrackLines.txt: A and B, mode, points, and the heading that is said."""

    ends: Float64
    mode: int
    points: Float64
    heading_rad: float


class Field(NamedTuple):
    """What the files say, in metres of the datum."""

    rings: list[Float64]
    tracks: dict[str, Track]


def read_field(folder: Path, datum: Datum = DATUM) -> Field:
    """By the readers of AgOpenGPS: the eighth line is followed by the origin; a flag, a count and
    so many `east,north,heading` make a ring."""
    lines = (folder / "Field.txt").read_text().splitlines()
    assert lines[7] == "StartFix"
    lat0, lon0 = map(float, lines[8].split(","))
    a = math.radians(lat0)
    north_m = (
        111132.92 - 559.82 * math.cos(2 * a) + 1.175 * math.cos(4 * a) - 0.0023 * math.cos(6 * a)
    )
    east_m = 111412.84 * math.cos(a) - 93.5 * math.cos(3 * a) + 0.118 * math.cos(5 * a)

    def there(rows: list[str]) -> Float64:
        values = np.array([[float(v) for v in row.split(",")] for row in rows]).reshape(
            len(rows), -1
        )
        lat, lon = lat0 + values[:, 1] / north_m, lon0 + values[:, 0] / east_m
        east, north, _ = datum.to_enu(lat, lon, datum.height_m)
        return np.column_stack([east, north, values[:, 2:]])

    lines = (folder / "Boundary.txt").read_text().splitlines()
    assert lines[0] == "$Boundary"
    rings, at = [], 1
    while at < len(lines):
        assert lines[at] == "False"
        count = int(lines[at + 1])
        rings.append(there(lines[at + 2 : at + 2 + count]))
        at += 2 + count
    lines = (folder / "TrackLines.txt").read_text().splitlines()
    assert lines[0] == "$TrackLines"
    tracks, at = {}, 1
    while at < len(lines):
        name, heading, *ends = lines[at : at + 4]
        nudge, mode, visible, count = lines[at + 4 : at + 8]
        assert (float(nudge), visible) == (0.0, "True")
        points = there(lines[at + 8 : at + 8 + int(count)]) if int(count) else np.zeros((0, 3))
        tracks[name] = Track(there(ends), int(mode), points, float(heading))
        at += 8 + int(count)
    return Field(rings, tracks)


@pytest.fixture(scope="module")
def planting() -> Planting:
    """Rows to the north-east, shorter to the right; something stands in the second lane, and one
    lane is bent by hand."""
    rows = straight(4, 30.0, 2.5, 40.0, at=(300.0, -120.0))
    rows[3] = np.array([rows[3][0], 0.4 * rows[3][0] + 0.6 * rows[3][1]])
    middle = 0.5 * (rows[1] + rows[2]).mean(axis=0)
    found = rows_of_view(view_of(rows, things=[(*middle.tolist(), 0.4)]))
    assert len(found.lanes) == 3
    line = np.asarray(found.lanes[0].line.coords)
    along = line[-1] - line[0]
    aside = np.array([-along[1], along[0]]) / np.hypot(*along)
    t = np.linspace(0.0, 1.0, 30)[:, None]
    bent = shapely.LineString(line[0] + t * along + 2.0 * t * (1.0 - t) * aside)
    lanes = (found.lanes[0]._replace(line=bent, length_m=bent.length), *found.lanes[1:])
    return replace(found, lanes=lanes)


def test_tracks_are_the_lanes_from_left_to_right(planting: Planting, tmp_path: Path) -> None:
    write_agopengps(planting, tmp_path / "field")
    tracks = read_field(tmp_path / "field").tracks
    assert list(tracks) == [lane.id for lane in planting.lanes]
    assert [track.mode for track in tracks.values()] == [4, 2, 2]
    for lane in planting.lanes:
        track, line = tracks[lane.id], np.asarray(lane.line.coords)
        assert np.abs(track.ends - line[[0, -1]]).max() < 0.01
        along = track.ends[1] - track.ends[0]
        assert math.cos(track.heading_rad - math.atan2(along[0], along[1])) > 1.0 - 1e-6
        if len(track.points):
            apart = shapely.distance(lane.line, shapely.points(track.points[:, :2]))
            assert apart.max() < 0.01
            step = np.gradient(track.points[:, :2], axis=0)
            off = track.points[:, 2] - np.arctan2(step[:, 0], step[:, 1])
            assert np.cos(off).min() > 0.999
    # To the right of the first track, as one who drives from A to B sees it, lies the second.
    first, second = (tracks[lane.id].ends for lane in planting.lanes[:2])
    ahead, over = first[1] - first[0], second[0] - first[0]
    assert ahead[0] * over[1] - ahead[1] * over[0] < 0.0
    # The field is not its own mirror image: the last lane is the shortest.
    sizes = [float(np.hypot(*(t.ends[1] - t.ends[0]))) for t in tracks.values()]
    assert sizes[2] < 0.8 * sizes[1]


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg"), [(-37.8, 145.0), (-33.4, -70.6), (-0.0005, 179.9995), (68.0, -150.0)]
)
def test_fields_lie_where_they_are_in_every_quarter_of_the_earth(
    planting: Planting, tmp_path: Path, lat_deg: float, lon_deg: float
) -> None:
    """The third one lies across the equator and the date line."""
    datum = Datum(lat_deg, lon_deg, 80.0)
    elsewhere = replace(planting, datum=datum)
    write_agopengps(elsewhere, tmp_path / "field")
    tracks = read_field(tmp_path / "field", datum).tracks
    write_planting(elsewhere, tmp_path / "rows.geojson")
    content = json.loads((tmp_path / "rows.geojson").read_text())
    drawn = {f["properties"]["id"]: f["geometry"]["coordinates"] for f in content["features"]}
    for lane in elsewhere.lanes:
        line = np.asarray(lane.line.coords)
        assert np.abs(tracks[lane.id].ends - line[[0, -1]]).max() < 0.01
        lon, lat = np.array(drawn[lane.id]).T
        assert np.abs(lon).max() <= 180.0
        east, north, _ = datum.to_enu(lat, lon, datum.height_m)
        assert np.abs(np.column_stack([east, north]) - line).max() < 0.01


def test_boundaries_enclose_lanes_and_keep_what_stands_inside(
    planting: Planting, tmp_path: Path
) -> None:
    write_agopengps(planting, tmp_path / "field")
    outer, *inner = (shapely.Polygon(ring[:, :2]) for ring in read_field(tmp_path / "field").rings)
    for lane in planting.lanes[1:]:
        assert outer.covers(lane.line)
    for headland in planting.headlands:
        assert outer.buffer(0.02).covers(headland.area)
    (thing,) = (o for o in planting.obstacles if o.lane == planting.lanes[1].id)
    ring = min(inner, key=lambda ring: ring.hausdorff_distance(thing.area))
    assert ring.hausdorff_distance(thing.area) < 0.01


def test_a_planting_that_is_no_field(planting: Planting, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="needs lanes"):
        write_agopengps(replace(planting, lanes=()), tmp_path / "field")
    far = planting.lanes[1]
    moved = [shapely.transform(shape, lambda at: at + 500.0) for shape in (far.line, far.area)]
    lanes = (*planting.lanes, far._replace(line=moved[0], area=moved[1]))
    with pytest.raises(ConfigError, match=r"in 2 places .* give --bounds"):
        write_agopengps(replace(planting, lanes=lanes), tmp_path / "field")
    assert not (tmp_path / "field").exists()


def test_only_fields_of_ours_are_overwritten(planting: Planting, tmp_path: Path) -> None:
    folder = tmp_path / "field"
    write_agopengps(planting, folder)
    with pytest.raises(MapExistsError):
        write_agopengps(planting, folder)
    write_agopengps(planting, folder, overwrite=True)
    (folder / "Field.txt").write_text("my own")
    with pytest.raises(MapExistsError):
        write_agopengps(planting, folder, overwrite=True)
