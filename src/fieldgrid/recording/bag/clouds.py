"""Point clouds in messages, turned to the axes of an optical frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fieldgrid.array_types import Float32, Float64
from fieldgrid.errors import RecordingError
from fieldgrid.recording.bag.images import MessageSource

MAX_POINTS = 20_000_000
"""More points than any sweep has."""

_FARTHEST_M = 1e6
_FLOATS: dict[int, np.dtype[Any]] = {
    7: np.dtype(np.float32),
    8: np.dtype(np.float64),
}  # PointField's own numbers

R_OPTICAL_FLU: Float64 = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Directions forward, left, up as right, down, forward."""


@dataclass(frozen=True, slots=True)
class MessageCloud(MessageSource):
    """A sensor_msgs/PointCloud2; `R` turns its axes into right, down, forward.

    `R` is kept as numbers by row, so that the source stays a plain value.
    """

    R: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    def read(self) -> Float32:
        """Points [n, 3], metres, finite: x right, y down, z forward."""
        points = points_of(self.decoded(), self.name)
        turn = np.array(self.R, dtype=np.float32).reshape(3, 3)
        if np.abs(turn).max(axis=1).min() == 1.0:  # axes that only change places, exactly
            axes = np.abs(turn).argmax(axis=1)
            return np.ascontiguousarray(points[:, axes] * turn[range(3), axes])
        return points @ turn.T


def points_of(message: Any, name: str) -> Float32:
    """The points [n, 3] of a sensor_msgs/PointCloud2 in its own axes, without those that are not
    finite or beyond any range."""
    width, height = int(message.width), int(message.height)
    point, row = int(message.point_step), int(message.row_step)
    if width * height > MAX_POINTS:
        raise RecordingError(
            f"{name} claims {width} x {height} points, more than {MAX_POINTS}; record sweeps one "
            "by one."
        )
    if width * height == 0:
        return np.zeros((0, 3), dtype=np.float32)
    if point <= 0 or row < width * point or row * (height - 1) + width * point > len(message.data):
        raise RecordingError(
            f"{name} has {len(message.data)} bytes in rows of {row}, too few for {width} x "
            f"{height} points of {point} bytes; it is damaged, record it again."
        )
    data = np.ascontiguousarray(message.data, dtype=np.uint8)
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    columns = []
    for axis in "xyz":
        offset, dtype = _field(message, axis, point, name)
        cells = np.ndarray((height, width), dtype.newbyteorder(order), data, offset, (row, point))
        with np.errstate(over="ignore", invalid="ignore"):
            columns.append(cells.reshape(-1).astype(np.float32))
    points = np.stack(columns, axis=1)
    sane = (np.abs(points) < _FARTHEST_M).all(axis=1)  # false for NaN, too
    return points if sane.all() else points[sane]


def _field(message: Any, axis: str, point_step: int, name: str) -> tuple[int, np.dtype[Any]]:
    for field in message.fields:
        if field.name == axis and int(field.datatype) in _FLOATS:
            dtype = _FLOATS[int(field.datatype)]
            if int(field.offset) + dtype.itemsize <= point_step:
                return int(field.offset), dtype
    raise RecordingError(
        f"{name} has no field {axis} of 32 or 64 bit floats within its {point_step} bytes a "
        "point; record the points as x, y, z."
    )
