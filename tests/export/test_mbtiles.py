"""MBTiles, read by GDAL and, tile by tile, by SQLite, Pillow and PROJ alone."""

from __future__ import annotations

import dataclasses
import io
import math
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import rasterio
from PIL import Image
from rasterio.transform import rowcol, xy
from rasterio.warp import transform

from fieldgrid.core import ConfigError
from fieldgrid.export import Selection, export_map
from fieldgrid.geometry import Bounds, Datum
from fieldgrid.maps import Farm, MapFile, create_map, open_map
from tests.export.asymmetric import (
    COARSE_M,
    DATUM,
    enu,
    geodetic,
    probes,
    truth,
    write_asymmetric_map,
)
from tests.maps.file.maps import drive

WORLD_M = 2.0 * math.pi * 6378137.0
_Floats = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


@pytest.fixture(scope="module")
def tiles(universal: MapFile, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tiles") / "f.mbtiles"
    done = export_map(universal, path)
    assert done.paths == (path,)
    assert done.about["tiles"] == len(list(pictures(path)))
    return path


def pictures(path: Path) -> Iterator[tuple[int, int, int, npt.NDArray[np.uint8]]]:
    """Zoom, x, y by the rows of the specification (from the south), and the pixels."""
    with closing(sqlite3.connect(path)) as database:
        for zoom, x, y, data in database.execute("select * from tiles"):
            yield zoom, x, y, np.asarray(Image.open(io.BytesIO(data)))


def metadata(path: Path) -> dict[str, str]:
    with closing(sqlite3.connect(path)) as database:
        return dict(database.execute("select name, value from metadata"))


def centres(zoom: int, x: int, y: int) -> tuple[_Floats, _Floats]:
    """East and north of a tile's pixels in the map's plane [256, 256], by Web Mercator's formula
    and PROJ."""
    pixel = (np.arange(256) + 0.5) / 256.0
    u = (x + pixel) / 2**zoom
    v = (2**zoom - 1 - y + pixel) / 2**zoom
    lon, lat = np.meshgrid(360.0 * u - 180.0, np.degrees(np.arctan(np.sinh(math.pi * (1 - 2 * v)))))
    return enu(lat, lon)[:2]


def test_each_pixel_of_the_finest_tiles_has_the_cell_under_it(tiles: Path) -> None:
    finest = int(metadata(tiles)["maxzoom"])
    seen = 0
    for zoom, x, y, pixels in pictures(tiles):
        assert pixels.shape == (256, 256, 4)
        if zoom != finest:
            continue
        east, north = centres(zoom, x, y)
        # 1 mm off an edge of a cell: the tangent plane is not quite the projection.
        sure = (np.abs((east / 0.05 + 0.5) % 1.0 - 0.5) > 0.04) & (
            np.abs((north / 0.05 + 0.5) % 1.0 - 0.5) > 0.04
        )
        true = truth(east, north)
        np.testing.assert_array_equal(pixels[..., 3][sure], np.where(true.observed, 255, 0)[sure])
        for band in range(3):
            both = sure & true.observed
            np.testing.assert_array_equal(pixels[..., band][both], true.density[both])
        seen += int((pixels[..., 3] > 0).sum())
    pixel_m = WORLD_M / 256 / 2**finest * math.cos(math.radians(DATUM.lat_deg))
    assert 0.025 < pixel_m <= 0.05
    assert seen * pixel_m**2 == pytest.approx(24.0 * 16.0 - 26.0, rel=0.02)  # what was observed


@pytest.mark.parametrize("times", [1, 2, 4])
def test_coarser_tiles_have_the_cells_of_the_map_s_own_rule(
    universal: MapFile, tiles: Path, times: int
) -> None:
    zoom = int(metadata(tiles)["maxzoom"]) - int(math.log2(times))
    view = universal.read(cell_m=0.05 * times)
    wrong = total = 0
    for found, x, y, pixels in pictures(tiles):
        if found != zoom:
            continue
        east, north = centres(found, x, y)
        # Overviews begin in the north-west corner of the map: here at multiples of all cells.
        i = np.floor(east / view.lattice.cell_m).astype(int) - view.window.i0
        j = np.floor(north / view.lattice.cell_m).astype(int) - view.window.j0
        inside = (i >= 0) & (i < view.window.width) & (j >= 0) & (j < view.window.height)
        known = np.zeros(east.shape, dtype=bool)
        known[inside] = view.observed[j[inside], i[inside]]
        both = known & (pixels[..., 3] > 0)
        wrong += int((pixels[..., 0][both] != view.density[j[both], i[both]]).sum())
        wrong += int((known != (pixels[..., 3] > 0)).sum())
        total += int(known.sum())
    assert total > 5_000
    assert wrong < 0.01 * total  # pixels on an edge


def test_gdal_reads_it_in_its_place(tiles: Path) -> None:
    east, north = probes()
    lat, lon, _ = geodetic(east, north)
    with rasterio.open(tiles) as dataset:
        assert dataset.driver == "MBTiles"
        assert dataset.crs.to_epsg() == 3857
        assert dataset.count == 4
        x, y = transform("EPSG:4326", dataset.crs, lon, lat)
        rows, columns = (np.array(v) for v in rowcol(dataset.transform, x, y))
        bands = dataset.read()
        assert dataset.overviews(1) != []
        inside = (rows >= 0) & (rows < bands.shape[1])
        inside &= (columns >= 0) & (columns < bands.shape[2])
        assert not truth(east, north).observed[~inside].any()
        rows, columns = rows[inside], columns[inside]
        places = xy(dataset.transform, rows, columns)
        lon, lat = transform(dataset.crs, "EPSG:4326", *places)
    at = enu(np.array(lat), np.array(lon))[:2]
    # A pixel has what lies under its centre, unless that is an edge of cells.
    sure = np.logical_and(*(np.abs((v / 0.05 + 0.5) % 1.0 - 0.5) > 0.04 for v in at))
    true = truth(*at)
    alpha = bands[3, rows, columns]
    np.testing.assert_array_equal(alpha[sure], np.where(true.observed, 255, 0)[sure])
    seen = sure & true.observed
    np.testing.assert_array_equal(bands[0, rows, columns][seen], true.density[seen])
    assert seen.sum() > 1000


def test_what_the_specification_asks_for(tiles: Path) -> None:
    said = metadata(tiles)
    assert (said["format"], said["type"], said["name"]) == ("png", "overlay", "f density")
    west, south, east, north = map(float, said["bounds"].split(","))
    corners = enu([south, north], [west, east])
    # Outwards to whole pixels of 2.7 cm, and to whole cells of 0.4 m of the last overview.
    np.testing.assert_allclose(corners[0], [-10.0, 14.0], atol=0.03)
    np.testing.assert_allclose(corners[1], [-7.2, 9.2], atol=0.03)
    assert float(said["fieldgrid_datum_height_m"]) == DATUM.height_m
    zooms = {zoom for zoom, *_ in pictures(tiles)}
    assert zooms == set(range(int(said["minzoom"]), int(said["maxzoom"]) + 1))
    with closing(sqlite3.connect(tiles)) as database:
        assert database.execute("pragma application_id").fetchone() == (0x4D504258,)


def test_where_nobody_was_there_is_no_tile(tmp_path: Path) -> None:
    """Two drives 300 m apart: the tiles go with what was seen, not with what lies between."""
    path = tmp_path / "m.gpkg"
    with create_map(path, DATUM, cell_m=0.1) as made, made.add_session("a") as session:
        for shift_m in (0.0, 300.0):
            for grid, pose in drive(2):
                moved = dataclasses.replace(
                    pose,
                    time_ns=pose.time_ns + int(shift_m * 1e9),
                    east_m=pose.east_m + shift_m,
                    north_m=pose.north_m + shift_m,
                )
                session.add(grid, moved)
    with open_map(path) as far:
        done = export_map(far, tmp_path / "t.mbtiles")
        whole = far.bounds
    side_m = WORLD_M / 2 ** done.about["zooms"][1] * math.cos(math.radians(DATUM.lat_deg))
    finest = [one for one in pictures(tmp_path / "t.mbtiles") if one[0] == done.about["zooms"][1]]
    assert all((pixels[..., 3] > 0).any() for *_, pixels in finest)
    covered = (whole.east_m - whole.west_m) * (whole.north_m - whole.south_m) / side_m**2
    assert len(finest) < 0.1 * covered


def test_a_part_and_larger_cells(universal: MapFile, tmp_path: Path) -> None:
    part = Selection(Bounds(-4.0, -2.0, 2.0, 7.0), COARSE_M, layer="max")
    done = export_map(universal, tmp_path / "p.mbtiles", part)
    for zoom, x, y, pixels in pictures(tmp_path / "p.mbtiles"):
        if zoom != done.about["zooms"][1]:
            continue
        east, north = centres(zoom, x, y)
        seen = pixels[..., 3] > 0
        assert east[seen].min() > -4.01
        assert north[seen].max() < 7.01
    assert done.about["layer"] == "max"


def test_beside_a_pole_there_are_no_tiles(tmp_path: Path) -> None:
    with create_map(tmp_path / "m.gpkg", Datum(89.0, 0.0, 10.0), cell_m=0.1) as made:
        with made.add_session("a") as session:
            session.add(*drive(1)[0])
        with pytest.raises(ConfigError, match=r"Web Mercator does not reach to .* 89\.0°"):
            export_map(made, tmp_path / "t.mbtiles")


def test_a_farm_has_the_tiles_of_its_map(tiles: Path, tmp_path: Path) -> None:
    (tmp_path / "farm").mkdir()
    write_asymmetric_map(tmp_path / "farm" / "f.gpkg")
    with Farm(tmp_path / "farm") as farm:
        export_map(farm, tmp_path / "f.mbtiles")
    alone, together = (
        {(zoom, x, y): pixels.tobytes() for zoom, x, y, pixels in pictures(path)}
        for path in (tiles, tmp_path / "f.mbtiles")
    )
    assert alone == together
