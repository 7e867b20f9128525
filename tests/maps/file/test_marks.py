"""What people say of places: kept as evidence, undone exactly, and where it counts."""

from __future__ import annotations

import json
import math
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import shapely
from pyogrio import list_layers
from pyogrio.raw import read as read_layer

from fieldgrid.core import ConfigError, MapError
from fieldgrid.geometry.shapes.vectors import geojson
from fieldgrid.maps import (
    MAX_CORNERS,
    Mark,
    MarkKind,
    features,
    marks_of_geojson,
    merge_maps,
    open_map,
)
from tests.maps.file.maps import CELL_M, DATUM, drive, write_map

POND = Mark(
    MarkKind.KEEPOUT, ((1.0, 0.0), (2.0, 0.0), (2.0, 1.0)), "pond", "until it is dry", "Ana"
)
GATE = Mark(MarkKind.PLACE, ((2.0, 3.0),), "gate", author="Bob")
FENCED = Mark(
    MarkKind.KEEPOUT,
    ((-3.0, -3.0), (5.0, -3.0), (5.0, 5.0), (-3.0, 5.0)),
    "all but the yard",
    holes=(((-1.0, -1.0), (0.0, -1.0), (0.0, 0.5)), ((1.0, 1.0), (2.0, 1.0), (2.0, 2.0))),
)


def square(
    east_m: float, north_m: float, side_m: float = 1.0, height_m: float | None = None
) -> tuple[tuple[float, float], ...]:
    """The corners of a rectangle from its south-west one."""
    east, north = east_m + side_m, north_m + (side_m if height_m is None else height_m)
    return (east_m, north_m), (east, north_m), (east, north), (east_m, north)


@pytest.fixture(scope="module")
def unmarked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_map(tmp_path_factory.mktemp("unmarked") / "map.gpkg", [drive(2)])


@pytest.fixture
def field(unmarked: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(unmarked, tmp_path / "map.gpkg"))


def add(path: Path, *marks: Mark) -> tuple[int, ...]:
    with open_map(path, writable=True) as universal:
        return universal.add_marks(marks)


def test_marks_are_kept_as_they_were_given_and_under_the_root_digest(field: Path) -> None:
    with open_map(field) as universal:
        before = universal.root_sha256
        assert universal.marks() == ()
    assert add(field, POND, GATE) == (1, 2)
    with open_map(field) as universal:
        pond, gate = universal.marks()
        assert universal.root_sha256 != before
        assert universal.verify(deep=True).sound
    assert pond._replace(created="", id=0) == POND
    assert (gate.id, gate.name, gate.author, gate.is_point) == (2, "gate", "Bob", True)
    assert len(pond.created) == len("2026-06-03T12:00:00.000Z")


def test_holes_are_kept(field: Path, tmp_path: Path) -> None:
    add(field, FENCED, POND)
    with open_map(field) as universal:
        fenced, pond = universal.marks()
        assert universal.verify(deep=True).sound
    assert fenced._replace(created="", id=0) == FENCED
    assert pond.holes == ()
    _, _, shapes, _ = read_layer(field, layer="mark")
    assert shapely.from_wkb(shapes[0]).equals(FENCED.geometry)
    assert shapely.from_wkb(shapes[0]).area == 64.0 - 0.75 - 0.5
    other = write_map(tmp_path / "other.gpkg", [drive(2, heading_deg=10.0)])
    add(other, fenced, fenced._replace(holes=fenced.holes[:1]))
    merge_maps([field, other], tmp_path / "both.gpkg")
    with open_map(tmp_path / "both.gpkg") as merged:
        assert [len(mark.holes) for mark in merged.marks()] == [2, 0, 1]


def test_what_was_removed_is_kept_and_restored_exactly(field: Path) -> None:
    add(field, POND, GATE)
    with open_map(field, writable=True) as universal:
        marks, root = universal.marks(), universal.root_sha256
        universal.remove_marks([1])
        assert [mark.id for mark in universal.marks()] == [2]
        removed, _ = universal.marks(removed=True)
        assert not removed.active
        assert removed._replace(removed=None) == marks[0]
        assert universal.verify(deep=True).sound
        with pytest.raises(ConfigError, match=r"Mark 1 of .* is removed already"):
            universal.remove_marks([2, 1])
        assert [mark.id for mark in universal.marks()] == [2]  # all or none
        universal.restore_marks([1])
        assert (universal.marks(), universal.root_sha256) == (marks, root)
        with pytest.raises(ConfigError, match="has no mark 7; `fieldgrid mark"):
            universal.restore_marks([7])


