"""A selection as a raster on disk: plain pixels beside the target, from which pictures are made.

GDAL makes both cloud-optimised GeoTIFFs and PNGs from another raster, so the pixels are written
twice: first as they are, a piece of the map at a time, then in the format that was asked for. No
more than some blocks are ever in memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import AnyArray, ConfigError, Draft, MapWriteError, mentions
from fieldgrid.export.georeference import extent
from fieldgrid.export.plane import PixelPlane, warped
from fieldgrid.export.registry import require
from fieldgrid.geometry import Bounds, Datum, Lattice, Window, check_area_of_use
from fieldgrid.maps import LAYERS, Readable, Selection

BLOCK_PX = 512
_TAG = b"FIELDGRID_DATUM_LAT_DEG"
CACHE_MB = 96
"""What GDAL may keep of the pixels in memory."""

MAX_SIDE_PX = 1 << 30

MOST_STRETCHED = 100.0
"""No system that is used somewhere stretches the ground more along one axis than along the other.
"""


class BandLayout(NamedTuple):
    """How a layer's cells become bands: of this type, with alpha or else a value for nodata.

    Where every value means something, band 2 is alpha: 255 where a cell was observed, 0 where not.
    """

    dtype: str
    alpha: bool
    nodata: float | None


class Raster(NamedTuple):
    """A raster on disk, to be made into something that others read, and its overviews."""

    file: Path
    overviews: list[Path]
    plane: PixelPlane
    layout: BandLayout
    rows: tuple[tuple[str, str], ...]
    about: Mapping[str, Any]
    scratch: Scratch


class Scratch(ExitStack):
    """Files beside a target that are gone when the block of its export ends."""

    def __init__(self, target: Path) -> None:
        super().__init__()
        self._target = target

    def file(self, what: str, ending: str = ".tif") -> Path:
        """A new file; `what` tells it from the other ones of the same export."""
        # It is never published, so a file of that name is safe.
        draft = Draft(self._target.with_name(f"{self._target.name}.{what}{ending}"), overwrite=True)
        # The callback holds the draft, whose file would be removed with it.
        self.callback(lambda: draft.discard())
        return draft.file


@contextmanager
def painted(
    universal: Readable,
    path: Path,
    selection: Selection,
    epsg: int | None,
    *,
    check: Callable[[PixelPlane], None] | None = None,
    smallest_px: int | None = None,
) -> Iterator[Raster]:
    """The selection as a raster beside `path`, in the map's plane or that of an EPSG code.

    With `smallest_px` it has overviews, each of half the size of the one before, until the longer
    side of one has at most so many pixels. Their cells are those of the map, made of all that was
    seen in them: GDAL's own averages would weigh a cell seen once like one seen a hundred times,
    and blur the mask.

    Gone when the block ends. `check` refuses a plane before a pixel is written. Raises ConfigError
    when rasterio is not installed, for a code that is none and for what cannot be selected,
    MapWriteError when the disk does not take it.
    """
    declared = LAYERS[selection.layer]
    layout = BandLayout(declared.dtype, declared.nodata is None, declared.nodata)
    with gdal(path), Scratch(path) as scratch:
        from rasterio.windows import Window as Pixels

        with (
            selection.blocks(universal, smallest_px=smallest_px) as blocks,
            ExitStack() as opened,
        ):
            whole, tags, datum = blocks.window, _tags(universal, selection), universal.datum
            plane = plane_of(datum, blocks.lattice, whole)
            other = None if epsg is None else _reprojected(plane, epsg, datum)
            if check is not None:
                check(other or plane)
            windows, files, datasets = {blocks.lattice: whole, **blocks.levels}, [], {}
            for level, lattice in enumerate(windows):
                files.append(scratch.file(f"level{level}"))
                datasets[lattice] = opened.enter_context(
                    creating(files[-1], _reduced(plane, 1 << level), layout, tags)
                )
            for view in blocks.views:
                window, part = windows[view.lattice], view.window
                from_north = (window.j0 + window.height) - (part.j0 + part.height)
                place = Pixels(part.i0 - window.i0, from_north, part.width, part.height)
                dataset = datasets[view.lattice]
                dataset.write(view.layer(selection.layer)[::-1], 1, window=place)
                if layout.alpha:
                    dataset.write(view.observed[::-1] * np.uint8(255), 2, window=place)
        if other is not None:
            plane = other
            for level, source in enumerate(files):
                files[level] = scratch.file(f"projected{level}")
                warp(source, files[level], _reduced(plane, 1 << level), layout, tags)
        described = _description(
            selection.layer, extent(blocks.lattice, whole, datum), datum, plane, epsg
        )
        yield Raster(files[0], files[1:], plane, layout, *described, scratch)


def _reduced(plane: PixelPlane, times: int) -> PixelPlane:
    """The pixels of an overview, of so many times the side."""
    from rasterio.transform import Affine

    placed = plane.transform
    return plane._replace(
        width=-(-plane.width // times),
        height=-(-plane.height // times),
        transform=Affine(times * placed.a, 0.0, placed.c, 0.0, times * placed.e, placed.f),
    )


def plane_of(datum: Datum, lattice: Lattice, window: Window) -> PixelPlane:
    """The pixels of a window in the map's own plane."""
    from rasterio.crs import CRS
    from rasterio.transform import Affine

    cell_m, bounds = 1.0 / lattice.cells_per_m, lattice.bounds(window)
    transform = Affine(cell_m, 0.0, bounds.west_m, 0.0, -cell_m, bounds.north_m)
    crs = CRS.from_wkt(datum.crs_wkt("WKT1_GDAL"))
    return _checked(PixelPlane(window.width, window.height, crs, transform))


