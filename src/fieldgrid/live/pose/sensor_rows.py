"""Rows of sensor data as they are pushed: their names, and their conversion to motion."""

from __future__ import annotations

import math
import threading
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import AnyArray, Bool, ConfigError, Float64, Int64, Quality
from fieldgrid.geometry import Fix, Gyro, Inertial, Motion, Orientation, RecordedTilt, WheelSpeed

Part = Gyro | WheelSpeed | Inertial | RecordedTilt | Orientation

PARTS: dict[str, type[Part]] = {
    "gyro": Gyro,
    "wheels": WheelSpeed,
    "inertial": Inertial,
    "tilt": RecordedTilt,
    "orientation": Orientation,
}
"""What moves the vehicle, by the name of its part of `Motion`."""

_COLUMNS: dict[str, tuple[str, ...]] = {
    **{part: kind._fields[1:] for part, kind in PARTS.items()},
    "poses": ("position_m", "axes", "variance"),
}
"""What the columns of rows are; poses of another program are kept as they are written: where the
body is, its axes, row by row, and what is stated of their errors, NaN where nothing is."""
_WIDE = {"inertial": (3, 3), "poses": (3, 9, 3)}
"""Widths of the columns, of parts whose columns are wider than one value."""

MOST_NS = 1 << 62

KEPT_NS = 15_000_000_000
"""Recent rows are kept for this time before the newest one."""

HELD_NS = 300_000_000
"""The rate, speed or angle of a sensor holds for this time after the last value."""

MOST_NEW = 1000
"""Number of pushes that wait to be put in order until something is asked."""

TICK_S = 0.02


class Rows(NamedTuple):
    """Some rows of one sensor: the times, and a column for each further field of its part."""

    time_ns: Int64
    columns: tuple[AnyArray, ...]

    def where(self, taken: Bool) -> Rows:
        """The rows where `taken` [n] is true."""
        return Rows(self.time_ns[taken], tuple(column[taken] for column in self.columns))


class SensorTrack(NamedTuple):
    """Values [n, k] of one sensor in order of time."""

    time_ns: Int64
    values: Float64

    def at(self, time_ns: Int64) -> Float64:
        """The values at some instants [m, k]; beyond the ends those there."""
        origin = self.time_ns[0]
        at_s, known_s = (time_ns - origin) / 1e9, (self.time_ns - origin) / 1e9
        return np.stack([np.interp(at_s, known_s, column) for column in self.values.T], axis=1)

    def holds(self, from_ns: int, to_ns: int) -> bool:
        """Whether it has values all the way from one instant to another."""
        inside = (self.time_ns >= from_ns - HELD_NS) & (self.time_ns <= to_ns + HELD_NS)
        around = np.concatenate([[from_ns - HELD_NS], self.time_ns[inside], [to_ns + HELD_NS]])
        return bool(inside.any()) and int(np.diff(around).max()) <= 2 * HELD_NS


def ticks(from_ns: int, to_ns: int) -> Int64:
    """Instants from one to another, close to each other."""
    count = math.ceil((to_ns - from_ns) / 1e9 / TICK_S) + 1
    return from_ns + np.rint(np.linspace(0.0, to_ns - from_ns, count)).astype(np.int64)


class RecentRows:
    """What all sensors said in the last seconds, by their parts; safe from any thread."""

    def __init__(self, kept_ns: int = KEPT_NS) -> None:
        """What is older than `kept_ns` before the newest row of its part is forgotten."""
        self._kept_ns, self._lock = kept_ns, threading.Lock()
        self._rows: dict[str, list[Rows]] = {}
        self.newest_ns = 0

    def add(self, part: str, rows: Rows) -> None:
        """Rows of a part, in any order."""
        if len(rows.time_ns):
            with self._lock:
                pieces = self._rows.setdefault(part, [])
                pieces.append(in_order(rows))
                self.newest_ns = max(self.newest_ns, int(rows.time_ns.max()))
                if len(pieces) >= MOST_NEW:
                    self._in_order(part)

    def forget(self, parts: Collection[str], time_ns: int) -> None:
        """Forget what some parts said after an instant: it was of another time."""
        with self._lock:
            for part in self._rows.keys() & set(parts):
                rows = self._in_order(part)
                self._rows[part] = [rows.where(rows.time_ns <= time_ns)]
            ends = (
                int(rows.time_ns.max(initial=0)) for all_ in self._rows.values() for rows in all_
            )
            self.newest_ns = max(ends, default=0)

    def since(self, since_ns: int) -> dict[str, Rows]:
        """What all parts said from an instant on, in order of time, of equal times the first."""
        with self._lock:
            all_ = {part: self._in_order(part) for part in self._rows}
        found = {part: rows.where(rows.time_ns >= since_ns) for part, rows in all_.items()}
        return {part: rows for part, rows in found.items() if len(rows.time_ns)}

    def track(self, part: str, width: int) -> SensorTrack:
        """The first columns of a part, so many, over the last seconds."""
        with self._lock:
            rows = self._in_order(part) if part in self._rows else None
        if rows is None:
            return SensorTrack(np.zeros(0, np.int64), np.zeros((0, width)))
        first = int(np.searchsorted(rows.time_ns, rows.time_ns.max(initial=0) - KEPT_NS))
        columns = [column[first:] for column in rows.columns[:width]]
        values = np.column_stack(columns).astype(np.float64)
        known = np.isfinite(values).all(axis=1)
        return SensorTrack(rows.time_ns[first:][known], values[known])

    def _in_order(self, part: str) -> Rows:
        """All that a part said, as one piece; under the lock."""
        pieces = self._rows[part]
        if len(pieces) > 1:
            rows = in_order(joined(pieces))
            since_ns = rows.time_ns.max(initial=0) - self._kept_ns
            self._rows[part] = pieces = [rows.where(rows.time_ns >= since_ns)]
        return pieces[0]


