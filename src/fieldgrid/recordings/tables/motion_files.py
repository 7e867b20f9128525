"""`imu/*.csv` and `odometry/*.csv` of a recording: gyro, accelerometer and wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, Int64, RecordingError, counted, quoted
from fieldgrid.geometry import Gyro, Inertial, Motion, WheelSpeed
from fieldgrid.recordings.tables.columns import Columns
from fieldgrid.recordings.tables.roles import FORCES, RATES, WHEELS, ColumnRole, guess
from fieldgrid.recordings.tables.table_time import find_time
from fieldgrid.recordings.tables.tables import OpenTable, open_table
from fieldgrid.recordings.tables.units import GRAVITY_MPS2, take_apart

AXES = "flu"
"""How an IMU is mounted when nothing is said: x forward, y left, z up."""

_DIRECTIONS = {
    **{"f": (1, 0, 0), "b": (-1, 0, 0), "l": (0, 1, 0)},
    **{"r": (0, -1, 0), "u": (0, 0, 1), "d": (0, 0, -1)},
}
_MOST_SENSED = 1e9
"""Beyond any rate or force: a sample with more is none."""
_UPRIGHT = 0.999
"""Of an axis that is taken for the vertical where there is no other, least part along it."""
_MOSTLY = 0.5
"""An accelerometer that says something in fewer of its rows than this says nothing."""


class MotionFiles(NamedTuple):
    """The motion of a recording, and remarks on its files."""

    motion: Motion = Motion()
    notes: tuple[str, ...] = ()


class MotionSeries(NamedTuple):
    """Values [n] or [n, k] with their times, increasing."""

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
        f"{quoted(axes)} is not where the three axes of an IMU point; give a right-handed set of "
        "f or b, l or r, u or d, like flu, frd or rfu"
    )


def read_motion(folder: Path, imu_axes: str = AXES) -> MotionFiles:
    """What `imu/` and `odometry/` of a recording hold; nothing where they are not."""
    notes: list[str] = []
    R_vehicle_imu = R_VEHICLE_FLU @ np.array(directions(imu_axes), dtype=np.float64).T
    motion = read_imu(_tables(folder / "imu"), R_vehicle_imu, notes, notes)
    wheels = _joined({path: _read_wheels(path, notes) for path in _tables(folder / "odometry")})
    if wheels is not None:
        motion = motion._replace(wheels=WheelSpeed(wheels.time_ns, wheels.values[:, 0]))
    return MotionFiles(motion, tuple(notes))


def read_imu(
    paths: Sequence[Path], R_vehicle_imu: Float64, notes: list[str], guessed: list[str]
) -> Motion:
    """What the files of one IMU hold, whose axes `R_vehicle_imu` turns into those of the vehicle.
    Remarks are added to `notes`, those on names of columns to `guessed`."""
    found = {path: _read_imu(path, R_vehicle_imu, notes, guessed) for path in paths}
    turning = _joined(found)
    whole = _joined(
        {path: s for path, s in found.items() if s and np.isfinite(s.values[:1, 0]).all()}
    )
    return Motion(
        gyro=None if turning is None else Gyro(turning.time_ns, -turning.values[:, 2]),
        inertial=None if whole is None else inertial_of(whole, notes),
    )


def gravity_unit_mps2(usual: Float64) -> float | None:
    """The unit of the usual specific force [3] of a drive: 1 m/s² or 1 g; None where its size is
    not that of gravity, as in a message from which gravity was removed."""
    size = float(np.linalg.norm(usual))
    if 0.9 < size < 1.1:
        return GRAVITY_MPS2
    return 1.0 if 9.0 < size < 10.6 else None


def inertial_of(sensed: MotionSeries, notes: list[str]) -> Inertial | None:
    """An IMU of samples [n, 6], rates and forces, whose accelerometer is believed if it sees
    gravity, in m/s² or in g, and sees it above it. None without a sample."""
    beyond = np.abs(sensed.values) > _MOST_SENSED
    if beyond.any():
        sane = ~beyond.any(axis=1)
        sensed = MotionSeries(sensed.time_ns[sane], sensed.values[sane])
    complete = np.isfinite(sensed.values).all(axis=1)
    count, felt = len(sensed.time_ns), int(complete.sum())
    if not count:
        return None
    if 0 < felt < count:
        # A sample without its force is as if there were none.
        used = "those are left out of the IMU" if felt > _MOSTLY * count else "it is not used"
        notes.append(
            f"The accelerometer says nothing in {count - felt} of {count} samples; {used}."
        )
    if felt > _MOSTLY * count:
        sensed = MotionSeries(sensed.time_ns[complete], sensed.values[complete])
    rates, forces = sensed.values[:, :3], sensed.values[:, 3:]
    inertial = Inertial(sensed.time_ns, rates.astype(np.float32), forces.astype(np.float32))
    usual = np.median(forces, axis=0)
    without = inertial._replace(force_mps2=np.full_like(inertial.force_mps2, np.nan))
    if not np.isfinite(usual).all():
        return without
    unit_mps2, up = gravity_unit_mps2(usual), float(usual[2])
    if unit_mps2 is None or up < 0.8 * float(np.linalg.norm(usual)):
        notes.append(
            "The accelerometer is not used: it should see gravity upward, 9.8 m/s² or 1 g, and "
            f"sees {usual[0]:.2f} to the right, {usual[1]:.2f} forward, {up:.2f} up; correct "
            "imu_axes in mounting.json"
            + (' (an IMU with x forward, y right, z down is "frd").' if up < 0.0 else ".")
        )
        return without
    if unit_mps2 == 1.0:
        return inertial
    notes.append("The accelerometer is taken to be in g.")
    return inertial._replace(force_mps2=inertial.force_mps2 * np.float32(unit_mps2))


def _tables(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    endings = (".csv", ".tsv", ".csv.gz", ".tsv.gz")
    return sorted(path for path in folder.iterdir() if path.name.lower().endswith(endings))


def _read_imu(
    path: Path, R_vehicle_imu: Float64, notes: list[str], guessed: list[str]
) -> MotionSeries | None:
    """Rates (rad/s) and forces (m/s²) along the vehicle's axes right, forward, up, [n, 6]; NaN
    where a file has fewer axes. None without a gyro about the vertical."""
    vertical = int(np.abs(R_vehicle_imu[2]).argmax())
    upward = RATES[vertical]
    with open_table(path) as table:
        has = {role: guess(role, table.header) is not None for role in (*RATES, *FORCES)}
        turns_whole = all(has[role] for role in RATES)
        aslant = abs(R_vehicle_imu[2, vertical]) < _UPRIGHT and not turns_whole
        if not has[upward] or aslant:
            notes.append(f"{path.name}: no column {upward.own}; it is not used.")
            return None
        turning = RATES if turns_whole else (upward,)
        pushing = FORCES if turns_whole and all(has[role] for role in FORCES) else ()
        name = guess(upward, table.header) or ""
        if name != upward.own:
            unit = take_apart(name).unit
            guessed.append(f"{path.name}: gyro from '{name}', taken as {unit or 'rad_s'}.")
        read = _read(table, (*turning, *pushing), notes, guessed, len(turning))
    sensed = np.full((len(read.time_ns), 6), np.nan)
    if not turns_whole:
        sensed[:, 2] = read.values[:, 0] * R_vehicle_imu[2, vertical]
        return MotionSeries(read.time_ns, sensed)
    for three in (slice(0, 3), slice(3, len(turning) + len(pushing))):
        if read.values[:, three].size:
            sensed[:, three] = read.values[:, three] @ R_vehicle_imu.T
    return MotionSeries(read.time_ns, sensed)


R_VEHICLE_FLU = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""From forward, left, up to the vehicle's axes right, forward, up."""


