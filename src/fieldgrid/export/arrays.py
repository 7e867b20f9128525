"""A map as arrays for scientists: NumPy's NPZ and Zarr.

Both hold the density, the mask of observed cells, how many frames saw each, and the layer that was
asked for, over the cells' centres east and north. Rows run to the north: row 0 is in the south.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import ConfigError
from fieldgrid.export.registry import Exported, Format, register
from fieldgrid.export.selection import Selection
from fieldgrid.export.tables import datum_values
from fieldgrid.mapfile import MapFile, MapView
from fieldgrid.publish import mentions, replacing, replacing_folder
from fieldgrid.settings import Settings


def export_npz(
    universal: MapFile, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a compressed NPZ: `east_m`, `north_m`, the layers, `cell_m`, the datum, `crs_wkt`.

    Arrays of cells have the shape [north, east]; no pickled object is in the file.
    """
    view = selection.view(universal, ("count",))
    east_m, north_m = view.lattice.centres(view.window)
    arrays: dict[str, npt.ArrayLike] = {
        "east_m": east_m,
        "north_m": north_m,
        "density": view.density,
        "observed": view.observed,
        **view.layers,
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
    universal: MapFile, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a Zarr store that xarray opens, with CF's attributes for coordinates and plane.

    Raises ConfigError when xarray or zarr is not installed.
    """
    try:
        import xarray  # noqa: F401 (to_xarray would ask for another extra)
        import zarr  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            "Writing Zarr needs zarr and xarray, which are not installed; "
            "run: pip install 'fieldgrid[tables]'"
        ) from error
    view = selection.view(universal, ("count",))
    with replacing_folder(path, overwrite=overwrite, ours=_is_zarr, what="a Zarr store") as draft:
        # Format 2 is read by every version of zarr and by GDAL; 3 is not yet.
        view.to_xarray().to_zarr(draft, mode="w", zarr_format=2, consolidated=True)
    return Exported((path,), _size(view))


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
        "npz", (".npz",), "arrays for NumPy", export_npz, readers="NumPy", limits="4·10^8 cells"
    ),
    Format(
        "zarr",
        (".zarr",),
        "Zarr store (format 2), a folder",
        export_zarr,
        folder=True,
        readers="xarray, dask",
        extras=("tables",),
        limits="4·10^8 cells",
    ),
)
