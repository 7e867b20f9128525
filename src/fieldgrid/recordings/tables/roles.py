"""What a column may hold, and by which names it is found: one table for logs, IMU and wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from fieldgrid.recordings.tables.units import take_apart


class ColumnRole(NamedTuple):
    """What columns hold: the project's own name for one ('' where it has none), which is the field
    of `FixColumns` that it fills; its quantity in `UNITS`; and what others call it, without unit
    and without words like "gps" before it, in the order of preference. A user says its unit by
    `option`."""

    own: str
    quantity: str
    known: tuple[str, ...]
    option: str = ""


ROLES: Mapping[str, ColumnRole] = {
    "time": ColumnRole("", "", ()),
    "lat": ColumnRole(
        "lat_deg", "angle",
        ("lat", "latitude", "lat_dd", "latitude_dd", "lat_wgs84", "latitude_wgs84"),
        "lat_lon_units",
    ),
    "lon": ColumnRole(
        "lon_deg", "angle",
        ("lon", "lng", "long", "longitude", "lon_dd", "longitude_dd", "lon_wgs84"),
        "lat_lon_units",
    ),
    "height": ColumnRole(
        "height_m", "length",
        (
            *("ellipsoidal_height", "ellipsoid_height", "height_ellipsoid", "height_ellipsoidal"),
            *("height_above_ellipsoid", "h_ell", "hae", "alt_ellipsoid", "altitude_ellipsoid"),
            *("height", "h", "up", "alt", "altitude", "elevation"),
            *("ele", "hmsl", "altitude_msl", "alt_msl", "msl"),
        ),
        "height_units",
    ),
    "quality": ColumnRole(
        "quality", "",
        (
            *("quality", "fix_quality", "fixquality", "qual", "qualityindicator", "gga_quality"),
            *("position_status", "quality_indicator", "solution_status", "rtk_status", "status"),
            *("fix_status", "fix_type", "fixtype", "fix", "carrier", "carrsoln", "solution"),
        ),
    ),
    "satellites": ColumnRole(
        "satellites", "",
        (
            *("satellites", "num_sats", "numsv", "num_sv", "num_satellites", "numsats", "nsats"),
            *("satellites_used", "used_satellites", "satellites_in_use", "n_sats", "sats", "nsat"),
            *("sat_count", "satellite_count", "num_sat", "n_satellites", "siv"),
        ),
    ),
    "hdop": ColumnRole("hdop", "", ("hdop", "h_dop", "horizontal_dop", "horizontal_dilution")),
    "age": ColumnRole(
        "age_s", "",
        (
            *("age", "diff_age", "differential_age", "correction_age", "age_of_corrections"),
            *("age_of_differential", "dgps_age", "age_diff", "diffage", "age_of_diff"),
        ),
    ),
    "sigma": ColumnRole("sigma_m", "length", ("sigma", "sigma_h", "horizontal_sigma")),
    "speed": ColumnRole(
        "speed_mps", "speed",
        (
            *("speed", "ground_speed", "groundspeed", "gspeed", "g_speed", "speed_over_ground"),
            *("sog", "drive_speed", "velocity", "vehicle_speed"),
        ),
        "speed_units",
    ),
    "heading": ColumnRole(
        "heading_deg", "angle",
        (
            *("heading", "true_heading", "heading_true", "hdg", "att_heading", "attitude_heading"),
            *("headveh", "head_veh", "heading_vehicle", "dual_heading", "nose_heading", "azimuth"),
            *("relposheading", "rel_pos_heading", "baseline_heading"),
        ),
        "heading_units",
    ),
    "heading_sigma": ColumnRole(
        "heading_sigma_deg", "angle",
        (
            *("heading_sigma", "heading_accuracy", "heading_acc", "heading_std", "head_acc"),
            *("headacc", "acc_heading", "accheading", "heading_stddev"),
        ),
    ),
    "course": ColumnRole(
        "course_deg", "angle",
        (
            *("course", "cog", "course_over_ground", "track", "track_made_good", "headmot"),
            *("head_mot", "heading_of_motion", "heading_motion", "true_course", "bearing"),
        ),
    ),
    # Of both axes together, and so √2 times the sigma.
    "accuracy": ColumnRole(
        "", "length",
        (
            *("hacc", "h_acc", "horizontal_accuracy", "accuracy", "hrms", "h_rms", "lateral_rms"),
            *("accuracy_horizontal", "eph", "hpe", "horizontal_rms"),
        ),
    ),
    "heading_valid": ColumnRole(
        "", "",
        (
            *("heading_valid", "head_valid", "headvalid", "headingvalid", "heading_ok"),
            *("rel_pos_heading_valid", "relposheadingvalid"),
        ),
    ),
    "date": ColumnRole("", "", ("date", "utc_date", "day")),
    "week": ColumnRole("", "", ("week", "weekno", "week_number", "wn", "wnc", "gwk", "gpsweek")),
    "tow": ColumnRole(
        "", "",
        (
            *("tow", "itow", "time_of_week", "seconds_of_week", "i_tow", "tow_s", "itow_s"),
            *("tow_ms", "itow_ms", "time_of_week_ms", "time_of_week_s", "sow", "seconds_in_week"),
            *("week_seconds", "gms", "gpstow", "gpssow", "gpsseconds", "gps_seconds"),
        ),
    ),
}  # fmt: skip
"""Of the fixes of a table: what a column may be mapped to."""

NORTHING = ColumnRole(
    "", "", ("northing", "utm_northing", "northings", "north", "utm_north", "utm_y", "y", "n")
)
EASTING = ColumnRole(
    "", "", ("easting", "utm_easting", "eastings", "east", "utm_east", "utm_x", "x", "e")
)
"""Of a projection, in the place of latitude and longitude."""

RATES = tuple(
    ColumnRole(f"gyro_{axis}_rad_s", "rate", tuple(f"{name}_{axis}" for name in names))
    for names in [("gyro", "gyr", "angular_velocity", "w", "g", "rate", "angvel", "w_rs_s")]
    for axis in "xyz"
)
FORCES = tuple(
    ColumnRole(f"acc_{axis}_m_s2", "force", tuple(f"{name}_{axis}" for name in names))
    for names in [("acc", "accel", "linear_acceleration", "a", "acceleration", "a_rs_s")]
    for axis in "xyz"
)
WHEELS = ColumnRole(
    "speed_mps", "speed",
    (
        *("speed", "wheel_speed", "velocity", "vel", "v", "vx", "twist_linear_x", "linear_x"),
        *("linear_velocity", "linear_velocity_x", "forward_speed", "odometry_speed"),
    ),
)  # fmt: skip
"""Of an IMU along x, y and z, and of wheels."""

_ALL_NAMES = frozenset(name for role in ROLES.values() for name in role.known)
_BEFORE = frozenset(
    {"gps", "gnss", "field", "msg", "navsatfix", "rtk", "position", "pos", "rover", "fix"}
)


def guess(role: ColumnRole, header: Sequence[str]) -> str | None:
    """The column that holds a role by its name, as it stands in the header."""
    if role.own and role.own in header:
        return role.own
    words = {words_of(name): name for name in reversed(header)}
    either = (words.get(known, words.get(known.replace("_", ""))) for known in role.known)
    return next(filter(None, either), None)


def words_of(name: str) -> str:
    """The name of a column without its unit, and without words before it that say nothing."""
    plain = take_apart(name).base
    words = plain.split("_")
    while len(words) > 1 and words[0] in _BEFORE and plain not in _ALL_NAMES:
        words = words[1:]
        plain = "_".join(words)
    return plain
