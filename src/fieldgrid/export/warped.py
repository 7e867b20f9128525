"""A raster as it is in another plane, made block by block when it is read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fieldgrid.export.raster import Plane

_NEARER_PX = 0.01
"""How far from its exact place, in cells, a reprojected pixel may look for its value."""


def warped(source: Any, plane: Plane) -> Any:
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
