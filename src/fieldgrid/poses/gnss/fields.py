"""The fields of an NMEA sentence: bytes to numbers, ValueError for what cannot be.

Whatever is in a field, nothing else is raised, and no number is infinite, not a number, or too
large to be squared. An empty field is None. Fields that repeat from sentence to sentence are
remembered, up to a limit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import date
from functools import lru_cache

import numpy as np

from fieldgrid.poses.gnss.gps_time import UNIX_EPOCH

_NUMBER = re.compile(rb"[+-]?(?:\d{1,12}(?:\.\d{0,30})?|\.\d{1,30})")
_TIME = re.compile(rb"(\d\d)(\d\d)(\d\d)(?:\.(\d*))?")
_ANGLE = re.compile(rb"(\d{1,3})(\d\d(?:\.\d*)?)")
FIRST_YEAR, LAST_YEAR = 1980, 2100
"""GPS began in 1980; maps have times until 2116 (2^62 ns)."""

DAY_NS = 86_400_000_000_000

_REMEMBERED = 2048
_MAX_HEIGHT_M = 1e5
_MAX_SPEED_MPS = 1e4
KNOT_MPS, KMH_MPS = 1852.0 / 3600.0, 1.0 / 3.6


def checksums(texts: list[bytes]) -> list[int]:
    """The XOR of the bytes of each text: of many at once much faster than one by one."""
    if not texts:
        return []
    # A zero behind each changes no sum, and there is something to be summed of each.
    joined = np.frombuffer(b"\0".join(texts) + b"\0", np.uint8)
    ends = np.cumsum(np.fromiter(map(len, texts), np.intp, len(texts)) + 1)
    sums: list[int] = np.bitwise_xor.reduceat(joined, np.concatenate([[0], ends[:-1]])).tolist()
    return sums


class UnsaidError(ValueError):
    """A sentence says that there is none of what is read."""


@dataclass(slots=True)
class StreamCounts:
    """What was found in any stream so far: `bad_checksum` counts what is complete and not intact,
    `broken` what cannot be, `no_position` what says so where a position is due, and `repeated`
    positions of an epoch that has one already."""

    bad_checksum: int = 0
    broken: int = 0
    no_position: int = 0
    repeated: int = 0


@lru_cache(_REMEMBERED)
def number(field: bytes) -> float | None:
    """The number of a field."""
    if not field:
        return None
    if not _NUMBER.fullmatch(field):  # float() would also take nan, inf and 1_0
        raise ValueError(field)
    return float(field)


def within(field: bytes, limit: float) -> float:
    """The number of a field, which is not beyond plus or minus a limit; UnsaidError where it is
    empty."""
    value = number(field)
    if value is None:
        raise UnsaidError
    if abs(value) > limit:
        raise ValueError(field)
    return value


@lru_cache(_REMEMBERED)
def course_deg(field: bytes) -> float | None:
    """Degrees clockwise from north, brought into (-180, 180]."""
    if not field:
        return None
    angle = within(field, 360.0)
    if angle > 180.0:
        return angle - 360.0
    return angle if angle > -180.0 else angle + 360.0


def heading_deg(field: bytes) -> float:
    """Degrees as those of a course; UnsaidError where the field is empty."""
    angle = course_deg(field)
    if angle is None:
        raise UnsaidError
    return angle


def tilt_deg(field: bytes) -> float | None:
    """Degrees of a pitch or roll, or of its sigma; None for nonsense, too: the heading beside it is
    no worse for that."""
    try:
        return within(field, 90.0)
    except ValueError:
        return None


@lru_cache(_REMEMBERED)
def integer(field: bytes) -> int | None:
    """The natural number of a field."""
    if not field:
        return None
    if not field.isdigit() or len(field) > 9:
        raise ValueError(field)
    return int(field)


@lru_cache(_REMEMBERED)
def of_day_ns(field: bytes) -> int:
    """Nanoseconds since midnight of `hhmmss.sss`; UnsaidError where the field is empty."""
    if not field:
        raise UnsaidError
    match = _TIME.fullmatch(field)
    if match is None:
        raise ValueError(field)
    fraction = (match[4] or b"").ljust(9, b"0")[:9]
    return clock_ns(int(match[1]), int(match[2]), int(match[3])) + int(fraction)


def clock_ns(hours: int, minutes: int, seconds: int) -> int:
    """Nanoseconds since midnight; second 60 is a leap second."""
    if hours > 23 or minutes > 59 or seconds > 60:
        raise ValueError(hours, minutes, seconds)
    return ((hours * 60 + minutes) * 60 + seconds) * 1_000_000_000


@lru_cache(_REMEMBERED)
def unix_day(day: bytes, month: bytes, year: bytes) -> int | None:
    """Days since 1970 of a date; a year of two digits is one of 1980..2079."""
    if not (day and month and year):
        return None
    d, m, y = (integer(v) or 0 for v in (day, month, year))
    if len(year) == 2:
        y += 1900 if y >= 80 else 2000
    return day_number(y, m, d)


def day_number(year: int, month: int, day: int) -> int:
    """Days since 1970 of a date."""
    if not FIRST_YEAR <= year <= LAST_YEAR:
        raise ValueError(year)
    return date(year, month, day).toordinal() - UNIX_EPOCH


LATITUDE, LONGITUDE = (b"N", b"S", 90.0), (b"E", b"W", 180.0)


def angle_deg(field: bytes, side: bytes, of: tuple[bytes, bytes, float]) -> float:
    """Degrees of `dddmm.mmm` and its side; UnsaidError where the field is empty."""
    if not field:
        raise UnsaidError
    match, (plus, minus, limit) = _ANGLE.fullmatch(field), of
    if match is None or side not in (plus, minus):
        raise ValueError(field)
    degrees, whole_minutes = match.groups()
    minutes = float(whole_minutes)
    angle = int(degrees) + minutes / 60.0
    if minutes >= 60.0 or angle > limit:
        raise ValueError(field)
    return angle if side == plus else -angle


def height_m(altitude: bytes, geoid: bytes = b"") -> float:
    """Height above the ellipsoid of an altitude, UnsaidError for an empty one, and the geoid."""
    return within(altitude, _MAX_HEIGHT_M) + (within(geoid, _MAX_HEIGHT_M) if geoid else 0.0)


def sigma_m(north_m: bytes, east_m: bytes) -> float | None:
    """The sigma along one axis, of those north and east."""
    north, east = number(north_m), number(east_m)
    if north is None or east is None:
        return None
    return math.sqrt((north * north + east * east) / 2.0) or None


def speed_mps(field: bytes, unit_mps: float) -> float | None:
    """The speed of a field in a unit. Some receivers sign it."""
    value = number(field)
    if value is None:
        return None
    speed = abs(value) * unit_mps
    if speed > _MAX_SPEED_MPS:
        raise ValueError(field)
    return speed
