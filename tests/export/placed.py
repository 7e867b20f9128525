"""Whether an export shows the asymmetric map where it is: independent of the code that writes.

A picture is asked at points whose longitude and latitude come from PROJ's own topocentric plane:
5 mm on either side of every edge that the map has, and 2000 points anywhere. What it must say
there is in `asymmetric.truth`, which is made of rectangles. So a picture that passes lies within
5 mm, the right way up, with the right values and nothing where nobody looked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyproj
import rasterio

from tests.export.asymmetric import DATUM, EXTENT, Truth, enu, geodetic, probes, truth

_Array = npt.NDArray[Any]
EDGE_M = 0.005

SAYS: dict[str, Callable[[Truth], _Array]] = {
    "density": lambda true: true.density,
    "count": lambda true: true.sessions,  # each saw each of its cells once
    "sessions": lambda true: true.sessions,
    "max": lambda true: true.highest,
    "variance": lambda true: true.variance,
    "persistence": lambda true: true.persistence,
}


@dataclass(frozen=True)
class Picture:
    """Pixels as a reader has them: row 0 first; x = a·column + c and y = e·row + f of corners."""

    values: _Array
    seen: _Array
    wkt: str
    a: float
    c: float
    e: float
    f: float


def opened(path: Path) -> Picture:
    """A raster as GDAL reads it."""
    with rasterio.open(path) as dataset:
        placed = dataset.transform
        assert (placed.b, placed.d) == (0.0, 0.0)
        assert dataset.crs is not None, "it has no reference system"
        return Picture(
            dataset.read(1),
            dataset.dataset_mask() > 0,
            dataset.crs.to_wkt(version="WKT2_2019"),
            placed.a,
            placed.c,
            placed.e,
            placed.f,
        )


def faults(picture: Picture, layer: str = "density") -> list[str]:
    """What is wrong with a picture whose pixels are the map's own cells."""
    east, north = probes()
    lat, lon, _ = geodetic(east, north)
    to_plane = pyproj.Transformer.from_crs("EPSG:4979", picture.wkt, always_xy=True)
    x, y = to_plane.transform(lon, lat)
    column = np.floor((x - picture.c) / picture.a)
    row = np.floor((y - picture.f) / picture.e)
    height, width = picture.values.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    values = np.zeros(len(east), dtype=np.float64)
    seen = np.zeros(len(east), dtype=np.bool_)
    place = row[inside].astype(int), column[inside].astype(int)
    values[inside], seen[inside] = picture.values[place], picture.seen[place]
    return compared(values, seen, truth(east, north), layer)


def faults_at_centres(picture: Picture, layer: str = "density") -> list[str]:
    """What is wrong with a picture of another plane: each pixel's centre is looked at, but for
    those within 5 mm of an edge."""
    height, width = picture.values.shape
    x = picture.c + picture.a * (np.arange(width) + 0.5)
    y = picture.f + picture.e * (np.arange(height) + 0.5)
    to_earth = pyproj.Transformer.from_crs(picture.wkt, "EPSG:4326", always_xy=True)
    lon, lat = to_earth.transform(*np.meshgrid(x, y))
    east, north, _ = enu(lat, lon)
    here = truth(east, north)
    sure = np.ones(here.observed.shape, dtype=np.bool_)
    for off_e in (-EDGE_M, EDGE_M):
        for off_n in (-EDGE_M, EDGE_M):
            near = truth(east + off_e, north + off_n)
            sure &= (near.density == here.density) & (near.observed == here.observed)
            sure &= near.sessions == here.sessions
    assert sure.mean() > 0.8
    part = Truth(*(field[sure] for field in here))
    part = Truth(*(field[sure] for field in here))
    found = compared(picture.values[sure], picture.seen[sure], part, layer)
    return [*found, *_cut_off(picture)]


def _cut_off(picture: Picture) -> list[str]:
    """The corners of the map, seen from a cell inside, that are not in a picture."""
    east = np.array([EXTENT.west_m, EXTENT.east_m, EXTENT.east_m, EXTENT.west_m])
    north = np.array([EXTENT.south_m, EXTENT.south_m, EXTENT.north_m, EXTENT.north_m])
    inwards = np.array([1, -1, -1, 1]), np.array([1, 1, -1, -1])
    lat, lon, _ = geodetic(east + EDGE_M * inwards[0], north + EDGE_M * inwards[1])
    to_plane = pyproj.Transformer.from_crs("EPSG:4326", picture.wkt, always_xy=True)
    x, y = to_plane.transform(lon, lat)
    height, width = picture.values.shape
    column, row = (x - picture.c) / picture.a, (y - picture.f) / picture.e
    inside = (column >= 0) & (row >= 0) & (column <= width) & (row <= height)
    return [] if inside.all() else [f"{np.count_nonzero(~inside)} corners are cut off"]


def compared(values: _Array, seen: _Array, true: Truth, layer: str) -> list[str]:
    """Differences of values and masks from the truth, counted."""
    wrong_mask = int(np.count_nonzero(seen != true.observed))
    both = seen & true.observed
    expected = SAYS[layer](true)[both]
    wrong = int(np.count_nonzero(np.abs(values[both].astype(np.float64) - expected) > 1e-3))
    found = [f"{wrong_mask} of {seen.size} masks"] if wrong_mask else []
    return [*found, f"{wrong} of {both.sum()} values"] if wrong else found


def mutants(picture: Picture) -> dict[str, Picture]:
    """The mistakes that exporters make, made on purpose."""
    values, seen = picture.values, picture.seen
    # The datum's latitude, rounded as some formats do: 2 cm.
    datum = f"+proj=tmerc +lat_0={DATUM.lat_deg + 2e-7} +lon_0={DATUM.lon_deg} +ellps=WGS84"
    return {
        "transposed": replace(picture, values=values.T, seen=seen.T),
        "mirrored": replace(picture, values=values[:, ::-1], seen=seen[:, ::-1]),
        "upside down": replace(picture, values=values[::-1], seen=seen[::-1]),
        "turned": replace(picture, values=values[::-1, ::-1], seen=seen[::-1, ::-1]),
        "half a cell east": replace(picture, c=picture.c + picture.a / 2),
        "half a cell south": replace(picture, f=picture.f + picture.e / 2),
        "a cell north": replace(picture, f=picture.f - picture.e),
        "centimetres east": replace(picture, c=picture.c + 0.2 * picture.a),
        "cells too large by a thousandth": replace(picture, a=1.001 * picture.a),
        "another datum": replace(picture, wkt=datum),
        "unknown is empty": replace(picture, seen=np.ones_like(seen)),
        "empty is unknown": replace(picture, seen=seen & (values > 0)),
        "values off by one": replace(picture, values=values + np.uint8(1)),
    }
