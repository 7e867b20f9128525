"""Times as logs write them, whole columns at once, to UTC nanoseconds without rounding."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime
from decimal import Decimal, InvalidOperation
from typing import NamedTuple

import numpy as np

from fieldgrid.core import MAX_TIME_NS, MIN_TIME_NS, Int64, quoted
from fieldgrid.poses import GPS_EPOCH_UNIX_S, unix_ns
from fieldgrid.recordings.tables.tables import NOTHING

NO_TIME = 0
"""What stands for an empty cell, and for a time before 1980: the receiver had none yet."""

GPS_CLOCK = ("GPST", "GPS")
"""How the clock of GPS time is called where a zone is asked for."""

UNITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Units of a time as decimal places of nanoseconds."""

_S = 1_000_000_000
_DAY_S = 86_400
_WEEK_NS = 7 * _DAY_S * _S
_YEAR_1980_S = 315_532_800
_UNIX_DAY = date(1970, 1, 1).toordinal()

_NUMBER = re.compile(r"\+?\d+(?:\.\d*)?(?:[eE]\+?\d{1,3})?")
_TOGETHER = re.compile(r"(19[89]|20\d)\d(0\d|1[0-2])[0-3]\d[0-2]\d[0-5]\d[0-6]\d(\.\d*)?")
_CIVIL = re.compile(
    r"(\d{4})[-/.]?(\d\d)[-/.]?(\d\d)[T _-]?(\d\d)[:.-]?(\d\d)[:.-]?(\d\d)", re.ASCII
)
_DAY_FIRST = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})[.,T ]\s*(\d:)?", re.ASCII)
_CLOCK = re.compile(r"\s*(\d\d?):(\d\d):(\d\d)((?:\.\d*)?)\s*", re.ASCII)
_REST = re.compile(
    r"(?:[.,:](\d{1,12}))?\s*+(?:Z|UTC|GMT)?+\s*+([+-](?:0\d|1[0-5]):?(?:\d\d)?)?", re.I | re.A
)
_REST_DASHED = re.compile(r"(?:[.,-](\d{1,12}))?()")


class TimeScale(NamedTuple):
    """How a column writes time: in decimal `unit`s since `origin_s`, or as date and time.

    `origin_s` is in Unix seconds; `declared` says that a user gave it, so that the time 0 is one,
    too. `gps` marks a scale without leap seconds. `zone_s` is how far
    a civil time without a zone of its own is ahead of UTC. `places` are the decimal places of
    a nanosecond that the unit has.
    """

    places: int | None = None
    origin_s: int = 0
    gps: bool = False
    zone_s: int = 0
    dashed: bool = False
    zoned: bool = True
    declared: bool = False

    def describe(self) -> str:
        """The scale in words."""
        if self.places is None:
            if self.gps:
                return "date and time of GPS"
            zone = "" if self.zoned else ", no zone: taken as UTC"
            hours = f", {self.zone_s / 3600:+g} h" if self.zone_s else zone
            return f"date and time{hours}"
        unit = next(name for name, places in UNITS.items() if places == self.places)
        if self.declared:
            origin = datetime.fromtimestamp(self.origin_s, UTC)
            return f"{unit} since {origin:%Y-%m-%d %H:%M:%S} UTC"
        since = "GPS" if self.gps else "1980" if self.origin_s == _YEAR_1980_S else "1970"
        return f"{unit} since {since}"


def guess_scale(name: str, cells: Sequence[str], decimal_comma: bool) -> TimeScale | None:
    """The scale of a column by its first value and its name; None when it is no absolute time."""
    cell = next((c.strip() for c in cells if c.strip().lower() not in NOTHING | {"0"}), "")
    if decimal_comma:
        cell = cell.replace(",", ".")
    if _NUMBER.fullmatch(cell):
        value = float(cell)
        if "1980" in name:
            return TimeScale(UNITS["s"], origin_s=_YEAR_1980_S)
        sizes = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (GPS_EPOCH_UNIX_S, "s"))
        unit = next((unit for size, unit in sizes if size <= value < 1e20), None)
        if _TOGETHER.fullmatch(cell) is None:
            return None if unit is None else TimeScale(UNITS[unit])
    cell = _year_first(cell)
    match = _CIVIL.match(cell)
    if match is None:
        return None
    dashed = cell[13:14] == "-" and cell[16:17] == "-"
    rest = (_REST_DASHED if dashed else _REST).fullmatch(cell, match.end())
    if rest is None:
        return None
    zoned = bool(rest[2]) or cell[-1] in "Zz" or cell[-3:].upper() in ("UTC", "GMT")
    return TimeScale(dashed=dashed, zoned=zoned)


