"""Fixes, tilts, datums and rigs as messages of ROS, made and read: one table for both ways.

A NavSatFix has no place for most of what a receiver says, and its status has four values. So each
is followed by what it cannot say, as JSON on a topic beside it, which is taken in its place where a
bag is read here, and which others need not know.
"""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np

from fieldgrid.core import (
    CARRIER,
    CalibrationError,
    DatumError,
    Float64,
    Int64,
    Quality,
    parse_json,
)
from fieldgrid.geometry import (
    Datum,
    Fix,
    FixColumns,
    Orientation,
    RecordedTilt,
    Rig,
    quality_by_sigma,
)
from fieldgrid.recordings.ros.ros_messages import MAP, header_of, new, text

DATUM, RIG, DETAILS = "/datum", "/fieldgrid/rig", "/details"
"""Topics of the datum and the rig, and what follows the name of a topic of fixes in that of what
they cannot say."""

TILT, ORIENTATION = "/fieldgrid/tilt", "/fieldgrid/orientation"
"""Topics of recorded roll and pitch, which an Imu could hold only with a heading."""

UP_SHARE = 2.0
"""How many times less sure a receiver's height is than its position."""

_NO_FIX, _FIX, _SBAS_FIX, _GBAS_FIX = -1, 0, 1, 2
# A fix, one with satellite-based and one with ground-based corrections. What no satellites gave
# (estimated, manual, simulated) is no fix.
_STATUS = {
    Quality.UNKNOWN: _FIX,
    Quality.GPS: _FIX,
    Quality.PPS: _FIX,
    Quality.SBAS: _SBAS_FIX,
    Quality.DIFFERENTIAL: _GBAS_FIX,
    Quality.RTK_FIXED: _GBAS_FIX,
    Quality.RTK_FLOAT: _GBAS_FIX,
}
_QUALITY = {
    _NO_FIX: Quality.NONE,
    _FIX: Quality.GPS,
    _SBAS_FIX: Quality.SBAS,
    _GBAS_FIX: Quality.DIFFERENTIAL,
}
_ALL_SERVICES = 15
_UNKNOWN, _APPROXIMATED, _DIAGONAL = 0, 1, 2
_MOST_TEXT = 1 << 16


def nav_sat_fix(fix: Fix, frame: str) -> Any:
    """A sensor_msgs/NavSatFix: altitude above the ellipsoid, and what the message can hold."""
    if fix.sigma_m is not None and fix.sigma_m > 0.0 and math.isfinite(fix.sigma_m):
        sigma_m, known = fix.sigma_m, _DIAGONAL
    elif fix.quality in CARRIER:
        # Without it nothing in the message would tell it from a plain differential fix.
        sigma_m, known = fix.position_sigma_m, _APPROXIMATED
    else:
        sigma_m, known = 0.0, _UNKNOWN
    variances = sigma_m**2 * np.array([1.0, 1.0, UP_SHARE**2])
    status = _STATUS.get(fix.quality, _NO_FIX)
    return new(
        "sensor_msgs/NavSatFix",
        header=header_of(fix.time_ns, frame),
        status=new("sensor_msgs/NavSatStatus", status=status, service=_ALL_SERVICES),
        latitude=fix.lat_deg,
        longitude=fix.lon_deg,
        altitude=fix.height_m,
        position_covariance=np.diag(variances).reshape(-1),
        position_covariance_type=known,
    )


def quality_of(message: Any) -> tuple[Quality, float | None]:
    """The quality of a sensor_msgs/NavSatFix, and its 1-sigma error along one horizontal axis.

    The quality is that of the status, and RTK fixed where the covariance says centimetres. A
    covariance of unknown type, of zeros or of nonsense says nothing.
    """
    quality = _QUALITY.get(int(message.status.status), Quality.UNKNOWN)
    sigma_m = _sigma_m(message)
    if quality is Quality.NONE or sigma_m is None:
        return quality, sigma_m
    by_sigma = Quality(int(quality_by_sigma(sigma_m)))
    return (quality if by_sigma is Quality.UNKNOWN else by_sigma), sigma_m


def _sigma_m(message: Any) -> float | None:
    if message.position_covariance_type == _UNKNOWN or len(message.position_covariance) != 9:
        return None
    east, north = (float(message.position_covariance[k]) for k in (0, 4))
    if not (east > 0.0 and north > 0.0):
        return None
    mean = east if east == north else (east + north) / 2.0
    return math.sqrt(mean) if math.isfinite(mean) else None


