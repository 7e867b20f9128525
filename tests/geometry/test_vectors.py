"""Features in files, read back by readers that are not the writer."""

from __future__ import annotations

import csv
import json
import sqlite3
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pyproj
import pytest
import shapely

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.geometry import Datum, Feature, write_features

DATUM = Datum(41.65, -4.72, 787.4)
LINE = shapely.LineString([(1.0, 2.0), (4.0, 10.0), (5.0, 30.0)])
AREA = shapely.Polygon(
    [(0.0, 0.0), (40.0, 0.0), (40.0, 25.0), (0.0, 20.0)],
    [[(10.0, 5.0), (10.0, 9.0), (15.0, 9.0), (12.0, 5.0)]],
)
FEATURES = [
    Feature("block", AREA, {"id": "B1", "rows": 2, "spacing_m": float("nan")}),
    Feature("row", LINE, {"id": "R1 <&>", "sigma_m": 0.0421, "sessions": ("a", "b")}),
    Feature("lane", LINE, {"id": "L1", "driven": True, "free_width_m": 1.85}),
    Feature("lane", LINE, {"id": "L2", "driven": False, "free_width_m": float("nan")}),
]
TOPOCENTRIC = pyproj.Transformer.from_pipeline(
    "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
    f"+step +proj=topocentric +ellps=WGS84 +lon_0={DATUM.lon_deg} +lat_0={DATUM.lat_deg} "
    f"+h_0={DATUM.height_m}"
)


def in_metres(degrees: np.ndarray) -> np.ndarray:
    """Longitudes and latitudes [n, 2] in the datum's plane, by PROJ alone."""
    east, north, _ = TOPOCENTRIC.transform(
        degrees[:, 0], degrees[:, 1], np.full(len(degrees), DATUM.height_m)
    )
    return np.column_stack([east, north])


def test_geojson_places_features_within_a_millimetre_and_winds_rings_as_the_rfc(
    tmp_path: Path,
) -> None:
    write_features(tmp_path / "a.geojson", FEATURES, DATUM)
    content = json.loads((tmp_path / "a.geojson").read_text())
    block, row, first, second = content["features"]
    for feature, true in ((block, AREA), (row, LINE)):
        shape = shapely.from_geojson(json.dumps(feature["geometry"]))
        metres = shapely.transform(shape, in_metres)
        assert metres.hausdorff_distance(true) < 0.001
        assert metres.symmetric_difference(true.buffer(0.0) if true is AREA else true).area < 0.05
    outer, inner = (shapely.LinearRing(ring) for ring in block["geometry"]["coordinates"])
    assert outer.is_ccw
    assert not inner.is_ccw
    assert block["properties"] == {"kind": "block", "id": "B1", "rows": 2, "spacing_m": None}
    assert row["properties"]["sessions"] == ["a", "b"]
    assert first["properties"]["driven"] is True
    assert second["properties"]["free_width_m"] is None
    assert content["datum"]["lat_deg"] == DATUM.lat_deg


def test_csv_has_a_column_a_property_and_the_shape_in_metres(tmp_path: Path) -> None:
    write_features(tmp_path / "a.csv", FEATURES, DATUM)
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["kind"] for r in rows] == ["block", "row", "lane", "lane"]
    assert rows[1]["sessions"] == "a b"
    assert rows[3]["free_width_m"] == ""
    assert shapely.from_wkt(rows[0]["wkt_m"]).equals_exact(AREA, 0.001)


def test_kml_has_a_folder_a_kind_and_keeps_holes(tmp_path: Path) -> None:
    write_features(tmp_path / "a.kml", FEATURES, DATUM)
    root = ElementTree.parse(tmp_path / "a.kml").getroot()
    name = {"k": "http://www.opengis.net/kml/2.2"}
    assert [f.text for f in root.findall(".//k:Folder/k:name", name)] == ["block", "row", "lane"]

    def ring(path: str) -> np.ndarray:
        text = root.find(path, name)
        assert text is not None
        assert text.text is not None
        return np.array([[float(v) for v in p.split(",")] for p in text.text.split()])

    hole = in_metres(ring(".//k:innerBoundaryIs/k:LinearRing/k:coordinates"))
    assert shapely.Polygon(hole).symmetric_difference(shapely.Polygon(AREA.interiors[0])).area < 0.1
    names = [p.text for p in root.findall(".//k:Placemark/k:name", name)]
    assert names == ["B1", "R1 <&>", "L1", "L2"]


def test_geopackage_has_a_table_a_kind_in_the_plane(tmp_path: Path) -> None:
    pytest.importorskip("pyogrio")
    write_features(tmp_path / "a.gpkg", FEATURES, DATUM)
    with sqlite3.connect(tmp_path / "a.gpkg") as base:
        tables = base.execute("SELECT table_name FROM gpkg_contents ORDER BY 1").fetchall()
        assert tables == [("block",), ("lane",), ("row",)]
        blob, spacing = base.execute("SELECT geom, spacing_m FROM block").fetchone()
        assert spacing is None
        assert base.execute("SELECT id, driven FROM lane ORDER BY id").fetchall() == [
            ("L1", 1), ("L2", 0)
        ]  # fmt: skip
        sizes = (0, 32, 48, 48, 64)
        shape = shapely.from_wkb(blob[8 + sizes[blob[3] >> 1 & 7] :])
        assert shape.equals_exact(AREA, 1e-6)
        wkt = base.execute(
            "SELECT definition FROM gpkg_spatial_ref_sys JOIN gpkg_geometry_columns USING (srs_id)"
        ).fetchone()[0]
    plane = pyproj.Transformer.from_crs("EPSG:4326", wkt, always_xy=True)
    assert np.allclose(plane.transform(DATUM.lon_deg, DATUM.lat_deg), 0.0, atol=1e-6)
    base.close()


def test_dxf_has_a_layer_a_kind_and_metres(tmp_path: Path) -> None:
    pytest.importorskip("pyogrio")
    write_features(tmp_path / "a.dxf", FEATURES, DATUM)
    lines = (tmp_path / "a.dxf").read_text().splitlines()
    pairs = list(zip((line.strip() for line in lines[::2]), lines[1::2], strict=True))
    entities = pairs[pairs.index(("2", "ENTITIES")) :]
    assert {v for code, v in entities if code == "8"} == {"block", "row", "lane"}
    east = [float(v) for code, v in entities if code == "10"]
    assert min(east) == pytest.approx(0.0, abs=1e-6)
    assert max(east) == pytest.approx(40.0, abs=1e-6)


def test_a_file_is_replaced_only_when_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    path.write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(MapExistsError):
            write_features(path, FEATURES, DATUM, overwrite=overwrite)
        assert path.read_text() == "mine"
    path.unlink()
    write_features(path, FEATURES[:1], DATUM)
    with pytest.raises(MapExistsError):
        write_features(path, FEATURES, DATUM)
    write_features(path, FEATURES, DATUM, overwrite=True)
    assert json.loads(path.read_text())["type"] == "FeatureCollection"


def test_an_unknown_ending_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"ends in none of \.geojson"):
        write_features(tmp_path / "a.shp", FEATURES, DATUM)
    assert not list(tmp_path.iterdir())


def test_nothing_found_is_a_file_without_features(tmp_path: Path) -> None:
    for name in ("a.geojson", "a.csv", "a.kml"):
        write_features(tmp_path / name, [], DATUM)
    assert json.loads((tmp_path / "a.geojson").read_text())["features"] == []
    with pytest.raises(ConfigError, match=r"nothing to write to a\.gpkg"):
        write_features(tmp_path / "a.gpkg", [], DATUM)