def _year_first(cell: str) -> str:
    """A date like 15.06.2011, whose day comes first wherever dots are written, as 2011-06-15."""
    match = _DAY_FIRST.match(cell.lstrip()) if "." in cell[:6] else None
    if match is None:
        return cell
    day, month, year, hour = match.groups()
    rest = cell.lstrip()[match.end() :]
    return f"{year}-{month:>02}-{day:>02} {'0' + hour if hour else ''}{rest}"


def _since_midnight(cell: str, places: int) -> str:
    """A time of day as decimal seconds (or smaller units) since midnight; else the cell."""
    match = _CLOCK.fullmatch(cell)
    if match is None:
        return cell
    hour, minute, second = map(int, match.groups()[:3])
    seconds = Decimal(f"{(hour * 60 + minute) * 60 + second}{match[4]}")
    return f"{seconds.scaleb(9 - places):f}"


def to_utc_ns(cells: Sequence[str], scale: TimeScale, decimal_comma: bool) -> Int64:
    """UTC nanoseconds of a column, :data:`NO_TIME` where there is none.

    A cell that cannot be read raises :class:`UnreadableTimeError`, which has its place.
    """
    if scale.places is None:
        times_ns = _civil_ns([_year_first(cell) for cell in cells], scale)
        if scale.gps:
            times_ns = _from_gps(*np.divmod(times_ns - GPS_EPOCH_UNIX_S * _S, _WEEK_NS))
        return _valid(times_ns)
    if decimal_comma:
        cells = [cell.replace(",", ".") for cell in cells]
    if scale.declared:
        cells = [_since_midnight(cell, scale.places) for cell in cells]
    since_ns = _decimal_ns(cells, scale.places)
    if scale.gps:
        return _valid(_from_gps(*np.divmod(since_ns, _WEEK_NS)))
    earliest_ns, origin_ns = 0 if scale.declared else 1, scale.origin_s * _S
    known = (since_ns >= earliest_ns) & (since_ns <= MAX_TIME_NS - origin_ns)
    return _valid(np.where(known, since_ns + origin_ns, NO_TIME))


def gps_week_ns(weeks: Sequence[str], seconds: Sequence[str], places: int) -> Int64:
    """UTC nanoseconds of GPS weeks (not modulo 1024) and times of week in a unit."""
    return _valid(_from_gps(_decimal_ns(weeks, 0), _decimal_ns(seconds, places)))


class UnreadableTimeError(ValueError):
    """A cell, given by its place in the column, that is no time at all."""

    def __init__(self, place: int) -> None:
        super().__init__(place)
        self.place = place


def _from_gps(weeks: Int64, of_week_ns: Int64) -> Int64:
    times_ns = []
    for week, rest_ns in zip(weeks.tolist(), of_week_ns.tolist(), strict=True):
        try:
            times_ns.append(unix_ns(week, rest_ns) if week > 0 else NO_TIME)
        except ValueError:
            times_ns.append(NO_TIME)
    return np.array(times_ns, dtype=np.int64)


def _valid(time_ns: Int64) -> Int64:
    return np.where((time_ns >= MIN_TIME_NS) & (time_ns <= MAX_TIME_NS), time_ns, NO_TIME)


def _decimal_ns(cells: Sequence[str], places: int) -> Int64:
    """Decimal numbers times 10^places, exactly; digits beyond are cut off."""
    aligned = _aligned_ns(cells, places)
    if aligned is not None:
        return aligned
    return np.array([_one_decimal(c, k, places) for k, c in enumerate(cells)], dtype=np.int64)


