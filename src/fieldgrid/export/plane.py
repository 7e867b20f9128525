"""Where the pixels of a raster lie, and a raster seen in another plane."""

from __future__ import annotations

from typing import Any, NamedTuple

_NEARER_PX = 0.01
"""How far from its exact place, in cells, a reprojected pixel may look for its value."""


class PixelPlane(NamedTuple):
    """Where the pixels are: `crs` and `transform` as rasterio has them, row 0 in the north."""

    width: int
    height: int
    crs: Any
    transform: Any

    def at(self, column: float, row: float) -> tuple[float, float]:
        """Where a point of the raster is; 0, 0 is the corner of its upper left pixel."""
        placed = self.transform
        return placed.c + placed.a * column, placed.f + placed.e * row


def warped(source: Any, plane: PixelPlane) -> Any:
    """An open raster in another plane, to be closed: each pixel has the cell that its centre falls
    in, or nothing."""
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    return WarpedVRT(
        source,
        crs=plane.crs,
        transform=plane.transform,
        width=plane.width,
        height=plane.height,
        resampling=Resampling.nearest,
        tolerance=_NEARER_PX,
        # Of an alpha band the warper would make weights; here it is a band like another.
        src_alpha=0,
    )
