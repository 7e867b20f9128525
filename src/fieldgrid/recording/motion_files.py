"""`imu/*.csv` and `odometry/*.csv` of a recording: the gyro and the wheels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64, Int64
from fieldgrid.errors import RecordingError
from fieldgrid.motion import Gyro, Motion, WheelSpeed
from fieldgrid.recording.columns import Columns, speed_factor, take_apart
from fieldgrid.recording.table_time import find_time
from fieldgrid.recording.tables import Table, open_table

AXES = "flu"
"""How an IMU is mounted when nothing is said: x forward, y left, z up."""

_OPPOSITE = {"f": "b", "b": "f", "l": "r", "r": "l", "u": "d", "d": "u"}
_DIRECTIONS = {
    **{"f": (1, 0, 0), "b": (-1, 0, 0), "l": (0, 1, 0)},
    **{"r": (0, -1, 0), "u": (0, 0, 1), "d": (0, 0, -1)},
}
# Names of the three axes' rates, then whether they are in degrees.
_RATES = (
    ("gyro_{}_rad_s", False), ("gyro_{}_radps", False), ("gyro_{}", False), ("gyr_{}", False),
    ("gyr{}", False), ("gyro{}", False), ("angular_velocity_{}", False), ("w{}", False),
    ("w_{}", False), ("g{}", False), ("rate_{}", False), ("angvel_{}", False),
    ("gyro_{}_deg_s", True), ("gyro_{}_dps", True), ("gyro_{}_degps", True),
)  # fmt: skip
_SPEEDS = (
    *("speed", "wheel_speed", "velocity", "vel", "v", "vx", "twist_linear_x", "linear_x"),
    *("linear_velocity", "linear_velocity_x", "forward_speed", "odometry_speed"),
)


class MotionFiles(NamedTuple):
    """The motion of a recording, and remarks on its files."""

    motion: Motion = Motion()
    notes: tuple[str, ...] = ()


class Series(NamedTuple):
    """Values with their times, increasing."""

    time_ns: Int64
    values: Float64


def directions(axes: str) -> tuple[tuple[int, int, int], ...]:
    """Where axes like flu point, one by one: forward, left, up."""
    return tuple(_DIRECTIONS[axis] for axis in axes)


def check_axes(axes: str) -> str:
    """The axes, once it is sure that they are three right-handed directions like flu."""
    if len(axes) == 3 and all(axis in _DIRECTIONS for axis in axes):
        columns = np.array([_DIRECTIONS[axis] for axis in axes])
        if round(float(np.linalg.det(columns))) == 1:
            return axes
    raise ValueError(
        f"{axes!r} is not where the three axes of an IMU point; give a right-handed set of "
        "f or b, l or r, u or d, like flu, frd or rfu"
    )


def read_motion(folder: Path, imu_axes: str = AXES) -> MotionFiles:
    """What `imu/` and `odometry/` of a recording hold; nothing where they are not."""
    notes: list[str] = []
    gyro = _joined([s for p in _tables(folder / "imu") if (s := _read_gyro(p, imu_axes, notes))])
    wheels = _joined([s for p in _tables(folder / "odometry") if (s := _read_speed(p, notes))])
    return MotionFiles(
        Motion(
            gyro=None if gyro is None else Gyro(*gyro),
            wheels=None if wheels is None else WheelSpeed(*wheels),
        ),
        tuple(notes),
    )


def _tables(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    endings = (".csv", ".tsv", ".csv.gz", ".tsv.gz")
    return sorted(path for path in folder.iterdir() if path.name.lower().endswith(endings))


def _read_gyro(path: Path, axes: str, notes: list[str]) -> tuple[Path, Series] | None:
    """The clockwise rate about the vehicle's vertical, rad/s; None without a gyro."""
    vertical = next(k for k, axis in enumerate(axes) if axis in "ud")
    with open_table(path) as table:
        found = _find_rate(table, "xyz"[vertical])
        if found is None:
            notes.append(f"{path.name}: no column gyro_{'xyz'[vertical]}_rad_s; it is not used.")
            return None
        name, in_degrees = found
        factor = math.radians(1.0) if in_degrees else 1.0
        series = _read(table, name, -factor if axes[vertical] == "u" else factor, notes)
        if not name.startswith("gyro_") or not name.endswith("_rad_s"):
            unit = "deg/s" if in_degrees else "rad/s"
            notes.append(f"{path.name}: gyro from '{name}', taken as {unit}.")
    return path, series


def _find_rate(table: Table, axis: str) -> tuple[str, bool] | None:
    for pattern, in_degrees in _RATES:
        for name in table.header:
            plain = "_".join("".join(c if c.isalnum() else " " for c in name.lower()).split())
            if plain in (pattern.format(axis), pattern.format(axis) + "_rad_s"):
                return name, in_degrees
    euroc = f"w_RS_S_{axis} [rad s^-1]"
    return (euroc, False) if euroc in table.header else None


def _read_speed(path: Path, notes: list[str]) -> tuple[Path, Series] | None:
    with open_table(path) as table:
        named = {take_apart(name): name for name in reversed(table.header)}
        bases = {apart.base: apart for apart in named}
        apart = next((bases[base] for base in _SPEEDS if base in bases), None)
        if apart is None:
            notes.append(f"{path.name}: no column speed_mps; it is not used.")
            return None
        series = _read(table, named[apart], apart.factor * speed_factor(apart.unit), notes)
        if named[apart] != "speed_mps":
            notes.append(
                f"{path.name}: speed from '{named[apart]}' in {apart.unit or 'm/s (assumed)'}."
            )
    return path, series


def _read(table: Table, name: str, factor: float, notes: list[str]) -> Series:
    """A column with its times, increasing; rows without either are dropped and counted."""
    time, place = find_time(table, Columns()), table.header.index(name)
    blocks = [(time.utc_ns(block), table.numbers(block, place)) for block in table.blocks()]
    times_ns = np.concatenate([times for times, _ in blocks] or [np.zeros(0, dtype=np.int64)])
    values = np.concatenate([values for _, values in blocks] or [np.zeros(0)]) * factor
    series, lost = in_order(times_ns, values)
    if lost:
        notes.append(
            f"{table.path.name}: {lost} rows without a time or value, or repeated, skipped."
        )
    notes += time.notes
    return series


def in_order(times_ns: Int64, values: Float64) -> tuple[Series, int]:
    """The values with a time, times increasing, the first of each; and how many are left out."""
    known = (times_ns > 0) & np.isfinite(values)
    kept_ns, kept = times_ns[known], values[known]
    if np.any(np.diff(kept_ns) <= 0):
        kept_ns, first = np.unique(kept_ns, return_index=True)
        kept = kept[first]
    return Series(kept_ns, kept), len(times_ns) - len(kept_ns)


def _joined(parts: Sequence[tuple[Path, Series]]) -> Series | None:
    """The files of one sensor in order of time; two that overlap are two sensors."""
    filled = sorted((p for p in parts if len(p[1].time_ns)), key=lambda p: int(p[1].time_ns[0]))
    for (path, earlier), (other, later) in pairwise(filled):
        if earlier.time_ns[-1] >= later.time_ns[0]:
            raise RecordingError(
                f"{path} and {other} overlap in time, so they are two sensors; keep one of them."
            )
    if not filled:
        return None
    return Series(
        np.concatenate([series.time_ns for _, series in filled]),
        np.concatenate([series.values for _, series in filled]),
    )
