"""Fixes from a table of whatever columns: guessed by name, or mapped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Float64, Index, Quality, RecordingError, counted
from fieldgrid.geometry import NOT_SAID, FixColumns, quality_by_sigma, wrap_deg
from fieldgrid.recordings.readers.oxts import FIELDS, oxts_fixes, oxts_motion
from fieldgrid.recordings.tables.columns import CCW_EAST, Columns, how_to_say
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.places import Places
from fieldgrid.recordings.tables.qualities import read_quality
from fieldgrid.recordings.tables.roles import ROLES, words_of
from fieldgrid.recordings.tables.table_time import find_time
from fieldgrid.recordings.tables.tables import NOTHING, OpenTable, TableRows, open_table
from fieldgrid.recordings.tables.units import UNITS, metres, take_apart

_T = TypeVar("_T")
_READ = [role for role in ROLES if role not in ("time", "date", "week", "tow")]
_NUMBERS = ("hdop", "age", "sigma", "accuracy", "speed", "heading", "heading_sigma", "course")
# Numbers in these columns are codes of their own in every second program.
_WORDS_ONLY = frozenset(
    {"status", "fix_status", "fix_type", "fixtype", "fix", "carrier", "carrsoln"}
)
_HIGHEST_M = 10_000.0
_FALSE = frozenset({"false", "no", "f", "n", "invalid", "0", "0.0"}) | NOTHING


def read_fix_table(path: Path, columns: Columns | None = None) -> FixLog:
    """The fixes of a table in a file; `columns` says what its names do not."""
    with open_table(path) as table:
        if set(FIELDS) <= set(table.header):
            return _read_oxts(table)
        return read_fixes(table, columns or Columns())


def read_fixes(table: OpenTable, columns: Columns) -> FixLog:
    """The fixes of a table."""
    reader = _Reader(table, columns)
    fixes = FixColumns.joined(reader.fixes(block) for block in table.blocks())
    reader.check_heights()
    return FixLog(fixes, reader.notes())


def _read_oxts(table: OpenTable) -> FixLog:
    time, name = find_time(table, Columns()), table.path.name
    columns = [table.header.index(field) for field in FIELDS]
    times, values = [], []
    for block in table.blocks():
        times.append(time.utc_ns(block))
        values.append(np.column_stack([table.numbers(block, column) for column in columns]))
    times_ns, rows = np.concatenate(times), np.concatenate(values)
    usable = (times_ns > 0) & np.isfinite(rows).all(axis=1)
    lost = int((~usable).sum())
    notes = (
        f"{name}: rows of an OXTS INS; their heights are above mean sea level.",
        *([f"{name}: {lost} incomplete rows skipped."] if lost else []),
    )
    times_ns, rows = times_ns[usable], rows[usable]
    return FixLog(oxts_fixes(times_ns, rows), notes, oxts_motion(times_ns, rows))


class _Reader:
    """Which columns are read, and what came up while reading."""

    def __init__(self, table: OpenTable, columns: Columns) -> None:
        self.table, self.columns = table, columns
        self.counts: Counter[str] = Counter()
        self.heights_m: list[Float64] = []
        self.unknown: set[str] = set()
        self.where = Places.find(table, columns)
        self.names: dict[str, str] = {}
        for role in _READ:
            if name := columns.find(role, table.header, table.path):
                self.names[role] = name
        self.names.update(lat=self.where.lat.name, lon=self.where.lon.name)
        self.time = find_time(table, columns)

    def fixes(self, block: TableRows) -> FixColumns:
        """The fixes of some rows; rows without a position or without a time are counted."""
        times_ns = self.time.utc_ns(block)
        lat, lon = self.where.lat_lon(block)
        placed, timed = np.isfinite(lat) & np.isfinite(lon), times_ns > 0
        unplaced = (block.row(k) for k in np.flatnonzero(~placed).tolist())
        self.counts["without a position skipped"] += sum(
            any(cell.strip() for cell in row) for row in unplaced
        )
        self.counts["without a time after 1980 skipped"] += int((placed & ~timed).sum())
        keep = np.flatnonzero(placed & timed)
        heights_m = self._heights(block)[keep]
        missing = np.isnan(heights_m)
        value = {r: self._numbers(r, block, keep) for r in _NUMBERS if r in self.names}
        accuracy = value.pop("accuracy", None)
        if accuracy is not None:
            value.setdefault("sigma", accuracy * (1.0 / np.sqrt(2.0)))
        if "heading" in value:
            value["heading"] = self._heading(value["heading"], block, keep)
        if "course" in value:
            value["course"] = wrap_deg(value["course"])
        if "speed" in value:
            value["speed"] = np.abs(value["speed"])
        said: dict[str, npt.ArrayLike] = {ROLES[role].own: value[role] for role in value}
        if "quality" in self.names:
            said["quality"] = self._each("quality", block, keep, self._quality)
        elif "sigma" in value:
            said["quality"] = quality_by_sigma(value["sigma"])
        if "satellites" in self.names:
            said["satellites"] = self._each("satellites", block, keep, _fewest)
        fixes = FixColumns.of(
            times_ns[keep],
            lat_deg=lat[keep],
            lon_deg=lon[keep],
            height_m=np.where(missing, 0.0, heights_m),
            **said,
        )
        self.heights_m.append(heights_m[~missing & (fixes.quality != Quality.NONE)])
        return fixes

    def check_heights(self) -> None:
        """Refuse heights that no field has, by all rows that were read and have a position."""
        heights_m = np.concatenate([*self.heights_m, np.empty(0)])
        if heights_m.size and np.median(np.abs(heights_m)) > _HIGHEST_M:
            raise RecordingError(
                f"{self.table.path}: {self.names['height']} is {np.median(heights_m):.12g} m, "
                f"higher than any field; say its unit: {how_to_say(height_units='mm')}, or cm or "
                "ft."
            )

    def _worth(self, role: str) -> float:
        """What 1 is worth in the column of a role, by what is said of it, else by its name."""
        found = ROLES[role]
        said = getattr(self.columns, found.option).removesuffix(CCW_EAST) if found.option else ""
        named = take_apart(self.names[role]).worth(found.quantity)
        return UNITS[found.quantity][said] if said else named

    def _numbers(self, role: str, block: TableRows, keep: Index) -> Float64:
        numbers = self.table.numbers(block, self.table.header.index(self.names[role]))
        return numbers[keep] * self._worth(role)

    def _heights(self, block: TableRows) -> Float64:
        """Metres, NaN where a row has none."""
        if "height" not in self.names:
            return np.zeros(block.row_count)
        unit_m = self._worth("height")

        def in_units(cell: str) -> float | None:
            length_m = metres(cell)
            return None if length_m is None else length_m / unit_m

        place = self.table.header.index(self.names["height"])
        heights = self.table.numbers(block, place, in_units) * unit_m
        self.counts["without a height: taken as 0 m"] += int(np.isnan(heights).sum())
        return heights

    def _heading(self, angle_deg: Float64, block: TableRows, keep: Index) -> Float64:
        """Headings clockwise from north; NaN where they are marked as not valid."""
        if self.columns.heading_units.endswith(CCW_EAST):
            angle_deg = 90.0 - angle_deg
        valid: npt.ArrayLike = True
        if "heading_valid" in self.names:
            valid = self._each(
                "heading_valid", block, keep, lambda cell: cell.strip().lower() not in _FALSE
            )
        return np.where(np.asarray(valid, dtype=bool), wrap_deg(angle_deg), np.nan)

    def _quality(self, cell: str) -> Quality:
        said = "quality" in self.columns.names or words_of(self.names["quality"]) not in _WORDS_ONLY
        quality = read_quality(cell, numbers_are_gga=said)
        if quality is None:
            self.unknown.add(cell)
        return Quality.UNKNOWN if quality is None else quality

    def _each(
        self, role: str, block: TableRows, keep: Index, read: Callable[[str], _T]
    ) -> list[_T]:
        """What the cells of the rows say that become fixes; equal ones are read once."""
        cells = block.cells(self.table.header.index(self.names[role]))
        kept = [cells[k] for k in keep.tolist()]
        known = {cell: read(cell) for cell in set(kept)}
        return [known[cell] for cell in kept]

    def notes(self) -> tuple[str, ...]:
        """What was guessed, assumed and skipped, a sentence each."""
        guessed = [
            f"{role} from '{name}'"
            for role, name in self.names.items()
            if role not in self.columns.names and name != ROLES[role].own
        ]
        stated = bool({"sigma", "accuracy"} & self.names.keys())
        unknown = ", ".join(repr(word[:30]) for word in sorted(self.unknown)[:5])
        told = (
            (guessed, f"{', '.join(guessed)}."),
            ("height" not in self.names, "no column height_m; heights are taken as 0 m."),
            (
                "quality" not in self.names and stated,
                "no column quality; stated errors up to 5 cm are taken for RTK fixed, the quality "
                "of others is unknown.",
            ),
            ("quality" not in self.names and not stated, "no column quality; it is unknown."),
            (unknown, f"quality {unknown} is not known; taken as unknown."),
            *((note, note) for note in self.where.notes),
            *((count, f"{counted(count, 'row')} {what}.") for what, count in self.counts.items()),
        )
        path = self.table.path
        return (*self.time.notes, *(f"{path.name}: {what}" for holds, what in told if holds))


def _fewest(cell: str) -> int:
    """The number of satellites of a cell, `NOT_SAID` without one; of a list of receivers, the
    lowest."""
    counts = []
    for item in cell.strip("[]() ").split(","):
        try:
            counts.append(int(float(item.strip(" '\""))))
        except (ValueError, OverflowError):
            continue
    return min((n for n in counts if 0 <= n < 10_000), default=NOT_SAID)
