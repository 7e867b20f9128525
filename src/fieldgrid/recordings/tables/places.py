"""Latitude and longitude of a table's rows: in degrees, in other ways of writing them, or as the
coordinates of a projection."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Float64, RecordingError
from fieldgrid.geometry import unprojected
from fieldgrid.recordings.tables.columns import how_to_say, is_radians, take_apart
from fieldgrid.recordings.tables.tables import OpenTable, TableRows

_E7 = 1e8
"""Beyond this whole numbers are 1e-7 degrees, as u-blox and MAVLink count: coordinates of
projections are no larger."""

# Nothing that was read is given back, so that each sign is looked at once.
_PART = r"(\d++(?:\.\d++)?+)"
_ANGLE = re.compile(
    rf"([NSEW]?)\s*+([+-]?){_PART}\s*+(?:°|º|deg|d)?+\s*+"
    rf"(?:{_PART}\s*+(?:'|\u2032|\u2019|m)?+\s*+"
    rf"(?:{_PART}\s*+(?:\"|\u2033|\u201d|''|(?-i:s))?+\s*+)?+)?+([NSEW]?)",
    re.IGNORECASE,
)


class Places(NamedTuple):
    """Where a table has its positions: columns of latitude and longitude, or, in a projection
    `crs`, of northing and easting. `units` are those of `LAT_LON_UNITS`, '' for what is found."""

    table: OpenTable
    lat_place: int
    lon_place: int
    units: str = ""
    crs: str = ""

    def lat_lon(self, block: TableRows) -> tuple[Float64, Float64]:
        """Degrees of some rows, NaN where there is no position."""
        lat = self.table.numbers(block, self.lat_place, latitude)
        lon = self.table.numbers(block, self.lon_place, longitude)
        if self.crs:
            return unprojected(self.crs, lat, lon)
        if self.units == "ddmm":
            return _of_minutes(lat), _of_minutes(lon)
        if self.units == "rad":
            return np.degrees(lat), np.degrees(lon)
        return (lat * 1e-7, lon * 1e-7) if self.units == "e7" else (lat, lon)

    def settled(self) -> tuple[Places, tuple[str, ...]]:
        """These columns with the units that the first rows show, and a note on what was found.

        RecordingError names the values, and what to say of them, where they are no degrees.
        """
        if self.units or self.crs:
            what = f"coordinates of {self.crs}" if self.crs else f"in {self.units}"
            return self, (f"{self.table.path.name}: positions {what}.",)
        if all(
            is_radians(take_apart(self._name(at)).unit) for at in (self.lat_place, self.lon_place)
        ):
            return self._replace(units="rad"), ()
        lat, lon = self.lat_lon(self.table.sample)
        known = np.flatnonzero(np.isfinite(lat) & np.isfinite(lon))
        if not known.size:
            return self, ()
        lat, lon = lat[known], lon[known]
        if np.median(np.abs(lat)) <= 90.0 and np.median(np.abs(lon)) <= 180.0:
            return self, ()
        whole = bool(np.all(lat == np.round(lat)) and np.all(lon == np.round(lon)))
        largest = max(np.median(np.abs(lat)), np.median(np.abs(lon)))
        if whole and largest > _E7 and np.all(np.abs(lat) <= 9e8) and np.all(np.abs(lon) <= 1.8e9):
            return self._replace(units="e7"), (
                f"{self.table.path.name}: positions taken as whole numbers of 1e-7 degrees.",
            )
        raise RecordingError(
            f"{self.table.path}: {self._name(self.lat_place)} {lat[0]:.12g} and "
            f"{self._name(self.lon_place)} {lon[0]:.12g} are no degrees; {_advice(lat, lon)}."
        )

    def _name(self, place: int) -> str:
        return self.table.header[place]


def _advice(lat: Float64, lon: Float64) -> str:
    """What numbers that are no degrees may be, and what says so."""
    if np.all(_is_minutes(lat, 90)) and np.all(_is_minutes(lon, 180)):
        return (
            "if they are degrees and minutes in one number, as 4139.0228 is 41° 39.0228', give "
            + how_to_say(lat_lon_units="ddmm")
        )
    return (
        "if they are northing and easting of a projection, as of UTM zone 30 north, name it: "
        f'{how_to_say(crs="EPSG:32630")}; if they are 1e-7 degrees, lat_lon_units = "e7" there'
    )


def _is_minutes(values: Float64, most_deg: int) -> Any:
    return (np.abs(values) <= 100 * most_deg) & (np.abs(values) % 100.0 < 60.0)


def _of_minutes(values: Float64) -> Float64:
    size = np.abs(values)
    whole = np.floor(size / 100.0)
    return np.copysign(whole + (size - 100.0 * whole) / 60.0, values)


def latitude(cell: str) -> float | None:
    """Degrees north of a text like 41°39'1.3"N or 41.65 N; None for what is none."""
    return _degrees(cell, "NS")


def longitude(cell: str) -> float | None:
    """Degrees east of a text like 4°43'12.8"W or 4.72 W; None for what is none."""
    return _degrees(cell, "EW")


def _degrees(cell: str, sides: str) -> float | None:
    match = _ANGLE.fullmatch(cell.strip())
    if match is None:
        return None
    before, sign, whole, minutes, seconds, after = match.groups()
    side = (before + after).upper()
    if len(side) > 1 or (side and (side not in sides or sign)):
        return None
    parts = [float(part) if part else 0.0 for part in (whole, minutes, seconds)]
    if parts[1] >= 60.0 or parts[2] >= 60.0:
        return None
    size = parts[0] + parts[1] / 60.0 + parts[2] / 3600.0
    return -size if sign == "-" or side == sides[1] else size
