"""What a user says of the columns of a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from fieldgrid.core import ConfigError, RecordingError, quoted, shortened
from fieldgrid.recordings.tables.roles import ROLES, guess
from fieldgrid.recordings.tables.times import UNITS as TIME_UNITS, zone_scale
from fieldgrid.recordings.tables.units import UNITS

CCW_EAST = "_ccw_east"
"""After the unit of a heading: counter-clockwise from east (ROS), not clockwise from north."""
_OPTIONS: dict[str, tuple[str, ...]] = {
    "time_units": (*TIME_UNITS, *(f"gps_{unit}" for unit in TIME_UNITS)),
    "time_zone": (),
    "time_epoch": (),
    "speed_units": tuple(UNITS["speed"]),
    "height_units": tuple(UNITS["length"]),
    "heading_units": ("deg", "rad", f"deg{CCW_EAST}", f"rad{CCW_EAST}"),
    # ddmm are degrees and minutes in one number as in NMEA, e7 units of 1e-7 degrees.
    "lat_lon_units": ("deg", "ddmm", "e7", "rad"),
    "crs": (),
}
"""What is said beside the names of columns, and the values that are known; () is any text."""


@dataclass(frozen=True, slots=True)
class Columns:
    """What is said of the columns of a log; what is not said is guessed.

    `names` maps :data:`ROLES` to column names as the header has them, '' for none. The units
    are those of the mapped or guessed column, '' for what its name says. `time_epoch` is the UTC
    from which a relative time counts, '' for a time that is one by itself. `crs` is the projection
    of which `lat` and `lon` are northing and easting, like EPSG:32630; '' for degrees.
    """

    names: Mapping[str, str] = field(default_factory=dict)
    time_units: str = ""
    time_zone: str = ""
    time_epoch: str = ""
    speed_units: str = ""
    height_units: str = ""
    heading_units: str = ""
    lat_lon_units: str = ""
    crs: str = ""

    def __post_init__(self) -> None:
        for role in self.names:
            if role not in ROLES:
                known = ", ".join((*ROLES, *_OPTIONS))
                raise ConfigError(f"Columns: {quoted(role)} cannot be mapped; known are {known}.")
        for option, values in _OPTIONS.items():
            value = getattr(self, option)
            if value and values and value not in values:
                raise ConfigError(
                    f"Columns: {option} is {quoted(value)}; give one of {', '.join(values)}."
                )
        if self.crs and self.lat_lon_units:
            raise ConfigError("Columns: crs is of metres; leave lat_lon_units out.")
        if self.time_epoch and (self.time_zone or self.time_units.startswith("gps_")):
            raise ConfigError(
                "Columns: time_epoch counts from a moment of UTC; leave time_zone and the GPS "
                "scale out."
            )
        try:
            zone_scale(self.time_zone or "UTC")
        except ValueError as problem:
            raise ConfigError(f"Columns: time_zone {problem}; correct it.") from problem
        epoch_s(self.time_epoch or "1980-01-06")

    def find(self, role: str, header: Sequence[str], path: Path) -> str | None:
        """The column of a role: the one that is said, which must be there, else by its name."""
        name = self.names.get(role)
        if name is None:
            return guess(ROLES[role], header)
        if name and name not in header:
            raise RecordingError(
                f"{path} has no column {quoted(name)} for {role}; it has: "
                f"{', '.join(header)[:200]}."
            )
        return name


def epoch_s(text: str, what: str = "Columns: time_epoch") -> int:
    """Unix seconds of a moment that is written like 2026-05-14T07:30:00Z."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = None
    if moment is None or not 1980 <= moment.year <= 2200 or moment.microsecond:
        raise ConfigError(
            f"{what} is {quoted(text)}; give a moment of UTC in whole seconds, like "
            "2026-05-14T07:30:00Z."
        )
    return int((moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp())


def columns_from_mapping(mapping: Mapping[str, object]) -> Columns:
    """The columns by a table of a settings file."""
    said: dict[str, dict[str, str]] = {"names": {}, "options": {}}
    for key, value in mapping.items():
        if not isinstance(value, str):
            raise ConfigError(
                f"Columns: {key} is {shortened(repr(value), 60)}; give a column name in quotes."
            )
        said["options" if key in _OPTIONS else "names"][key] = value
    return Columns(said["names"], **said["options"])


def columns_from_text(text: str) -> Columns:
    """The columns by an option like ``time=stamp,lat=Lat,heading_units=rad_ccw_east``."""
    mapping: dict[str, str] = {}
    for item in text.split(","):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals:
            raise ConfigError(
                f"Columns: {quoted(item)} is not KEY=COLUMN; write it like lat=Latitude."
            )
        if key in mapping:
            raise ConfigError(f"Columns: {key} is given twice; keep one.")
        mapping[key] = value
    return columns_from_mapping(mapping)


def how_to_say(**said: str) -> str:
    """How a user says something of the columns, for the remedy of an error: in every command by
    the recording, and to `track` also by its option."""
    entries = ", ".join(f'{key} = "{value}"' for key, value in said.items())
    option = ",".join(f"{key}={value}" for key, value in said.items())
    return (
        f"{entries} in [gnss.columns] of recording.toml, or --columns {option} for "
        "`fieldgrid track`"
    )