def _aligned_ns(cells: Sequence[str], places: int) -> Int64 | None:
    """Nanoseconds of cells with their decimal points in one column, as in most logs; else None."""
    first = cells[0] if len(cells) else ""
    length, wide = len(first), first.find(".") if "." in first else len(first)
    text = "".join(cells)
    if not 0 < wide <= 19 or set(map(len, cells)) != {length} or not text.isascii():
        return None
    digits = np.frombuffer(text.encode(), np.uint8).reshape(-1, length)
    if length > wide and (digits[:, wide] != ord(".")).any():
        return None
    digits = np.delete(digits, wide, axis=1) - ord("0") if length > wide else digits - ord("0")
    if (digits > 9).any() or (wide == 19 and (digits[:, 0] == 9).any()):
        return None  # the latter may be too large for an int64
    fraction = np.zeros(len(cells), dtype=np.int64)
    whole = fraction.copy()
    for column in digits.T[:wide]:
        whole = 10 * whole + column
    for k in range(places):
        fraction = 10 * fraction + (digits[:, wide + k] if wide + k < digits.shape[1] else 0)
    possible = (whole >= 0) & (whole < MAX_TIME_NS // 10**places)
    return np.asarray(np.where(possible, whole * 10**places + fraction, NO_TIME), dtype=np.int64)


def _one_decimal(cell: str, place: int, places: int) -> int:
    text = cell.strip()
    if text.lower() in NOTHING:
        return NO_TIME
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise UnreadableTimeError(place) from None
    if not value.is_finite() or value < 0 or value.adjusted() + places > 18:
        return NO_TIME
    return min(int(value.scaleb(places)), MAX_TIME_NS + 1)


def _civil_ns(cells: Sequence[str], scale: TimeScale) -> Int64:
    # Rows of one second share their start, and those of all seconds their ends.
    starts: dict[str, int | None] = {}
    ends: dict[str, int | None] = {}
    times_ns = np.zeros(len(cells), dtype=np.int64)
    for k, cell in enumerate(cells):
        start, end = cell[:19], cell[19:]
        start_ns = starts[start] if start in starts else starts.setdefault(start, _start_ns(start))
        end_ns = ends[end] if end in ends else ends.setdefault(end, _end_ns(end, scale))
        if start_ns is None or end_ns is None:
            times_ns[k] = _one_civil(cell.strip(), k, scale)
        else:
            times_ns[k] = start_ns + end_ns
    return times_ns


def _one_civil(cell: str, place: int, scale: TimeScale) -> int:
    if cell.lower() in NOTHING:
        return NO_TIME
    match = _CIVIL.match(cell)
    start_ns = _start_ns(match[0]) if match is not None else None
    end_ns = _end_ns(cell[match.end() :], scale) if match is not None else None
    if start_ns is None or end_ns is None:
        raise UnreadableTimeError(place)
    return start_ns + end_ns


def _start_ns(text: str) -> int | None:
    """Nanoseconds of a date and time to the second, None for what is none."""
    match = _CIVIL.fullmatch(text)
    if match is None:
        return None
    year, month, day, hour, minute, second = map(int, match.groups())
    try:
        days = date(year, month, day).toordinal() - _UNIX_DAY
    except ValueError:
        return None
    if not 1900 <= year <= 2100 or hour > 23 or minute > 59 or second > 60:
        return None
    return (days * _DAY_S + (hour * 60 + minute) * 60 + second) * _S


def _end_ns(text: str, scale: TimeScale) -> int | None:
    """Nanoseconds that the fraction adds and the zone takes away, None for what is neither."""
    match = (_REST_DASHED if scale.dashed else _REST).fullmatch(text.rstrip())
    if match is None:
        return None
    fraction = int((match[1] or "").ljust(9, "0")[:9])
    if match[2]:
        return fraction - zone_s(match[2]) * _S
    zoned = text.rstrip()[-1:].upper() == "Z" or text.rstrip()[-3:].upper() in ("UTC", "GMT")
    return fraction - (0 if zoned else scale.zone_s) * _S


def zone_s(text: str) -> int:
    """Seconds that +02:00, -0430, +2 or UTC is ahead of UTC; ValueError for what is no zone.

    Names as CET are none: who writes them may mean the hour of winter, or that of the clocks.
    """
    if text.upper() in ("UTC", "GMT", "Z"):
        return 0
    match = re.fullmatch(r"([+-])(\d\d?):?(\d\d)?", text, re.ASCII)
    if match is None or int(match[2]) > 15:
        raise ValueError(
            f"{quoted(text)} is no time zone like +02:00 (how far that clock was ahead of UTC) or "
            "UTC"
        )
    seconds = int(match[2]) * 3600 + int(match[3] or 0) * 60
    return -seconds if match[1] == "-" else seconds


def zone_scale(text: str) -> TimeScale:
    """The scale of dates and times whose clock is that of a zone, as :func:`zone_s` reads it, or
    GPST: that of GPS, which has no leap seconds."""
    return TimeScale(gps=True) if text.upper() in GPS_CLOCK else TimeScale(zone_s=zone_s(text))
