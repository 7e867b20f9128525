"""GPS time to UTC."""

from __future__ import annotations

from bisect import bisect_right
from datetime import date

UNIX_EPOCH = date(1970, 1, 1).toordinal()
_WEEK_S = 7 * 86_400
GPS_EPOCH_UNIX_S = (date(1980, 1, 6).toordinal() - UNIX_EPOCH) * 86_400

# The days that a leap second precedes; none is announced after the last.
_AFTER_LEAP = (
    (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7),
    (1993, 7), (1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7),
    (2015, 7), (2017, 1),
)  # fmt: skip
_LEAPS_GPS_S = [
    (date(year, month, 1).toordinal() - UNIX_EPOCH) * 86_400 - GPS_EPOCH_UNIX_S + count
    for count, (year, month) in enumerate(_AFTER_LEAP, start=1)
]


def unix_ns(week: int, of_week_ns: int) -> int:
    """UTC, nanoseconds since 1970, of a full GPS week number and nanoseconds in it.

    ValueError for times that no receiver can have seen.
    """
    if not (0 <= week < 11_000 and 0 <= of_week_ns < _WEEK_S * 1_000_000_000):
        raise ValueError(f"GPS week {week}, {of_week_ns} ns")
    gps_s, fraction_ns = divmod(of_week_ns, 1_000_000_000)
    gps_s += week * _WEEK_S
    leaps = bisect_right(_LEAPS_GPS_S, gps_s)
    return (GPS_EPOCH_UNIX_S + gps_s - leaps) * 1_000_000_000 + fraction_ns


def leap_seconds(time_ns: int) -> int:
    """How many seconds GPS time is ahead of UTC at a time in UTC, nanoseconds since 1970."""
    gps_s = time_ns // 1_000_000_000 - GPS_EPOCH_UNIX_S
    return sum(gps_s >= leap_s - count for count, leap_s in enumerate(_LEAPS_GPS_S, start=1))
