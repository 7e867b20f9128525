"""A map as PNG with what places it: a world file, its system, and GDAL's own notes."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from fieldgrid.core import ConfigError, MapWriteError, UInt8
from fieldgrid.export.cells.raster import is_ours, painted
from fieldgrid.export.options import PlaneOptions
from fieldgrid.export.plane import PixelPlane
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format
from fieldgrid.export.together import text_writer, write_together
from fieldgrid.maps import Readable, Selection

MAX_SIDE_PX = 65_535
MAX_PIXELS = 1 << 30
"""What usual programs read of a PNG (2 bytes a pixel), though the format itself allows more."""

_END = b"\0\0\0\0IEND\xaeB`\x82"
_LEVEL = 1
"""Of compression: others take several times as long, for a tenth of the bytes."""


def export_png(
    universal: Readable,
    path: Path,
    selection: Selection,
    options: PlaneOptions,
    *,
    overwrite: bool,
) -> Exported:
    """Write the density, or `max`, as PNG: grey is the value, alpha 255 where a cell was observed.

    Beside it come a world file (.pgw: the pixels' sides, and the centre of the upper left one),
    the system as .prj, and a .png.aux.xml in which GDAL and QGIS find both again, with the tags of
    the GeoTIFF. Raises ConfigError for a picture that usual programs do not open; other errors as
    in `write_geotiff`.
    """
    with (
        painted(universal, path, selection, options.epsg, check=_check_size) as raster,
        ExitStack() as stack,
    ):
        made = raster.scratch.file("picture", ".png")
        notes = made.with_name(f"{made.name}.aux.xml")
        stack.callback(notes.unlink, missing_ok=True)

        def write_notes(file: Path) -> None:
            """Have GDAL make the PNG, which writes its notes beside it; keep the notes."""
            import rasterio.shutil

            rasterio.shutil.copy(raster.file, made, driver="PNG", zlevel=_LEVEL)
            with made.open("rb") as opened:
                opened.seek(-len(_END), 2)
                if opened.read() != _END:
                    raise MapWriteError(
                        "The disk is full and cut the picture short; free some space."
                    )
            notes.replace(file)

        placed = raster.plane.transform
        # The pixels' sides and turns, and the centre of the upper left pixel.
        world = (placed.a, placed.d, placed.b, placed.e, *raster.plane.at(0.5, 0.5))
        paths = write_together(
            {
                path.with_name(f"{path.name}.aux.xml"): write_notes,
                path.with_suffix(".prj"): text_writer(
                    raster.plane.crs.to_wkt(version="WKT1_ESRI") + "\n"
                ),
                path.with_suffix(".pgw"): text_writer("".join(f"{float(v)!r}\n" for v in world)),
                path: made.replace,
            },
            overwrite=overwrite,
            ours=is_ours,
            what="a PNG",
        )
    return Exported((paths[-1], *paths[:-1]), raster.rows, raster.about)


def grey_png(grey: UInt8, alpha: UInt8, level: int) -> bytes:
    """A PNG in colour, which all viewers take, of grey values and alpha [rows, columns], the first
    row uppermost; `level` is that of compression."""
    import cv2

    pixels = np.dstack([grey, grey, grey, alpha])
    _, encoded = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, level])
    return bytes(encoded)


def _check_size(plane: PixelPlane) -> None:
    if max(plane.width, plane.height) > MAX_SIDE_PX or plane.width * plane.height > MAX_PIXELS:
        raise ConfigError(
            f"A PNG of {plane.width} x {plane.height} pixels is more than usual programs open "
            f"({MAX_SIDE_PX} a side, {MAX_PIXELS / 1e6:.0f} million); give smaller bounds or a "
            "larger cell, or write a GeoTIFF."
        )


register_export_format(
    ExportFormat(
        "png",
        (".png",),
        "picture with a world file",
        export_png,
        PlaneOptions,
        Holds.GREY,
        several=True,
        readers="GIS, any viewer",
        extras=("gis",),
        limits="65535 a side, 2^30 pixels",
    )
)
