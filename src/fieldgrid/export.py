"""A view of a map for programs that do not read GeoPackages: GeoTIFF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.errors import ConfigError, MapWriteError
from fieldgrid.mapfile import MapView
from fieldgrid.mapfile.publish import Draft

_BLOCK_PX = 512


def export_geotiff(view: MapView, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a view as a cloud-optimised GeoTIFF in the map's own plane.

    Band 1 is the 3D density 0..255; every value means something, so there is no nodata value:
    band 2 is alpha, 255 where a cell was observed and 0 where not. Pixels are areas, the first
    row is the northernmost. The tags FIELDGRID_* hold the datum and the cell.

    The file appears when it is complete. Raises MapExistsError when `path` exists and may not
    be overwritten, ConfigError when rasterio is not installed.
    """
    try:
        import rasterio
        from rasterio.enums import ColorInterp
        from rasterio.errors import RasterioError
    except ImportError as error:
        raise ConfigError(
            "Writing a GeoTIFF needs rasterio, which is not installed; "
            "run: pip install 'fieldgrid[gis]'"
        ) from error
    path = Path(path)
    draft = Draft(path, overwrite=overwrite)
    try:
        with rasterio.open(draft.file, "w", **_profile(view)) as dataset:
            dataset.colorinterp = (ColorInterp.gray, ColorInterp.alpha)
            dataset.update_tags(**_tags(view))
            dataset.write(view.density[::-1], 1)
            dataset.write(view.observed[::-1].astype(np.uint8) * np.uint8(255), 2)
        draft.publish()
    except (RasterioError, OSError) as error:
        if isinstance(error, MapWriteError):
            raise
        raise MapWriteError(
            f"{path} could not be written ({error}); check the space on the disk."
        ) from error
    finally:
        draft.discard()


def _profile(view: MapView) -> dict[str, Any]:
    from rasterio.crs import CRS
    from rasterio.transform import Affine

    cell_m = 1.0 / view.lattice.cells_per_m
    bounds = view.bounds
    return {
        "driver": "COG",
        "dtype": "uint8",
        "count": 2,
        "width": view.window.width,
        "height": view.window.height,
        "crs": CRS.from_wkt(view.datum.crs_wkt("WKT1_GDAL")),
        "transform": Affine(cell_m, 0.0, bounds.west_m, 0.0, -cell_m, bounds.north_m),
        "compress": "DEFLATE",
        "blocksize": _BLOCK_PX,
        "overview_resampling": "AVERAGE",
    }


def _tags(view: MapView) -> dict[str, str]:
    return {
        "FIELDGRID_DATUM_LAT_DEG": repr(float(view.datum.lat_deg)),
        "FIELDGRID_DATUM_LON_DEG": repr(float(view.datum.lon_deg)),
        "FIELDGRID_DATUM_HEIGHT_M": repr(float(view.datum.height_m)),
        "FIELDGRID_CELL_M": repr(float(view.lattice.cell_m)),
    }
