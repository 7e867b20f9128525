"""Fixes from a table of whatever columns: guessed by name, or mapped."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Float64, Index, Quality, RecordingError, counted, quoted
from fieldgrid.geometry import (
    NOT_SAID,
    FixColumns,
    heading_from_yaw_rad,
    quality_by_sigma,
    wrap_deg,
)
from fieldgrid.recordings.readers.oxts import FIELDS, oxts_fixes, oxts_motion
from fieldgrid.recordings.tables.columns import (
    LENGTHS,
    SPEEDS,
    Columns,
    guess,
    how_to_say,
    is_radians,
    metres,
    take_apart,
)
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.places import Places
from fieldgrid.recordings.tables.qualities import read_quality
from fieldgrid.recordings.tables.table_time import find_time
from fieldgrid.recordings.tables.tables import NOTHING, OpenTable, TableRows, open_table

_OWN = {
    "lat": "lat_deg", "lon": "lon_deg", "height": "height_m", "quality": "quality",
    "satellites": "satellites", "hdop": "hdop", "age": "age_s", "sigma": "sigma_m",
    "speed": "speed_mps", "heading": "heading_deg", "heading_sigma": "heading_sigma_deg",
    "course": "course_deg",
}  # fmt: skip
"""The project's own column names; who writes them knows what they mean."""

_T = TypeVar("_T")
_NUMBERS = ("hdop", "age", "sigma", "accuracy", "speed", "heading", "heading_sigma", "course")
# Numbers in these columns are codes of their own in every second program.
_WORDS_ONLY = frozenset(
    {"status", "fix_status", "fix_type", "fixtype", "fix", "carrier", "carrsoln"}
)
_HIGHEST_M = 10_000.0
_FALSE = frozenset({"false", "no", "f", "n", "invalid", "0", "0.0"}) | NOTHING


def read_fix_table(path: Path, columns: Columns | None = None) -> FixLog:
    """The fixes of a table; `columns` says what its names do not."""
    with open_table(path) as table:
        if set(FIELDS) <= set(table.header):
            time = find_time(table, Columns())
            places = [table.header.index(name) for name in FIELDS]
            blocks = [
                (time.utc_ns(block), np.column_stack([table.numbers(block, k) for k in places]))
                for block in table.blocks()
            ]
            times_ns = np.concatenate([times for times, _ in blocks])
            rows = np.concatenate([values for _, values in blocks])
            usable = (times_ns > 0) & np.isfinite(rows).all(axis=1)
            notes: tuple[str, ...] = (
                f"{table.path.name}: rows of an OXTS INS; their heights are above mean sea level.",
            )
            if not usable.all():
                notes += (f"{table.path.name}: {(~usable).sum()} incomplete rows skipped.",)
            times_ns, rows = times_ns[usable], rows[usable]
            return FixLog(oxts_fixes(times_ns, rows), notes, oxts_motion(times_ns, rows))
        plan = _Plan(table, columns or Columns())
        fixes = FixColumns.joined(plan.fixes(block) for block in table.blocks())
        plan.check_heights()
        return FixLog(fixes, plan.notes())


