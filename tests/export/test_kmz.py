from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.export import Selection, export_map
from fieldgrid.export.cells import kmz as kmz_module
from fieldgrid.geometry import Bounds
from fieldgrid.maps import MapFile, open_map
from tests.export.asymmetric import DATUM, enu, geodetic, probes, track, truth, write_asymmetric_map
from tests.export.placed import compared
from tests.maps.file.maps import drive, write_map
from tests.maps.file.test_geopackage import tool

KML = {"k": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


@dataclass(frozen=True)
class Overlay:
    """A picture [rows from the top, columns], and longitude and latitude of its corners, from the
    lower left one counter-clockwise."""

    values: npt.NDArray[Any]
    seen: npt.NDArray[Any]
    corners: npt.NDArray[np.float64]


def read(path: Path) -> tuple[ElementTree.Element, list[Overlay]]:
    """The document and its overlays, as the specification says."""
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        root = ElementTree.fromstring(archive.read("doc.kml"))
        overlays = []
        for overlay in root.iterfind(".//k:GroundOverlay", KML):
            href = overlay.findtext("k:Icon/k:href", namespaces=KML)
            assert href is not None
            encoded = np.frombuffer(archive.read(href), dtype=np.uint8)
            blue, green, red, alpha = cv2.split(cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED))
            assert (blue == green).all()
            assert (blue == red).all()
            quad = overlay.findtext("gx:LatLonQuad/k:coordinates", namespaces=KML)
            overlays.append(Overlay(blue, alpha > 0, coordinates(quad)))
    return root, overlays


def coordinates(text: str | None) -> npt.NDArray[np.float64]:
    assert text is not None
    return np.array([[float(v) for v in pair.split(",")[:2]] for pair in text.split()])


def faults(overlays: list[Overlay]) -> list[str]:
    """What is wrong, by the longitude and latitude of points that are known."""
    east, north = probes()
    lat, lon, _ = geodetic(east, north)
    values, seen = np.zeros(len(east)), np.zeros(len(east), dtype=np.bool_)
    for overlay in overlays:
        height, width = overlay.values.shape
        origin = overlay.corners[0]
        # Between corners some metres apart nothing bends: an affine map, checked at the fourth.
        sides = np.stack([overlay.corners[1] - origin, overlay.corners[3] - origin], axis=1)
        u, v = np.linalg.solve(sides, np.stack([lon, lat]) - origin[:, None])
        column, row = np.floor(u * width), np.floor((1.0 - v) * height)
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        place = row[inside].astype(int), column[inside].astype(int)
        values[inside], seen[inside] = overlay.values[place], overlay.seen[place]
    return compared(values, seen, truth(east, north), "density")


@pytest.mark.parametrize("cell_m", [None, 0.25])
def test_the_picture_lies_where_the_cells_are(
    universal: MapFile, tmp_path: Path, cell_m: float | None
) -> None:
    export_map(universal, tmp_path / "f.kmz", Selection(cell_m=cell_m))
    _, overlays = read(tmp_path / "f.kmz")
    assert len(overlays) == 1
    assert faults(overlays) == []
    assert [file.name for file in tmp_path.iterdir()] == ["f.kmz"]


def test_it_is_cut_into_pictures(
    universal: MapFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kmz_module, "PICTURE_PX", 64)
    export_map(universal, tmp_path / "f.kmz")
    root, overlays = read(tmp_path / "f.kmz")
    assert 30 < len(overlays) < 40  # those where nobody looked are left out
    assert faults(overlays) == []
    for region, overlay in zip(root.iterfind(".//k:Region", KML), overlays, strict=True):
        box = {
            side: float(region.findtext(f"k:LatLonAltBox/k:{side}", "nan", KML))
            for side in ("west", "south", "east", "north")
        }
        west, south = overlay.corners.min(axis=0)
        east, north = overlay.corners.max(axis=0)
        expected = {"west": west, "south": south, "east": east, "north": north}
        assert box == pytest.approx(expected, abs=1e-10)


