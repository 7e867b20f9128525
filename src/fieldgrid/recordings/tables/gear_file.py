"""Gears that a user knows: a table of the spans in which a vehicle drove forward or in reverse."""

from __future__ import annotations

from pathlib import Path

from fieldgrid.core import GearName, GearSpan, RecordingError
from fieldgrid.recordings.tables.tables import OpenTable, TableRows, open_table
from fieldgrid.recordings.tables.times import UnreadableTimeError, guess_scale, to_utc_ns

HEADER = ("from", "to", "gear")


MOST_SPANS = 100_000


def read_gear_spans(path: Path) -> tuple[GearSpan, ...]:
    """The spans of a table with the columns `from`, `to` (UTC: ISO 8601, or a number since 1970)
    and `gear` (forward or reverse).

    Raises RecordingError for a table with other columns, or a row that is no span.
    """
    spans: list[GearSpan] = []
    with open_table(path) as table:
        places = [table.column(name) for name in HEADER]
        if None in places:
            raise RecordingError(
                f"{path} has the columns {', '.join(table.header)[:80]}; a table of gears has "
                f"{', '.join(HEADER)}."
            )
        start, stop, gear = (place for place in places if place is not None)
        for block in table.blocks():
            starts, stops = _times_ns(table, block, start), _times_ns(table, block, stop)
            for k, name in enumerate(block.cells(gear)):
                try:
                    known = GearName(name.strip().lower())
                except ValueError:
                    words = "is neither forward nor reverse"
                    raise table.error(block.line + k, gear, name, words) from None
                if stops[k] <= starts[k]:
                    words = "does not come after the start of its span"
                    raise table.error(block.line + k, stop, block.cells(stop)[k], words)
                if len(spans) == MOST_SPANS:
                    raise RecordingError(
                        f"{path} has more than {MOST_SPANS} spans of gears; no drive changes them "
                        "so often, check the file."
                    )
                spans.append(GearSpan(start_ns=starts[k], stop_ns=stops[k], gear=known))
    return tuple(spans)


def _times_ns(table: OpenTable, block: TableRows, place: int) -> list[int]:
    cells = block.cells(place)
    scale = guess_scale(table.header[place], cells, table.decimal_comma)
    if scale is None:
        raise table.error(block.line, place, cells[0], "is no UTC time")
    try:
        times = to_utc_ns(cells, scale, table.decimal_comma).tolist()
    except UnreadableTimeError as problem:
        line = block.line + problem.place
        raise table.error(line, place, cells[problem.place], "is no UTC time") from None
    for k, time_ns in enumerate(times):
        if time_ns == 0:
            raise table.error(block.line + k, place, cells[k], "is no UTC time after 1980")
    return [int(time_ns) for time_ns in times]
