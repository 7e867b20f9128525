"""Trajectories of other programs in text files: TUM and KITTI."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import MIN_TIME_NS, Bool, Float64, Int64, RecordingError, quoted
from fieldgrid.recordings.files import read_lines
from fieldgrid.recordings.tables.times import UNITS, TimeScale, guess_scale, to_utc_ns

MOST_M = 1e7
"""No trajectory leads farther from its origin."""

_TUM, _KITTI = 8, 12
OFF_UNIT = 0.02
"""By how much a quaternion's length and a matrix's rows may be off, as they are written."""


class BodyPoses(NamedTuple):
    """Poses of a body as they are written, n rows: `time_ns` UTC, None where they have no times;
    where the body is, `position_m` [n, 3], and its axes, `R` [n, 3, 3], in the frame of the
    trajectory. `name` is what they are from. `variance` [n, 3] is what is stated of x, y (m²) and
    the turn about z (rad²), NaN where nothing is."""

    name: str
    time_ns: Int64 | None
    position_m: Float64
    R: Float64
    variance: Float64


def read_pose_file(path: Path, offset_ns: int = 0) -> BodyPoses:
    """The poses of a TUM file (`t x y z qx qy qz qw` a line) or a KITTI one (12 numbers a line,
    without times). `offset_ns` is added to the times; where it leads beyond 1980, it is that of
    times that count from 0.

    Raises RecordingError, with the line, for anything else.
    """
    wanted = (
        "a trajectory of TUM (t x y z qx qy qz qw) or of KITTI (12 numbers, the upper three rows "
        "of a matrix)"
    )
    lines, first, values = _read_numbers(path, (_TUM, _KITTI), wanted)
    unsaid = np.full((len(values), 3), np.nan)
    if values.shape[1] == _KITTI:
        matrices = values.reshape(-1, 3, 4)
        R = matrices[:, :, :3]
        off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        wrong = (off > OFF_UNIT) | (np.linalg.det(R) < 0.0)
        _refuse(path, lines, wrong, "its first three columns are no rotation")
        return BodyPoses(path.name, None, matrices[:, :, 3], R, unsaid)
    length = np.linalg.norm(values[:, 4:], axis=1)
    _refuse(
        path,
        lines,
        np.asarray(np.abs(length - 1.0) > OFF_UNIT),
        "its quaternion has not the length 1",
    )
    times_ns = read_times(first, path, lines, offset_ns)
    return BodyPoses(path.name, times_ns, values[:, 1:4], rotations(values[:, 4:]), unsaid)


def read_time_file(path: Path, offset_ns: int) -> Int64:
    """The times of poses that have none, one a line, UTC nanoseconds."""
    lines, first, _ = _read_numbers(path, (1,), "one time a line")
    return read_times(first, path, lines, offset_ns)


def read_times(cells: list[str], path: Path, lines: list[int], offset_ns: int) -> Int64:
    """UTC nanoseconds of the times of a trajectory, in s, ms, us or ns since 1970, or in seconds
    from 0 where the offset is a time itself."""
    scale = guess_scale("", cells, decimal_comma=False)
    if offset_ns >= MIN_TIME_NS:
        seconds, offset_ns = divmod(offset_ns, 1_000_000_000)
        scale = TimeScale(UNITS["s"], origin_s=seconds, declared=True)
    if scale is None or scale.places is None:
        raise RecordingError(
            f"{path}, line {lines[0]}: {quoted(cells[0])} is no UTC time since 1970; if the times "
            "count from 0, say when that was with --poses-offset (seconds since 1970)."
        )
    times_ns = to_utc_ns(cells, scale, decimal_comma=False)
    _refuse(path, lines, times_ns <= 0, "its time is no UTC time after 1980")
    return times_ns + offset_ns


def rotations(quaternions: Float64) -> Float64:
    """Rotations [n, 3, 3] of quaternions x, y, z, w [n, 4], which need not have the length 1."""
    q = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    x, y, z, w = q.T
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0).copy()


def _read_numbers(
    path: Path, widths: tuple[int, ...], wanted: str
) -> tuple[list[int], list[str], Float64]:
    """The numbers of a file whose lines have one of these widths, the same in all; `wanted` is
    what an error asks for. Of each line that is no remark: where it is in the file, its first word,
    and its values [n, width]."""
    lines: list[int] = []
    first: list[str] = []
    numbers = array("d")
    width = 0
    for number, line in read_lines(path):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        width = width or len(words)
        if width not in widths:
            raise RecordingError(f"{path} has {width} numbers a line; give {wanted}.")
        if len(words) != width:
            raise RecordingError(
                f"{path}, line {number}: {len(words)} numbers, and the first line has {width}; "
                "write the file again."
            )
        lines.append(number)
        first.append(words[0])
        try:
            numbers.extend(map(float, words))
        except ValueError as problem:
            why = str(problem).replace("could not convert string to float", "no number")
            raise RecordingError(f"{path}: {why[:200]}; write the file again.") from problem
    if not lines:
        raise RecordingError(f"{path} is empty; give {wanted}.")
    values = np.array(numbers).reshape(-1, width)
    is_possible = np.isfinite(values).all(axis=1)
    if width != _KITTI:
        is_possible &= values[:, 0] >= 0.0
    if width != 1:
        is_possible &= (np.abs(values[:, int(width == _TUM) :]) < MOST_M).all(axis=1)
    why = "it holds NaN, a time below 0, or a number beyond any drive"
    _refuse(path, lines, ~is_possible, why)
    return lines, first, values


def _refuse(path: Path, lines: list[int], wrong: Bool, why: str) -> None:
    if wrong.any():
        first = int(np.argmax(wrong))
        more = int(np.count_nonzero(wrong)) - 1
        others = f" (and {more} more)" if more else ""
        raise RecordingError(
            f"{path}, line {lines[first]}{others}: {why}; leave out poses that were lost, and "
            "write the file again."
        )