def test_a_failed_addition_leaves_the_map_as_it_was(field: Path) -> None:
    add(field, GATE)
    before = field.read_bytes()
    with (
        pytest.raises(ConfigError, match="crosses itself"),
        open_map(field, writable=True) as universal,
    ):
        universal.add_marks([POND, POND._replace(corners=((0, 0), (1, 1), (1, 0), (0, 1)))])
    assert field.read_bytes() == before


def test_a_map_that_never_had_a_mark_has_no_table_for_them(field: Path) -> None:
    """So maps of before marks are read, verified and changed as they are."""
    with closing(sqlite3.connect(field)) as database:
        assert not database.execute(
            "SELECT 1 FROM sqlite_schema WHERE name LIKE '%mark%'"
        ).fetchall()
    with open_map(field, writable=True) as universal:
        universal.repair()
        assert universal.verify(deep=True).sound


def test_a_map_of_format_2_is_upgraded_by_its_first_mark(tmp_path: Path) -> None:
    old = Path(shutil.copy(Path(__file__).with_name("format2.gpkg"), tmp_path / "old.gpkg"))
    with open_map(old) as universal:
        assert universal.marks() == ()
    add(old, POND)
    with open_map(old) as universal:
        assert [mark.name for mark in universal.marks()] == ["pond"]
        assert universal.verify(deep=True).sound


def test_marks_of_several_maps_go_along_once(field: Path, tmp_path: Path) -> None:
    add(field, POND, GATE)
    other = write_map(tmp_path / "other.gpkg", [drive(2, heading_deg=10.0)])
    with open_map(field, writable=True) as universal:
        universal.remove_marks([2])
        (pond,) = universal.marks()
    add(other, pond, POND._replace(name="lake"))
    merge_maps([field, other], tmp_path / "both.gpkg")
    with open_map(tmp_path / "both.gpkg") as merged:
        assert [(mark.name, mark.id) for mark in merged.marks(removed=True)] == [
            ("pond", 1),
            ("lake", 2),
        ]
        assert merged.marks()[0].created == pond.created
        assert merged.verify(deep=True).sound


def test_repair_keeps_marks_and_lists_them_again(field: Path) -> None:
    add(field, POND)
    with closing(sqlite3.connect(field)) as database, database:
        database.execute("DELETE FROM gpkg_geometry_columns WHERE table_name = 'mark'")
    with open_map(field, writable=True) as universal:
        marks = universal.marks()
        assert "The layer mark is not listed" in universal.verify(deep=True).problems[0]
        universal.repair()
        assert universal.verify(deep=True).sound
        assert universal.marks() == marks


def test_a_gis_sees_those_in_force(field: Path) -> None:
    add(field, POND, GATE)
    with open_map(field, writable=True) as universal:
        universal.remove_marks([2])
    assert ["mark", "Unknown"] in list_layers(field).tolist()
    meta, _, _, columns = read_layer(field, layer="mark")
    found = dict(zip(meta["fields"], (values.tolist() for values in columns), strict=True))
    assert (found["kind"], found["name"], found["author"]) == (["keepout"], ["pond"], ["Ana"])


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE fieldgrid_mark SET name = 'lake'",
        "UPDATE fieldgrid_mark SET removed = '2026-01-01T00:00:00.000Z'",
        "DELETE FROM fieldgrid_mark WHERE id = 2",
        "DROP VIEW mark",
        "DROP VIEW mark; DROP TABLE fieldgrid_mark",
        "UPDATE fieldgrid_mark SET geom = X'00' WHERE id = 1",
    ],
)
def test_marks_that_were_tampered_with_are_found(field: Path, damage: str) -> None:
    add(field, POND, GATE)
    with closing(sqlite3.connect(field)) as database:
        database.executescript(damage)
    with open_map(field) as universal:
        assert not universal.verify(deep=True).sound


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("kind", "'lake'"),
        ("geom", "X'4750'"),
        ("geom", "'no blob'"),
        ("geom", "zeroblob(2000000)"),
        ("created", "'yesterday'"),
        ("name", "X'41'"),
    ],
)
def test_a_damaged_mark_is_told_in_a_sentence(field: Path, column: str, value: str) -> None:
    add(field, POND)
    with closing(sqlite3.connect(field)) as database, database:
        database.execute(f"UPDATE fieldgrid_mark SET {column} = {value}")
    with open_map(field) as universal:
        with pytest.raises(MapError, match=r"Mark 1 of the map is damaged: .*\. Restore a copy\."):
            universal.marks()
        assert not universal.verify(deep=True).sound


