"""Times as logs write them, whole columns at once, to UTC nanoseconds without rounding."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime
from decimal import Decimal, InvalidOperation
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fieldgrid.core import MAX_TIME_NS, MIN_TIME_NS, Int64, UInt64, quoted
from fieldgrid.poses import GPS_EPOCH_UNIX_S, unix_ns
from fieldgrid.recordings.tables.tables import NOTHING

NO_TIME = 0
"""What stands for an empty cell, and for a time before 1980: the receiver had none yet."""

UNITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Units of a time as decimal places of nanoseconds."""

_LEAST = {"ns": 1e17, "us": 1e14, "ms": 1e11, "s": GPS_EPOCH_UNIX_S}
"""From which number on a time since 1970 is in a unit."""
_MOST = 1e20

_S = 1_000_000_000
_WEEK_NS = 7 * 86_400 * _S
_YEAR_1980_S = 315_532_800
_UNIX_DAY = date(1970, 1, 1).toordinal()

_NUMBER = re.compile(r"\+?\d+(?:\.\d*)?(?:[eE]\+?\d{1,3})?")
_TOGETHER = re.compile(r"(19[89]|20\d)\d(0\d|1[0-2])[0-3]\d[0-2]\d[0-5]\d[0-6]\d(\.\d*)?")
_YEAR_FIRST = re.compile(
    r"(?P<year>\d{4})[-/.]?(?P<month>\d\d)[-/.]?(?P<day>\d\d)"
    r"[T _-]?(?P<hour>\d\d)[:.-]?(?P<minute>\d\d)[:.-]?(?P<second>\d\d)",
    re.ASCII,
)
_DAY_FIRST = re.compile(  # wherever dots are written
    r"(?P<day>\d\d?)\.(?P<month>\d\d?)\.(?P<year>\d{4})"
    r"[.,T ]\s*(?P<hour>\d\d?)[:.-]?(?P<minute>\d\d)[:.-]?(?P<second>\d\d)",
    re.ASCII,
)
# A fraction after a dash has 3, 6 or 9 digits, a zone 2 or 4.
_REST = re.compile(
    r"(?:[.,:](?P<part>\d{1,12})|-(?P<dashed>(?:\d{3}){1,3}))?"
    r"\s*+(?P<utc>Z|UTC|GMT)?+\s*+(?P<zone>[+-](?:0\d|1[0-5]):?(?:\d\d)?)?\s*+",
    re.I | re.A,
)
_CLOCK = re.compile(r"(\d\d?):(\d\d):(\d\d(?:\.\d*)?)", re.ASCII)
_ZONE = re.compile(r"([+-])(\d\d?):?(\d\d)?", re.ASCII)


class TimeScale(NamedTuple):
    """How a column writes time: as numbers since `origin_s`, or as date and time.

    `places` are the decimal places of a nanosecond that the unit of numbers has, None for dates.
    `origin_s` is in Unix seconds; `declared` says that a user gave it, so that the time 0 is one,
    too. `gps` marks the clock of GPS, without leap seconds. `zone_s` is how far a date without
    a zone of its own is ahead of UTC, `zoned` whether dates have one.
    """

    places: int | None = None
    origin_s: int = 0
    gps: bool = False
    zone_s: int = 0
    zoned: bool = True
    declared: bool = False

    def describe(self) -> str:
        """The scale in words."""
        if self.places is None:
            zone = "" if self.zoned else ", no zone: taken as UTC"
            if self.zone_s:
                zone = f", {self.zone_s / 3600:+g} h"
            return "date and time of GPS" if self.gps else f"date and time{zone}"
        unit = next(name for name, places in UNITS.items() if places == self.places)
        since = "GPS" if self.gps else "1980" if self.origin_s == _YEAR_1980_S else "1970"
        if self.declared:
            since = f"{datetime.fromtimestamp(self.origin_s, UTC):%Y-%m-%d %H:%M:%S} UTC"
        return f"{unit} since {since}"


