"""Layers that are kept in a map: features beside the evidence, under a digest of their own."""

from __future__ import annotations

import math
import sqlite3
from contextlib import closing
from pathlib import Path

import pyogrio
import pytest
import shapely

from fieldgrid.core import ConfigError, MapError
from fieldgrid.geometry import Feature
from fieldgrid.maps import open_map
from tests.field.rows.fields import straight, view_of, write_map

HOLED = shapely.Polygon([(0, 0), (9, 0), (9, 5), (0, 5)], [[(1, 1), (1, 2), (2, 2), (2, 1)]])
FOUND = [
    Feature("headland", HOLED, {"id": "H1", "area_m2": 44.0}),
    Feature(
        "lane",
        shapely.LineString([(1.0, 2.0), (3.5, 40.25)]),
        {
            "id": "B1-L1", "rows": ("B1-R1", "B1-R2"), "driven": True, "cells": 12,
            "free_width_m": math.nan, "known": 0.5,
        },
    ),
]  # fmt: skip


@pytest.fixture
def field(tmp_path: Path) -> Path:
    return write_map(tmp_path / "field.gpkg", view_of(straight(2, 12.0)))


def test_what_is_kept_is_read_back_and_leaves_the_map_sound(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        root = universal.root_sha256
        assert universal.kept_features() is None
        universal.keep_features(FOUND, root)
    with open_map(field) as universal:
        kept = universal.kept_features()
        assert kept is not None
        assert kept.root_sha256 == root == universal.root_sha256
        assert universal.verify(deep=True).sound
    headland, lane = kept.features
    assert headland == FOUND[0]
    assert lane.geometry == FOUND[1].geometry
    told = {**FOUND[1].properties, "rows": "B1-R1 B1-R2", "free_width_m": None}
    assert lane.properties == told


def test_a_gis_reads_the_layers_in_the_plane_of_the_map(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
    layers = dict(pyogrio.list_layers(field).tolist())
    assert (layers["found_headland"], layers["found_lane"]) == ("Polygon", "LineString")
    about = pyogrio.read_info(field, layer="found_lane")
    assert about["crs"] == pyogrio.read_info(field, layer="footprint")["crs"]
    assert tuple(about["total_bounds"]) == (1.0, 2.0, 3.5, 40.25)
    _, _, geometry, values = pyogrio.raw.read(field, layer="found_lane", read_geometry=True)
    assert shapely.from_wkb(geometry[0]) == FOUND[1].geometry
    told = dict(zip(pyogrio.read_info(field, layer="found_lane")["fields"], values, strict=True))
    assert (told["cells"][0], told["driven"][0], told["known"][0]) == (12, 1, 0.5)


def test_what_was_kept_before_goes(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        root = universal.root_sha256
        universal.keep_features(FOUND, root)
        universal.keep_features(FOUND[:1], root)
        kept = universal.kept_features()
        assert kept is not None
        assert [one.kind for one in kept.features] == ["headland"]
        universal.keep_features([], root)
        assert universal.kept_features() is None
    assert not {"found_lane", "found_headland"} & set(pyogrio.list_layers(field)[:, 0])


def test_what_was_found_in_another_state_is_not_kept(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        root = universal.root_sha256
        universal.rename_session("june-03", "june-04")
        with pytest.raises(ConfigError, match="has changed since"):
            universal.keep_features(FOUND, root)
        assert universal.kept_features() is None
        universal.keep_features(FOUND, universal.root_sha256)
        universal.rename_session("june-04", "june-05")
        kept = universal.kept_features()
        assert kept is not None
        assert kept.root_sha256 != universal.root_sha256


def test_a_layer_of_somebody_else_stays(field: Path) -> None:
    with sqlite3.connect(field) as connection:
        connection.execute("CREATE TABLE found_lane (fid INTEGER PRIMARY KEY, geom BLOB)")
    connection.close()
    with open_map(field, writable=True) as universal, pytest.raises(MapError, match="found_lane"):
        universal.keep_features(FOUND, universal.root_sha256)
    with open_map(field) as universal:
        assert universal.kept_features() is None


def test_layers_that_are_found_again_are_counted_again(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
    with closing(sqlite3.connect(field, isolation_level=None)) as database:  # as GDAL does
        database.execute("CREATE TABLE gpkg_ogr_contents (table_name TEXT, feature_count INTEGER)")
        database.execute(
            "INSERT INTO gpkg_ogr_contents SELECT 'found_lane', count(*) FROM found_lane"
        )
    with open_map(field, writable=True) as universal:
        assert universal.verify(1).sound
        universal.keep_features([*FOUND, *FOUND], universal.root_sha256)
        assert universal.verify(1).sound


def test_a_damaged_layer_says_so(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
    with sqlite3.connect(field) as connection:
        connection.execute("UPDATE found_lane SET geom = substr(geom, 1, 12)")
    connection.close()
    with open_map(field) as universal, pytest.raises(MapError, match=r"found_lane .*damaged"):
        universal.kept_features()


def test_no_other_table_is_dropped_whatever_a_map_says_of_it(field: Path) -> None:
    """As in a map that somebody made for this."""
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
        before = [frame.frame_id for frame in universal.frames(universal.sessions()[0].name)]
    connection = sqlite3.connect(field)
    connection.execute(
        "UPDATE gpkg_contents SET description = (SELECT description FROM gpkg_contents WHERE "
        "table_name = 'found_lane') WHERE table_name = 'footprint'"
    )
    connection.commit()
    connection.close()
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND[:1], universal.root_sha256)
        kept = universal.kept_features()
        assert kept is not None
        assert [one.kind for one in kept.features] == ["headland"]
        assert [f.frame_id for f in universal.frames(universal.sessions()[0].name)] == before
    assert "footprint" in dict(pyogrio.list_layers(field).tolist())


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE found_lane SET geom = (SELECT geom FROM found_headland)",
        "UPDATE found_lane SET cells = 13",
        "DELETE FROM found_lane",
        "DROP TABLE found_lane",
        "ALTER TABLE found_lane ADD COLUMN more",
        "UPDATE gpkg_contents SET srs_id = 4326 WHERE table_name = 'found_lane'",
        "UPDATE gpkg_contents SET max_x = 9 WHERE table_name = 'found_lane'",
        "UPDATE gpkg_contents SET description = 'f' || description WHERE table_name = 'found_lane'",
        "UPDATE gpkg_geometry_columns SET srs_id = 4326 WHERE table_name = 'found_lane'",
        "UPDATE fieldgrid_meta SET value = 'ab' WHERE key = 'found_sha256'",
        "UPDATE fieldgrid_meta SET key = 'found_sha255' WHERE key = 'found_sha256'",
        "CREATE TRIGGER t AFTER INSERT ON found_lane BEGIN DELETE FROM fieldgrid_frame; END",
    ],
)
def test_layers_that_are_not_as_they_were_stored_are_found(field: Path, change: str) -> None:
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
    with closing(sqlite3.connect(field, isolation_level=None)) as database:
        database.execute(change)
    with open_map(field) as universal:
        for deep in (False, True):
            assert not universal.verify(deep=deep).sound


def test_what_is_found_again_takes_the_place_of_damaged_layers(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
    with closing(sqlite3.connect(field, isolation_level=None)) as database:
        database.execute("UPDATE found_lane SET cells = 13")
    with open_map(field, writable=True) as universal:
        (problem,) = universal.repair()
        assert "found_headland, found_lane" in problem
        assert "rows --keep" in problem
        assert universal.verify().problems == (problem,)
        universal.keep_features(FOUND, universal.root_sha256)
        health = universal.verify()
        assert (health.sound, health.deep) == (True, False)
        universal.keep_features([], universal.root_sha256)
        assert universal.verify().sound


def test_an_index_that_a_gis_adds_to_a_layer_is_no_damage(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
    with closing(sqlite3.connect(field, isolation_level=None)) as database:
        database.execute("CREATE INDEX lanes ON found_lane (id)")
    with open_map(field) as universal:
        assert universal.verify().sound


@pytest.mark.parametrize("has_digest", [True, False])
def test_a_view_in_place_of_a_layer_is_told_of_and_not_read(field: Path, has_digest: bool) -> None:
    """Its rows have no end."""
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
    with closing(sqlite3.connect(field, isolation_level=None)) as database:
        database.execute("DROP TABLE found_lane")
        database.execute(
            "CREATE VIEW Found_Lane AS WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 "
            "FROM r) SELECT x AS fid, NULL AS geom FROM r"
        )
        if not has_digest:
            database.execute("DELETE FROM fieldgrid_meta WHERE key = 'found_sha256'")
    with open_map(field, writable=True) as universal:
        for deep in (False, True):
            assert "found_lane" in universal.verify(deep=deep).problems[0]
        with pytest.raises(MapError, match="no table"):
            universal.kept_features()
        universal.keep_features(FOUND, universal.root_sha256)
        assert universal.verify().sound


def test_layers_that_are_gone_can_be_found_again(field: Path) -> None:
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
    with closing(sqlite3.connect(field, isolation_level=None)) as database:
        database.execute("DROP TABLE found_lane")
    with open_map(field, writable=True) as universal:
        universal.keep_features(FOUND, universal.root_sha256)
        assert universal.verify().sound
