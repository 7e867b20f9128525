from __future__ import annotations

import builtins
import errno
import json
import re
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio
import rasterio.errors
import rasterio.shutil
from rasterio.enums import ColorInterp
from rasterio.warp import transform

from fieldgrid.core import ConfigError, MapExistsError, MapWriteError, palette, publish
from fieldgrid.export import Selection, export_change, export_map
from fieldgrid.export.cells.raster import check_whole
from fieldgrid.geometry import Bounds, Lattice, Window
from fieldgrid.maps import (
    GROUPS,
    LAYERS,
    MEANING,
    Change,
    MapFile,
    groups_of,
    mean_density,
    open_map,
)
from fieldgrid.maps.transfer import MeanFold
from tests.export import asymmetric
from tests.export.asymmetric import COARSE_M, write_asymmetric_map
from tests.export.placed import faults, faults_at_centres, mutants, opened
from tests.maps.file import test_qgis
from tests.maps.file.maps import CELL_M, DATUM, drive, one_cell, write_map
from tests.maps.file.test_geopackage import CENTIMETRE, POINTS, geodetic, tool

CELLS = ((12.35, -45.65, 173), (-30.25, 41.75, 9), (50.05, 20.05, 0))
ALL = Selection()


@pytest.fixture
def universal(tmp_path: Path) -> MapFile:
    return open_map(write_map(tmp_path / "map.gpkg", [drive(9)]))


