"""A map as cloud-optimised GeoTIFF."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from fieldgrid.core import replacing
from fieldgrid.export.cells.raster import (
    BLOCK_PX,
    BandLayout,
    Raster,
    Scratch,
    check_whole,
    creating,
    datum_tags,
    gdal,
    is_ours,
    painted,
    plane_of,
    value_range,
)
from fieldgrid.export.options import PlaneOptions
from fieldgrid.export.registry import Exported, ExportFormat, register_export_format
from fieldgrid.maps import LAYERS, MEANING, Change, ChangeView, Readable, Selection, qgis

_THREADS_A_CORE = 2
"""GDAL compresses as many blocks ahead as it has threads; with one a core some cores wait."""

_LEVEL = 1
"""Of DEFLATE: with the default of 6 it takes more than twice the time, for 5 % fewer bytes."""


def write_geotiff(
    universal: Readable,
    path: Path,
    selection: Selection,
    options: PlaneOptions,
    *,
    overwrite: bool,
) -> Exported:
    """Write a layer as a cloud-optimised GeoTIFF, in the map's own plane or another.

    Of the density and of `max` every value means something: band 2 is alpha, 255 where a cell was
    observed and 0 where not. Other layers have one band, in which unobserved cells are NaN where
    that can be said, else 0, and nodata either way. Pixels are areas, the first row is the
    northernmost. In another plane a pixel has the value of the cell in which its centre lies.
    Its overviews are of whole cells, so that it reaches up to a pixel of the smallest one beyond
    what is asked for. The tags FIELDGRID_* hold the datum, the cell, the layer and the last session
    that is in it. Beside it lies a style of the same name (.qml), by which QGIS shows it in the
    colours of `show`; not where QGIS would take that style for a map of this name, too, nor over
    one of a user.

    The file appears when it is complete; until then about three times the size of its pixels is
    used beside it. Raises MapExistsError when `path` exists and may not be overwritten,
    ConfigError when rasterio is not installed or for what cannot be selected, MapWriteError when
    it cannot be written.
    """
    style, why_none = path.with_suffix(".qml"), ""
    if path.with_suffix(".gpkg").exists():
        why_none = f"none: QGIS would use it for {path.stem}.gpkg, too; give another name"
    elif style.exists() and not qgis.is_raster_style(style):
        why_none = f"{style.name} as it was"
    with (
        replacing(path, overwrite=overwrite, ours=is_ours, what="a GeoTIFF") as file,
        painted(universal, path, selection, options.epsg, smallest_px=BLOCK_PX) as raster,
    ):
        _copy(raster, file)
        if not why_none:
            with replacing(style) as draft:
                draft.write_text(_style(raster, selection.layer), encoding="utf-8")
    if why_none:
        return Exported((path,), (*raster.rows, ("style", why_none)), raster.about)
    return Exported((path, style), raster.rows, raster.about)


def _style(raster: Raster, layer: str) -> str:
    """How QGIS shows a raster that lies beside this document: in the colours of `show`."""
    import rasterio

    with rasterio.open([raster.file, *raster.overviews][-1]) as pixels:
        # They tell what range those values have that have none of their own.
        known = pixels.read(1, masked=True).compressed()
    alpha_band = 2 if raster.layout.alpha else -1
    return qgis.raster_style(LAYERS[layer].colours.ramp, *value_range(layer, known), alpha_band)


def export_change(view: ChangeView, path: str | Path, *, overwrite: bool = False) -> None:
    """Write what changed as a cloud-optimised GeoTIFF in the map's own plane.

    One band with the number of each cell's `Change`; 0, never observed, is nodata. The tags
    FIELDGRID_CHANGE_n say what each number means. Errors as in `write_geotiff`.
    """
    path = Path(path)
    layout = BandLayout("uint8", alpha=False, nodata=0)
    tags = {
        **datum_tags(view.datum, view.lattice),
        **{f"FIELDGRID_CHANGE_{kind.value}": MEANING[kind] for kind in Change},
    }
    with (
        replacing(path, overwrite=overwrite, ours=is_ours, what="a GeoTIFF") as file,
        gdal(path),
        Scratch(path) as scratch,
    ):
        plane = plane_of(view.datum, view.lattice, view.window)
        pixels = scratch.file("pixels")
        with creating(pixels, plane, layout, tags) as dataset:
            dataset.write(view.change[::-1], 1)
        # What became of a cell has no average.
        _copy(Raster(pixels, [], plane, layout, (), {}, scratch), file, resampling="MODE")


def _copy(raster: Raster, file: Path, resampling: str = "NEAREST") -> None:
    """Have GDAL make the GeoTIFF, with the overviews of the raster, else by `resampling`."""
    import rasterio.shutil

    rasterio.shutil.copy(
        _with_overviews(raster) if raster.overviews else raster.file,
        file,
        driver="COG",
        compress="DEFLATE",
        level=_LEVEL,
        predictor="NO" if raster.layout.dtype == "uint8" else "YES",
        blocksize=BLOCK_PX,
        num_threads=str(_THREADS_A_CORE * (os.cpu_count() or 1)),
        bigtiff="IF_SAFER",
        overview_resampling=resampling,
    )
    check_whole(file)


def _with_overviews(raster: Raster) -> Path:
    """A virtual raster of the pixels and their overviews, which are files of their own."""
    import rasterio.shutil

    virtual = raster.scratch.file("virtual", ".vrt")
    rasterio.shutil.copy(raster.file, virtual, driver="VRT")
    tree = ElementTree.parse(virtual)
    for band in tree.iter("VRTRasterBand"):
        for level in raster.overviews:
            overview = ElementTree.SubElement(band, "Overview")
            ElementTree.SubElement(overview, "SourceFilename", relativeToVRT="1").text = level.name
            ElementTree.SubElement(overview, "SourceBand").text = band.attrib["band"]
    tree.write(virtual)
    return virtual


register_export_format(
    ExportFormat(
        "geotiff",
        (".tif", ".tiff"),
        "cloud-optimised GeoTIFF with overviews",
        write_geotiff,
        PlaneOptions,
        several=True,
        readers="GIS, web maps",
        extras=("gis",),
        limits="10^10 cells",
    )
)
