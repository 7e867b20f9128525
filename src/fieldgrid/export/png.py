"""A map as PNG with what places it: a world file, its system, and GDAL's own notes."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from fieldgrid.errors import ConfigError, MapWriteError
from fieldgrid.export.options import PlaneOptions
from fieldgrid.export.plane import PixelPlane
from fieldgrid.export.raster import Raster, is_ours, painted
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format
from fieldgrid.export.selection import Selection
from fieldgrid.export.together import write_together
from fieldgrid.mapfile import Readable

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
    in `export_geotiff`.
    """
    with ExitStack() as stack:
        picture = _Picture(
            stack.enter_context(
                painted(universal, path, selection, options.epsg, check=_check_size)
            )
        )
        stack.callback(picture.discard)
        paths = write_together(
            {
                path.with_name(f"{path.name}.aux.xml"): picture.write_notes,
                path.with_suffix(".prj"): picture.write_system,
                path.with_suffix(".pgw"): picture.write_world,
                path: picture.write_pixels,
            },
            overwrite=overwrite,
            ours=is_ours,
            what="a PNG",
        )
    return Exported((paths[-1], *paths[:-1]), picture.raster.rows, picture.raster.about)


class _Picture:
    """A raster as PNG and the files beside it, each written when it is asked for."""

    def __init__(self, raster: Raster) -> None:
        self.raster = raster
        self._made = raster.scratch.file("picture", ".png")
        self._notes = self._made.with_name(f"{self._made.name}.aux.xml")

    def write_notes(self, file: Path) -> None:
        """What GDAL has to say of a PNG beside it; it does so when it makes one."""
        import rasterio.shutil

        rasterio.shutil.copy(self.raster.file, self._made, driver="PNG", zlevel=_LEVEL)
        with self._made.open("rb") as opened:
            opened.seek(-len(_END), 2)
            if opened.read() != _END:
                raise MapWriteError("The disk is full and cut the picture short; free some space.")
        self._notes.replace(file)

    def write_system(self, file: Path) -> None:
        """The reference system, in the words that sidecars have."""
        file.write_text(self.raster.plane.crs.to_wkt(version="WKT1_ESRI") + "\n")

    def write_world(self, file: Path) -> None:
        """Six numbers: the pixels' sides and turns, and the centre of the upper left pixel."""
        placed = self.raster.plane.transform
        x, y = self.raster.plane.at(0.5, 0.5)
        numbers = (placed.a, placed.d, placed.b, placed.e, x, y)
        file.write_text("".join(f"{float(number)!r}\n" for number in numbers))

    def write_pixels(self, file: Path) -> None:
        """The PNG itself."""
        self._made.replace(file)

    def discard(self) -> None:
        """Remove what GDAL left beside its work."""
        self._notes.unlink(missing_ok=True)


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