@pytest.fixture(scope="module")
def asymmetric_map(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A GeoTIFF of three single cells."""
    folder = tmp_path_factory.mktemp("cells")
    frames = [one_cell(*cell) for cell in CELLS]
    export_map(open_map(write_map(folder / "map.gpkg", [frames])), folder / "map.tif", ALL)
    return folder / "map.tif"


# --- the asymmetric map comes back through PROJ and GDAL


@pytest.mark.parametrize("cell_m", [None, COARSE_M])
@pytest.mark.parametrize("layer", ["density", "count", "sessions", "max", "variance"])
def test_every_layer_lands_in_its_place(
    layer: str, cell_m: float | None, asymmetric_map: MapFile, tmp_path: Path
) -> None:
    path = tmp_path / "f.tif"
    done = export_map(asymmetric_map, path, Selection(cell_m=cell_m, layer=layer))
    assert done.paths == (path, path.with_suffix(".qml"))
    if layer != "count" or cell_m is None:  # larger cells are seen from neighbouring frames too
        assert faults(opened(path), layer) == []


@pytest.mark.parametrize("epsg", [25830, 32631, 4326, 3857, 3035])
@pytest.mark.parametrize("layer", ["density", "persistence"])
def test_in_another_system_each_pixel_has_the_cell_under_its_centre(
    epsg: int, layer: str, asymmetric_map: MapFile, tmp_path: Path
) -> None:
    path = tmp_path / "f.tif"
    export_map(asymmetric_map, path, Selection(layer=layer), options={"epsg": epsg})
    picture = opened(path)
    assert faults_at_centres(picture, layer) == []
    with rasterio.open(path) as dataset:
        assert dataset.crs.to_epsg() == epsg
        assert dataset.transform.a == -dataset.transform.e  # square
        # As large as a cell where the map is, where the system stretches one axis along the other.
        sides = []
        for other in ((10, 9), (9, 10)):
            centres = np.array([dataset.xy(9, 9), dataset.xy(*other)]).T
            east, north, _ = asymmetric.enu(*transform(dataset.crs, "EPSG:4326", *centres)[::-1])
            sides.append(float(np.hypot(*np.diff([east, north])[:, 0])))
        assert max(sides) == pytest.approx(0.05, rel=2e-3)
        assert min(sides) > 0.03
        assert float(dataset.tags()["FIELDGRID_DATUM_HEIGHT_M"]) == 742.0


def test_mistakes_do_not_go_unnoticed(asymmetric_map: MapFile, tmp_path: Path) -> None:
    export_map(asymmetric_map, tmp_path / "f.tif", ALL)
    picture = opened(tmp_path / "f.tif")
    assert faults(picture) == []
    for mistake, wrong in mutants(picture).items():
        assert faults(wrong), mistake
    export_map(asymmetric_map, tmp_path / "g.tif", ALL, options={"epsg": 25830})
    projected = opened(tmp_path / "g.tif")
    for mistake, wrong in mutants(projected).items():
        if mistake != "another datum":
            assert faults_at_centres(wrong), mistake


def test_a_picture_without_its_plane_is_noticed(asymmetric_map: MapFile, tmp_path: Path) -> None:
    path = tmp_path / "f.tif"
    export_map(asymmetric_map, path, ALL)
    rasterio.shutil.copy(path, tmp_path / "bare.png", driver="PNG")
    (tmp_path / "bare.png.aux.xml").unlink()
    with (
        pytest.warns(rasterio.errors.NotGeoreferencedWarning),
        pytest.raises(AssertionError, match="no reference system"),
    ):
        opened(tmp_path / "bare.png")


def test_the_height_is_that_of_the_ground_under_the_vehicle(
    asymmetric_map: MapFile, tmp_path: Path
) -> None:
    path = tmp_path / "f.tif"
    export_map(asymmetric_map, path, Selection(layer="height"))
    with rasterio.open(path) as dataset:
        height, tags = dataset.read(1), dataset.tags()
        assert np.isnan(dataset.nodata)
    observed = asymmetric_map.read().observed[::-1]
    np.testing.assert_array_equal(np.isnan(height), ~observed)
    np.testing.assert_allclose(height[observed], 0.3, atol=1e-6)
    assert "FIELDGRID_DATUM_HEIGHT_M + value" in tags["FIELDGRID_HEIGHT"]


def test_the_tags_say_what_it_is(asymmetric_map: MapFile, tmp_path: Path) -> None:
    spring = Selection(Bounds(-1.0, -2.0, 3.0, 4.0), 0.25, "variance", "spring")
    export_map(asymmetric_map, tmp_path / "f.tif", spring)
    with rasterio.open(tmp_path / "f.tif") as dataset:
        assert tuple(dataset.bounds) == pytest.approx((-1.0, -2.0, 3.0, 4.0))
        tags = dataset.tags()
    assert tags["FIELDGRID_LAYER"] == "variance"
    assert tags["FIELDGRID_SAYS"] == LAYERS["variance"].meaning
    assert float(tags["FIELDGRID_CELL_M"]) == 0.25
    assert (tags["FIELDGRID_SESSIONS"], tags["FIELDGRID_AS_OF_SESSION"]) == ("1", "spring")
    assert tags["FIELDGRID_AS_OF_TIME"].startswith("2026-04-03T")


# --- what a GeoTIFF is


def test_the_geotiff_holds_the_view(tmp_path: Path, universal: MapFile) -> None:
    path = tmp_path / "map.tif"
    export_map(universal, str(path), ALL)
    view = universal.read()
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


def test_what_changed_is_a_geotiff_too(asymmetric_map: MapFile, tmp_path: Path) -> None:
    view = asymmetric_map.diff("spring", "summer")
    export_change(view, tmp_path / "c.tif")
    with rasterio.open(tmp_path / "c.tif") as dataset:
        assert dataset.nodata == 0
        np.testing.assert_array_equal(dataset.read(1)[::-1], view.change)
        assert dataset.tags()["FIELDGRID_CHANGE_1"] == MEANING[Change(1)]
        assert tuple(dataset.bounds) == pytest.approx(tuple(view.bounds))
    assert [file.name for file in tmp_path.iterdir()] == ["c.tif"]


# A cell seen 100 times outweighs its neighbour.
OFTEN = [*[one_cell(-40.25, 40.15, 0)] * 100, one_cell(-40.35, 40.05, 200)]
CORNERS = [(-41.2, 41.6), (-41.1, 41.5), (-40.95, 41.25)]
WIDE = [*drive(7), *OFTEN, one_cell(61.05, 41.05, 200), one_cell(-40.35, -30.15, 90)]


@pytest.fixture(scope="module")
def wide_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_map(tmp_path_factory.mktemp("wide") / "map.gpkg", [WIDE])


@pytest.mark.parametrize("layer", list(LAYERS))
def test_overviews_follow_the_rule_of_larger_cells(
    wide_map: Path, tmp_path: Path, layer: str
) -> None:
    path, bounds = tmp_path / "map.tif", Bounds(-41.2, -30.8, 62.4, 41.6)
    with open_map(wide_map) as source:
        export_map(source, path, Selection(bounds, layer=layer))
        expected = source.read(bounds, 0.2, layers=[layer])
    with rasterio.open(path) as dataset:
        assert dataset.overviews(1) == [2, 4]
    with rasterio.open(path, overview_level=0) as dataset:
        np.testing.assert_array_equal(dataset.read(1)[::-1], expected.layer(layer))
        if dataset.count == 2:
            np.testing.assert_array_equal(dataset.read(2)[::-1] > 0, expected.observed)
    assert {2, 90, 200} <= set(expected.density[expected.observed].tolist())


@pytest.mark.parametrize("bounds", [None, *(Bounds(w, -30.75, 62.35, n) for w, n in CORNERS)])
@pytest.mark.parametrize("cell_m", [CELL_M, 0.12])
def test_overviews_are_of_whole_cells(
    wide_map: Path, tmp_path: Path, bounds: Bounds | None, cell_m: float
) -> None:
    path, lattice = tmp_path / "map.tif", Lattice(cell_m)
    with open_map(wide_map) as source:
        export_map(source, path, Selection(bounds, cell_m))
        whole = lattice.window(bounds or source.bounds)
    with rasterio.open(path) as found:
        levels = len(found.overviews(1))
    assert levels in (1, 2)
    fold = None
    for level in range(levels + 1):
        with rasterio.open(path, **({} if level == 0 else {"overview_level": level - 1})) as found:
            side = 1 << level
            west, north = (round(v / cell_m) for v in (found.transform.c, found.transform.f))
            window = Window(
                west, north - found.height * side, found.width * side, found.height * side
            )
            pixels = found.read()
        assert window.union(whole) == window
        if fold is None:
            assert max(window.width - whole.width, window.height - whole.height) < 8
            fold = MeanFold(lattice, window)
            for grid, pose in WIDE:
                fold.add(grid, pose)
            sums = fold.sums
        else:
            sums = sums.reshape(2, found.height, 2, found.width, 2).sum(axis=(2, 4))
        density, observed = mean_density(*sums)
        np.testing.assert_array_equal(pixels[0, ::-1], density)
        np.testing.assert_array_equal(pixels[1, ::-1] > 0, observed)
    assert pixels.any()


def test_overviews_never_hold_all_channels_of_a_square(wide_map: Path) -> None:
    with open_map(wide_map) as source, source.read_blocks() as whole:
        cells, names = whole.window.width * whole.window.height, groups_of(("traversability",))
        channels = sum(len(GROUPS[name].channels) for name in names)
        tracemalloc.start()
        try:
            with Selection(layer="traversability", jobs=1).blocks(source, (), 256) as blocks:
                assert {view.lattice.cell_m for view in blocks.views} == {0.1, 0.2, 0.4}
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert peak < 8 * channels * cells / 3


def test_overviews_in_another_plane_are_those_of_the_cells(wide_map: Path, tmp_path: Path) -> None:
    path = tmp_path / "map.tif"
    with open_map(wide_map) as source:
        export_map(source, path, Selection(), options={"epsg": 25830})
        view = source.read(cell_m=2 * CELL_M)
        own = view.density[view.observed]
    with rasterio.open(path, overview_level=0) as dataset:
        values, alpha = dataset.read()
    assert set(np.unique(alpha)) == {0, 255}
    assert set(values[alpha > 0].tolist()) <= set(own.tolist())
    assert (alpha > 0).sum() == pytest.approx(len(own), rel=0.03)


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


@pytest.mark.parametrize("epsg", [25830, 4326, 3035])
def test_a_cell_far_from_the_datum_is_found_in_another_system(epsg: int, tmp_path: Path) -> None:
    east, north = 1500.05, 2200.05
    universal = open_map(write_map(tmp_path / "map.gpkg", [[one_cell(east, north, 255)]]))
    near = Selection(Bounds(east - 9.0, north - 9.0, east + 9.0, north + 9.0))
    export_map(universal, tmp_path / "p.tif", near, options={"epsg": epsg})
    with rasterio.open(tmp_path / "p.tif") as dataset:
        rows, columns = np.nonzero(dataset.read(2))
        assert 1 <= len(rows) <= 2  # a cell may hold the centres of two smaller pixels
        x, y = dataset.xy(rows, columns)
        lon, lat = transform(dataset.crs, "EPSG:4326", x, y)
    found = DATUM.to_enu(lat, lon, DATUM.to_geodetic(east, north, 0.0)[2])
    assert np.abs(found[0] - east).max() <= CELL_M / 2 + CENTIMETRE
    assert np.abs(found[1] - north).max() <= CELL_M / 2 + CENTIMETRE


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
    part = Selection(Bounds(-900.0, 400.0, -800.0, 500.0), 2.5)
    export_map(universal, tmp_path / "part.tif", part)
    with rasterio.open(tmp_path / "part.tif") as dataset:
        assert tuple(dataset.bounds) == pytest.approx((-900.0, 400.0, -800.0, 500.0))
        assert list(next(dataset.sample([(-830.25, 410.75)]))) == [77, 255]
        rows, columns = np.nonzero(dataset.read(2))
        assert (len(rows), dataset.xy(rows[0], columns[0])) == (1, (-831.25, 411.25))


def test_the_system_opens_it_without_complaint(cells: Path) -> None:
    out = tool("gdalinfo", str(cells))
    assert re.search(r"Band 2 .*ColorInterp=Alpha", out)


# --- whole, or not at all


def test_an_existing_file_is_replaced_only_when_asked(tmp_path: Path, universal: MapFile) -> None:
    path = tmp_path / "map.tif"
    path.write_text("mine")
    with pytest.raises(MapExistsError, match=r"another name, or --overwrite"):
        export_map(universal, path, ALL)
    assert path.read_text() == "mine"
    path.write_text("")
    export_map(universal, path, ALL, overwrite=True)
    export_map(universal, path, ALL, overwrite=True)
    with rasterio.open(path) as dataset:
        assert dataset.count == 2
    assert sorted(file.name for file in tmp_path.iterdir()) == ["map.gpkg", "map.tif"]


def test_qgis_shows_it_in_the_colours_of_the_layer(tmp_path: Path, universal: MapFile) -> None:
    """By the style beside it, which QGIS opens by itself; of other layers by their own range."""
    export_map(universal, tmp_path / "d.tif", ALL)
    export_map(universal, tmp_path / "s.tif", Selection(layer="count"))
    renderer, *_ = ElementTree.parse(tmp_path / "d.qml").iter("rasterrenderer")
    assert (renderer.get("type"), renderer.get("alphaBand")) == ("singlebandpseudocolor", "2")
    assert [(float(i.get("value", "")), i.get("color")) for i in renderer.iter("item")] == [
        (pytest.approx(255.0 * share), colour) for share, colour in palette.DENSITY
    ]
    renderer, *_ = ElementTree.parse(tmp_path / "s.qml").iter("rasterrenderer")
    assert renderer.get("alphaBand") == "-1"
    counts = universal.read(layers=["count"]).layer("count")
    values = [float(item.get("value", "")) for item in renderer.iter("item")]
    assert (values[0], values[-1]) == (0.0, counts.max())


def test_no_style_is_put_on_a_map_of_the_same_name(tmp_path: Path, universal: MapFile) -> None:
    """QGIS takes `map.qml` for `map.tif` and `map.gpkg` alike, and their bands differ."""
    done = export_map(universal, tmp_path / "map.tif", ALL)
    assert done.paths == (tmp_path / "map.tif",)
    assert (
        dict(done.rows)["style"] == "none: QGIS would use it for map.gpkg, too; give another name"
    )
    assert not (tmp_path / "map.qml").exists()


def test_a_style_that_a_user_has_saved_stays(tmp_path: Path, universal: MapFile) -> None:
    path, style = tmp_path / "f.tif", tmp_path / "f.qml"
    export_map(universal, path, Selection(layer="count"))
    export_map(universal, path, ALL, overwrite=True)
    assert 'alphaBand="2"' in style.read_text()
    saved = style.read_text().replace('version="3.22.0"', 'version="3.22.16-Białowieża"')
    style.write_text(saved, encoding="utf-8")
    done = export_map(universal, path, ALL, overwrite=True)
    assert (done.paths, dict(done.rows)["style"]) == ((path,), "f.qml as it was")
    assert style.read_text(encoding="utf-8") == saved


BY_QGIS = """
import json, os, sys
from qgis.core import QgsApplication, QgsRasterLayer
application = QgsApplication([], False)
application.initQgis()
layers = [QgsRasterLayer(path, "cells", "gdal") for path in sys.argv[1:]]
print(json.dumps([[one.renderer().type(), one.renderer().alphaBand()] for one in layers]))
sys.stdout.flush()
os._exit(0)  # QGIS may crash when it is taken down in the wrong order
"""


def test_qgis_itself_takes_the_style(tmp_path: Path, universal: MapFile) -> None:
    if not test_qgis.is_there():
        pytest.skip("QGIS's library (Debian's python3-qgis) is not installed")
    files = [str(tmp_path / name) for name in ("d.tif", "map.tif", "map.gpkg")]
    for path in files[:2]:
        export_map(universal, path, ALL)
    asked = [test_qgis.PYTHON, "-c", BY_QGIS, *files]
    environment = {"QT_QPA_PLATFORM": "offscreen", "HOME": str(tmp_path)}
    done = subprocess.run(asked, capture_output=True, text=True, timeout=120, env=environment)
    drawn = [["singlebandpseudocolor", 2], ["singlebandgray", 2], ["multibandcolor", 4]]
    assert json.loads(done.stdout) == drawn, done.stderr


def test_an_export_that_fails_leaves_nothing(
    tmp_path: Path, universal: MapFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(publish.os, "fsync", full)
    with pytest.raises(MapWriteError, match="disk is full"):
        export_map(universal, tmp_path / "map.tif", ALL)
    monkeypatch.undo()

    def broken(*_: object, **__: object) -> None:
        raise rasterio.errors.RasterioIOError("write error")

    monkeypatch.setattr(rasterio, "open", broken)
    with pytest.raises(MapWriteError, match="write error"):
        export_map(universal, tmp_path / "map.tif", ALL)
    with pytest.raises(MapWriteError, match="folder does not exist"):
        export_map(universal, tmp_path / "no" / "map.tif", ALL)
    assert [file.name for file in tmp_path.iterdir()] == ["map.gpkg"]


def test_without_rasterio_it_says_what_to_install(
    tmp_path: Path, universal: MapFile, monkeypatch: pytest.MonkeyPatch
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
        export_map(universal, tmp_path / "map.tif", ALL)


@pytest.mark.parametrize(
    ("epsg", "message"),
    [(99999, "EPSG:99999 is not known"), (4978, "neither a projected nor a geographic")],
)
def test_systems_that_cannot_be(
    epsg: int, message: str, asymmetric_map: MapFile, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=message):
        export_map(asymmetric_map, tmp_path / "f.tif", ALL, options={"epsg": epsg})
    assert list(tmp_path.iterdir()) == []


def test_a_file_whose_end_is_missing_is_noticed(asymmetric_map: MapFile, tmp_path: Path) -> None:
    path = tmp_path / "f.tif"
    export_map(asymmetric_map, path, ALL)
    check_whole(path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(MapWriteError, match="disk is full"):
        check_whole(path)
