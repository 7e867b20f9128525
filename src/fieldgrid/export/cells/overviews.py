"""Overviews of a raster, by the map's own rule for larger cells: a pixel is made of the channels of
all cells in it, not of the values of finer pixels.

GDAL's own averages would weigh a cell seen once like one seen a hundred times, and would blur the
mask: every reader would have to guess from which alpha on a cell counts as observed.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from fieldgrid.export.cells.raster import BLOCK_PX, Raster, creating, warp
from fieldgrid.export.plane import PixelPlane
from fieldgrid.export.selection import Selection
from fieldgrid.maps import Readable


def write_overviews(
    universal: Readable, selection: Selection, raster: Raster, smallest_px: int = BLOCK_PX
) -> list[Path]:
    """Rasters of half the size, of a quarter, and so on, until the longer side of one has at most
    `smallest_px` pixels, by default those of a block."""
    from rasterio.windows import Window as Pixels

    planes, cells = [raster.plane], [raster.cells]
    while max(planes[-1].width, planes[-1].height) > smallest_px:
        planes.append(_half(planes[-1]))
        cells.append(_half(cells[-1]))
    levels = [raster.scratch.file(f"level{k}") for k in range(1, len(planes))]
    if not levels:
        return []
    with ExitStack() as stack:
        datasets = [
            stack.enter_context(creating(file, plane, raster.layout, {}))
            for file, plane in zip(levels, cells[1:], strict=True)
        ]
        for block in stack.enter_context(selection.overviews(universal, len(levels))):
            height, width = block.observed.shape
            place = Pixels(block.column, block.row, width, height)
            for number, band in enumerate(raster.layout.bands(block, selection.layer), 1):
                datasets[block.level - 1].write(band, number, window=place)
    if raster.plane != raster.cells:
        for k, (file, plane) in enumerate(zip(list(levels), planes[1:], strict=True)):
            levels[k] = raster.scratch.file(f"projected{k + 1}")
            warp(file, levels[k], plane, raster.layout, {})
    return levels


def _half(plane: PixelPlane) -> PixelPlane:
    from rasterio.transform import Affine

    placed = plane.transform
    return plane._replace(
        width=-(-plane.width // 2),
        height=-(-plane.height // 2),
        transform=Affine(2.0 * placed.a, 0.0, placed.c, 0.0, 2.0 * placed.e, placed.f),
    )
