"""How QGIS shows a map, and the times by which a GIS sorts its features."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from fieldgrid.core import palette
from fieldgrid.maps import Mark, MarkKind, open_map
from fieldgrid.maps.vector import qgis
from tests.maps.file.maps import drive, track, write_map, write_session

LAYERS = ("density", "trajectory", "frame_position", "footprint")


def ask(path: Path, sql: str, *values: Any) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(sql, values).fetchall()


def rules(path: Path, layer: str) -> dict[str, str]:
    """The label and the filter of each rule by which QGIS draws a layer."""
    ((document,),) = ask(
        path,
        "SELECT styleQML FROM layer_styles WHERE f_table_name = ? AND owner = 'fieldgrid'",
        layer,
    )
    found = ET.fromstring(document).iter("rule")
    return {rule.get("label", ""): rule.get("filter", "") for rule in found}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_map(tmp_path / "map.gpkg", [drive(2), drive(1)], trajectory=track(4))


def test_every_layer_has_a_default_style(path: Path) -> None:
    found = ask(path, "SELECT f_table_name, f_geometry_column, useAsDefault FROM layer_styles")
    assert sorted(found) == sorted(
        (name, "" if name == "density" else "geom", 1) for name in LAYERS
    )
    ((document,),) = ask(path, "SELECT styleQML FROM layer_styles WHERE f_table_name = 'density'")
    items = [
        (item.get("value"), item.get("color")) for item in ET.fromstring(document).iter("item")
    ]
    # Up to 100 in the colours of free ground, from 101 in those of an obstacle.
    assert items[2:4] == [
        ("100", palette.DENSITY[2].colour),
        ("101", palette.DENSITY[3].colour),
    ]


def test_marks_have_a_default_style(path: Path) -> None:
    square = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    with open_map(path, writable=True) as universal:
        universal.add_marks(
            [Mark(MarkKind.KEEPOUT, square), Mark(MarkKind.PLACE, ((5.0, 5.0),), "gate")]
        )
        assert universal.verify(deep=True).sound
    asked = (
        "SELECT f_geometry_column, useAsDefault, styleQML FROM layer_styles "
        "WHERE f_table_name = 'mark'"
    )
    ((geometry, is_default, document),) = ask(path, asked)
    assert (geometry, is_default) == ("geom", 1)
    filters = [rule.get("filter", "") for rule in ET.fromstring(document).iter("rule")]
    for kind in MarkKind:
        for shape in ("Polygon", "Point"):
            assert f"\"kind\" = '{kind}' AND geometry_type($geometry) = '{shape}'" in filters
    # One that a user has saved stays, also where marks are announced again.
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE layer_styles SET styleQML = 'mine' WHERE f_table_name = 'mark'")
    with open_map(path, writable=True) as universal:
        universal.repair()
    assert ask(path, asked) == [("geom", 1, "mine")]


def test_sessions_have_their_colours_until_they_are_removed(path: Path) -> None:
    first, second = "\"session\" IN ('0')", "\"session\" IN ('1')"
    assert [f.partition(" AND")[0] for f in rules(path, "trajectory").values()][:2] == [
        first,
        second,
    ]
    with open_map(path, writable=True) as universal:
        universal.remove_session("0")
    assert not any(first in text for text in rules(path, "footprint").values())
    assert any(second in text for text in rules(path, "footprint").values())
    with open_map(path, writable=True) as universal:
        write_session(universal, 'it\'s "june"', drive(1))
    assert any("'it\\'s \"june\"'" in text for text in rules(path, "trajectory").values())


def test_many_sessions_share_eight_colours(path: Path) -> None:
    with open_map(path, writable=True) as universal:
        for k in range(2, 18):
            write_session(universal, str(k), [])
    found = rules(path, "trajectory")
    assert len(found) == len(palette.SESSIONS) + 2  # and the rejected, and others
    assert "\"session\" IN ('0', '8', '16')" in found["0, 8, 16"]


def test_documents_without_names_filled_in_are_those_of_an_xml_library() -> None:
    names = ["a & <b>", 'it\'s "june"', "c\\d", "ä" * 90, *map(str, range(9)), "\n"]
    sessions = [(name, palette.session_colour(k)) for k, name in enumerate(names)]
    for layer in qgis.LAYERS:
        for some in (sessions[:0], sessions[:3], sessions):
            root = ET.Element("qgis", version=qgis.VERSION)
            root.set("styleCategories", "Symbology|Rendering|Temporal")
            qgis.fill_style(root, layer, some)
            ET.indent(root)
            _, _, document = qgis.style(layer, some).partition("\n")
            assert document == ET.tostring(root, encoding="unicode")


def test_a_style_that_a_user_saved_stays_the_default(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DELETE FROM layer_styles WHERE f_table_name = 'footprint'")
        connection.execute(
            "INSERT INTO layer_styles (f_table_name, styleName, styleQML, useAsDefault, owner) "
            "VALUES ('footprint', 'mine', '<qgis/>', 1, '')"
        )
    with open_map(path, writable=True) as universal:
        universal.remove_session("0")
    found = ask(
        path,
        "SELECT styleName, styleQML = '<qgis/>', useAsDefault FROM layer_styles "
        "WHERE f_table_name = 'footprint'",
    )
    assert sorted(found) == [("fieldgrid", 0, 0), ("mine", 1, 1)]


def test_features_have_the_time_as_a_gis_reads_it(path: Path) -> None:
    for layer in ("trajectory", "frame_position", "footprint"):
        rows = ask(path, f"SELECT time_ns, time FROM {layer}")
        assert rows
        for time_ns, text in rows:
            moment = np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64)
            assert text.endswith("Z")
            assert 0 <= time_ns - moment < 1_000_000
        kinds = {name: kind for _, name, kind, *_ in ask(path, f"PRAGMA table_info({layer})")}
        assert kinds["time"] == "DATETIME"


def test_repair_gives_tables_of_features_their_columns(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("ALTER TABLE trajectory DROP COLUMN time")
    with open_map(path, writable=True) as universal:
        universal.repair()
        assert universal.verify(deep=True).sound


def test_verify_and_repair_know_the_time(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE footprint SET time = '2001-01-01T00:00:00.000Z'")
    with open_map(path) as universal:
        assert not universal.verify(deep=True).sound
    with open_map(path, writable=True) as universal:
        universal.repair()
        assert universal.verify(deep=True).sound
