"""A map as arrays for scientists: NumPy's NPZ, Zarr and NetCDF.

All hold the density, the mask of observed cells, how many frames saw each, and the layer that was
asked for, over the cells' centres east and north. Rows run to the north: row 0 is in the south.
A cell that nobody saw is NaN, or has `_FillValue`: no comparison takes it for free ground.
"""

from __future__ import annotations

import importlib
import shutil
import zipfile
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from fieldgrid.array_types import AnyArray
from fieldgrid.errors import ConfigError
from fieldgrid.export.georeference import extent
from fieldgrid.export.registry import Exported, Format, register
from fieldgrid.export.selection import Selection
from fieldgrid.export.tables import datum_values
from fieldgrid.lattice import Window
from fieldgrid.mapfile import LAYERS, MapView, Readable, cf_dataset, masked
from fieldgrid.mapfile.view import empty_view
from fieldgrid.publish import mentions, replacing, replacing_folder, working_beside
from fieldgrid.settings import Settings


def export_npz(
    universal: Readable, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a compressed NPZ: `east_m`, `north_m`, the layers, `cell_m`, the datum, `crs_wkt`.

    Arrays of cells have the shape [north, east]; no pickled object is in the file. They are made
    on the disk beside it, a piece of the map at a time.
    """
    with (
        replacing(path, overwrite=overwrite, ours=_is_npz, what="an NPZ") as file,
        working_beside(file) as folder,
        selection.blocks(universal, ("count",)) as blocks,
    ):
        lattice, window, datum = blocks.lattice, blocks.window, universal.datum
        names = dict.fromkeys((selection.layer, "count"))
        corner = Window(window.i0, window.j0, 1, 1)
        unseen = empty_view(lattice, corner, datum, [name for name in names if name != "density"])
        with ExitStack() as stack:
            raws = {
                name: _Raw(stack, Path(folder) / name, array, window)
                for name, array in _cells(unseen).items()
            }
            for view in blocks.views:
                for name, array in _cells(view).items():
                    raws[name].write(array, view.window)
            east_m, north_m = lattice.centres(window)
            small: dict[str, npt.ArrayLike] = {
                "east_m": east_m,
                "north_m": north_m,
                "cell_m": np.float64(lattice.cell_m),
                "crs_wkt": np.array(datum.crs_wkt("WKT2_2019")),
                **{f"datum_{key}": np.float64(v) for key, v in datum_values(datum).items()},
            }
            with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
                for name, values in small.items():
                    with archive.open(f"{name}.npy", "w") as member:
                        np.lib.format.write_array(member, np.asanyarray(values), allow_pickle=False)
                for name, raw in raws.items():
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                        raw.copy_to(member)
    rows = (("cells", f"{window.width} x {window.height}"),)
    return Exported((path,), rows, extent(lattice, window, datum))


def _cells(view: MapView) -> dict[str, AnyArray]:
    """The arrays of cells of an NPZ."""
    return {
        "observed": view.observed,
        **{
            name: masked(values, view.observed, LAYERS[name].nodata)
            for name, values in {"density": view.density, **view.layers}.items()
        },
    }


class _Raw:
    """An array of cells in a file, as it is in memory; `unseen` [1, 1] is what nobody saw."""

    def __init__(self, stack: ExitStack, file: Path, unseen: AnyArray, window: Window) -> None:
        self._window, self._dtype = window, unseen.dtype
        self._file = stack.enter_context(file.open("w+b"))
        row = np.full(window.width, unseen[0, 0]).tobytes()
        if any(row[: self._dtype.itemsize]):
            for _ in range(window.height):
                self._file.write(row)
        else:
            self._file.truncate(len(row) * window.height)  # of zeros, which take no space

    def write(self, values: AnyArray, part: Window) -> None:
        """Put in a part."""
        i, j = part.i0 - self._window.i0, part.j0 - self._window.j0
        for k, row in enumerate(values):
            self._file.seek(((j + k) * self._window.width + i) * self._dtype.itemsize)
            self._file.write(row.tobytes())

    def copy_to(self, out: IO[bytes]) -> None:
        """Write all of it as NumPy's format has it."""
        about = {
            "descr": np.lib.format.dtype_to_descr(self._dtype),
            "fortran_order": False,
            "shape": self._window.shape,
        }
        np.lib.format.write_array_header_1_0(out, about)
        self._file.seek(0)
        shutil.copyfileobj(self._file, out, 1 << 20)


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
    return Exported((path,), _size(view), extent(view.lattice, view.window, view.datum))


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
    return Exported((path,), _size(view), extent(view.lattice, view.window, view.datum))


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
        limits="10^10 cells",
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
