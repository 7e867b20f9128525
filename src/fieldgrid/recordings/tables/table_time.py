"""The time of a table's rows: which column holds it, and on which scale."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Int64, RecordingError, quoted
from fieldgrid.recordings.tables.columns import Columns, epoch_s, guess, how_to_say, time_candidates
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
_FIRST_WEEK = 1024
"""Of August 1999: no drive is older, but a receiver may count modulo 1024."""


_YEAR_2000_NS = 946_684_800 * 10**9


class TimeColumn(NamedTuple):
    """A table's time: one column, a date beside a time of day, or a week beside a time of week."""

    table: OpenTable
    place: int
    scale: TimeScale
    date_place: int | None = None
    week_place: int | None = None
    notes: tuple[str, ...] = ()

    def utc_ns(self, block: TableRows) -> Int64:
        """UTC nanoseconds of some rows, 0 where there is no time after 1980."""
        cells = self._cells(block)
        try:
            if self.week_place is not None:
                weeks = block.cells(self.week_place)
                return gps_week_ns(weeks, cells, self.scale.places or 0)
            return to_utc_ns(cells, self.scale, self.table.decimal_comma)
        except UnreadableTimeError as problem:
            raise self.table.error(
                block.line + problem.place, self.place, cells[problem.place], "is no UTC time"
            ) from None

    def rises(self) -> bool:
        """Whether the first rows are moments after 2000 that rise: no name has to say it."""
        try:
            times_ns = self.utc_ns(self.table.sample)
        except RecordingError:
            return False
        rises = times_ns[-1] > times_ns[0] and bool((np.diff(times_ns) >= 0).all())
        return rises and bool(times_ns[0] > _YEAR_2000_NS)

    def _cells(self, block: TableRows) -> list[str]:
        cells = block.cells(self.place)
        if self.date_place is None:
            return cells
        days = block.cells(self.date_place)
        return [f"{d.strip()} {c.strip()}".strip() for d, c in zip(days, cells, strict=True)]


def find_time(table: OpenTable, columns: Columns) -> TimeColumn:
    """The time of a table by what is said of its columns, else by name and content."""
    said = columns.names.get("time", "")
    if said and said not in table.header:
        raise RecordingError(
            f"{table.path} has no column {quoted(said)} for time; "
            f"it has: {', '.join(table.header)[:200]}."
        )
    if not said and "date" not in columns.names:
        week = _by_week(table, columns)
        if week is not None:
            return week
    names = [said] if said else time_candidates(table.header)
    found = [time for name in names if (time := _column(table, name, columns)) is not None]
    if not (found or said or columns.time_epoch or columns.time_units):
        others = (_column(table, name, columns) for name in table.header if name not in names)
        found = [time for time in others if time is not None and time.rises()]
    if not found:
        tried = f" ({', '.join(_shown(table, n) for n in names)[:200]} can not be read as one)"
        raise RecordingError(
            f"{table.path} has no column with UTC times{tried if names else ''}; name it: "
            f"{how_to_say(time='COLUMN')}, and, if need be, time_units=s, ms, us, ns, gps_s, "
            "gps_ms, gps_us or gps_ns; of GPS's weeks, name both columns: week=COLUMN,tow=COLUMN; "
            "of a time that counts from the start of a drive or a week, or from midnight, "
            "say when that was with time_epoch=2026-05-14T07:30:00Z; write a date with time like "
            "2026-05-14T07:30:00.25Z, with hours from 0 to 23, or with its day first like "
            "14.05.2026 07:30:00.25. "
            f"It has: {', '.join(table.header)[:500]}."
        )
    # The first, unless its stamps repeat in many rows and those of another do not.
    distinct = [len(set(time._cells(table.sample))) for time in found]
    is_fine = table.header[found[0].place] in _OWN or 3 * distinct[0] >= 2 * max(distinct)
    time = found[0 if is_fine else distinct.index(max(distinct))]
    _check_zone(time, columns.time_zone)
    name = table.header[time.place]
    if name in _OWN or (said and time.scale.places is not None):
        return time
    beside = "" if time.date_place is None else f" and '{table.header[time.date_place]}'"
    what = f"time from '{name}'{beside} ({time.scale.describe()})"
    return time._replace(notes=(f"{table.path.name}: {what}.",))


