"""What a session's poses were estimated from, as named arrays that a map keeps.

With them poses can be estimated again, by other rules or a better program, without images.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Bool, Int64, MapError
from fieldgrid.geometry import (
    Fix,
    FixColumns,
    GivenPoses,
    Gyro,
    Inertial,
    Motion,
    Orientation,
    RecordedTilt,
    Steps,
    WheelSpeed,
    known_codes,
)

Arrays = dict[str, npt.NDArray[np.generic]]

_LATER = frozenset(
    {
        *("steps.up_m", "steps.roll_deg", "steps.pitch_deg", "steps.tilt_sigma_deg"),
        *("poses.sigma_m", "poses.sigma_deg"),
    }
)
"""Columns that sessions of earlier versions do not have: they are NaN."""

_IF_SAID = ("pitch_deg", "roll_deg", "tilt_sigma_deg", "stamp_sigma_s")
"""Columns of fixes that few logs say something in, and that are kept where they do."""

_Part = TypeVar("_Part", Gyro, WheelSpeed, Steps, Inertial, RecordedTilt, GivenPoses, Orientation)


class Inputs(NamedTuple):
    """The fixes in the order of the log, the drive's own motion, and which frames (by their
    times, image clock offset included) had their ground found."""

    fixes: FixColumns
    motion: Motion
    frame_ns: Int64
    ground_found: Bool


def to_arrays(inputs: Inputs) -> Arrays:
    """Named arrays of everything in the inputs."""
    arrays: Arrays = {
        "frame_ns": inputs.frame_ns,
        "ground_found": inputs.ground_found.astype(np.uint8),
        **{
            f"fix.{name}": column
            for name, column in inputs.fixes.columns().items()
            if name not in _IF_SAID or not np.isnan(column).all()
        },
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
            _part(Inertial, "inertial", arrays),
            _part(RecordedTilt, "tilt", arrays),
            _part(GivenPoses, "poses", arrays),
            _part(Orientation, "orientation", arrays),
        )
        frame_ns = np.asarray(arrays["frame_ns"], dtype=np.int64)
        ground = np.asarray(arrays["ground_found"]).astype(np.bool_)
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise MapError(
            f"The session's inputs are damaged: {error}; run fieldgrid verify."
        ) from error
    return Inputs(fixes, motion, frame_ns, ground)


def _fixes(arrays: Mapping[str, npt.NDArray[np.generic]]) -> FixColumns:
    """The columns that are kept; what the writer could not say yet is not said."""
    names = [
        name
        for name in Fix._fields
        if f"fix.{name}" in arrays or name not in Fix._field_defaults or name == "quality"
    ]
    columns: dict[str, Any] = {name: arrays[f"fix.{name}"] for name in names}
    for name in {"quality", "heading_quality"} & columns.keys():
        columns[name] = known_codes(columns[name])
    if len({column.shape for column in columns.values()}) > 1:
        raise ValueError("the columns of the fixes differ in length")
    return FixColumns.of(columns.pop("time_ns"), **columns)


def _part(
    kind: type[_Part], name: str, arrays: Mapping[str, npt.NDArray[np.generic]]
) -> _Part | None:
    keys = [f"{name}.{field}" for field in kind._fields]
    if keys[0] not in arrays:
        return None
    known = {**dict.fromkeys(_LATER, np.full(len(arrays[keys[0]]), np.nan)), **arrays}
    columns: list[Any] = [known[key] for key in keys]
    return kind(*columns)
