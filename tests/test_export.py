from __future__ import annotations

import builtins
import errno
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rasterio.warp import transform

from fieldgrid import publish
from fieldgrid.errors import ConfigError, MapExistsError, MapWriteError
from fieldgrid.export import export_geotiff
from fieldgrid.lattice import Bounds
from fieldgrid.mapfile import MapView, open_map
from tests.mapfile.maps import CELL_M, DATUM, drive, one_cell, write_map
from tests.mapfile.test_geopackage import CENTIMETRE, POINTS, geodetic, tool

CELLS = ((12.35, -45.65, 173), (-30.25, 41.75, 9), (50.05, 20.05, 0))


@pytest.fixture
def view(tmp_path: Path) -> MapView:
    return open_map(write_map(tmp_path / "map.gpkg", [drive(9)])).read()


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A GeoTIFF of three single cells."""
    folder = tmp_path_factory.mktemp("cells")
    frames = [one_cell(*cell) for cell in CELLS]
    view = open_map(write_map(folder / "map.gpkg", [frames])).read()
    export_geotiff(view, folder / "map.tif")
    return folder / "map.tif"


def test_the_geotiff_holds_the_view(tmp_path: Path, view: MapView) -> None:
    path = tmp_path / "map.tif"
    export_geotiff(view, path)
    with rasterio.open(path) as dataset:
        assert dataset.driver == "GTiff"
        assert tuple(dataset.bounds) == pytest.approx(tuple(view.bounds))
        assert dataset.res == pytest.approx((CELL_M, CELL_M))
        assert dataset.colorinterp == (ColorInterp.gray, ColorInterp.alpha)
        assert dataset.nodata is None
        density, alpha = dataset.read()
        np.testing.assert_array_equal(dataset.dataset_mask(), alpha)
        tags = dataset.tags()
        structure = dataset.tags(ns="IMAGE_STRUCTURE")
    np.testing.assert_array_equal(density[::-1], view.density)
    np.testing.assert_array_equal(alpha[::-1], view.observed * 255)
    assert tags["AREA_OR_POINT"] == "Area"
    assert float(tags["FIELDGRID_DATUM_LAT_DEG"]) == DATUM.lat_deg
    assert float(tags["FIELDGRID_DATUM_LON_DEG"]) == DATUM.lon_deg
    assert float(tags["FIELDGRID_DATUM_HEIGHT_M"]) == DATUM.height_m
    assert float(tags["FIELDGRID_CELL_M"]) == CELL_M
    assert structure["LAYOUT"] == "COG"


@pytest.mark.parametrize("cell", CELLS)
def test_a_cell_is_where_it_belongs(cells: Path, cell: tuple[float, float, int]) -> None:
    east, north, density = cell
    with rasterio.open(cells) as dataset:
        assert list(next(dataset.sample([(east, north)]))) == [density, 255]
        assert list(next(dataset.sample([(east - 2 * CELL_M, north)]))) in ([0, 0], [])
        assert np.count_nonzero(dataset.read(2)) == len(CELLS)


@pytest.mark.parametrize("cell", CELLS)
def test_the_gdal_of_the_system_finds_it_too(cells: Path, cell: tuple[float, float, int]) -> None:
    east, north, density = cell
    lat, lon = geodetic(east, north)
    out = tool("gdallocationinfo", "-valonly", "-wgs84", str(cells), repr(lon), repr(lat))
    assert [int(value) for value in out.split()] == [density, 255]


@pytest.mark.parametrize("point", POINTS)
def test_the_plane_of_the_geotiff_is_the_tangent_plane(
    cells: Path, point: tuple[float, float, float]
) -> None:
    lat, lon = geodetic(*point)
    with rasterio.open(cells) as dataset:
        (east,), (north,) = transform("EPSG:4326", dataset.crs, [lon], [lat])
    assert (east, north) == pytest.approx(point[:2], abs=CENTIMETRE)
    wkt = tool("gdalsrsinfo", "-o", "wkt1", "--single-line", str(cells)).strip()
    out = tool("gdaltransform", "-s_srs", "EPSG:4326", "-t_srs", wkt, stdin=f"{lon!r} {lat!r}\n")
    assert [float(v) for v in out.split()[:2]] == pytest.approx(point[:2], abs=CENTIMETRE)


def test_a_part_at_a_larger_cell_keeps_its_place(tmp_path: Path) -> None:
    frames = [one_cell(-830.25, 410.75, 77), one_cell(1500.05, 2200.05, 255)]
    universal = open_map(write_map(tmp_path / "map.gpkg", [frames]))
    view = universal.read(Bounds(-900.0, 400.0, -800.0, 500.0), cell_m=2.5)
    export_geotiff(view, tmp_path / "part.tif")
    with rasterio.open(tmp_path / "part.tif") as dataset:
        assert tuple(dataset.bounds) == pytest.approx((-900.0, 400.0, -800.0, 500.0))
        assert list(next(dataset.sample([(-830.25, 410.75)]))) == [77, 255]
        rows, columns = np.nonzero(dataset.read(2))
        assert (len(rows), dataset.xy(rows[0], columns[0])) == (1, (-831.25, 411.25))


def test_the_system_opens_it_without_complaint(cells: Path) -> None:
    out = tool("gdalinfo", str(cells))
    assert re.search(r"Band 2 .*ColorInterp=Alpha", out)


def test_an_existing_file_is_replaced_only_when_asked(tmp_path: Path, view: MapView) -> None:
    path = tmp_path / "map.tif"
    path.write_text("mine")
    with pytest.raises(MapExistsError, match=r"another name, or --overwrite"):
        export_geotiff(view, path)
    assert path.read_text() == "mine"
    export_geotiff(view, str(path), overwrite=True)
    with rasterio.open(path) as dataset:
        assert dataset.count == 2
    assert sorted(file.name for file in tmp_path.iterdir()) == ["map.gpkg", "map.tif"]


def test_an_export_that_fails_leaves_nothing(
    tmp_path: Path, view: MapView, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(publish.os, "fsync", full)
    with pytest.raises(MapWriteError, match="disk is full"):
        export_geotiff(view, tmp_path / "map.tif")
    monkeypatch.undo()

    def broken(*_: object, **__: object) -> None:
        raise rasterio.errors.RasterioIOError("write error")

    monkeypatch.setattr(rasterio, "open", broken)
    with pytest.raises(MapWriteError, match="write error"):
        export_geotiff(view, tmp_path / "map.tif")
    with pytest.raises(MapWriteError, match="folder does not exist"):
        export_geotiff(view, tmp_path / "no" / "map.tif")
    assert [file.name for file in tmp_path.iterdir()] == ["map.gpkg"]


def test_without_rasterio_it_says_what_to_install(
    tmp_path: Path, view: MapView, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = builtins.__import__

    def without(name: str, *arguments: Any, **options: Any) -> Any:
        if name.partition(".")[0] == "rasterio":
            raise ImportError(name)
        return original(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    for name in [name for name in sys.modules if name.partition(".")[0] == "rasterio"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(ConfigError, match=r"pip install 'fieldgrid\[gis\]'"):
        export_geotiff(view, tmp_path / "map.tif")
