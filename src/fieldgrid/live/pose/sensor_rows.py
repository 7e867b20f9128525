"""Rows of sensor data as they are pushed: their names, and their conversion to motion."""

from __future__ import annotations

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
    "poses": ("position_m", "axes"),
}
"""What the columns of rows are; poses of another program are kept as they are written: where the
body is, and its axes, row by row."""
_WIDE = {"inertial": (3, 3), "poses": (3, 9)}
"""Widths of the columns, of parts whose columns are wider than one value."""

MOST_NS = 1 << 62

KEPT_NS = 15_000_000_000
"""Recent rows are kept for this time before the newest one."""

HELD_NS = 300_000_000
"""The rate, speed or angle of a sensor holds for this time after the last value."""

MOST_NEW = 1000
"""Number of pushes that wait to be put in order until something is asked."""


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


class RecentRows:
    """The first columns of the rows of some parts, over the last seconds; safe from any thread."""

    def __init__(self, columns: Mapping[str, int]) -> None:
        """`columns` are how many columns of each part are kept."""
        self._columns = columns
        self._rows_lock = threading.Lock()
        self._new: dict[str, list[SensorTrack]] = {part: [] for part in columns}
        self._tracks: dict[str, SensorTrack] = {}

    def add_rows(self, part: str, rows: Rows) -> None:
        """Rows of any part; those of other parts are ignored."""
        if part not in self._columns or not len(rows.time_ns):
            return
        values = np.column_stack(rows.columns[: self._columns[part]]).astype(np.float64)
        known = np.isfinite(values).all(axis=1)
        with self._rows_lock:
            self._new[part].append(SensorTrack(rows.time_ns[known], values[known]))
            if len(self._new[part]) >= MOST_NEW:
                self._merge(part)

    def forget(self, sources: Collection[str]) -> None:
        """Forget what some sources said: it was of another time."""
        with self._rows_lock:
            for part in self._columns.keys() & set(sources):
                self._tracks.pop(part, None)
                self._new[part].clear()

    def track(self, part: str) -> SensorTrack:
        """The values of a part, with those that were added last."""
        with self._rows_lock:
            return self._merge(part)

    def _merge(self, part: str) -> SensorTrack:
        """Put what is new of a part in order, without rows that are old; under the lock."""
        pieces = [self._tracks[part]] if part in self._tracks else []
        pieces += self._new[part]
        if not pieces:
            return SensorTrack(np.zeros(0, np.int64), np.zeros((0, self._columns[part])))
        if self._new[part]:
            times, values = (np.concatenate(column) for column in zip(*pieces, strict=True))
            times, first = np.unique(times, return_index=True)
            recent = times >= times.max(initial=0) - KEPT_NS
            self._tracks[part] = SensorTrack(times[recent], values[first][recent])
            self._new[part].clear()
        return self._tracks[part]


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
        if part != "inertial" and not np.isfinite(values).all():
            raise ConfigError(f"{name} of {part} holds a value that is not finite; leave it out.")
        made.append(values)
    return Rows(times, tuple(made))


def joined(pieces: Sequence[Rows]) -> Rows:
    """The rows of some pieces, one piece behind the other."""
    columns = zip(*(rows.columns for rows in pieces), strict=True)
    time_ns = np.concatenate([rows.time_ns for rows in pieces])
    return Rows(time_ns, tuple(np.concatenate(values) for values in columns))


def motion_of(parts: Mapping[str, Sequence[Rows]]) -> Motion:
    """Motion of all rows but those of poses, in order of time, of equal times the first."""
    made: dict[str, Any] = {}
    for part, chunks in parts.items():
        if not chunks or part not in PARTS:
            continue
        whole_ns, columns = joined(chunks)
        time_ns, first = np.unique(whole_ns, return_index=True)
        made[part] = PARTS[part](time_ns, *(column[first] for column in columns))
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
