"""A view of a map for programs that do not read GeoPackages: GeoTIFF."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fieldgrid.errors import ConfigError, MapWriteError
from fieldgrid.mapfile import LAYERS, MEANING, Change, ChangeView, MapView
from fieldgrid.publish import Draft

_BLOCK_PX = 512


def export_geotiff(view: MapView, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a view as a cloud-optimised GeoTIFF in the map's own plane.

    Band 1 is the 3D density 0..255; every value means something, so there is no nodata value:
    band 2 is alpha, 255 where a cell was observed and 0 where not. Pixels are areas, the first
    row is the northernmost. The tags FIELDGRID_* hold the datum and the cell.

    The file appears when it is complete. Raises MapExistsError when `path` exists and may not
    be overwritten, ConfigError when rasterio is not installed.
    """
    bands = (view.density, view.observed.astype(np.uint8) * np.uint8(255))
    _write(Path(path), view, bands, _tags(view), overwrite=overwrite)


def export_layer(view: MapView, name: str, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a layer of a view as a cloud-optimised GeoTIFF in the map's own plane.

    One band of the layer's own type. Unobserved cells are NaN where that can be said, else 0,
    and nodata either way, but for `max`, in which 0 is also a density: it has a mask. Errors as
    in `export_geotiff`.
    """
    values = view.layer(name)
    if name == "max":
        bands = (values, view.observed.astype(np.uint8) * np.uint8(255))
        _write(Path(path), view, bands, _tags(view), overwrite=overwrite)
        return
    tags = {**_tags(view), "FIELDGRID_LAYER": name, "FIELDGRID_SAYS": LAYERS[name].says}
    _write(Path(path), view, (values,), tags, overwrite=overwrite)


def export_change(view: ChangeView, path: str | Path, *, overwrite: bool = False) -> None:
    """Write what changed as a cloud-optimised GeoTIFF in the map's own plane.

    One band with the number of each cell's `Change`; 0, never observed, is nodata. The tags
    FIELDGRID_CHANGE_n say what each number means. Errors as in `export_geotiff`.
    """
    meanings = {f"FIELDGRID_CHANGE_{kind.value}": MEANING[kind] for kind in Change}
    _write(Path(path), view, (view.change,), {**_tags(view), **meanings}, overwrite=overwrite)


def _write(
    path: Path,
    view: MapView | ChangeView,
    bands: Sequence[npt.NDArray[Any]],
    tags: dict[str, str],
    *,
    overwrite: bool,
) -> None:
    try:
        import rasterio
        from rasterio.enums import ColorInterp
        from rasterio.errors import RasterioError
    except ImportError as error:
        raise ConfigError(
            "Writing a GeoTIFF needs rasterio, which is not installed; "
            "run: pip install 'fieldgrid[gis]'"
        ) from error
    draft = Draft(path, overwrite=overwrite)
    try:
        with rasterio.open(draft.file, "w", **_profile(view, bands)) as dataset:
            if len(bands) > 1:
                dataset.colorinterp = (ColorInterp.gray, ColorInterp.alpha)
            dataset.update_tags(**tags)
            for number, band in enumerate(bands, 1):
                dataset.write(band[::-1], number)
        draft.publish()
    except (RasterioError, OSError) as error:
        if isinstance(error, MapWriteError):
            raise
        raise MapWriteError(
            f"{path} could not be written ({error}); check the space on the disk."
        ) from error
    finally:
        draft.discard()


def _profile(view: MapView | ChangeView, bands: Sequence[npt.NDArray[Any]]) -> dict[str, Any]:
    from rasterio.crs import CRS
    from rasterio.transform import Affine

    cell_m = 1.0 / view.lattice.cells_per_m
    bounds = view.bounds
    return {
        "driver": "COG",
        "dtype": bands[0].dtype.name,
        "count": len(bands),
        "width": view.window.width,
        "height": view.window.height,
        "crs": CRS.from_wkt(view.datum.crs_wkt("WKT1_GDAL")),
        "transform": Affine(cell_m, 0.0, bounds.west_m, 0.0, -cell_m, bounds.north_m),
        "compress": "DEFLATE",
        "blocksize": _BLOCK_PX,
        # What became of a cell has no average.
        "overview_resampling": "MODE" if isinstance(view, ChangeView) else "AVERAGE",
        # With a mask of its own every value means something.
        "nodata": None if len(bands) > 1 else math.nan if bands[0].dtype.kind == "f" else 0,
    }


def _tags(view: MapView | ChangeView) -> dict[str, str]:
    return {
        "FIELDGRID_DATUM_LAT_DEG": repr(float(view.datum.lat_deg)),
        "FIELDGRID_DATUM_LON_DEG": repr(float(view.datum.lon_deg)),
        "FIELDGRID_DATUM_HEIGHT_M": repr(float(view.datum.height_m)),
        "FIELDGRID_CELL_M": repr(float(view.lattice.cell_m)),
    }
