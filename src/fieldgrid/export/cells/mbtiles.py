"""A map as MBTiles: the tiles of a web map in one SQLite file, by the specification 1.3.

Tiles are PNG of 256 x 256 pixels, grey and alpha, in Web Mercator. The finest zoom has pixels no
larger than the cells; each zoom above it shows the overview of the map's own rule with cells twice
as large, no average of pixels. Tiles are made one by one, and only where something was observed.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from fieldgrid.core import ConfigError, MapWriteError, Settings, mentions, replacing
from fieldgrid.export.cells.png import grey_png
from fieldgrid.export.cells.raster import Raster, painted
from fieldgrid.export.plane import PixelPlane, warped
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format
from fieldgrid.maps import LAYERS, Readable, Selection

TILE_PX = 256
SMALLEST_PX = 64
"""Most cells along a side of the coarsest zoom, which shows all of the map in four tiles at most.
"""

MARGIN_PX = 2
"""How far beyond a tile it is looked for anything: finer tiles show edges of cells that no pixel of
this one has its centre in."""

WORLD_M = 2.0 * math.pi * 6_378_137.0
"""A side of Web Mercator's square."""

MOST_LAT_DEG = 85.0
"""Web Mercator ends a little beyond."""

_APPLICATION_ID = 0x4D504258  # "MPBX", by the specification
_MARK = "fieldgrid_datum_lat_deg"
_LEVEL = 3
"""Of compression."""


def export_mbtiles(
    universal: Readable, path: Path, selection: Selection, _: Settings, *, overwrite: bool
) -> Exported:
    """Write a layer of whole numbers as MBTiles; grey is the value, and what was not observed is
    transparent or has no tile.

    The metadata have the datum, too. Until the file is complete some three times the size of its
    pixels is used beside it. Raises ConfigError when rasterio is not installed, for a map beside a
    pole and for what cannot be selected, MapExistsError when `path` exists and may not be
    overwritten, MapWriteError when it cannot be written.
    """
    if abs(universal.datum.lat_deg) > MOST_LAT_DEG:
        raise ConfigError(
            f"Web Mercator does not reach to the latitude of {universal.datum.lat_deg:.1f}°, so "
            "there are no tiles of this map; write a GeoTIFF."
        )
    with (
        replacing(
            path,
            overwrite=overwrite,
            ours=lambda file: mentions(file, _MARK.encode()),
            what="an MBTiles",
        ) as file,
        painted(universal, path, selection, None, smallest_px=SMALLEST_PX) as raster,
        ExitStack() as opened,
    ):
        zooms = _Zooms(
            opened,
            [raster.file, *raster.overviews],
            raster.plane,
            universal.datum.lat_deg,
        )
        try:
            count = _write(file, zooms, _metadata(path.stem, zooms, universal, selection, raster))
        except sqlite3.Error as error:
            raise MapWriteError(
                f"{path} could not be written ({error}); check the space on the disk."
            ) from error
    told = (("zooms", f"{zooms.coarsest} to {zooms.finest}"), ("tiles", str(count)))
    about = {
        **{key: value for key, value in raster.about.items() if not key.startswith("pixel")},
        "epsg": 3857,
        "zooms": [zooms.coarsest, zooms.finest],
        "tiles": count,
    }
    return Exported((path,), (*(row for row in raster.rows if row[0] != "plane"), *told), about)


