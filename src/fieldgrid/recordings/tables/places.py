"""Latitude and longitude of a table's rows: in degrees, in other ways of writing them, or as the
coordinates of a projection."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, RecordingError
from fieldgrid.geometry import unprojected
from fieldgrid.recordings.tables.columns import Columns, how_to_say
from fieldgrid.recordings.tables.roles import EASTING, NORTHING, ROLES, guess
from fieldgrid.recordings.tables.tables import OpenTable, TableRows
from fieldgrid.recordings.tables.units import UNITS, take_apart

# Nothing that was read is given back, so that each sign is looked at once.
_PART = r"(\d++(?:\.\d++)?+)"
_ANGLE = re.compile(
    rf"([NSEW]?)\s*+([+-]?){_PART}\s*+(?:°|º|deg|d)?+\s*+"
    rf"(?:{_PART}\s*+(?:'|\u2032|\u2019|m)?+\s*+"
    rf"(?:{_PART}\s*+(?:\"|\u2033|\u201d|''|(?-i:s))?+\s*+)?+)?+([NSEW]?)",
    re.IGNORECASE,
)
_LEAST_E7, _MOST_E7 = 1e8, 1.8e9
"""Whole numbers from here on are 1e-7 degrees, as u-blox and MAVLink count: coordinates of
projections are no larger."""


class CoordinateColumn(NamedTuple):
    """The column of one coordinate, with the letters of its sides and the worth of its unit."""

    name: str
    place: int
    sides: str
    worth: float

    def numbers(self, table: OpenTable, block: TableRows) -> Float64:
        """Degrees or metres of some rows, NaN where there are none."""
        return self.worth * table.numbers(block, self.place, self._degrees)

    def _degrees(self, cell: str) -> float | None:
        """Degrees of a text like 41°39'1.3"N or 4.72 W; None for what is none."""
        match = _ANGLE.fullmatch(cell.strip())
        if match is None:
            return None
        before, sign, *numbers, after = match.groups()
        side = (before + after).upper()
        whole, minutes, seconds = (float(number or 0.0) for number in numbers)
        if len(side) > 1 or (side and (side not in self.sides or sign)):
            return None
        if minutes >= 60.0 or seconds >= 60.0:
            return None
        size = whole + minutes / 60.0 + seconds / 3600.0
        return -size if sign == "-" or side == self.sides[1] else size


class Places(NamedTuple):
    """Where a table has its positions: columns of latitude and longitude, or, in a projection
    `crs`, of northing and easting; degrees and minutes are in one number where it says so."""

    table: OpenTable
    lat: CoordinateColumn
    lon: CoordinateColumn
    crs: str = ""
    in_minutes: bool = False
    notes: tuple[str, ...] = ()

    @classmethod
    def find(cls, table: OpenTable, columns: Columns) -> Places:
        """The positions of a table by its names and what is said of them; their unit also by the
        first rows.

        RecordingError names the values, and what to say of them, where they are no degrees.
        """
        axes = []
        for role, projected, sides in (("lat", NORTHING, "NS"), ("lon", EASTING, "EW")):
            name = guess(projected, table.header) if columns.crs else None
            if role in columns.names or name is None:
                name = columns.find(role, table.header, table.path)
            if not name:
                raise RecordingError(
                    f"{table.path} has no column {ROLES[role].own}, and none whose name is known "
                    f"for it; name it: {how_to_say(**{role: 'COLUMN'})}; {_PROJECTED}. It has: "
                    f"{', '.join(table.header)[:500]}."
                )
            worth = take_apart(name).worth("angle")
            if columns.lat_lon_units or columns.crs:
                worth = UNITS["angle"].get(columns.lat_lon_units, 1.0)
            axes.append(CoordinateColumn(name, table.header.index(name), sides, worth))
        found = cls(table, axes[0], axes[1], columns.crs, columns.lat_lon_units == "ddmm")
        if columns.lat_lon_units or columns.crs:
            what = f"coordinates of {columns.crs}" if columns.crs else f"in {columns.lat_lon_units}"
            return found._replace(notes=(f"positions {what}.",))
        return found._settled()

    def lat_lon(self, block: TableRows) -> tuple[Float64, Float64]:
        """Degrees of some rows, NaN where there is no position."""
        lat, lon = (axis.numbers(self.table, block) for axis in (self.lat, self.lon))
        if self.crs:
            return unprojected(self.crs, lat, lon)
        return (_of_minutes(lat), _of_minutes(lon)) if self.in_minutes else (lat, lon)

    def _settled(self) -> Places:
        """With the unit that the first rows show."""
        lat, lon = self.lat_lon(self.table.sample)
        known = np.flatnonzero(np.isfinite(lat) & np.isfinite(lon))
        both = np.abs([lat[known], lon[known]])
        usual = np.median(both, axis=1) if known.size else np.zeros(2)
        if usual[0] <= 90.0 and usual[1] <= 180.0:
            return self
        if usual.max() > _LEAST_E7 and both.max() <= _MOST_E7 and (both % 1.0 == 0.0).all():
            return self._replace(
                lat=self.lat._replace(worth=UNITS["angle"]["e7"]),
                lon=self.lon._replace(worth=UNITS["angle"]["e7"]),
                notes=("positions taken as whole numbers of 1e-7 degrees.",),
            )
        raise RecordingError(
            f"{self.table.path}: {self.lat.name} {lat[known[0]]:.12g} and {self.lon.name} "
            f"{lon[known[0]]:.12g} are no degrees; if they are degrees and minutes in one number, "
            f"as 4139.0228 is 41° 39.0228', give {how_to_say(lat_lon_units='ddmm')}; if 1e-7 "
            f"degrees, lat_lon_units=e7; {_PROJECTED}."
        )


_PROJECTED = (
    "if they are northing and easting in metres of a projection, as of UTM zone 30 north, name it: "
    + how_to_say(crs="EPSG:32630")
)


def _of_minutes(values: Float64) -> Float64:
    size = np.abs(values)
    whole = np.floor(size / 100.0)
    return np.copysign(whole + (size - 100.0 * whole) / 60.0, values)
