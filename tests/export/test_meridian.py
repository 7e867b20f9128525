"""Exports of a field on Taveuni, where longitudes begin anew in its middle."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely

from fieldgrid.core import ConfigError
from fieldgrid.export import Selection, export_map
from fieldgrid.export.shapes.taskdata import zone_grid
from fieldgrid.field.rows.formats.agopengps import FieldPlane
from fieldgrid.geometry import Bounds, Datum
from fieldgrid.maps import MapFile, open_map
from tests.maps.file import maps
from tests.maps.file.maps import drive, write_map

DATUM = Datum(-16.8, 179.99998, 50.0)
"""The meridian of 180° is 2.1 m to the east."""


@pytest.fixture
def universal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(maps, "DATUM", DATUM)
    with open_map(write_map(tmp_path / "map.gpkg", [drive(12, step_m=2.0)])) as universal:
        yield universal


def test_no_shape_spans_the_world(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "map.geojson")
    document = json.loads((tmp_path / "map.geojson").read_text())
    shapes = [shapely.geometry.shape(one["geometry"]) for one in document["features"]]
    parts = [part for shape in shapes for part in shapely.get_parts(shape)]
    assert max(part.bounds[2] - part.bounds[0] for part in parts) < 0.001
    sides = [{bool(part.bounds[0] > 0.0) for part in shapely.get_parts(one)} for one in shapes]
    assert {True, False} in sides


def test_nor_does_an_overlay_or_a_line(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "map.kmz")
    with zipfile.ZipFile(tmp_path / "map.kmz") as kmz:
        text = kmz.read("doc.kml").decode()
    found = re.findall(r"<coordinates>([^<]*)</coordinates>", text)
    lons = [np.array([float(place.split(",")[0]) for place in one.split()]) for one in found]
    assert len(lons) >= 2
    assert max(np.ptp(one) for one in lons) < 0.001


def test_zones_are_as_many_as_elsewhere(universal: MapFile) -> None:
    view = universal.read()
    grid = zone_grid(view)
    assert grid.zones.shape[1] < view.observed.shape[1] + 5
    assert -180.0 <= grid.west_deg <= 180.0


@pytest.mark.parametrize("epsg", [3857, 4326])
def test_a_system_that_ends_there_is_refused_with_a_way_out(
    epsg: int, universal: MapFile, tmp_path: Path
) -> None:
    """Pixels around the world took hours."""
    with pytest.raises(ConfigError, match=rf"both sides of where EPSG:{epsg} .*by --bounds"):
        export_map(universal, tmp_path / "map.tif", options={"epsg": epsg})
    export_map(universal, tmp_path / "utm.tif", options={"epsg": 32760})
    with rasterio.open(tmp_path / "utm.tif") as dataset:
        assert dataset.width < 2 * universal.read().observed.shape[1]


def test_web_tiles_are_of_one_side(universal: MapFile, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"both sides of the meridian of 180°.*by --bounds"):
        export_map(universal, tmp_path / "map.mbtiles")
    west, south, _, north = universal.bounds
    part = Selection(bounds=Bounds(west, south, 0.0, north))
    export_map(universal, tmp_path / "west.mbtiles", part)
    assert (tmp_path / "west.mbtiles").stat().st_size > 1000


def test_the_plane_of_a_field_goes_on() -> None:
    east_m = np.array([[-20.0, 0.0], [0.0, 0.0], [20.0, 0.0]])
    found = FieldPlane(DATUM.lat_deg, DATUM.lon_deg).metres(east_m, DATUM)
    np.testing.assert_allclose(found, east_m, atol=0.01)
