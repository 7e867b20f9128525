"""Gears that a user knows: a table of the spans in which a vehicle drove forward or in reverse."""

from __future__ import annotations

from pathlib import Path

from fieldgrid.core import GearName, GearSpan, RecordingError
from fieldgrid.recordings.tables.table_time import TimeColumn
from fieldgrid.recordings.tables.tables import OpenTable, TableRows, open_table
from fieldgrid.recordings.tables.times import NO_TIME, guess_scale

HEADER = ("from", "to", "gear")


MOST_SPANS = 100_000


def read_gear_spans(path: Path) -> tuple[GearSpan, ...]:
    """The spans of a table with the columns `from`, `to` (UTC: ISO 8601, or a number since 1970)
    and `gear` (forward or reverse).

    Raises RecordingError for a table with other columns, or a row that is no span.
    """
    spans: list[GearSpan] = []
    with open_table(path) as table:
        if not {*HEADER} <= {*table.header}:
            raise RecordingError(
                f"{path} has the columns {', '.join(table.header)[:80]}; a table of gears has "
                f"{', '.join(HEADER)}."
            )
        start, stop, gear = (table.header.index(name) for name in HEADER)
        for block in table.blocks():
            starts, stops = _times_ns(table, block, start), _times_ns(table, block, stop)
            for k, name in enumerate(block.cells(gear)):
                line, known = block.line + k, name.strip().lower()
                if known not in [*GearName]:
                    raise table.error(line, gear, name, "is neither forward nor reverse")
                if stops[k] <= starts[k]:
                    cell = block.cells(stop)[k]
                    raise table.error(line, stop, cell, "does not come after the start of its span")
                spans.append(GearSpan(start_ns=starts[k], stop_ns=stops[k], gear=GearName(known)))
            if len(spans) > MOST_SPANS:
                raise RecordingError(
                    f"{path} has more than {MOST_SPANS} spans of gears; no drive changes them so "
                    "often, check the file."
                )
    return tuple(spans)


def _times_ns(table: OpenTable, block: TableRows, place: int) -> list[int]:
    cells = block.cells(place)
    scale = guess_scale(table.header[place], cells, table.decimal_comma)
    if scale is None:
        raise table.error(block.line, place, cells[0], "is no UTC time")
    times_ns = TimeColumn(table, (place,), scale).utc_ns(block).tolist()
    if NO_TIME in times_ns:
        k = times_ns.index(NO_TIME)
        raise table.error(block.line + k, place, cells[k], "is no UTC time after 1980")
    return [int(time_ns) for time_ns in times_ns]
