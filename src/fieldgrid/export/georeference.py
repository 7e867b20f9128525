"""Where the plane of a map lies on Earth, for formats that have no room for it of their own."""

from __future__ import annotations

from typing import Any

from fieldgrid.geometry import Datum, Lattice, Window

VERSION = 1

CONVENTION = (
    "x is metres east and y metres north of the datum in its local tangent plane, z is up; a yaw "
    "is 0 in the east and counter-clockwise (REP-103). Heights are above the WGS84 ellipsoid."
)


def extent(lattice: Lattice, window: Window, datum: Datum) -> dict[str, Any]:
    """The datum, the cells and their bounds in metres, as JSON can hold them."""
    bounds = lattice.bounds(window)
    return {
        "datum": {
            "lat_deg": datum.lat_deg,
            "lon_deg": datum.lon_deg,
            "height_m": datum.height_m,
            "ellipsoid": "WGS84",
        },
        "cell_m": lattice.cell_m,
        "width": window.width,
        "height": window.height,
        "bounds_m": dict(zip(("west", "south", "east", "north"), map(float, bounds), strict=True)),
    }


def georeference(lattice: Lattice, window: Window, datum: Datum) -> dict[str, Any]:
    """The datum, the plane, the extent and its corners on Earth, as JSON can hold them.

    `pixel_to_map` is [a, b, c, d, e, f]: x = a·column + b·row + c and y = d·column + e·row + f,
    where column 0.5 and row 0.5 are the centre of the picture's upper left pixel.
    """
    bounds, cell_m = lattice.bounds(window), lattice.cell_m
    east_m = [bounds.west_m, bounds.east_m, bounds.east_m, bounds.west_m]
    north_m = [bounds.south_m, bounds.south_m, bounds.north_m, bounds.north_m]
    lat_deg, lon_deg, _ = datum.to_geodetic(east_m, north_m, 0.0)
    names = ("south_west", "south_east", "north_east", "north_west")
    return {
        "fieldgrid_georeference": VERSION,
        **extent(lattice, window, datum),
        "convention": CONVENTION,
        "crs_wkt": datum.crs_wkt("WKT2_2019"),
        "pixel_to_map": [cell_m, 0.0, bounds.west_m, 0.0, -cell_m, bounds.north_m],
        "corners_deg": {
            name: [round(float(lat), 10), round(float(lon), 10)]
            for name, lat, lon in zip(names, lat_deg, lon_deg, strict=True)
        },
    }