def test_mistakes_do_not_go_unnoticed(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "f.kmz")
    _, (overlay,) = read(tmp_path / "f.kmz")
    values, seen, corners = overlay.values, overlay.seen, overlay.corners
    half = (corners[1] - corners[0]) / values.shape[1] / 2.0
    mutants = {
        "transposed": replace(overlay, values=values.T, seen=seen.T),
        "mirrored": replace(overlay, values=values[:, ::-1], seen=seen[:, ::-1]),
        "upside down": replace(overlay, values=values[::-1], seen=seen[::-1]),
        "corners from the upper left": replace(overlay, corners=np.roll(corners, 1, axis=0)),
        "corners clockwise": replace(overlay, corners=corners[::-1]),
        "latitude first": replace(overlay, corners=corners[:, ::-1]),
        "half a cell off": replace(overlay, corners=corners + half),
        "another datum": replace(overlay, corners=corners + np.array([0.0, 2e-7])),
        "unknown is empty": replace(overlay, seen=np.ones_like(seen)),
    }
    for mistake, wrong in mutants.items():
        assert faults([wrong]), mistake


def test_the_drives_are_lines_of_the_accepted_poses(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "f.kmz")
    root, _ = read(tmp_path / "f.kmz")
    lines = {
        mark.findtext("k:name", namespaces=KML): mark.find("k:LineString", KML)
        for mark in root.iterfind(".//k:Placemark", KML)
    }
    assert list(lines) == ["spring", "summer"]
    for session, line in lines.items():
        assert session is not None
        assert line is not None
        assert line.findtext("k:altitudeMode", namespaces=KML) == "clampToGround"
        lon, lat = coordinates(line.findtext("k:coordinates", namespaces=KML)).T
        east, north, _ = enu(lat, lon)
        drive = track(session)
        assert len(east) == np.count_nonzero(drive.accepted)
        np.testing.assert_allclose(east, drive.east_m[drive.accepted], atol=0.001)
        np.testing.assert_allclose(north, drive.north_m[drive.accepted], atol=0.001)
    export_map(universal, tmp_path / "spring.kmz", Selection(at="spring"))
    root, _ = read(tmp_path / "spring.kmz")
    assert [m.findtext("k:name", "", KML) for m in root.iterfind(".//k:Placemark", KML)] == [
        "spring"
    ]


def test_a_session_without_a_trajectory_has_the_line_of_its_frames(tmp_path: Path) -> None:
    frames = drive(4)
    export_map(open_map(write_map(tmp_path / "m.gpkg", [frames])), tmp_path / "f.kmz")
    root, _ = read(tmp_path / "f.kmz")
    (line,) = root.iterfind(".//k:LineString", KML)
    assert len(coordinates(line.findtext("k:coordinates", namespaces=KML))) == len(frames)


def test_a_map_whose_name_is_no_text_is_shown_too(tmp_path: Path) -> None:
    odd = tmp_path / os.fsdecode(b"a<&\xff\x01.gpkg")
    write_map(tmp_path / "m.gpkg", [drive(2)]).rename(odd)
    export_map(open_map(odd), tmp_path / "f.kmz")
    root, _ = read(tmp_path / "f.kmz")
    assert root.findtext("k:Document/k:name", "", KML) == "a<&\ufffd\ufffd"


def test_the_datum_is_in_it(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "f.kmz")
    root, _ = read(tmp_path / "f.kmz")
    data = {
        entry.get("name"): float(entry.findtext("k:value", "nan", KML))
        for entry in root.iterfind("k:Document/k:ExtendedData/k:Data", KML)
    }
    assert data == {
        "datum_lat_deg": DATUM.lat_deg,
        "datum_lon_deg": DATUM.lon_deg,
        "datum_height_m": DATUM.height_m,
        "cell_m": 0.05,
    }
    assert DATUM.described() in root.findtext("k:Document/k:description", "", KML)


def test_the_gdal_of_the_system_reads_it(universal: MapFile, tmp_path: Path) -> None:
    path = tmp_path / "f.kmz"
    export_map(universal, path)
    said = tool("ogrinfo", "-al", str(path))
    if "LIBKML" not in said:
        pytest.skip("the system's GDAL has no LIBKML")
    assert "Layer name: density" in said
    assert "Layer name: drives" in said
    assert said.count("LINESTRING") == 2


def test_what_it_cannot_hold_is_refused(universal: MapFile, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="kmz cannot hold the layer 'count', only layers"):
        export_map(universal, tmp_path / "f.kmz", Selection(layer="count"))
    wide = Selection(Bounds(0.0, 0.0, 3000.0, 800.0))
    with pytest.raises(ConfigError, match=r"240 pictures, .* or cells of 0\.1 m"):
        export_map(universal, tmp_path / "f.kmz", wide)
    (tmp_path / "f.kmz").write_text("mine")
    with pytest.raises(MapExistsError, match="exists already"):
        export_map(universal, tmp_path / "f.kmz")
    assert [file.name for file in tmp_path.iterdir()] == ["f.kmz"]