@contextmanager
def gdal(path: Path) -> Iterator[None]:
    """GDAL with bounded memory, its errors as ours about `path`."""
    require(f"Writing {path.name}", "gis", "rasterio")
    import rasterio
    from rasterio._err import CPLE_BaseError  # what copying raises is of no public class
    from rasterio.errors import RasterioError

    try:
        with rasterio.Env(GDAL_CACHEMAX=CACHE_MB):
            yield
    except (RasterioError, CPLE_BaseError) as error:
        why = str(error.__cause__ or error).rstrip(".")
        raise MapWriteError(
            f"{path} could not be written ({why}); check the space on the disk."
        ) from error


@contextmanager
def creating(
    file: Path, plane: PixelPlane, layout: BandLayout, tags: dict[str, str]
) -> Iterator[Any]:
    """A new raster of plain pixels, open for writing; what is not written takes no space."""
    import rasterio
    from rasterio.enums import ColorInterp

    with rasterio.open(
        file,
        "w",
        driver="GTiff",
        dtype=layout.dtype,
        count=1 + layout.alpha,
        width=plane.width,
        height=plane.height,
        crs=plane.crs,
        transform=plane.transform,
        nodata=layout.nodata,
        tiled=True,
        blockxsize=BLOCK_PX,
        blockysize=BLOCK_PX,
        interleave="band",
        sparse_ok=True,
        bigtiff="IF_SAFER",
    ) as dataset:
        if layout.alpha:
            dataset.colorinterp = (ColorInterp.gray, ColorInterp.alpha)
        dataset.update_tags(**tags)
        yield dataset
    check_whole(file)


