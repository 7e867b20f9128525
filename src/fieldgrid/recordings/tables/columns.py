"""Which column of a table holds what: by a mapping that is given, else by common names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import NamedTuple

from fieldgrid.core import ConfigError, quoted, shortened
from fieldgrid.recordings.tables.times import UNITS, zone_scale

SPEEDS = {
    "mps": 1.0, "m_s": 1.0, "mmps": 1e-3, "mm_s": 1e-3, "cm_s": 1e-2,
    "kmh": 1 / 3.6, "km_h": 1 / 3.6, "kph": 1 / 3.6, "mph": 0.44704,
    "knots": 1852 / 3600, "knot": 1852 / 3600, "kn": 1852 / 3600, "kts": 1852 / 3600,
}  # fmt: skip
_US_FOOT_M = 1200 / 3937
LENGTHS = {
    "m": 1.0, "mm": 1e-3, "cm": 1e-2, "metres": 1.0, "meters": 1.0,
    "ft": 0.3048, "feet": 0.3048, "foot": 0.3048,
    "us_ft": _US_FOOT_M, "usft": _US_FOOT_M, "ftus": _US_FOOT_M, "us_survey_ft": _US_FOOT_M,
    "us_survey_feet": _US_FOOT_M,
}  # fmt: skip
_ANGLES = {"deg": "deg", "degrees": "deg", "rad": "rad", "radians": "rad"}

HEADING_UNITS = ("deg", "rad", "deg_ccw_east", "rad_ccw_east")
"""Of a recorded heading: clockwise from north, or counter-clockwise from east (ROS)."""

# What a column is called, without unit and without words like "gps" before it; in the order of
# preference. Words in the second group mean an accuracy of both axes together.
_NAMES: dict[str, tuple[str, ...]] = {
    "lat": ("lat", "latitude", "lat_dd", "latitude_dd", "lat_wgs84", "latitude_wgs84"),
    "lon": ("lon", "lng", "long", "longitude", "lon_dd", "longitude_dd", "lon_wgs84"),
    "height": (
        *("ellipsoidal_height", "ellipsoid_height", "height_ellipsoid", "height_ellipsoidal"),
        *("height_above_ellipsoid", "h_ell", "hae", "alt_ellipsoid", "altitude_ellipsoid"),
        *("height", "h", "up", "alt", "altitude", "elevation"),
        *("ele", "hmsl", "altitude_msl", "alt_msl", "msl"),
    ),
    "quality": (
        *("quality", "fix_quality", "fixquality", "qual", "qualityindicator", "gga_quality"),
        *("position_status", "quality_indicator", "solution_status", "rtk_status", "status"),
        *("fix_status", "fix_type", "fixtype", "fix", "carrier", "carrsoln", "solution"),
    ),
    "satellites": (
        *("satellites", "num_sats", "numsv", "num_sv", "num_satellites", "numsats", "nsats"),
        *("satellites_used", "used_satellites", "satellites_in_use", "n_sats", "sats", "nsat"),
        *("sat_count", "satellite_count", "num_sat", "n_satellites", "siv"),
    ),
    "hdop": ("hdop", "h_dop", "horizontal_dop", "horizontal_dilution"),
    "age": (
        *("age", "diff_age", "differential_age", "correction_age", "age_of_corrections"),
        *("age_of_differential", "dgps_age", "age_diff", "diffage", "age_of_diff"),
    ),
    "sigma": ("sigma", "sigma_h", "horizontal_sigma"),
    "accuracy": (
        *("hacc", "h_acc", "horizontal_accuracy", "accuracy", "hrms", "h_rms", "lateral_rms"),
        *("accuracy_horizontal", "eph", "hpe", "horizontal_rms"),
    ),
    "speed": (
        *("speed", "ground_speed", "groundspeed", "gspeed", "g_speed", "speed_over_ground"),
        *("sog", "drive_speed", "velocity", "vehicle_speed"),
    ),
    "heading": (
        *("heading", "true_heading", "heading_true", "hdg", "att_heading", "attitude_heading"),
        *("headveh", "head_veh", "heading_vehicle", "dual_heading", "nose_heading", "azimuth"),
        *("relposheading", "rel_pos_heading", "baseline_heading"),
    ),
    "heading_sigma": (
        *("heading_sigma", "heading_accuracy", "heading_acc", "heading_std", "head_acc"),
        *("headacc", "acc_heading", "accheading", "heading_stddev"),
    ),
    "heading_valid": (
        *("heading_valid", "head_valid", "headvalid", "headingvalid", "heading_ok"),
        *("rel_pos_heading_valid", "relposheadingvalid"),
    ),
    "course": (
        *("course", "cog", "course_over_ground", "track", "track_made_good", "headmot"),
        *("head_mot", "heading_of_motion", "heading_motion", "true_course", "bearing"),
    ),
    "date": ("date", "utc_date", "day"),
    "week": ("week", "weekno", "week_number", "wn", "wnc", "gwk", "gpsweek"),
    "tow": (
        *("tow", "itow", "time_of_week", "seconds_of_week", "i_tow", "tow_s", "itow_s"),
        *("tow_ms", "itow_ms", "time_of_week_ms", "time_of_week_s", "sow", "seconds_in_week"),
        *("week_seconds", "gms", "gpstow", "gpssow", "gpsseconds", "gps_seconds"),
    ),
}  # fmt: skip
_BEFORE = frozenset(
    {"gps", "gnss", "field", "msg", "navsatfix", "rtk", "position", "pos", "rover", "fix"}
)
_TIME_WORDS = frozenset(
    {"time", "timestamp", "stamp", "datetime", "utc", "epoch", "t", "tstamp", "gpst"}
)
_NO_TIME_WORDS = frozenset(
    {"delta", "elapsed", "uptime", "duration", "zone", "timezone", "diff", "since", "boot", "fix"}
)
_OPTIONS = (
    *("time_units", "time_zone", "time_epoch", "speed_units", "height_units", "heading_units"),
    *("lat_lon_units", "crs"),
)
LAT_LON_UNITS = ("deg", "ddmm", "e7", "rad")
"""Of positions: degrees, degrees and minutes in one number as in NMEA, 1e-7 degrees, radians."""

# Of a projection, in the place of latitude and longitude.
_PROJECTED = {
    "lat": ("northing", "utm_northing", "northings", "north", "utm_north", "utm_y", "y", "n"),
    "lon": ("easting", "utm_easting", "eastings", "east", "utm_east", "utm_x", "x", "e"),
}

ROLES = ("time", *_NAMES)
"""What a column may be mapped to."""


class ColumnName(NamedTuple):
    """A column's name taken apart: words without unit, the unit, and a factor before it."""

    base: str
    unit: str = ""
    factor: float = 1.0


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
        for key, known_units in (
            ("time_units", (*UNITS, *(f"gps_{unit}" for unit in UNITS))),
            ("speed_units", tuple(SPEEDS)),
            ("height_units", tuple(LENGTHS)),
            ("heading_units", HEADING_UNITS),
            ("lat_lon_units", LAT_LON_UNITS),
        ):
            value = getattr(self, key)
            if value and value not in known_units:
                raise ConfigError(
                    f"Columns: {key} is {quoted(value)}; give one of {', '.join(known_units)}."
                )
        if self.crs and self.lat_lon_units:
            raise ConfigError("Columns: crs is of metres; leave lat_lon_units out.")
        if self.time_zone:
            try:
                zone_scale(self.time_zone)
            except ValueError as problem:
                raise ConfigError(f"Columns: time_zone {problem}; correct it.") from problem
        if self.time_epoch:
            epoch_s(self.time_epoch)
            if self.time_zone or self.time_units.startswith("gps_"):
                raise ConfigError(
                    "Columns: time_epoch counts from a moment of UTC; leave time_zone and the GPS "
                    "scale out."
                )


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
    for key, value in mapping.items():
        if not isinstance(value, str):
            raise ConfigError(
                f"Columns: {key} is {shortened(repr(value), 60)}; give a column name in quotes."
            )
    said = {key: str(value) for key, value in mapping.items()}
    options = {key: said.pop(key) for key in _OPTIONS if key in said}
    return Columns(said, **options)


