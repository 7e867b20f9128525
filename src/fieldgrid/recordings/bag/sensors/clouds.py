"""Point clouds in messages, turned to the axes of an optical frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fieldgrid.core import AnyArray, Float32, RecordingError
from fieldgrid.perception import TIME_FIELDS, Sweep, seconds_after
from fieldgrid.recordings.bag.sensors.images import MessageSource

MAX_POINTS = 20_000_000
"""More points than any sweep has."""

_FARTHEST_M = 1e6
_NUMBERS: dict[int, np.dtype[Any]] = {
    5: np.dtype("i4"),
    6: np.dtype("u4"),
    7: np.dtype("f4"),
    8: np.dtype("f8"),
}
"""Types of fields by PointField's own numbers."""
_SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class MessageCloud(MessageSource):
    """A sensor_msgs/PointCloud2; `R` turns its axes into right, down, forward.

    `R` is kept as numbers by row, so that the source stays a plain value. Points that are
    `corrected` for the motion within their sweep have no times any more.
    """

    R: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    corrected: bool = False

    def read(self) -> Float32:
        """Points [n, 3], metres, finite: x right, y down, z forward."""
        return self.sweep().points_m

    def sweep(self) -> Sweep:
        """The points, with their times by the header's stamp."""
        points, after_s = _sweep_of(self.decoded(), self.name)
        if self.corrected:
            after_s = None
        turn = np.array(self.R, dtype=np.float32).reshape(3, 3)
        return Sweep(points @ turn.T, after_s)


def _sweep_of(message: Any, name: str) -> Sweep:
    """The points of a sensor_msgs/PointCloud2 in its own axes, without those that are not
    finite or beyond any range."""
    width, height = int(message.width), int(message.height)
    point, row = int(message.point_step), int(message.row_step)
    if width * height > MAX_POINTS:
        raise RecordingError(
            f"{name} claims {width} x {height} points, more than {MAX_POINTS}; record sweeps one "
            "by one."
        )
    if width * height == 0:
        return Sweep(np.zeros((0, 3), dtype=np.float32))
    if point <= 0 or row < width * point or row * (height - 1) + width * point > len(message.data):
        raise RecordingError(
            f"{name} has {len(message.data)} bytes in rows of {row}, too few for {width} x "
            f"{height} points of {point} bytes; it is damaged, record it again."
        )
    order: Literal["<", ">"] = ">" if message.is_bigendian else "<"
    fields: dict[str, tuple[np.dtype[Any], int]] = {}
    for field in message.fields:
        kind = _NUMBERS.get(int(field.datatype))
        if kind is not None and int(field.offset) + kind.itemsize <= point:
            fields.setdefault(field.name, (kind.newbyteorder(order), int(field.offset)))

    def column(name: str) -> AnyArray:
        kind, offset = fields[name]
        cells: AnyArray = np.ndarray((height, width), kind, message.data, offset, (row, point))
        return cells.reshape(-1)

    for axis in "xyz":
        if axis not in fields or fields[axis][0].kind != "f":
            raise RecordingError(
                f"{name} has no field {axis} of 32 or 64 bit floats within its {point} bytes a "
                "point; record the points as x, y, z."
            )
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.stack([column(axis).astype(np.float32) for axis in "xyz"], axis=1)
    sane = (np.abs(points) < _FARTHEST_M).all(axis=1)  # false for NaN, too
    after_s = None
    timed = next((field for field in fields if field in TIME_FIELDS), None)
    if timed is not None:
        stamp = message.header.stamp
        after_s = seconds_after(column(timed)[sane], stamp.sec * _SECOND_NS + stamp.nanosec)
    return Sweep(points if sane.all() else points[sane], after_s)