def check_whole(file: Path) -> None:
    """Raise MapWriteError when the end of a TIFF is missing.

    GDAL keeps the last bytes until a file is closed, and does not tell when the disk is full then.
    """
    import rasterio

    end = 0
    with rasterio.open(file) as dataset:
        for band in dataset.indexes:
            levels: list[tuple[int | None, int, int]] = [(None, dataset.width, dataset.height)]
            for number, factor in enumerate(dataset.overviews(band)):
                levels.append((number, -(-dataset.width // factor), -(-dataset.height // factor)))
            for level, width, height in levels:
                rows, columns = range(-(-height // BLOCK_PX)), range(-(-width // BLOCK_PX))
                for y, x in product(rows, columns):
                    where = ("TIFF", band, level)
                    offset = dataset.get_tag_item(f"BLOCK_OFFSET_{x}_{y}", *where)
                    if offset is not None:  # else the block has no bytes
                        size = dataset.get_tag_item(f"BLOCK_SIZE_{x}_{y}", *where)
                        end = max(end, int(offset) + int(size))
    if file.stat().st_size < end:
        raise MapWriteError("The disk is full and cut a picture short; free some space.")


def is_ours(file: Path) -> bool:
    """Whether a raster, or what lies beside it, has our tags."""
    return mentions(file, _TAG) or mentions(file.with_name(f"{file.name}.aux.xml"), _TAG)


def datum_tags(datum: Datum, lattice: Lattice) -> dict[str, str]:
    """The datum and the cell as tags."""
    return {
        "FIELDGRID_DATUM_LAT_DEG": repr(float(datum.lat_deg)),
        "FIELDGRID_DATUM_LON_DEG": repr(float(datum.lon_deg)),
        "FIELDGRID_DATUM_HEIGHT_M": repr(float(datum.height_m)),
        "FIELDGRID_CELL_M": repr(float(lattice.cell_m)),
    }


def value_range(layer: str, known: AnyArray) -> tuple[float, float]:
    """The least and the greatest value that has a colour, apart also where all are the same."""
    colours = LAYERS[layer].colours
    low, high = colours.low, colours.high
    if low is None or high is None:
        known = known.astype(np.float64)
        low = float(known.min(initial=math.inf)) if low is None else low
        high = float(known.max(initial=-math.inf)) if high is None else high
    if low < high:
        return low, high
    return (low - 0.5, low + 0.5) if math.isfinite(low) else (0.0, 1.0)


def _tags(universal: Readable, selection: Selection) -> dict[str, str]:
    """What a reader of the raster alone has to know."""
    lattice = Lattice(universal.cell_m if selection.cell_m is None else selection.cell_m)
    tags = {
        **datum_tags(universal.datum, lattice),
        "FIELDGRID_LAYER": selection.layer,
        "FIELDGRID_SAYS": LAYERS[selection.layer].meaning,
    }
    if LAYERS[selection.layer].above_datum:
        tags["FIELDGRID_HEIGHT"] = (
            "above the plane that touches the datum: the ellipsoidal height is "
            "FIELDGRID_DATUM_HEIGHT_M + value + (east^2 + north^2) / 12.75e6 m"
        )
    names = selection.names(universal)
    tags |= {"FIELDGRID_SESSIONS": str(len(names)), "FIELDGRID_AS_OF_SESSION": names[-1]}
    last = {info.name: info.last_time_ns for info in universal.sessions()}[names[-1]]
    if last is not None:
        tags["FIELDGRID_AS_OF_TIME"] = datetime.fromtimestamp(last // 10**9, UTC).isoformat()
    return tags


def _description(
    layer: str, place: dict[str, Any], datum: Datum, plane: PixelPlane, epsg: int | None
) -> tuple[tuple[tuple[str, str], ...], dict[str, Any]]:
    """What a raster is, as rows for a reader and as numbers for a program."""
    size, side = [plane.width, plane.height], [plane.transform.a, -plane.transform.e]
    pixels = f"{size[0]} x {size[1]} of {side[0]:.9g} x {side[1]:.9g}"
    rows = (
        ("layer", f"{layer}: {LAYERS[layer].meaning}"),
        ("cells", f"{place['width']} x {place['height']} of {place['cell_m']:g} m"),
        ("west south east north", " ".join(f"{v:.3f}" for v in place["bounds_m"].values()) + " m"),
        ("datum", datum.described()),
        *(() if epsg is None else (("pixels", pixels),)),
        ("plane", "Transverse Mercator at the datum" if epsg is None else f"EPSG:{epsg}"),
    )
    return rows, {"layer": layer, **place, "epsg": epsg, "pixels": size, "pixel_size": side}


def _reprojected(source: PixelPlane, epsg: int, datum: Datum) -> PixelPlane:
    """Square pixels north up that cover a raster, as large as its cells in the middle, or smaller
    along one axis where the system stretches the ground."""
    from rasterio.transform import Affine
    from rasterio.warp import transform, transform_bounds

    crs = _crs_of(epsg)
    check_area_of_use(epsg, datum)
    west, north = source.at(0, 0)
    east, south = source.at(source.width, source.height)
    half_m = source.transform.a * 0.5
    x, y = (west + east) / 2.0, (south + north) / 2.0
    xs, ys = transform(
        source.crs, crs, [x - half_m, x + half_m, x, x], [y, y, y - half_m, y + half_m]
    )
    side_x = math.hypot(xs[1] - xs[0], 0.0 if crs.is_geographic else ys[1] - ys[0])
    side_y = math.hypot(ys[3] - ys[2], 0.0 if crs.is_geographic else xs[3] - xs[2])
    area = Bounds(*transform_bounds(source.crs, crs, west, south, east, north, densify_pts=99))
    # As large in both units of the system: many programs take no other pixels.
    side = min(side_x, side_y)
    if not (all(math.isfinite(v) for v in (*area, side_x, side_y)) and side > 0):
        raise ConfigError(
            f"EPSG:{epsg} ({crs_name(crs)}) does not reach to the map; choose a system that is "
            "used there."
        )
    wide, high = area.east_m - area.west_m, area.north_m - area.south_m
    if wide <= 0.0 or max(wide, high) > MOST_STRETCHED * side * (source.width + source.height):
        raise ConfigError(
            f"The map lies on both sides of where EPSG:{epsg} ({crs_name(crs)}) ends, as at the "
            "meridian of 180°; leave --epsg out, choose a system that goes on there, or export the "
            "parts by --bounds."
        )
    width, height = math.ceil(wide / side), math.ceil(high / side)
    return _checked(
        PixelPlane(
            max(width, 1),
            max(height, 1),
            crs,
            Affine(side, 0.0, area.west_m, 0.0, -side, area.north_m),
        )
    )


def _crs_of(epsg: int) -> Any:
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        crs = CRS.from_epsg(epsg)
    except CRSError as error:
        raise ConfigError(
            f"EPSG:{epsg} is not known to PROJ; give the number of a projected or geographic "
            "system, such as 25830."
        ) from error
    if not (crs.is_projected or crs.is_geographic):
        raise ConfigError(
            f"EPSG:{epsg} is neither a projected nor a geographic system; give one such as 25830."
        )
    return crs


def crs_name(crs: Any) -> str:
    """What a system is called."""
    return str(crs.to_wkt().split('"')[1])


def warp(
    source: Path, file: Path, plane: PixelPlane, layout: BandLayout, tags: dict[str, str]
) -> None:
    """The pixels of another plane: each has the cell that its centre falls in, or nothing."""
    import rasterio
    from rasterio.windows import Window as Pixels

    rows, columns = 2 * BLOCK_PX, 16 * BLOCK_PX  # that are in memory at once
    with (
        rasterio.open(source) as found,
        warped(found, plane) as projected,
        creating(file, plane, layout, tags) as dataset,
    ):
        for row, column in product(range(0, plane.height, rows), range(0, plane.width, columns)):
            width, height = min(columns, plane.width - column), min(rows, plane.height - row)
            part = Pixels(column, row, width, height)
            dataset.write(projected.read(window=part), window=part)


def _checked(plane: PixelPlane) -> PixelPlane:
    if max(plane.width, plane.height) > MAX_SIDE_PX:
        raise ConfigError(
            f"A raster of {plane.width} x {plane.height} pixels is too large; give smaller bounds "
            "or a larger cell."
        )
    return plane