def guess_scale(name: str, cells: Sequence[str], decimal_comma: bool) -> TimeScale | None:
    """The scale of a column by its first value and its name; None when it is no absolute time."""
    cell = next((c.strip() for c in cells if c.strip().lower() not in NOTHING | {"0"}), "")
    number = cell.replace(",", ".") if decimal_comma else cell
    if _NUMBER.fullmatch(number) is not None:
        if "1980" in name:
            return TimeScale(UNITS["s"], origin_s=_YEAR_1980_S)
        if _TOGETHER.fullmatch(number) is None:
            value = float(number)
            unit = next((unit for unit, least in _LEAST.items() if least <= value < _MOST), "")
            return TimeScale(UNITS[unit]) if unit else None
    match = _date(cell)
    rest = None if match is None else _REST.fullmatch(cell, match.end())
    return None if rest is None else TimeScale(zoned=bool(rest["utc"] or rest["zone"]))


def to_utc_ns(cells: Sequence[str], scale: TimeScale, decimal_comma: bool) -> Int64:
    """UTC nanoseconds of a column, :data:`NO_TIME` where there is none.

    A cell that cannot be read raises :class:`UnreadableTimeError`, which has its place.
    """
    if scale.places is None:
        times_ns = _civil_ns(cells, scale.zone_s)
        since_ns = times_ns - GPS_EPOCH_UNIX_S * _S
    else:
        if decimal_comma:
            cells = [cell.replace(",", ".") for cell in cells]
        since_ns, origin_ns = _decimal_ns(cells, scale.places), scale.origin_s * _S
        known = (since_ns >= (not scale.declared)) & (since_ns <= MAX_TIME_NS - origin_ns)
        times_ns = np.where(known, since_ns + origin_ns, NO_TIME)
    if scale.gps:
        times_ns = _of_gps(*np.divmod(since_ns, _WEEK_NS))
    return _valid(times_ns)


def gps_week_ns(weeks: Sequence[str], seconds: Sequence[str], places: int) -> Int64:
    """UTC nanoseconds of GPS weeks (not modulo 1024) and times of week in a unit."""
    return _valid(_of_gps(_decimal_ns(weeks, 0), _decimal_ns(seconds, places)))


class UnreadableTimeError(ValueError):
    """A cell, given by its place in the column, that is no time at all."""

    def __init__(self, place: int) -> None:
        super().__init__(place)
        self.place = place


def _valid(times_ns: Int64) -> Int64:
    return np.where((times_ns >= MIN_TIME_NS) & (times_ns <= MAX_TIME_NS), times_ns, NO_TIME)


def _unix_ns(week: int, of_week_ns: int) -> int:
    try:
        return unix_ns(week, of_week_ns) if week > 0 else NO_TIME
    except ValueError:
        return NO_TIME


_of_gps = np.vectorize(_unix_ns, otypes=[np.int64])


def _decimal_ns(cells: Sequence[str], places: int) -> Int64:
    """Decimal numbers times 10^places, exactly, -1 for none; digits beyond are cut off."""
    aligned = _aligned_ns(cells, places)
    if aligned is not None:
        return aligned
    return np.array([_one_decimal(c, k, places) for k, c in enumerate(cells)], dtype=np.int64)


def _aligned_ns(cells: Sequence[str], places: int) -> Int64 | None:
    """Numbers of one length with their decimal points in one column, as in most logs; else None."""
    first, text = (cells[0] if cells else ""), "".join(cells)
    point = first.find(".") if "." in first else len(first)
    if not 0 < point <= 19 - places or set(map(len, cells)) != {len(first)} or not text.isascii():
        return None
    digits = np.frombuffer(text.encode(), np.uint8).reshape(len(cells), -1)
    if (digits[:, point:] == ord(".")).sum() != len(cells) * ("." in first):
        return None
    digits = np.delete(digits, np.s_[point : point + 1], axis=1) - ord("0")
    if (digits > 9).any():
        return None
    weights = 10 ** np.arange(point + places - 1, -1, -1, dtype=np.uint64)
    values: UInt64 = digits[:, : len(weights)] @ weights[: digits.shape[1]]
    return np.minimum(values, np.uint64(MAX_TIME_NS + 1)).astype(np.int64)