@pytest.mark.parametrize(
    ("mark", "message"),
    [
        (POND._replace(corners=POND.corners[:2]), "of 2 corners is neither a point nor a polygon"),
        (POND._replace(corners=((0, 0), (1, 0), (2, 0))), "encloses nothing"),
        (POND._replace(holes=(((1.5, 0.1), (1.6, 0.1)),)), "encloses nothing"),
        (POND._replace(holes=(((0.0, 0.0), (3.0, 0.0), (3.0, 3.0)),)), "crosses itself or another"),
        (FENCED._replace(holes=(tuple((k * 1e-3, k % 2) for k in range(MAX_CORNERS)),)), "2004"),
        (GATE._replace(holes=(POND.corners,)), "4 corners"),
        (POND._replace(corners=((0.0, 0.0), (1.0, math.nan), (2.0, 2.0))), "is nowhere"),
        (POND._replace(corners=((0.0, 60_000.0),)), "km from the map's datum"),
        (POND._replace(corners=tuple((k * 1e-3, k % 2) for k in range(MAX_CORNERS + 1))), "2001"),
        (POND._replace(name="a\nb"), "not printable"),
        (POND._replace(note="x" * 501), "up to 500"),
        (GATE._replace(name=""), "no name"),
    ],
)
def test_what_cannot_be_marked_is_refused(field: Path, mark: Mark, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        add(field, mark)


def test_geojson_of_marks_is_read_back_to_a_tenth_of_a_millimetre() -> None:
    marks = [POND, GATE, FENCED]
    document = json.loads(json.dumps(geojson(features(marks), DATUM)))
    again = marks_of_geojson(document, DATUM, {})
    for mark, read in zip(marks, again, strict=True):
        assert read[2:5] == mark[2:5]
        for hole, back in zip(mark.holes, read.holes, strict=True):
            np.testing.assert_allclose(sorted(back), sorted(hole), atol=2e-4)
        np.testing.assert_allclose(sorted(read.corners), sorted(mark.corners), atol=2e-4)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"type": "FeatureCollection", "features": []}, "no feature"),
        ({"type": "Feature", "geometry": None}, "no GeoJSON of points and polygons"),
        ({"type": "LineString", "coordinates": [[0, 0], [1, 1]]}, "has a LineString"),
        ({"type": "Point", "coordinates": [500_000, 4_000_000]}, r"EPSG:4326"),
        ({"type": "Point", "coordinates": [0, 0]}, "km from the map's datum"),
        ({"type": "Polygon", "coordinates": []}, "no GeoJSON of points and polygons"),
        ("text", "no GeoJSON"),
        ({"type": "Point", "coordinates": "ab"}, "no GeoJSON"),
    ],
)
def test_geojson_that_cannot_be_marks_is_refused(document: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        marks_of_geojson(document, DATUM, {"kind": "free"})


def test_a_kind_is_needed() -> None:
    with pytest.raises(ConfigError, match=r"has 'no kind' as its kind; give one of keepout, free"):
        marks_of_geojson({"type": "Point", "coordinates": [-1.2, 39.4]}, DATUM, {})


def test_the_density_stays_what_the_drives_saw(field: Path) -> None:
    with open_map(field) as universal:
        before = universal.read(layers=("peak", "seen_share"), cell_m=4 * CELL_M)
    add(field, POND, Mark(MarkKind.OBSTACLE, square(-9.0, 3.0, 4.0)), GATE)
    with open_map(field) as universal:
        after = universal.read(layers=("peak", "seen_share"), cell_m=4 * CELL_M, decide="density")
    for name in ("density", "observed", "peak", "seen_share"):
        np.testing.assert_array_equal(before.layer(name), after.layer(name))
    assert len(after.marks) == 3
    assert (after.decision().worst != before.peak).any()
