"""The time of a table's rows: which column holds it, and on which scale."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Int64, RecordingError, quoted
from fieldgrid.recordings.tables.columns import Columns, epoch_s, how_to_say
from fieldgrid.recordings.tables.roles import ROLES, guess
from fieldgrid.recordings.tables.tables import OpenTable, TableRows
from fieldgrid.recordings.tables.times import (
    UNITS,
    TimeScale,
    UnreadableTimeError,
    gps_week_ns,
    guess_scale,
    to_utc_ns,
    zone_scale,
)

_OWN = ("time_ns", "timestamp_utc_s")
_TIME = re.compile(r"time|stamp|epoch|\b(?:datetime|utc|t|gpst)\b")
_NO_TIME = re.compile(r"\b(?:delta|elapsed|uptime|duration|zone|timezone|diff|since|boot|fix)\b")
_BETWEEN_WORDS = re.compile(r"[^a-z0-9]+")
_FIRST_WEEK = 1024
"""Of August 1999: no drive is older, but a receiver may count modulo 1024."""
_WEEK_S = 604_800
_YEAR_2000_NS = 946_684_800 * 10**9


class TimeColumn(NamedTuple):
    """A table's time by the places of its columns: one, a date beside a time of day, or (`weeks`) a
    GPS week beside a time of week."""

    table: OpenTable
    places: tuple[int, ...]
    scale: TimeScale = TimeScale()
    weeks: bool = False
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name of the column of the time itself."""
        return self.table.header[self.places[-1]]

    def cells(self, block: TableRows) -> list[str]:
        """The times of some rows as they are written, with their dates."""
        *before, cells = (block.cells(place) for place in self.places)
        for days in before:
            cells = [f"{d.strip()} {c.strip()}".strip() for d, c in zip(days, cells, strict=True)]
        return cells

    def utc_ns(self, block: TableRows) -> Int64:
        """UTC nanoseconds of some rows, 0 where there is no time after 1980."""
        cells = block.cells(self.places[-1]) if self.weeks else self.cells(block)
        try:
            if self.weeks:
                return gps_week_ns(block.cells(self.places[0]), cells, self.scale.places or 0)
            return to_utc_ns(cells, self.scale, self.table.decimal_comma)
        except UnreadableTimeError as problem:
            line, cell = block.line + problem.place, cells[problem.place]
            raise self.table.error(line, self.places[-1], cell, "is no UTC time") from None

    def rises(self) -> bool:
        """Whether the first rows are moments after 2000 that rise: no name has to say it."""
        try:
            times_ns = self.utc_ns(self.table.sample)
        except RecordingError:
            return False
        rises = times_ns[-1] > times_ns[0] and bool((np.diff(times_ns) >= 0).all())
        return rises and bool(times_ns[0] > _YEAR_2000_NS)


def find_time(table: OpenTable, columns: Columns) -> TimeColumn:
    """The time of a table by what is said of its columns, else by name and content."""
    header = table.header
    said = columns.find("time", header, table.path)
    if not said and "date" not in columns.names:
        week, tow = (columns.find(role, header, table.path) for role in ("week", "tow"))
        if week and tow:
            return _by_week(table, week, tow, columns)
    names = [said] if said else _candidates(header)
    found = [time for name in names if (time := _column(table, name, columns)) is not None]
    if not (found or said or columns.time_epoch or columns.time_units):
        others = (_column(table, name, columns) for name in header if name not in names)
        found = [time for time in others if time is not None and time.rises()]
    if not found:
        tried = ", ".join(f"{name} {quoted(_first(table, name))}" for name in names)[:200]
        raise RecordingError(
            f"{table.path} has no column with UTC times"
            f"{f' ({tried} can not be read as one)' if names else ''}; name it: "
            f"{how_to_say(time='COLUMN')}, and, if need be, time_units=s, ms, us, ns, gps_s, "
            "gps_ms, gps_us or gps_ns; of GPS's weeks, name both columns: week=COLUMN,tow=COLUMN; "
            "of a time that counts from the start of a drive or a week, or from midnight, "
            "say when that was with time_epoch=2026-05-14T07:30:00Z; write a date with time like "
            "2026-05-14T07:30:00.25Z, with hours from 0 to 23, or with its day first like "
            "14.05.2026 07:30:00.25. "
            f"It has: {', '.join(header)[:500]}."
        )
    # The first, unless its stamps repeat in many rows and those of another do not.
    distinct = [len(set(time.cells(table.sample))) for time in found]
    is_fine = found[0].name in _OWN or 3 * distinct[0] >= 2 * max(distinct)
    time = found[0 if is_fine else distinct.index(max(distinct))]
    _refuse_zone(time, columns)
    if time.name in _OWN or (said and time.scale.places is not None):
        return time
    beside = "".join(f" and '{header[place]}'" for place in time.places[:-1])
    what = f"time from '{time.name}'{beside} ({time.scale.describe()})"
    return time._replace(notes=(f"{table.path.name}: {what}.",))


