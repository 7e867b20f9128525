"""Arrays for scientists: NPZ and Zarr come back as the truth, with their plane."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
import rasterio
import rioxarray  # noqa: F401 (registers what tests ask of .rio)
import xarray
import zarr

from fieldgrid.core import ConfigError, MapExistsError
from fieldgrid.export import Selection, export_map
from fieldgrid.export.cells import arrays
from fieldgrid.geometry import TILE_CELLS
from fieldgrid.maps import MapFile, cf_dataset, open_map
from fieldgrid.maps.views import blocks
from tests.export.asymmetric import (
    COARSE_M,
    DATUM,
    Truth,
    cells,
    geodetic,
    write_asymmetric_map,
)


@pytest.fixture(scope="module")
def universal(tmp_path_factory: pytest.TempPathFactory) -> MapFile:
    return open_map(write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg"))


def opened(path: Path) -> Any:
    engine = {".zarr": "zarr", ".nc": "h5netcdf"}[path.suffix]
    return xarray.open_dataset(path, engine=engine, decode_coords="all")


def unseen_is_nan(true: Truth) -> Any:
    return np.where(true.observed, true.density, np.float32(np.nan))


def test_npz_is_the_truth_without_pickles(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "map.npz", Selection(cell_m=COARSE_M, layer="variance"))
    east, north, true = cells(COARSE_M)
    with np.load(tmp_path / "map.npz", allow_pickle=False) as arrays:
        np.testing.assert_allclose(arrays["east_m"], east)
        np.testing.assert_allclose(arrays["north_m"], north)
        np.testing.assert_array_equal(arrays["density"], unseen_is_nan(true))
        np.testing.assert_array_equal(arrays["observed"], true.observed)
        assert not (arrays["density"] <= 255)[~true.observed].any()  # of no density at all
        np.testing.assert_array_equal(arrays["count"], true.sessions)
        np.testing.assert_allclose(arrays["variance"], true.variance, rtol=1e-6)
        assert arrays["cell_m"] == COARSE_M
        datum = [float(arrays[f"datum_{name}"]) for name in ("lat_deg", "lon_deg", "height_m")]
        assert datum == [DATUM.lat_deg, DATUM.lon_deg, DATUM.height_m]
        assert str(arrays["crs_wkt"]).startswith("PROJCRS[")


@pytest.mark.parametrize("name", ["map.zarr", "map.nc"])
def test_a_dataset_is_the_truth(universal: MapFile, tmp_path: Path, name: str) -> None:
    export_map(universal, tmp_path / name, Selection(cell_m=COARSE_M, layer="persistence"))
    east, north, true = cells(COARSE_M)
    with opened(tmp_path / name) as dataset:
        at = dataset.sel(east_m=east[7], north_m=north[30], method="nearest")
        assert int(at.density) == true.density[30, 7]
        np.testing.assert_allclose(dataset.north_m, north)
        np.testing.assert_array_equal(dataset.density, unseen_is_nan(true))
        np.testing.assert_array_equal(dataset.observed, true.observed)
        np.testing.assert_array_equal(
            dataset["count"], np.where(true.observed, true.sessions, np.nan)
        )
        np.testing.assert_allclose(dataset.persistence, true.persistence)


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # rioxarray of affine
@pytest.mark.parametrize("name", ["map.zarr", "map.nc"])
def test_what_nobody_saw_is_no_free_ground_to_rioxarray(
    universal: MapFile, tmp_path: Path, name: str
) -> None:
    export_map(universal, tmp_path / name, Selection(cell_m=COARSE_M, layer="lasting"))
    _, _, true = cells(COARSE_M)
    with opened(tmp_path / name) as dataset:
        for layer in ("density", "lasting", "count"):
            array = dataset[layer]
            assert np.isnan(array.rio.nodata if array.rio.nodata is not None else np.nan)
            assert array.rio.crs.is_projected
            np.testing.assert_array_equal(np.isnan(array), ~true.observed)
            array.rio.to_raster(tmp_path / "layer.tif")
            with rasterio.open(tmp_path / "layer.tif") as raster:
                seen = raster.read_masks(1) != 0
                south_up = raster.transform.e > 0
                np.testing.assert_array_equal(seen if south_up else seen[::-1], true.observed)
                assert raster.transform.a == COARSE_M


def test_gdal_reads_a_netcdf_with_its_mask(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "map.nc", Selection(cell_m=COARSE_M))
    _, _, true = cells(COARSE_M)
    with rasterio.open(f"netcdf:{tmp_path / 'map.nc'}:density") as raster:
        assert raster.nodata == -1
        np.testing.assert_array_equal(raster.read_masks(1)[::-1] != 0, true.observed)
        assert raster.crs.to_dict()["lat_0"] == pytest.approx(DATUM.lat_deg, abs=1e-9)


def test_a_checker_of_the_conventions_has_nothing_to_say(
    universal: MapFile, tmp_path: Path
) -> None:
    export_map(universal, tmp_path / "map.nc", Selection(cell_m=COARSE_M, layer="ground"))
    checker = pytest.importorskip("compliance_checker.runner")
    checker.CheckSuite.load_all_available_checkers()
    out = tmp_path / "report.json"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        checker.ComplianceChecker.run_checker(
            str(tmp_path / "map.nc"), ["cf:1.11"], 0, "strict",
            output_filename=str(out), output_format="json",
        )  # fmt: skip
    report = json.loads(out.read_text())["cf:1.11"]
    found = {
        one["name"]: one["msgs"]
        for group in ("high_priorities", "medium_priorities", "low_priorities")
        for one in report[group]
        if one["msgs"]
    }
    assert found == {}
    assert report["possible_points"] > 50


def test_zarr_places_its_cells_on_earth(universal: MapFile, tmp_path: Path) -> None:
    export_map(universal, tmp_path / "map.zarr", Selection(cell_m=COARSE_M))
    store = zarr.open_group(tmp_path / "map.zarr", mode="r")
    crs = pyproj.CRS.from_wkt(store["crs"].attrs["crs_wkt"])
    to_wgs84 = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    assert store["density"].attrs["grid_mapping"] == "crs"
    east, north = store["east_m"][:], store["north_m"][:]
    lon, lat = to_wgs84.transform(east[[0, -1]], north[[0, -1]])
    true_lat, true_lon, _ = geodetic(east[[0, -1]], north[[0, -1]])
    np.testing.assert_allclose(lat, true_lat, atol=1e-9)  # 0.1 mm
    np.testing.assert_allclose(lon, true_lon, atol=1e-9)


def test_only_a_zarr_store_is_overwritten(universal: MapFile, tmp_path: Path) -> None:
    out = tmp_path / "map.zarr"
    out.mkdir()
    (out / "thesis.txt").write_text("mine")
    with pytest.raises(MapExistsError, match="holds other things than a Zarr store"):
        export_map(universal, out, overwrite=True)
    (out / "thesis.txt").unlink()
    export_map(universal, out, overwrite=True)
    with pytest.raises(MapExistsError, match="--overwrite"):
        export_map(universal, out)
    (out / "thesis.txt").write_text("mine")
    with pytest.raises(MapExistsError, match="holds other things than a Zarr store"):
        export_map(universal, out, overwrite=True)
    (out / "thesis.txt").unlink()
    export_map(universal, out, Selection(cell_m=COARSE_M), overwrite=True)
    assert zarr.open_group(out, mode="r")["density"].shape == (64, 96)
    assert [path.name for path in tmp_path.iterdir()] == ["map.zarr"]


@pytest.mark.parametrize("name", ["map.npz", "map.zarr"])
def test_an_unknown_layer(universal: MapFile, tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="There is no layer 'heigth'"):
        export_map(universal, tmp_path / name, Selection(layer="heigth"))
    assert list(tmp_path.iterdir()) == []


# A file may grow to so many bytes only: a disk that fills up at the start, in the middle, or late.
FULL = """
import resource, sys
from pathlib import Path
from fieldgrid.core import MapWriteError
from fieldgrid.export.cells import arrays; from fieldgrid.export import export_map
from fieldgrid.maps import open_map