def _one_decimal(cell: str, place: int, places: int) -> int:
    """A number, or a time of day as seconds since midnight."""
    text = cell.strip()
    if text.lower() in NOTHING:
        return -1
    clock = _CLOCK.fullmatch(text)
    try:
        if clock is not None:
            minutes = 60 * int(clock[1]) + int(clock[2])
            value, places = 60 * minutes + Decimal(clock[3]), UNITS["s"]
        else:
            value = Decimal(text)
    except InvalidOperation:
        raise UnreadableTimeError(place) from None
    if not value.is_finite() or value < 0 or value.adjusted() + places > 18:
        return -1
    return min(int(value.scaleb(places)), MAX_TIME_NS + 1)


def _date(text: str) -> re.Match[str] | None:
    """The date and time to the second that a text begins with."""
    return _YEAR_FIRST.match(text) or _DAY_FIRST.match(text)


def _civil_ns(cells: Sequence[str], zone_s: int) -> Int64:
    times_ns = np.zeros(len(cells), dtype=np.int64)
    width = 19
    for k, cell in enumerate(cells):
        # Rows of one second share their start, and those of all seconds their ends.
        start_ns, rest_ns = second_ns(cell[:width]), _rest_ns(cell[width:], zone_s)
        if start_ns is None or rest_ns is None:
            text = cell.strip()
            match = _date(text)
            if match is None and text.lower() in NOTHING:
                continue
            width = 0 if match is None else match.end()
            start_ns, rest_ns = second_ns(text[:width]), _rest_ns(text[width:], zone_s)
            if start_ns is None or rest_ns is None:
                raise UnreadableTimeError(k)
        times_ns[k] = start_ns + rest_ns
    return times_ns


@lru_cache(1 << 12)
def second_ns(text: str) -> int | None:
    """Nanoseconds of a date and time to the second, None for what is none."""
    match = _date(text)
    if match is None or match.end() < len(text):
        return None
    names = ("year", "month", "day", "hour", "minute", "second")
    year, month, day, hour, minute, second = map(int, match.group(*names))
    try:
        days = date(year, month, day).toordinal() - _UNIX_DAY
    except ValueError:
        return None
    if not 1900 <= year <= 2100 or hour > 23 or minute > 59 or second > 60:
        return None
    return (((days * 24 + hour) * 60 + minute) * 60 + second) * _S


@lru_cache(1 << 12)
def _rest_ns(text: str, usual_zone_s: int) -> int | None:
    """Nanoseconds that the fraction adds and the zone takes away, None for what is neither."""
    match = _REST.fullmatch(text)
    if match is None:
        return None
    fraction = match["part"] or match["dashed"] or ""
    zone = match["zone"] or ("UTC" if match["utc"] else "")
    ahead_s = zone_s(zone) if zone else usual_zone_s
    return int(fraction.ljust(9, "0")[:9]) - ahead_s * _S


def zone_s(text: str) -> int:
    """Seconds that +02:00, -0430, +2 or UTC is ahead of UTC; ValueError for what is no zone.

    Names as CET are none: who writes them may mean the hour of winter, or that of the clocks.
    """
    if text.upper() in ("UTC", "GMT", "Z"):
        return 0
    match = _ZONE.fullmatch(text)
    if match is None or int(match[2]) > 15:
        raise ValueError(
            f"{quoted(text)} is no time zone like +02:00 (how far that clock was ahead of UTC) or "
            "UTC"
        )
    seconds = int(match[2]) * 3600 + int(match[3] or 0) * 60
    return -seconds if match[1] == "-" else seconds


def zone_scale(text: str) -> TimeScale:
    """The scale of dates whose clock is that of a zone, as :func:`zone_s` reads it, or GPST: that
    of GPS, which has no leap seconds."""
    is_gps = text.upper() in ("GPST", "GPS")
    return TimeScale(gps=is_gps, zone_s=0 if is_gps else zone_s(text))
