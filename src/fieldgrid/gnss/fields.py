"""The fields of an NMEA sentence: bytes to numbers, ValueError for what cannot be."""

from __future__ import annotations

import re
from datetime import date

_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)")
_TIME = re.compile(rb"(\d\d)(\d\d)(\d\d)(?:\.(\d*))?")
_ANGLE = re.compile(rb"(\d{1,3})(\d\d(?:\.\d*)?)")
_UNIX_DAY = date(1970, 1, 1).toordinal()


def checksum(text: bytes) -> int:
    """XOR of all bytes: the number folded upon itself, faster than a loop."""
    value = int.from_bytes(text, "big")
    for bits in (1024, 512, 256, 128, 64, 32, 16, 8):
        value ^= value >> bits
    return value & 0xFF


def number(field: bytes) -> float | None:
    """The number of a field, None when it is empty."""
    return required(field) if field else None


def required(field: bytes) -> float:
    """The number of a field that must not be empty."""
    if not _NUMBER.fullmatch(field):  # float() would also take nan, inf and 1_0
        raise ValueError(field)
    return float(field)


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
    minutes = float(match[2])
    angle = int(match[1]) + minutes / 60.0
    if minutes >= 60.0 or angle > limit:
        raise ValueError(field)
    return angle if side == plus else -angle


def unix_day(day: bytes, month: bytes, year: bytes) -> int:
    """Days since 1970 of a date; a year of two digits is one of 1980..2079."""
    d, m, y = (integer(v) or 0 for v in (day, month, year))
    if len(year) == 2:
        y += 1900 if y >= 80 else 2000
    if not 1980 <= y <= 2200:  # GPS began in 1980; 64 bits of nanoseconds end in 2262
        raise ValueError(year)
    return date(y, m, d).toordinal() - _UNIX_DAY