def _read_wheels(path: Path, notes: list[str]) -> MotionSeries | None:
    with open_table(path) as table:
        name = guess(WHEELS, table.header)
        if name is None:
            notes.append(f"{path.name}: no column {WHEELS.own}; it is not used.")
            return None
        series = _read(table, (WHEELS,), notes, notes)
        if name != WHEELS.own:
            unit = take_apart(name).unit or "m/s (assumed)"
            notes.append(f"{path.name}: speed from '{name}' in {unit}.")
    return series


def _read(
    table: OpenTable,
    roles: Sequence[ColumnRole],
    notes: list[str],
    guessed: list[str],
    needed: int = 1,
) -> MotionSeries:
    """The columns [n, k] of roles with their times, increasing; rows without one of the first
    `needed` of them are dropped and counted."""
    time = find_time(table, Columns())
    names = [guess(role, table.header) or "" for role in roles]
    places = [table.header.index(name) for name in names]
    times, rows = [np.zeros(0, dtype=np.int64)], [np.zeros((0, len(names)))]
    for block in table.blocks():
        times.append(time.utc_ns(block))
        rows.append(np.stack([table.numbers(block, place) for place in places], axis=1))
    worth = [take_apart(n).worth(role.quantity) for n, role in zip(names, roles, strict=True)]
    series, lost = in_order(np.concatenate(times), np.concatenate(rows) * worth, needed)
    notes += skipped(table.path.name, lost, "row")
    guessed += time.notes
    return series


def in_order(times_ns: Int64, values: Float64, needed: int = 1) -> tuple[MotionSeries, int]:
    """The rows with a time and their first `needed` values, times increasing, the first of each;
    and how many are left out."""
    known = (times_ns > 0) & np.isfinite(values.reshape(len(values), -1)[:, :needed]).all(axis=1)
    kept_ns, kept = times_ns[known], values[known]
    if np.any(np.diff(kept_ns) <= 0):
        kept_ns, first = np.unique(kept_ns, return_index=True)
        kept = kept[first]
    return MotionSeries(kept_ns, kept), len(times_ns) - len(kept_ns)


def skipped(source: str, lost: int, noun: str) -> list[str]:
    """What is said of rows or messages that :func:`in_order` leaves out."""
    said = f"{source}: {counted(lost, noun)} without a time or value, or repeated, skipped."
    return [said] if lost else []


def _joined(parts: Mapping[Path, MotionSeries | None]) -> MotionSeries | None:
    """The files of one sensor in order of time; two that overlap are two sensors."""
    filled = sorted(
        ((s, path) for path, s in parts.items() if s and len(s.time_ns)),
        key=lambda part: int(part[0].time_ns[0]),
    )
    for (earlier, path), (later, other) in pairwise(filled):
        if earlier.time_ns[-1] >= later.time_ns[0]:
            raise RecordingError(
                f"{path} and {other} overlap in time, so they are two sensors; keep one of them."
            )
    if not filled:
        return None
    columns = zip(*(series for series, _ in filled), strict=True)
    return MotionSeries(*(np.concatenate(column) for column in columns))
