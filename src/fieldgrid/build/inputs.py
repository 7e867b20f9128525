"""What a session's poses were estimated from, as named arrays that a map keeps.

With them poses can be estimated again, by other rules or a better program, without images.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from fieldgrid.array_types import Bool, Int64
from fieldgrid.errors import MapError
from fieldgrid.gnss import Fix
from fieldgrid.motion import Gyro, Motion, Steps, WheelSpeed

Arrays = dict[str, npt.NDArray[np.generic]]

_INTEGERS = frozenset({"time_ns", "quality", "satellites", "heading_quality"})
_NOT_SAID = -1
"""Stands for None among integers, which have no NaN."""

_Part = TypeVar("_Part", Gyro, WheelSpeed, Steps)


class Inputs(NamedTuple):
    """The fixes in the order of the log, the drive's own motion, and which frames (by their
    times, image clock offset included) had their ground found."""

    fixes: list[Fix]
    motion: Motion
    frame_ns: Int64
    ground_found: Bool


def to_arrays(inputs: Inputs) -> Arrays:
    """Named arrays of everything in the inputs."""
    arrays: Arrays = {
        "frame_ns": inputs.frame_ns,
        "ground_found": inputs.ground_found.astype(np.uint8),
        **_fix_columns(inputs.fixes),
    }
    for kind, part in inputs.motion._asdict().items():
        if part is not None:
            arrays.update({f"{kind}.{name}": column for name, column in part._asdict().items()})
    return arrays


def from_arrays(arrays: Mapping[str, npt.NDArray[np.generic]]) -> Inputs:
    """What `to_arrays` was given. Raises MapError when something is missing."""
    if "fix.time_ns" not in arrays:
        raise MapError(
            "The session holds no fixes, so its poses cannot be estimated again; build it again "
            "from its recording."
        )
    try:
        fixes = _fixes(arrays)
        motion = Motion(
            _part(Gyro, "gyro", arrays),
            _part(WheelSpeed, "wheels", arrays),
            _part(Steps, "steps", arrays),
        )
        frame_ns = np.asarray(arrays["frame_ns"], dtype=np.int64)
        ground = np.asarray(arrays["ground_found"]).astype(np.bool_)
    except (KeyError, ValueError, TypeError) as error:
        raise MapError(
            f"The session's inputs are damaged: {error}; run fieldgrid verify."
        ) from error
    return Inputs(fixes, motion, frame_ns, ground)


def _fix_columns(fixes: Sequence[Fix]) -> Arrays:
    columns: Arrays = {}
    for k, name in enumerate(Fix._fields):
        values = [fix[k] for fix in fixes]
        if name in _INTEGERS:
            filled = [_NOT_SAID if value is None else value for value in values]
            columns[f"fix.{name}"] = np.array(filled, dtype=np.int64)
        else:
            reals = [np.nan if value is None else value for value in values]
            columns[f"fix.{name}"] = np.array(reals, dtype=np.float64)
    return columns


def _fixes(arrays: Mapping[str, npt.NDArray[np.generic]]) -> list[Fix]:
    count = len(arrays["fix.time_ns"])
    columns = []
    for name in Fix._fields:
        key = f"fix.{name}"
        # What this version may say of a fix and the writer's could not is not said.
        unsaid = name in Fix._field_defaults and key not in arrays
        values = [None] * count if unsaid else arrays[key].tolist()
        if name in _INTEGERS:
            values = [None if value == _NOT_SAID else value for value in values]
        elif name in Fix._field_defaults:
            values = [None if value != value else value for value in values]
        columns.append(values)
    return [Fix(*row) for row in zip(*columns, strict=True)]


def _part(
    kind: type[_Part], name: str, arrays: Mapping[str, npt.NDArray[np.generic]]
) -> _Part | None:
    if f"{name}.{kind._fields[0]}" not in arrays:
        return None
    columns: list[Any] = [arrays[f"{name}.{field}"] for field in kind._fields]
    return kind(*columns)