def _check_zone(time: TimeColumn, time_zone: str) -> None:
    """Refuse a zone or the clock of GPS for a column of numbers, which has a unit and no zone."""
    places = time.scale.places
    if places is None or not time_zone:
        return
    said = zone_scale(time_zone)
    if said.gps and not time.scale.gps:
        unit = next(unit for unit in UNITS if UNITS[unit] == places)
        said_so = how_to_say(time_units=f"gps_{unit}")
        other = f"if it counts from 1980 as GPS does, say so in its place: {said_so}"
    elif said.zone_s:
        other = "if its clock is not that of UTC, move it with --gnss-offset SECONDS in its place"
    else:
        return
    raise RecordingError(
        f"{time.table.path}: time_zone is {time_zone}, which is of dates, but "
        f"{_shown(time.table, time.table.header[time.place])} is a number; {other}; if it is Unix "
        "time, leave time_zone out."
    )


def _shown(table: OpenTable, name: str) -> str:
    """A column with its first value, as an error shows it."""
    cells = table.sample.cells(table.header.index(name))
    value = next((cell.strip() for cell in cells if cell.strip()), "")
    return f"{name} {quoted(value)}"


def _column(table: OpenTable, name: str, columns: Columns) -> TimeColumn | None:
    place = table.header.index(name)
    alone = TimeColumn(table, place, TimeScale())
    scale = _scale(name, table.sample.cells(place), table, columns)
    if scale is not None:
        return alone._replace(scale=scale)
    date = columns.names.get("date") or guess("date", table.header)
    if not date or date not in table.header or date == name:
        return None
    paired = alone._replace(date_place=table.header.index(date))
    scale = _scale(name, paired._cells(table.sample), table, columns)
    return None if scale is None or scale.places is not None else paired._replace(scale=scale)


def _scale(name: str, cells: Sequence[str], table: OpenTable, columns: Columns) -> TimeScale | None:
    if columns.time_epoch:
        places = UNITS[columns.time_units or "s"]
        return TimeScale(places, origin_s=epoch_s(columns.time_epoch), declared=True)
    if columns.time_units:
        unit = columns.time_units.removeprefix("gps_")
        return TimeScale(UNITS[unit], gps=unit != columns.time_units)
    scale = guess_scale(name.lower(), cells, table.decimal_comma)
    if scale is None or scale.places is not None:
        return scale
    if columns.time_zone:
        said = zone_scale(columns.time_zone)
        return scale._replace(zone_s=said.zone_s, gps=said.gps and not scale.zoned)
    # As a word: the clock of a column gpstime may be UTC, as that of gps_time.
    of_gps = "gpst" in re.split(r"[^a-z]+", name.lower())
    return scale._replace(gps=of_gps and not scale.zoned)


def _by_week(table: OpenTable, columns: Columns) -> TimeColumn | None:
    week = columns.names.get("week") or guess("week", table.header)
    tow = columns.names.get("tow") or guess("tow", table.header)
    if not (week and tow and week in table.header and tow in table.header):
        return None
    weeks = table.numbers(table.sample, table.header.index(week))
    if weeks.size and np.nanmax(weeks, initial=-np.inf) < _FIRST_WEEK and np.isfinite(weeks).any():
        names = (n for n in time_candidates(table.header) if _column(table, n, columns) is not None)
        name = next(names, "")
        other = f", or take the time of '{name}': {how_to_say(time=name)}" if name else ""
        raise RecordingError(
            f"{table.path}: GPS week {np.nanmax(weeks):.0f} is before 1999; if the receiver begins "
            "anew after 1024 weeks, add 2048 to its weeks (1024 to those before April 2019)"
            f"{other}."
        )
    if columns.time_zone and not zone_scale(columns.time_zone).gps:
        raise RecordingError(
            f"{table.path}: time_zone is {columns.time_zone}, but '{week}' and '{tow}' are of "
            "GPS's clock; leave time_zone out (if theirs is another, move it with --gnss-offset "
            f"SECONDS), or name the column of dates that it is of: {how_to_say(time='COLUMN')}."
        )
    place = table.header.index(tow)
    seconds = table.numbers(table.sample, place)
    # A week has 604,800 s; the time of week of a log that is longer than ten minutes tells.
    milliseconds = "ms" in tow.lower() or bool((seconds > 604_800).any())
    unit = columns.time_units or ("ms" if milliseconds else "s")
    if unit not in UNITS:
        raise RecordingError(f"{table.path}: time_units of a time of week is {unit}; give s or ms.")
    return TimeColumn(
        table,
        place,
        TimeScale(UNITS[unit], gps=True),
        week_place=table.header.index(week),
        notes=(f"{table.path.name}: time from GPS '{week}' and '{tow}' in {unit}.",),
    )