def details_message(fix: Fix) -> Any:
    """A std_msgs/String of what a NavSatFix cannot say: JSON of the fields of a fix by name."""
    said = {name: value for name, value in fix._asdict().items() if value is not None}
    for name in ("lat_deg", "lon_deg", "height_m"):
        del said[name]
    return text(json.dumps(said))


class JsonRows:
    """What a topic of such texts says: `names` are the numbers of a row, besides its time. A number
    that is missing, or not below `most`, is NaN."""

    def __init__(self, names: tuple[str, ...], most: float) -> None:
        self._names, self._most = names, most
        self._times_ns, self._values = array("q"), array("d")

    def add(self, said: str) -> None:
        """One text; what is no such text is passed over."""
        values = _object(said)
        time_ns = values.get("time_ns")
        if not isinstance(time_ns, int) or not 0 < time_ns < 1 << 63:
            return
        self._times_ns.append(time_ns)
        for value in map(values.get, self._names):
            is_known = isinstance(value, int | float) and abs(value) < self._most
            self._values.append(float(value) if is_known and value is not None else math.nan)

    def _rows(self) -> tuple[Int64, Float64]:
        """Times [n] and numbers [n, names]."""
        values = np.array(self._values, dtype=np.float64).reshape(-1, len(self._names))
        return np.array(self._times_ns, dtype=np.int64), values


class Details(JsonRows):
    """What such texts say of the fixes on the topic beside them."""

    def __init__(self) -> None:
        super().__init__(Fix._fields[4:], 1e9)

    def added_to(self, fixes: FixColumns) -> FixColumns:
        """The fixes, those of a time of which something is said with what is said of them."""
        times_ns, said = self._rows()
        at = np.arange(len(times_ns))
        if not np.array_equal(times_ns, fixes.time_ns):
            first = dict(zip(times_ns[::-1].tolist(), at[::-1].tolist(), strict=True))
            at = np.array([first.get(t, -1) for t in fixes.time_ns.tolist()], dtype=np.int64)
        rows = np.flatnonzero(at >= 0)
        columns = {}
        for name, values in zip(self._names, said[at[rows]].T, strict=True):
            column = getattr(fixes, name).copy()
            if column.dtype == np.int64:
                values = np.where(np.isnan(values), -1.0, np.round(values))
                if name in ("quality", "heading_quality"):
                    values[(values < Quality.UNKNOWN) | (values > Quality.SBAS)] = Quality.UNKNOWN
            column[rows] = values
            columns[name] = column
        return fixes.replace(**columns)


def tilt_messages(tilt: RecordedTilt | Orientation) -> Iterator[tuple[int, Any]]:
    """A std_msgs/String for each row, JSON of its fields by name, with its time."""
    for row in zip(*(column.tolist() for column in tilt), strict=True):
        yield row[0], text(json.dumps(dict(zip(tilt._fields, row, strict=True))))


class Tilts(JsonRows):
    """What such texts say: rows of `kind`, whole ones only."""

    def __init__(self, kind: type[RecordedTilt | Orientation]) -> None:
        super().__init__(kind._fields[1:], 1e3)
        self._kind = kind

    def found(self) -> RecordedTilt | Orientation | None:
        """The rows in order of time, None where there are none."""
        times_ns, values = self._rows()
        known = np.isfinite(values).all(axis=1)
        times_ns, first = np.unique(times_ns[known], return_index=True)
        return self._kind(times_ns, *values[known][first].T.copy()) if len(times_ns) else None


def datum_message(datum: Datum, time_ns: int) -> Any:
    """A sensor_msgs/NavSatFix of the origin of the frame `map`; its height is ellipsoidal."""
    origin = Fix(time_ns, datum.lat_deg, datum.lon_deg, datum.height_m)
    return nav_sat_fix(origin, MAP)


def datum_of(message: Any) -> Datum | None:
    """The datum of such a message; None for what is none."""
    try:
        return Datum(message.latitude, message.longitude, message.altitude)
    except (DatumError, AttributeError):
        return None


def rig_message(rig: Rig) -> Any:
    """A std_msgs/String of a rig, exactly, for which transforms have no place."""
    return text(json.dumps(rig.as_dict()))


def rig_of(message: Any) -> Rig | None:
    """The rig of such a message; None for what is none."""
    try:
        return Rig.from_dict(_object(message.data))
    except CalibrationError:
        return None


def _object(said: str) -> dict[str, Any]:
    """The JSON object of a text, an empty one where it is none."""
    try:
        values = parse_json(said) if len(said) < _MOST_TEXT else None
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}