def _candidates(header: Sequence[str]) -> list[str]:
    """Columns that may hold the time, the project's own names first."""
    others = []
    for name in header:
        words = _BETWEEN_WORDS.sub(" ", name.lower())
        # What begins anew every week is no time by itself, though its size may look like one.
        of_week = guess(ROLES["tow"], [name]) is not None
        if _TIME.search(words) and not _NO_TIME.search(words) and not of_week:
            others.append(name)
    return list(dict.fromkeys([*(name for name in _OWN if name in header), *others]))


def _first(table: OpenTable, name: str) -> str:
    """The first value of a column."""
    cells = table.sample.cells(table.header.index(name))
    return next((cell.strip() for cell in cells if cell.strip()), "")


def _refuse_zone(time: TimeColumn, columns: Columns) -> None:
    """Refuse a zone for a column of numbers, which has a unit and no zone."""
    if time.scale.places is None or not columns.time_zone:
        return
    said = zone_scale(columns.time_zone)
    if said.gps == time.scale.gps and not said.zone_s:
        return
    unit = next(unit for unit, places in UNITS.items() if places == time.scale.places)
    raise RecordingError(
        f"{time.table.path}: time_zone is {columns.time_zone}, which is of dates, but {time.name} "
        f"{quoted(_first(time.table, time.name))} is a number; leave time_zone out, and say "
        f"in its place: {how_to_say(time_units=f'gps_{unit}')}, of numbers that count from 1980 "
        "as GPS does; a clock of another zone is moved with --gnss-offset SECONDS."
    )


def _column(table: OpenTable, name: str, columns: Columns) -> TimeColumn | None:
    place = table.header.index(name)
    alone = TimeColumn(table, (place,))
    scale = _scale(alone, columns)
    if scale is not None:
        return alone._replace(scale=scale)
    date = columns.find("date", table.header, table.path)
    if not date or date == name:
        return None
    paired = alone._replace(places=(table.header.index(date), place))
    scale = _scale(paired, columns)
    return None if scale is None or scale.places is not None else paired._replace(scale=scale)


def _scale(time: TimeColumn, columns: Columns) -> TimeScale | None:
    if columns.time_epoch:
        places = UNITS[columns.time_units or "s"]
        return TimeScale(places, origin_s=epoch_s(columns.time_epoch), declared=True)
    if columns.time_units:
        unit = columns.time_units.removeprefix("gps_")
        return TimeScale(UNITS[unit], gps=unit != columns.time_units)
    name, table = time.name.lower(), time.table
    scale = guess_scale(name, time.cells(table.sample), table.decimal_comma)
    if scale is None or scale.places is not None:
        return scale
    # As a word: the clock of a column gpstime may be UTC, as that of gps_time.
    clock = "GPST" if "gpst" in re.split(r"[^a-z]+", name) else "UTC"
    said = zone_scale(columns.time_zone or clock)
    return scale._replace(zone_s=said.zone_s, gps=said.gps and not scale.zoned)


def _by_week(table: OpenTable, week: str, tow: str, columns: Columns) -> TimeColumn:
    places = (table.header.index(week), table.header.index(tow))
    weeks, seconds = (table.numbers(table.sample, place) for place in places)
    latest = np.nanmax(weeks, initial=-np.inf)
    if -np.inf < latest < _FIRST_WEEK:
        raise RecordingError(
            f"{table.path}: GPS week {latest:.0f} is before 1999; if the receiver begins anew "
            "after 1024 weeks, add 2048 to its weeks (1024 to those before April 2019), or name "
            f"a column with another time: {how_to_say(time='COLUMN')}."
        )
    # The time of week of a log that is longer than ten minutes tells its unit.
    milliseconds = "ms" in tow.lower() or bool((seconds > _WEEK_S).any())
    unit = columns.time_units or ("ms" if milliseconds else "s")
    if unit not in UNITS:
        raise RecordingError(f"{table.path}: time_units of a time of week is {unit}; give s or ms.")
    note = f"{table.path.name}: time from GPS '{week}' and '{tow}' in {unit}."
    time = TimeColumn(table, places, TimeScale(UNITS[unit], gps=True), weeks=True, notes=(note,))
    _refuse_zone(time, columns)
    return time
