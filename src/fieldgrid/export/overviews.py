"""Overviews of a raster: each pixel says what four of the level below say of the seen ones.

GDAL's own averages would blur the mask: a pixel that is half seen would be half transparent, and
every reader would have to guess from which alpha on a cell counts as observed.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.array_types import AnyArray
from fieldgrid.export.raster import BLOCK_PX, Layout, Plane, Raster, creating, windows
from fieldgrid.kernel import kernel

_THREADS = 2


def write_overviews(raster: Raster) -> list[Path]:
    """Rasters of half the size, of a quarter, and so on, until one block holds all."""
    levels: list[Path] = []
    source, plane = raster.file, raster.plane
    while max(plane.width, plane.height) > BLOCK_PX:
        plane = _half(plane)
        levels.append(raster.scratch.file(f"level{len(levels) + 1}"))
        _write_half(source, levels[-1], plane, raster.layout)
        source = levels[-1]
    return levels


def _half(plane: Plane) -> Plane:
    from rasterio.transform import Affine

    placed = plane.transform
    return plane._replace(
        width=-(-plane.width // 2),
        height=-(-plane.height // 2),
        transform=Affine(2.0 * placed.a, 0.0, placed.c, 0.0, 2.0 * placed.e, placed.f),
    )


def _write_half(source: Path, file: Path, plane: Plane, layout: Layout) -> None:
    parts = windows(plane.width, plane.height, BLOCK_PX)
    with (
        ThreadPoolExecutor(_THREADS, thread_name_prefix="fieldgrid-overviews") as pool,
        creating(file, plane, layout, {}) as dataset,
    ):
        while some := list(islice(parts, _THREADS)):
            for part, halved in zip(
                some, pool.map(lambda part: _read_half(source, part, layout), some), strict=True
            ):
                if halved is not None:
                    dataset.write(halved, window=part)


def _read_half(source: Path, part: Any, layout: Layout) -> AnyArray | None:
    """The overview of what a window of it covers in the level below."""
    import rasterio

    with rasterio.open(source) as below:  # of its own: no two threads may share one
        rows = 2 * part.row_off, min(2 * (part.row_off + part.height), below.height)
        columns = 2 * part.col_off, min(2 * (part.col_off + part.width), below.width)
        return halve(below.read(window=(rows, columns)), layout)


def halve(pixels: AnyArray, layout: Layout) -> AnyArray | None:
    """The overview [bands, ceil(rows / 2), ceil(columns / 2)] of pixels [bands, rows, columns].

    None when there is nothing in it.
    """
    values = pixels[0]
    unseen: float = layout.nodata or 0
    if layout.alpha:
        seen = pixels[1]
    elif math.isnan(unseen):
        seen = (~np.isnan(values)).view(np.uint8)
    else:
        seen = (values != unseen).view(np.uint8)
    if not seen.any():
        return None
    if values.shape[0] % 2 or values.shape[1] % 2:
        beyond = tuple((0, side % 2) for side in values.shape)
        values, seen = np.pad(values, beyond), np.pad(seen, beyond)
    shape = values.shape[0] // 2, values.shape[1] // 2
    halved = np.empty((len(pixels), *shape), dtype=values.dtype)
    mask = halved[1] if layout.alpha else np.empty(shape, dtype=np.uint8)
    rounding = 0.5 if values.dtype.kind == "u" else 0.0
    combine_four(values, seen, layout.highest, rounding, unseen, halved[0], mask)
    return halved


@kernel
def combine_four(  # type: ignore[no-untyped-def]
    values, seen, highest, rounding, unseen, halved, mask
):
    """Fill `halved` with the mean, or the highest, of the seen ones of 2 x 2 values, or else with
    `unseen`, and `mask` with 255 or 0. `rounding` is added to means that are cut to whole numbers.

    Without branches or divisions, so that the loop runs in vector registers.
    """
    share = np.array([0.0, 1.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 4.0])
    for j in range(halved.shape[0]):
        y = 2 * j
        for i in range(halved.shape[1]):
            x = 2 * i
            a, b = seen[y, x] != 0, seen[y, x + 1] != 0
            c, d = seen[y + 1, x] != 0, seen[y + 1, x + 1] != 0
            value_a = float(values[y, x]) if a else 0.0
            value_b = float(values[y, x + 1]) if b else 0.0
            value_c = float(values[y + 1, x]) if c else 0.0
            value_d = float(values[y + 1, x + 1]) if d else 0.0
            count = int(a) + int(b) + int(c) + int(d)
            mean = (value_a + value_b + value_c + value_d) * share[count] + rounding
            most = max(max(value_a, value_b), max(value_c, value_d))
            mask[j, i] = 255 if count else 0
            halved[j, i] = (most if highest else mean) if count else unseen
