"""A map as arrays for scientists: NumPy's NPZ, Zarr and NetCDF.

All hold the density, the mask of observed cells, how many frames saw each, and the layer that was
asked for, over the cells' centres east and north. Rows run to the north: row 0 is in the south.
A cell that nobody saw is NaN, or has `_FillValue`: no comparison takes it for free ground.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import ConfigError
from fieldgrid.export.registry import Exported, Format, register
from fieldgrid.export.selection import Selection
from fieldgrid.export.tables import datum_values
from fieldgrid.mapfile import LAYERS, MapView, Readable, cf_dataset, masked
from fieldgrid.publish import mentions, replacing, replacing_folder
from fieldgrid.settings import Settings


def export_npz(
    universal: Readable, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a compressed NPZ: `east_m`, `north_m`, the layers, `cell_m`, the datum, `crs_wkt`.

    Arrays of cells have the shape [north, east]; no pickled object is in the file.
    """
    view = selection.view(universal, ("count",))
    east_m, north_m = view.lattice.centres(view.window)
    arrays: dict[str, npt.ArrayLike] = {
        "east_m": east_m,
        "north_m": north_m,
        "observed": view.observed,
        **{
            name: masked(values, view.observed, LAYERS[name].nodata)
            for name, values in {"density": view.density, **view.layers}.items()
        },
        "cell_m": np.float64(view.lattice.cell_m),
        "crs_wkt": np.array(view.crs_wkt),
        **{f"datum_{name}": np.float64(value) for name, value in datum_values(view.datum).items()},
    }
    with (
        replacing(path, overwrite=overwrite, ours=_is_npz, what="an NPZ") as file,
        file.open("wb") as out,
    ):
        np.savez_compressed(out, allow_pickle=False, **arrays)
    return Exported((path,), _size(view))


def export_zarr(
    universal: Readable, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a Zarr store by the CF conventions, which xarray, rioxarray and GDAL open.

    Raises ConfigError when xarray or zarr is not installed.
    """
    view, dataset = _dataset(universal, selection, "Zarr", "zarr")
    with replacing_folder(path, overwrite=overwrite, ours=_is_zarr, what="a Zarr store") as draft:
        # Format 2 is read by every version of zarr and by GDAL; 3 is not yet.
        dataset.to_zarr(draft, mode="w", zarr_format=2, consolidated=True)
    return Exported((path,), _size(view))


def export_netcdf(
    universal: Readable, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write NetCDF-4 by the CF conventions, compressed.

    Raises ConfigError when xarray or h5netcdf is not installed.
    """
    view, dataset = _dataset(universal, selection, "NetCDF", "h5netcdf", "h5py")
    packed = {name: {"zlib": True, "complevel": 4} for name in dataset if name != "crs"}
    with replacing(path, overwrite=overwrite, ours=_is_netcdf, what="a NetCDF") as file:
        # In memory: HDF5 ends the program when the disk fills up.
        file.write_bytes(dataset.to_netcdf(engine="h5netcdf", encoding=packed))
    return Exported((path,), _size(view))


def _dataset(
    universal: Readable, selection: Selection, what: str, *libraries: str
) -> tuple[MapView, Any]:
    try:
        for name in ("xarray", *libraries):
            importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(
            f"Writing {what} needs xarray and {' and '.join(libraries)}, which are not installed; "
            "run: pip install 'fieldgrid[tables]'"
        ) from error
    view = selection.view(universal, ("count",))
    return view, cf_dataset(view)


def _is_netcdf(file: Path) -> bool:
    return mentions(file, b"datum_lat_deg")


def _is_npz(file: Path) -> bool:
    return mentions(file, b"datum_lat_deg.npy")


def _is_zarr(folder: Path) -> bool:
    return mentions(folder / ".zattrs", b"datum_lat_deg") and all(
        entry.name.startswith(".z") or (entry / ".zarray").is_file() for entry in folder.iterdir()
    )


def _size(view: MapView) -> tuple[tuple[str, str], ...]:
    return (("cells", f"{view.window.width} x {view.window.height}"),)


register(
    Format(
        "npz",
        (".npz",),
        "arrays for NumPy",
        export_npz,
        several=True,
        readers="NumPy",
        limits="4·10^8 cells",
    ),
    Format(
        "zarr",
        (".zarr",),
        "Zarr store (format 2), a folder",
        export_zarr,
        folder=True,
        several=True,
        readers="xarray, rioxarray, dask",
        extras=("tables",),
        limits="4·10^8 cells",
    ),
    Format(
        "netcdf",
        (".nc",),
        "NetCDF-4 by the CF conventions",
        export_netcdf,
        several=True,
        readers="xarray, GDAL, Panoply",
        extras=("tables",),
        limits="4·10^8 cells",
    ),
)
