"""The map as QGIS's own library reads it: where Debian's python3-qgis is installed."""

from __future__ import annotations

import json
import os
import subprocess
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.maps.file.maps import DATUM, one_cell, track, write_map

PYTHON = "/usr/bin/python3"
CELLS = ((12.35, -45.65, 173), (-830.25, 410.75, 9), (1500.05, 2200.05, 0))

PROGRAM = """
import json, os, sys
from qgis.core import (
    QgsApplication, QgsCoordinateReferenceSystem, QgsCoordinateTransform, QgsPointXY,
    QgsProject, QgsRaster, QgsRasterLayer, QgsVectorLayer,
)
application = QgsApplication([], False)
application.initQgis()
path, points = sys.argv[1], json.loads(sys.argv[2])
raster = QgsRasterLayer(path, "density", "gdal")
wgs84 = QgsCoordinateReferenceSystem("EPSG:4326")
result = {"raster": raster.isValid(), "layers": {}, "cells": [], "corners": []}
to_map = QgsCoordinateTransform(wgs84, raster.crs(), QgsProject.instance())
for lat, lon in points:
    place = to_map.transform(QgsPointXY(lon, lat))
    found = raster.dataProvider().identify(place, QgsRaster.IdentifyFormatValue).results()
    result["cells"].append([place.x(), place.y(), found.get(1), found.get(4)])
for name in ("trajectory", "frame_position", "footprint"):
    layer = QgsVectorLayer(f"{path}|layername={name}", name, "ogr")
    to_layer = QgsCoordinateTransform(layer.crs(), wgs84, QgsProject.instance())
    rows = []
    for feature in layer.getFeatures():
        vertices = [[v.x(), v.y()] for v in feature.geometry().vertices()]
        centre = to_layer.transform(QgsPointXY(*vertices[0])) if vertices else None
        rows.append([vertices, [centre.y(), centre.x()] if centre else None])
    result["layers"][name] = {"valid": layer.isValid(), "rows": rows}
print(json.dumps(result))
sys.stdout.flush()
os._exit(0)  # QGIS may crash when it is taken down in the wrong order
"""


@lru_cache
def is_there() -> bool:
    """Whether the system's Python has QGIS."""
    if not Path(PYTHON).exists():
        return False
    return subprocess.run([PYTHON, "-c", "import qgis.core"], capture_output=True).returncode == 0


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What QGIS finds in a map of three single cells."""
    if not is_there():
        pytest.skip("QGIS's library (Debian's python3-qgis) is not installed")
    folder = tmp_path_factory.mktemp("qgis")
    path = write_map(
        folder / "map.gpkg", [[one_cell(*cell) for cell in CELLS]], trajectory=track(7)
    )
    points = [DATUM.to_geodetic(east, north, 0.0)[:2] for east, north, _ in CELLS]
    places = json.dumps([[float(lat), float(lon)] for lat, lon in points])
    done = subprocess.run(
        [PYTHON, "-c", PROGRAM, str(path), places],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={
            "PATH": os.environ["PATH"],
            "HOME": str(folder),
            "QT_QPA_PLATFORM": "offscreen",
            "XDG_RUNTIME_DIR": str(folder),
        },
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def test_qgis_finds_the_density_by_latitude_and_longitude(seen: dict[str, Any]) -> None:
    assert seen["raster"]
    for (east, north, density), found in zip(CELLS, seen["cells"], strict=True):
        assert found[:2] == pytest.approx((east, north), abs=0.01)
        assert found[2:] == [density, 255]


def test_qgis_finds_the_trajectory_within_a_centimetre(seen: dict[str, Any]) -> None:
    layer = seen["layers"]["trajectory"]
    assert layer["valid"]
    expected = track(7)
    assert len(layer["rows"]) == 7
    for k, (vertices, (lat, lon)) in enumerate(layer["rows"]):
        place = (expected.east_m[k], expected.north_m[k])
        assert vertices[0] == pytest.approx(place, abs=1e-9)
        east, north, _ = DATUM.to_enu(lat, lon, DATUM.height_m)
        assert (float(east), float(north)) == pytest.approx(place, abs=0.01)


def test_qgis_finds_the_frames_and_their_footprints(seen: dict[str, Any]) -> None:
    layers = seen["layers"]
    assert layers["frame_position"]["valid"]
    assert layers["footprint"]["valid"]
    for (vertices, _), (position, _) in zip(
        layers["footprint"]["rows"], layers["frame_position"]["rows"], strict=True
    ):
        corners = np.array(vertices)
        np.testing.assert_array_equal(corners[0], corners[-1])
        # The vehicle stands in the middle of the near side of what it looks at.
        np.testing.assert_allclose(corners[:2].mean(axis=0), position[0], atol=1e-9)
        np.testing.assert_allclose(np.ptp(corners[:4], axis=0), (6.0, 4.0), atol=1e-9)
