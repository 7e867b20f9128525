"""Shapes in longitude and latitude."""

from __future__ import annotations

from typing import Any

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.geometry.geodesy import Datum, continued_deg

DECIMALS = 9
"""Of degrees: a tenth of a millimetre."""


def in_degrees(geometry: Any, datum: Datum) -> Any:
    """Geometries in longitude and latitude, nine decimals, of points in the datum's plane.

    At the meridian of 180° they are cut, as RFC 7946 has it: a line that goes from 179.9999° to
    -179.9999° would span the world.
    """
    import shapely

    def turned(places: Float64) -> Float64:
        lat_deg, lon_deg, _ = datum.to_geodetic(places[:, 0], places[:, 1], np.zeros(len(places)))
        degrees = np.column_stack([continued_deg(lon_deg, datum.lon_deg), lat_deg])
        return np.asarray(degrees.round(DECIMALS))

    found = shapely.transform(shapely.force_2d(geometry), turned)
    west, _, east, _ = np.moveaxis(shapely.bounds(found), -1, 0)
    beyond = (west < -180.0) | (east > 180.0)
    if not np.any(beyond):
        return found
    if np.ndim(found) == 0:
        return _cut(found)
    found[beyond] = [_cut(shape) for shape in found[beyond]]
    return found


def _cut(shape: Any) -> Any:
    """A shape that reaches beyond ±180° of longitude in parts that do not, those of a line in its
    own order."""
    import shapely

    size = int(shapely.get_dimensions(shape))
    parts: list[Any] = []
    along: list[float] = []
    for turns in (-1, 0, 1):
        middle = 360.0 * turns
        world = shapely.box(middle - 180.0, -90.0, middle + 180.0, 90.0)
        for part in shapely.get_parts(shapely.intersection(shape, world)):
            if part.is_empty or shapely.get_dimensions(part) != size:
                continue
            parts.append(shapely.transform(part, lambda at, middle=middle: at - [middle, 0.0]))
            middle_point = part.interpolate(0.5, normalized=True) if size == 1 else None
            along.append(0.0 if middle_point is None else float(shape.project(middle_point)))
    several = (shapely.multipoints, shapely.multilinestrings, shapely.multipolygons)
    ordered = [parts[k] for k in np.argsort(along, kind="stable")]
    rounded = shapely.transform(ordered, lambda at: at.round(DECIMALS))
    if len(rounded) == 1:
        return rounded[0]
    return several[size](rounded)