class _Plan:
    """Which columns are read, and what came up while reading."""

    def __init__(self, table: OpenTable, columns: Columns) -> None:
        self.table, self.columns, header = table, columns, table.header
        self.counts: Counter[str] = Counter()
        self.heights_m: list[Float64] = []
        self.unknown: set[str] = set()
        self.places: dict[str, int] = {}
        for role in _OWN | {"accuracy": "", "heading_valid": ""}:
            name = self.columns.names.get(role)
            if name is None:
                own = _OWN.get(role, "")
                projected = role in ("lat", "lon") and bool(self.columns.crs)
                name = own if own in header else guess(role, header, projected=projected)
            elif name and name not in header:
                raise RecordingError(
                    f"{self.table.path} has no column {quoted(name)} for {role}; "
                    f"it has: {', '.join(header)[:200]}."
                )
            if name:
                self.places[role] = header.index(name)
        for role in ("lat", "lon"):
            if role not in self.places:
                raise RecordingError(self._no_place(role))
        self.where, self.told = Places(
            self.table,
            *(self.places["lat"], self.places["lon"]),
            *(self.columns.lat_lon_units, self.columns.crs),
        ).settled()
        self.time = find_time(self.table, self.columns)

    def _no_place(self, role: str) -> str:
        header = self.table.header
        told = f"{self.table.path} has no column {_OWN[role]}, and none whose name is known for it"
        has = f"It has: {', '.join(header)[:500]}."
        metres = [guess(axis, header, projected=True) for axis in ("lat", "lon")]
        if None not in metres and not self.columns.crs:
            return (
                f"{told}; if {metres[0]} and {metres[1]} are metres north and east in a "
                "projection, as of UTM zone 30 north, name it: "
                f"{how_to_say(crs='EPSG:32630')}. {has}"
            )
        return f"{told}; name it: {how_to_say(**{role: 'COLUMN'})}. {has}"

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
        value = {
            r: self.table.numbers(block, self.places[r])[keep] for r in _NUMBERS if r in self.places
        }
        sigma = value.get("sigma")
        if sigma is None and "accuracy" in value:
            sigma = value["accuracy"] * (self._length("accuracy") / np.sqrt(2.0))
        elif sigma is not None:
            sigma = sigma * self._length("sigma")
        course = self._degrees("course", value)
        fields: dict[str, Float64 | None] = {
            "sigma_m": sigma,
            "hdop": value.get("hdop"),
            "age_s": value.get("age"),
            "heading_sigma_deg": self._degrees("heading_sigma", value),
            "course_deg": None if course is None else wrap_deg(course),
            "heading_deg": self._heading(value, block, keep),
        }
        if "speed" in value:
            unit, factor = self._unit("speed")
            if self.columns.speed_units:
                unit, factor = self.columns.speed_units, 1.0
            fields["speed_mps"] = np.abs(value["speed"]) * (factor * SPEEDS.get(unit, 1.0))
        said: dict[str, npt.ArrayLike] = {k: v for k, v in fields.items() if v is not None}
        said["quality"] = self._qualities(block, keep, sigma)
        if "satellites" in self.places:
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
                f"{self.table.path}: {self.table.header[self.places['height']]} is "
                f"{np.median(heights_m):.12g} m, higher than any field; say its unit: "
                f"{how_to_say(height_units='mm')}, or cm or ft."
            )

    def _unit(self, role: str) -> tuple[str, float]:
        named = take_apart(self.table.header[self.places[role]])
        return named.unit, named.factor

    def _length(self, role: str) -> float:
        unit, factor = self._unit(role)
        return factor * LENGTHS.get(unit, 1.0)

    def _heights(self, block: TableRows) -> Float64:
        """Metres, NaN where a row has none."""
        if "height" not in self.places:
            return np.zeros(block.row_count)
        said = self.columns.height_units
        unit_m = LENGTHS.get(said, 1.0) if said else self._length("height")

        def in_units(cell: str) -> float | None:
            length_m = metres(cell)
            return None if length_m is None else length_m / unit_m

        heights = self.table.numbers(block, self.places["height"], in_units) * unit_m
        self.counts["without a height: taken as 0 m"] += int(np.isnan(heights).sum())
        return heights

    def _degrees(self, role: str, value: dict[str, Float64]) -> Float64 | None:
        if role not in value:
            return None
        return np.degrees(value[role]) if is_radians(self._unit(role)[0]) else value[role]

    def _heading(self, value: dict[str, Float64], block: TableRows, keep: Index) -> Float64 | None:
        """Headings clockwise from north; NaN where they are marked as not valid."""
        if "heading" not in value:
            return None
        units, angle = self.columns.heading_units, value["heading"]
        radians = is_radians(units or self._unit("heading")[0])
        if units.endswith("ccw_east"):
            angle = heading_from_yaw_rad(angle if radians else np.radians(angle))
        else:
            angle = wrap_deg(np.degrees(angle) if radians else angle)
        if "heading_valid" in self.places:
            valid = self._each(
                "heading_valid", block, keep, lambda cell: cell.strip().lower() not in _FALSE
            )
            angle = np.where(np.array(valid, dtype=bool), angle, np.nan)
        return angle

    def _qualities(self, block: TableRows, keep: Index, sigma: Float64 | None) -> npt.ArrayLike:
        if "quality" not in self.places:
            return Quality.UNKNOWN if sigma is None else quality_by_sigma(sigma)
        name = self.table.header[self.places["quality"]]
        said = "quality" in self.columns.names or take_apart(name).base not in _WORDS_ONLY

        def read(cell: str) -> Quality:
            quality = read_quality(cell, numbers_are_gga=said)
            if quality is None:
                self.unknown.add(cell)
                return Quality.UNKNOWN
            return quality

        return self._each("quality", block, keep, read)

    def _each(
        self, role: str, block: TableRows, keep: Index, read: Callable[[str], _T]
    ) -> list[_T]:
        """What the cells of the rows say that become fixes; equal ones are read once."""
        cells = block.cells(self.places[role])
        kept = [cells[k] for k in keep.tolist()]
        known = {cell: read(cell) for cell in set(kept)}
        return [known[cell] for cell in kept]

    def notes(self) -> tuple[str, ...]:
        """What was guessed, assumed and skipped, a sentence each."""
        name, header = self.table.path.name, self.table.header
        guessed = [
            f"{role} from '{header[place]}'"
            for role, place in self.places.items()
            if role not in self.columns.names and header[place] != _OWN.get(role)
        ]
        notes = (
            [*self.time.notes, f"{name}: {', '.join(guessed)}."]
            if guessed
            else list(self.time.notes)
        )
        if "height" not in self.places:
            notes.append(f"{name}: no column height_m; heights are taken as 0 m.")
        if "quality" not in self.places:
            sigma = {"sigma", "accuracy"} & self.places.keys()
            notes.append(
                f"{name}: no column quality; stated errors up to 5 cm are taken for RTK fixed, the "
                "quality of others is unknown."
                if sigma
                else f"{name}: no column quality; it is unknown."
            )
        if self.unknown:
            words = ", ".join(repr(word[:30]) for word in sorted(self.unknown)[:5])
            notes.append(f"{name}: quality {words} is not known; taken as unknown.")
        notes += self.told
        return tuple(
            notes + [f"{name}: {counted(n, 'row')} {what}." for what, n in self.counts.items() if n]
        )


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