arrays.CHUNK_CELLS = 64
folder = Path(sys.argv[2])
with open_map(sys.argv[1]) as universal:
    export_map(universal, folder / "whole.nc")
    size = (folder / "whole.nc").stat().st_size
    for room in (0, 5_000, size // 3, size // 2, size - 200, size):
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
        try:
            export_map(universal, folder / "out.nc")
            print("written")
        except MapWriteError as error:
            print("File too large" in str(error), not (folder / "out.nc").exists())
"""


def test_a_netcdf_on_a_disk_that_fills_up_anywhere(universal: MapFile, tmp_path: Path) -> None:
    """HDF5 ends the program when it cannot write, so it never hears of it."""
    pytest.importorskip("resource", reason="this system has no limit of a file's size")
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(universal.path), str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == ["True True"] * 5 + ["written"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.nc", "whole.nc"]
    assert (tmp_path / "out.nc").read_bytes() == (tmp_path / "whole.nc").read_bytes()


@pytest.mark.parametrize("name", ["a.zarr", "a.nc"])
def test_pieces_and_chunks_leave_no_trace(
    universal: MapFile, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is that of the whole view, whatever is read and compressed at once."""
    monkeypatch.setattr(arrays, "CHUNK_CELLS", 64)
    monkeypatch.setattr(blocks, "_ROWS", TILE_CELLS)
    monkeypatch.setattr(blocks, "_COLUMNS", TILE_CELLS)
    selection = Selection(layer="ground")
    export_map(universal, tmp_path / name, selection)
    expected = xarray.decode_cf(
        cf_dataset(selection.view(universal, ("count",))), decode_coords="all"
    )
    with opened(tmp_path / name) as found:
        xarray.testing.assert_identical(found.load(), expected)