class _Zooms:
    """The zooms of a raster and its overviews, each as it lies in Web Mercator."""

    def __init__(
        self, opened: ExitStack, levels: Sequence[Path], plane: PixelPlane, lat_deg: float
    ) -> None:
        import rasterio
        from rasterio.crs import CRS
        from rasterio.warp import transform_bounds

        corners = (*plane.at(0, plane.height), *plane.at(plane.width, 0))
        area = transform_bounds(plane.crs, CRS.from_epsg(3857), *corners, densify_pts=99)
        if area[2] - area[0] > WORLD_M / 2.0:
            raise ConfigError(
                "The map lies on both sides of the meridian of 180°, where Web Mercator ends; "
                "export the parts to the west and to the east of it by --bounds, or write a "
                "GeoTIFF."
            )
        on_ground_m = WORLD_M / TILE_PX * math.cos(math.radians(lat_deg))
        self.finest = max(math.ceil(math.log2(on_ground_m / plane.transform.a)), 0)
        # GDAL begins its raster at the bounds, so they go by whole pixels.
        pixel_m = WORLD_M / 2**self.finest / TILE_PX
        low = [math.floor(v / pixel_m) * pixel_m for v in area[:2]]
        high = [math.ceil(v / pixel_m) * pixel_m for v in area[2:]]
        self.bounds_deg = (*_lon_lat_deg(*low), *_lon_lat_deg(*high))
        self.coarsest = max(self.finest - len(levels) + 1, 0)
        self._ranges: dict[int, tuple[int, int, int, int]] = {}
        self._sources: dict[int, Any] = {}
        for zoom in range(self.coarsest, self.finest + 1):
            tile_m = WORLD_M / 2**zoom
            west, east = (int((x + WORLD_M / 2.0) // tile_m) for x in (area[0], area[2]))
            north, south = (int((WORLD_M / 2.0 - y) // tile_m) for y in (area[3], area[1]))
            self._ranges[zoom] = (west, north, east, south)
            found = opened.enter_context(rasterio.open(levels[self.finest - zoom]))
            self._sources[zoom] = opened.enter_context(warped(found, self._plane(zoom)))

    def tiles(self) -> Iterator[tuple[int, int, int, bytes]]:
        """The tiles in which something was observed, each before the finer ones in it: the zoom,
        the numbers east and south of the square's corner in the north-west, and the PNG."""
        west, north, east, south = self._ranges[self.coarsest]
        for y in range(north, south + 1):
            for x in range(west, east + 1):
                yield from self._within(self.coarsest, x, y)

    def _within(self, zoom: int, x: int, y: int) -> Iterator[tuple[int, int, int, bytes]]:
        from rasterio.windows import Window

        west, north, east, south = self._ranges[zoom]
        if not (west <= x <= east and north <= y <= south):
            return
        side = TILE_PX + 2 * MARGIN_PX
        part = Window((x - west) * TILE_PX, (y - north) * TILE_PX, side, side)
        grey, alpha = self._sources[zoom].read(window=part)
        if not alpha.any():
            return
        inner = slice(MARGIN_PX, MARGIN_PX + TILE_PX)
        if alpha[inner, inner].any():
            yield zoom, x, y, grey_png(grey[inner, inner], alpha[inner, inner], _LEVEL)
        if zoom < self.finest:
            for south_east in range(4):
                yield from self._within(zoom + 1, 2 * x + south_east % 2, 2 * y + south_east // 2)

    def _plane(self, zoom: int) -> PixelPlane:
        """All tiles of a zoom together, with a margin."""
        from rasterio.crs import CRS
        from rasterio.transform import Affine

        west, north, east, south = self._ranges[zoom]
        pixel_m = WORLD_M / 2**zoom / TILE_PX
        placed = Affine(
            pixel_m,
            0.0,
            (west * TILE_PX - MARGIN_PX) * pixel_m - WORLD_M / 2.0,
            0.0,
            -pixel_m,
            WORLD_M / 2.0 - (north * TILE_PX - MARGIN_PX) * pixel_m,
        )
        width, height = (
            (last - first + 1) * TILE_PX + 2 * MARGIN_PX
            for first, last in ((west, east), (north, south))
        )
        return PixelPlane(width, height, CRS.from_epsg(3857), placed)


def _lon_lat_deg(x_m: float, y_m: float) -> tuple[float, float]:
    """A place in Web Mercator."""
    radius_m = WORLD_M / (2.0 * math.pi)
    return math.degrees(x_m / radius_m), math.degrees(math.atan(math.sinh(y_m / radius_m)))


def _write(file: Path, zooms: _Zooms, metadata: list[tuple[str, str]]) -> int:
    """Write the file; returns how many tiles it has."""
    count = 0
    with closing(sqlite3.connect(file, isolation_level=None)) as database:
        # Nobody reads a draft, and a draft that is cut short is thrown away.
        database.execute("pragma journal_mode = off")
        database.execute("pragma synchronous = off")
        database.execute(f"pragma application_id = {_APPLICATION_ID}")
        database.execute("create table metadata (name text primary key, value text)")
        database.execute(
            "create table tiles (zoom_level integer, tile_column integer, tile_row integer, "
            "tile_data blob, primary key (zoom_level, tile_column, tile_row))"
        )
        database.executemany("insert into metadata values (?, ?)", metadata)
        database.execute("begin")
        for zoom, x, y, picture in zooms.tiles():
            row = 2**zoom - 1 - y  # counted from the south
            database.execute("insert into tiles values (?, ?, ?, ?)", (zoom, x, row, picture))
            count += 1
        database.execute("commit")
    return count


def _metadata(
    name: str, zooms: _Zooms, universal: Readable, selection: Selection, raster: Raster
) -> list[tuple[str, str]]:
    """What the specification asks for, and the datum."""
    west, south, east, north = zooms.bounds_deg
    datum, layer = universal.datum, selection.layer
    return [
        ("name", f"{name} {layer}"),
        ("description", f"{LAYERS[layer].meaning}; cells of {raster.about['cell_m']:g} m"),
        ("format", "png"),
        ("type", "overlay"),
        ("version", "1.3"),
        ("bounds", f"{west:.11f},{south:.11f},{east:.11f},{north:.11f}"),
        ("center", f"{(west + east) / 2:.9f},{(south + north) / 2:.9f},{zooms.coarsest}"),
        ("minzoom", str(zooms.coarsest)),
        ("maxzoom", str(zooms.finest)),
        (_MARK, repr(float(datum.lat_deg))),
        ("fieldgrid_datum_lon_deg", repr(float(datum.lon_deg))),
        ("fieldgrid_datum_height_m", repr(float(datum.height_m))),
    ]


register_export_format(
    ExportFormat(
        "mbtiles",
        (".mbtiles",),
        "tiles of a web map, PNG in Web Mercator",
        export_mbtiles,
        holds=Holds.GREY,
        several=True,
        readers="web maps, mobile apps, GIS",
        extras=("gis",),
        limits="10^10 cells",
    )
)