def check_time(what: str, time_ns: int) -> None:
    """Raise ConfigError for what no time of a drive can be: no map could have it."""
    if not 0 <= time_ns < MOST_NS:
        raise ConfigError(
            f"The time of {what} is no number of nanoseconds since 1970 (UTC): {time_ns}."
        )


def rows_of(part: str, time_ns: npt.ArrayLike, *columns: npt.ArrayLike) -> Rows:
    """Rows of a part of the motion, one or many; ConfigError for what cannot be rows of it."""
    times = np.atleast_1d(np.asarray(time_ns, dtype=np.int64))
    if times.ndim != 1 or (times.size and not 0 <= times.min() <= times.max() < MOST_NS):
        raise ConfigError(f"Times of {part} are no nanoseconds since 1970 (UTC); give int64 [n].")
    wide = _WIDE.get(part, (None,) * len(columns))
    kind = np.float32 if part == "inertial" else np.float64
    made = []
    for name, column, width in zip(_COLUMNS[part], columns, wide, strict=True):
        shape = (len(times),) if width is None else (len(times), width)
        values = np.asarray(column, dtype=kind)
        values = values.reshape(shape) if values.size == np.prod(shape) else values
        if values.shape != shape:
            raise ConfigError(
                f"{name} of {part} has the shape {values.shape} for {len(times)} times; give "
                f"{list(shape)}."
            )
        may_be_unknown = part == "inertial" or name == "variance"
        if not may_be_unknown and not np.isfinite(values).all():
            raise ConfigError(f"{name} of {part} holds a value that is not finite; leave it out.")
        made.append(values)
    return Rows(times, tuple(made))


def joined(pieces: Sequence[Rows]) -> Rows:
    """The rows of some pieces, one piece behind the other."""
    columns = zip(*(rows.columns for rows in pieces), strict=True)
    time_ns = np.concatenate([rows.time_ns for rows in pieces])
    return Rows(time_ns, tuple(np.concatenate(values) for values in columns))


def in_order(rows: Rows) -> Rows:
    """Rows in order of time, of equal times the first."""
    if (np.diff(rows.time_ns) > 0).all():  # as nearly always
        return rows
    time_ns, first = np.unique(rows.time_ns, return_index=True)
    return Rows(time_ns, tuple(column[first] for column in rows.columns))


def motion_of(parts: Mapping[str, Sequence[Rows]]) -> Motion:
    """Motion of all rows but those of poses, in order of time, of equal times the first."""
    made: dict[str, Any] = {}
    for part, chunks in parts.items():
        if not chunks or part not in PARTS:
            continue
        rows = in_order(joined(chunks))
        made[part] = PARTS[part](rows.time_ns, *rows.columns)
    return Motion(**made)


def rows_to_json(part: str, rows: Rows) -> Any:
    """The rows as a value that JSON has, exactly."""
    return [part, rows.time_ns.tolist(), *(column.tolist() for column in rows.columns)]


def rows_from_json(value: Any) -> tuple[str, Rows]:
    """The part and the rows of a value that `rows_to_json` made."""
    part, time_ns, *columns = value
    return part, rows_of(part, time_ns, *columns)


def fix_to_json(fix: Fix) -> Any:
    """A fix as a value that JSON has, exactly."""
    return [value.value if isinstance(value, Quality) else value for value in fix]


def fix_from_json(value: Any) -> Fix:
    """The fix of a value that `fix_to_json` made; what an earlier version did not keep was not
    said."""
    fix = Fix(*value)
    heading = None if fix.heading_quality is None else Quality(fix.heading_quality)
    return fix._replace(quality=Quality(fix.quality), heading_quality=heading)
