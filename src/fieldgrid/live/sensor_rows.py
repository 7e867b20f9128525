"""Rows of sensor data as they are pushed: their names, and their conversion to motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.array_types import AnyArray, Bool, Int64
from fieldgrid.errors import ConfigError
from fieldgrid.fixes import Fix
from fieldgrid.motion import Gyro, Inertial, Motion, Orientation, RecordedTilt, WheelSpeed
from fieldgrid.quality import Quality

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
"""Of parts whose columns are wider than one value, how wide they are."""

MOST_NS = 1 << 62


class Rows(NamedTuple):
    """Some rows of one sensor: the times, and a column for each further field of its part."""

    time_ns: Int64
    columns: tuple[AnyArray, ...]

    def where(self, taken: Bool) -> Rows:
        """Those that are taken [n]."""
        return Rows(self.time_ns[taken], tuple(column[taken] for column in self.columns))


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
    """The same again."""
    part, time_ns, *columns = value
    return part, rows_of(part, time_ns, *columns)


def fix_to_json(fix: Fix) -> Any:
    """A fix as a value that JSON has, exactly."""
    return [value.value if isinstance(value, Quality) else value for value in fix]


def fix_from_json(value: Any) -> Fix:
    """The same again; what an earlier version did not keep was not said."""
    fix = Fix(*value)
    heading = fix.heading_quality
    return fix._replace(
        quality=Quality(fix.quality),
        heading_quality=None if heading is None else Quality(heading),
    )