def columns_from_text(text: str) -> Columns:
    """The columns by an option like ``time=stamp,lat=Lat,heading_units=rad_ccw_east``."""
    mapping: dict[str, str] = {}
    for item in text.split(","):
        key, equals, value = item.partition("=")
        if not equals:
            raise ConfigError(
                f"Columns: {quoted(item)} is not KEY=COLUMN; write it like lat=Latitude."
            )
        if key.strip() in mapping:
            raise ConfigError(f"Columns: {key.strip()} is given twice; keep one.")
        mapping[key.strip()] = value.strip()
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


_BEFORE_UNIT = re.compile(r"(.+)_(?:(\d+)p(\d+))?")


def take_apart(name: str) -> ColumnName:
    """The words of a column name: ``Speed [km/h]`` is speed in km_h."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", "_", name)
    plain = re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")
    factor = 1.0
    for unit in sorted((*SPEEDS, *LENGTHS, *_ANGLES), key=len, reverse=True):
        match = _BEFORE_UNIT.fullmatch(plain.removesuffix(unit)) if plain.endswith(unit) else None
        if match is not None:
            if match[2]:
                factor = float(f"{match[2]}.{match[3]}")
            return ColumnName(_without_prefix(match[1]), unit, factor)
    return ColumnName(_without_prefix(plain))


def _without_prefix(plain: str) -> str:
    words = plain.split("_")
    while len(words) > 1 and words[0] in _BEFORE and plain not in _ALL_NAMES:
        words = words[1:]
        plain = "_".join(words)
    return plain


_ALL_NAMES = frozenset(name for names in _NAMES.values() for name in names)


def guess(role: str, header: Sequence[str], *, projected: bool = False) -> str | None:
    """The column that holds a role by its name, as it stands in the header; of a projection,
    northing and easting by their own names first."""
    bases = [(take_apart(name).base, name) for name in header]
    for wanted in (*_PROJECTED[role], *_NAMES[role]) if projected else _NAMES[role]:
        for base, name in bases:
            if base in (wanted, wanted.replace("_", "")):
                return name
    return None


def time_candidates(header: Sequence[str]) -> list[str]:
    """Columns that may hold the time, the project's own names first."""
    own = [name for name in ("time_ns", "timestamp_utc_s") if name in header]
    others = []
    for name in header:
        words = set(re.sub(r"[^a-z0-9]+", " ", name.lower()).split())
        joined = any(word in name.lower() for word in ("time", "stamp", "epoch"))
        # What begins anew every week is no time by itself, though its size may look like one.
        of_week = guess("tow", [name]) is not None
        if (words & _TIME_WORDS or joined) and not words & _NO_TIME_WORDS and not of_week:
            others.append(name)
    return own + [name for name in others if name not in own]


def metres(cell: str) -> float | None:
    """The length of a cell that has its unit with it, like 2625.5 ft; None of another."""
    # Bounded, since the parts of the pattern can share what is between them.
    match = re.fullmatch(
        r"([+-]?\d{1,20}(?:\.\d{0,20})?)\s{0,9}([A-Za-z][A-Za-z .]{0,30}?)\.?", cell.strip()
    )
    unit = "" if match is None else re.sub(r"[ .]+", "_", match[2].lower())
    return None if match is None or unit not in LENGTHS else float(match[1]) * LENGTHS[unit]


def is_radians(unit: str) -> bool:
    """Whether a unit of angles is the radian."""
    return _ANGLES.get(unit, unit.split("_", maxsplit=1)[0]) == "rad"
