"""The fields of an NMEA sentence: bytes to numbers, ValueError for what cannot be.

Whatever is in a field, nothing else is raised, and no number is infinite, not a number, or too
large to be squared. Fields that repeat from sentence to sentence are remembered, up to a limit.
"""

from __future__ import annotations

import re
from datetime import date
from functools import lru_cache

import numpy as np

_NUMBER = re.compile(rb"[+-]?(?:\d{1,12}(?:\.\d{0,30})?|\.\d{1,30})")
_TIME = re.compile(rb"(\d\d)(\d\d)(\d\d)(?:\.(\d*))?")
_ANGLE = re.compile(rb"(\d{1,3})(\d\d(?:\.\d*)?)")
_UNIX_DAY = date(1970, 1, 1).toordinal()
FIRST_YEAR, LAST_YEAR = 1980, 2100
"""GPS began in 1980; maps have times until 2116 (2^62 ns)."""

_REMEMBERED = 2048


def checksums(texts: list[bytes]) -> list[int]:
    """The XOR of the bytes of each text: of many at once much faster than one by one."""
    if not texts:
        return []
    # A zero behind each changes no sum, and there is something to be summed of each.
    joined = np.frombuffer(b"\0".join(texts) + b"\0", np.uint8)
    ends = np.cumsum(np.fromiter(map(len, texts), np.intp, len(texts)) + 1)
    sums: list[int] = np.bitwise_xor.reduceat(joined, np.concatenate([[0], ends[:-1]])).tolist()
    return sums


def number(field: bytes) -> float | None:
    """The number of a field, None when it is empty."""
    return required(field) if field else None


@lru_cache(_REMEMBERED)
def required(field: bytes) -> float:
    """The number of a field that must not be empty."""
    if not _NUMBER.fullmatch(field):  # float() would also take nan, inf and 1_0
        raise ValueError(field)
    return float(field)


def within(field: bytes, limit: float) -> float:
    """The number of a field that must not be empty, nor beyond plus or minus a limit."""
    value = required(field)
    if abs(value) > limit:
        raise ValueError(field)
    return value


@lru_cache(_REMEMBERED)
def direction_deg(field: bytes) -> float | None:
    """Degrees clockwise from north, brought into (-180, 180]; None when the field is empty."""
    if not field:
        return None
    angle = within(field, 360.0)
    if angle > 180.0:
        return angle - 360.0
    return angle if angle > -180.0 else angle + 360.0


def tilt_deg(field: bytes) -> float | None:
    """Degrees of a pitch or roll, or of its sigma. None when the field is empty or nonsense: the
    heading beside it is no worse for that."""
    try:
        return within(field, 90.0)
    except ValueError:
        return None


def integer(field: bytes) -> int | None:
    """The natural number of a field, None when it is empty."""
    if not field:
        return None
    if not field.isdigit() or len(field) > 9:
        raise ValueError(field)
    return int(field)


def of_day_ns(field: bytes) -> int:
    """Nanoseconds since midnight of `hhmmss.sss`; second 60 is a leap second."""
    match = _TIME.fullmatch(field)
    if match is None:
        raise ValueError(field)
    hours, minutes, seconds = int(match[1]), int(match[2]), int(match[3])
    if hours > 23 or minutes > 59 or seconds > 60:
        raise ValueError(field)
    fraction = (match[4] or b"").ljust(9, b"0")[:9]
    return ((hours * 60 + minutes) * 60 + seconds) * 1_000_000_000 + int(fraction)


def angle_deg(field: bytes, side: bytes, plus: bytes, minus: bytes, limit: float) -> float:
    """Degrees of `dddmm.mmm` and its side, negative on the `minus` side."""
    match = _ANGLE.fullmatch(field)
    if match is None or side not in (plus, minus):
        raise ValueError(field)
    degrees, whole_minutes = match.groups()
    minutes = float(whole_minutes)
    angle = int(degrees) + minutes / 60.0
    if minutes >= 60.0 or angle > limit:
        raise ValueError(field)
    return angle if side == plus else -angle


@lru_cache(_REMEMBERED)
def unix_day(day: bytes, month: bytes, year: bytes) -> int:
    """Days since 1970 of a date; a year of two digits is one of 1980..2079."""
    d, m, y = (integer(v) or 0 for v in (day, month, year))
    if len(year) == 2:
        y += 1900 if y >= 80 else 2000
    if not FIRST_YEAR <= y <= LAST_YEAR:
        raise ValueError(year)
    return date(y, m, d).toordinal() - _UNIX_DAY
