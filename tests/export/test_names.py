"""Names of files with control characters and markup: what is exported can be read all the same."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
import shapely

from fieldgrid.core import ConfigError
from fieldgrid.export import export_map
from fieldgrid.geometry import Feature, write_features
from fieldgrid.maps import MapFile, create_map, open_map
from tests.maps.file.maps import CELL_M, DATUM, drive, track

NAME = "n\x1b[31m\n<b>&]]>\ufffe"


@pytest.fixture
def named_badly(tmp_path: Path) -> MapFile:
    path = tmp_path / f"{NAME}.gpkg"
    with (
        create_map(path, DATUM, cell_m=CELL_M) as universal,
        universal.add_session("</script>&<b>]]>", trajectory=track(), source=NAME) as session,
    ):
        for grid, pose in drive(3):
            session.add(grid, pose)
    return open_map(path)


def test_archives_hold_xml_that_can_be_read(named_badly: MapFile, tmp_path: Path) -> None:
    for name in ("a.kmz", "taskdata.zip"):
        export_map(named_badly, tmp_path / name)
        with zipfile.ZipFile(tmp_path / name) as archive:
            for member in archive.namelist():
                if member.lower().endswith((".kml", ".xml")):
                    text = archive.read(member)
                    assert ElementTree.fromstring(text) is not None
                    assert b"\x1b" not in text


def test_geojson_says_nothing_that_moves_a_cursor(named_badly: MapFile, tmp_path: Path) -> None:
    export_map(named_badly, tmp_path / "a.geojson")
    data = (tmp_path / "a.geojson").read_bytes()
    assert json.loads(data)["type"] == "FeatureCollection"
    assert b"\x1b" not in data


def test_a_project_cannot_name_such_a_map(named_badly: MapFile, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot name '.*x1b\[31m.*'; rename the map"):
        export_map(named_badly, tmp_path / "a.qgz")
    assert not (tmp_path / "a.qgz").exists()


def test_features_of_such_names_are_kml(tmp_path: Path) -> None:
    path = tmp_path / f"{NAME}.kml"
    write_features(path, [Feature("row", shapely.Point(1, 2), {"name": NAME, "note": NAME})], DATUM)
    root = ElementTree.parse(path).getroot()
    assert "n\\x1b[31m\\n<b>&]]>\\ufffe" in {element.text for element in root.iter()}
