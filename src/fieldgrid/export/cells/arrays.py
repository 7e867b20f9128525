"""A map as arrays for scientists: NumPy's NPZ, Zarr and NetCDF.

All hold the density, the mask of observed cells, how many frames saw each, and the layer that was
asked for, over the cells' centres east and north. Rows run to the north: row 0 is in the south.
A cell that nobody saw is NaN, or has `_FillValue`: no comparison takes it for free ground.
"""

from __future__ import annotations

import io
import shutil
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from fieldgrid.core import AnyArray, Settings, mentions, replacing, replacing_folder, working_beside
from fieldgrid.export.cells.tables import datum_values
from fieldgrid.export.cells.zarr_folder import zarr_folder
from fieldgrid.export.georeference import extent
from fieldgrid.export.registry import Exported, ExportFormat, register_export_format, require
from fieldgrid.geometry import Datum, Window
from fieldgrid.maps import (
    LAYERS,
    MapBlocks,
    MapView,
    Readable,
    Selection,
    cf_dataset,
    empty_view,
    masked,
)


def export_npz(
    universal: Readable, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a compressed NPZ: `east_m`, `north_m`, the layers, `cell_m`, the datum, `crs_wkt`.

    Arrays of cells have the shape [north, east]; no pickled object is in the file. They are made
    on the disk beside it, a piece of the map at a time.
    """
    ours = partial(mentions, mark=b"datum_lat_deg.npy")
    with (
        replacing(path, overwrite=overwrite, ours=ours, what="an NPZ") as file,
        working_beside(file) as folder,
        selection.blocks(universal, ("count",)) as blocks,
    ):
        lattice, window, datum = blocks.lattice, blocks.window, universal.datum
        unseen = _unseen_cell(blocks, datum, selection.layer)
        with ExitStack() as stack:
            stores = {
                name: _CellStore(stack, Path(folder) / name, array, window)
                for name, array in _cells(unseen).items()
            }
            for view in blocks.views:
                for name, array in _cells(view).items():
                    stores[name].write(array, view.window)
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
                for name, store in stores.items():
                    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                        store.copy_to(member)
        return _exported(path, blocks, universal)


def _unseen_cell(blocks: MapBlocks, datum: Datum, layer: str) -> MapView:
    """A view of one cell that nobody saw, with the layers that are written beside the density."""
    names = [name for name in dict.fromkeys((layer, "count")) if name != "density"]
    return empty_view(
        blocks.lattice, Window(blocks.window.i0, blocks.window.j0, 1, 1), datum, names
    )


def _cells(view: MapView) -> dict[str, AnyArray]:
    """The arrays of cells of an NPZ."""
    return {
        "observed": view.observed,
        **{
            name: masked(values, view.observed, LAYERS[name].nodata)
            for name, values in {"density": view.density, **view.layers}.items()
        },
    }


class _CellStore:
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
        np.lib.format.write_array_header_1_0(
            out,
            {
                "descr": np.lib.format.dtype_to_descr(self._dtype),
                "fortran_order": False,
                "shape": self._window.shape,
            },
        )
        self._file.seek(0)
        shutil.copyfileobj(self._file, out, 1 << 20)


def export_zarr(
    universal: Readable, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a Zarr store by the CF conventions, which xarray, rioxarray and GDAL open.

    Raises ConfigError when xarray or zarr is not installed.
    """
    require("Writing Zarr", "tables", "xarray", "zarr")
    import zarr

    with (
        replacing_folder(path, overwrite=overwrite, ours=_is_zarr, what="a Zarr store") as draft,
        zarr_folder(draft) as store,
        selection.blocks(universal, ("count",)) as blocks,
    ):
        # Format 2 is read by every version of zarr and by GDAL; 3 is not yet.
        group = zarr.open_group(store, mode="w", zarr_format=2)

        def create(name: str, one: Any, shape: Shape, chunks: Shape | None, fill: Any) -> Any:
            said = {key: _json(value) for key, value in one.attrs.items()}
            return group.create_array(
                name,
                shape=shape,
                chunks=chunks or shape or "auto",
                dtype=one.dtype,
                fill_value=fill,
                attributes={**said, "_ARRAY_DIMENSIONS": list(one.dims)},
            )

        group.attrs.update(
            {k: _json(v) for k, v in _written(blocks, universal.datum, selection, create).items()}
        )
        zarr.consolidate_metadata(store)
        return _exported(path, blocks, universal)


def export_netcdf(
    universal: Readable, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write NetCDF-4 by the CF conventions, compressed.

    Raises ConfigError when xarray or h5netcdf is not installed.
    """
    require("Writing NetCDF", "tables", "xarray", "h5netcdf", "h5py")
    import h5netcdf  # type: ignore[import-untyped]

    ours = partial(mentions, mark=b"datum_lat_deg")
    with (
        replacing(path, overwrite=overwrite, ours=ours, what="a NetCDF") as file,
        selection.blocks(universal, ("count",)) as blocks,
        file.open("w+b", buffering=0) as raw,
    ):
        disk = _Disk(raw)
        with h5netcdf.File(disk, "w") as out:
            out.dimensions = dict(zip(_AXES, blocks.window.shape, strict=True))

            def create(name: str, one: Any, shape: Shape, chunks: Shape | None, fill: Any) -> Any:
                packed = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
                made = out.create_variable(
                    name,
                    one.dims,
                    one.dtype,
                    fillvalue=fill,
                    chunks=chunks,
                    **(packed if chunks else {}),
                )
                made.attrs.update(one.attrs)
                disk.check()
                return made

            out.attrs.update(_written(blocks, universal.datum, selection, create, disk.check))
        disk.check()
        return _exported(path, blocks, universal)


_AXES = ("north_m", "east_m")
CHUNK_CELLS = 1024
"""A side of what is compressed at once."""


Shape = tuple[int, ...]


def _written(
    blocks: MapBlocks,
    datum: Datum,
    selection: Selection,
    create: Callable[[str, Any, Shape, Shape | None, Any], Any],
    after_each: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Write the dataset of the blocks, a block at a time, into variables as `create` makes them of
    a name, xarray's variable, the shape, the shape of chunks (None for what is no array of cells)
    and the fill value (None for what has a value everywhere).

    Cells of no block have the fill value. Returns the attributes of the dataset.
    """
    lattice, window = blocks.lattice, blocks.window
    empty = cf_dataset(_unseen_cell(blocks, datum, selection.layer))
    sizes = dict(zip(_AXES, window.shape, strict=True))
    east_m, north_m = lattice.centres(window)
    whole = {"east_m": east_m, "north_m": north_m, "crs": empty["crs"].values}
    cells = {}
    for name, variable in empty.variables.items():
        shape = tuple(sizes[axis] for axis in variable.dims)
        fill = variable.attrs.pop("_FillValue", None)
        chunks = tuple(min(side, CHUNK_CELLS) for side in shape) if name not in whole else None
        made = create(name, variable, shape, chunks, fill)
        if name in whole:
            made[...] = whole[name]
        else:
            cells[name] = made
    for view in blocks.views:
        row, column = view.window.j0 - window.j0, view.window.i0 - window.i0
        here = np.s_[row : row + view.window.height, column : column + view.window.width]
        part = cf_dataset(view)
        for name, made in cells.items():
            made[here] = part[name].values
            after_each()
    return dict(empty.attrs)


class _Disk(io.RawIOBase):
    """A file for HDF5, which ends the program when a write fails: here none does, until somebody
    asks. What follows a write that failed is thrown away."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._failed: OSError | None = None

    def check(self) -> None:
        """Raise the error of the first write that failed."""
        if self._failed is not None:
            raise self._failed

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        data = self._file.read(len(view))
        view[:] = data.ljust(len(view), b"\0")  # HDF5 may look for what was thrown away
        return len(view)

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        if self._failed is None:
            try:
                done = 0
                while done < len(view):
                    done += self._file.write(view[done:])
            except OSError as error:
                self._failed = error
        return len(view)

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        if self._failed is None:
            try:
                return self._file.truncate(size)
            except OSError as error:
                self._failed = error
        return self._file.tell() if size is None else size


def _json(value: Any) -> Any:
    """An attribute as JSON has it."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _exported(path: Path, blocks: MapBlocks, universal: Readable) -> Exported:
    return Exported(
        (path,),
        (("cells", f"{blocks.window.width} x {blocks.window.height}"),),
        extent(blocks.lattice, blocks.window, universal.datum),
    )


def _is_zarr(folder: Path) -> bool:
    return mentions(folder / ".zattrs", b"datum_lat_deg") and all(
        entry.name.startswith(".z") or (entry / ".zarray").is_file() for entry in folder.iterdir()
    )


register_export_format(
    ExportFormat(
        "npz",
        (".npz",),
        "arrays for NumPy",
        export_npz,
        several=True,
        readers="NumPy",
        limits="10^10 cells",
    ),
    ExportFormat(
        "zarr",
        (".zarr",),
        "Zarr store (format 2), a folder",
        export_zarr,
        folder=True,
        several=True,
        readers="xarray, rioxarray, dask",
        extras=("tables",),
        limits="10^10 cells",
    ),
    ExportFormat(
        "netcdf",
        (".nc",),
        "NetCDF-4 by the CF conventions",
        export_netcdf,
        several=True,
        readers="xarray, GDAL, Panoply",
        extras=("tables",),
        limits="10^10 cells",
    ),
)
