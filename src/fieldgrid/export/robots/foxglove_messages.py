"""Maps, and what a live session tells, as messages of Foxglove in Protocol Buffers.

Foxglove draws grids in its 3D panel and GeoJSON in its map panel.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import Bool, UInt8
from fieldgrid.geometry import Bounds, Fix, LocalGrid, Pose, yaw_from_heading_rad
from fieldgrid.maps import UNKNOWN_COST, MapView
from fieldgrid.recordings import MAP


class EncodedMessage(NamedTuple):
    """A message that is serialised already, and what it is: its schema is protobuf's."""

    schema_name: str
    schema: bytes
    data: bytes


def grid(view: MapView, time_ns: int) -> EncodedMessage:
    """foxglove.Grid of the density: bright is free, dark an obstacle, transparent not observed.

    Each cell has five bytes: red, green, blue and alpha, in which it is drawn, and the density.
    """
    bounds = view.bounds
    return _grid(
        "density",
        view.density,
        view.observed,
        _pose((bounds.west_m, bounds.south_m, 0.0), 0.0),
        view.lattice.cell_m,
        MAP,
        time_ns,
    )


def cost_grid(costs: UInt8, bounds: Bounds, cell_m: float, time_ns: int) -> EncodedMessage:
    """foxglove.Grid of costs [rows north, columns east] as Nav2 has them, drawn as `grid`; its
    fifth byte is the cost."""
    return _grid(
        "cost",
        costs,
        costs != UNKNOWN_COST,
        _pose((bounds.west_m, bounds.south_m, 0.0), 0.0),
        cell_m,
        MAP,
        time_ns,
    )


def local_grid(local: LocalGrid, time_ns: int, base: str) -> EncodedMessage:
    """foxglove.Grid of a local grid's density, in the frame `base` of the vehicle: forward, left,
    up. Its rows lie ahead of each other, its columns from left to right."""
    # The corner is that on the near left, and columns run to the right: a quarter turn.
    corner = _pose((0.0, local.spec.width_m / 2.0, 0.0), -math.pi / 2.0)
    density, observed = local.density, local.observed
    return _grid("density", density, observed, corner, local.spec.cell_m, base, time_ns)


def _grid(
    name: str,
    values: UInt8,
    observed: Bool,
    corner: Any,
    cell_m: float,
    frame: str,
    time_ns: int,
) -> EncodedMessage:
    """foxglove.Grid of values [rows, columns] whose first cell begins at the pose `corner`."""
    from foxglove_schemas_protobuf.Grid_pb2 import Grid
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField

    names = ("red", "green", "blue", "alpha", name)
    cells = np.empty((*values.shape, len(names)), dtype=np.uint8)
    cells[..., :3] = (np.uint8(255) - values)[..., None]
    cells[..., 3] = observed * np.uint8(255)
    cells[..., 4] = values
    message = Grid(
        frame_id=frame,
        pose=corner,
        column_count=values.shape[1],
        row_stride=values.shape[1] * len(names),
        cell_stride=len(names),
        fields=[
            PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8)
            for offset, name in enumerate(names)
        ],
        data=cells.tobytes(),
    )
    message.cell_size.x = message.cell_size.y = cell_m
    return _encoded(message, time_ns)


def pose(at: Pose) -> EncodedMessage:
    """foxglove.PoseInFrame of a pose in the map; its x is forward."""
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

    return _encoded(PoseInFrame(frame_id=MAP, pose=_pose_of(at)), at.time_ns)


def path(poses: Sequence[Pose], time_ns: int) -> EncodedMessage:
    """foxglove.PosesInFrame of poses in the map."""
    from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame

    return _encoded(PosesInFrame(frame_id=MAP, poses=[_pose_of(one) for one in poses]), time_ns)


def transform(at: Pose, base: str) -> EncodedMessage:
    """foxglove.FrameTransform: where the vehicle's frame `base` is in the map."""
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

    message = FrameTransform(parent_frame_id=MAP, child_frame_id=base)
    placed = _pose_of(at)
    for name in "xyz":
        setattr(message.translation, name, getattr(placed.position, name))
    message.rotation.CopyFrom(placed.orientation)
    return _encoded(message, at.time_ns)


def location_fix(fix: Fix, frame: str) -> EncodedMessage:
    """foxglove.LocationFix of the antenna, with its height above the ellipsoid; the height's
    error is taken as twice the horizontal one."""
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    return _encoded(
        LocationFix(
            frame_id=frame,
            latitude=fix.lat_deg,
            longitude=fix.lon_deg,
            altitude=fix.height_m,
            position_covariance=(np.diag([1.0, 1.0, 4.0]) * fix.position_sigma_m**2)
            .reshape(-1)
            .tolist(),
            position_covariance_type=LocationFix.APPROXIMATED,
        ),
        fix.time_ns,
    )


def log(text: str, time_ns: int, *, is_warning: bool) -> EncodedMessage:
    """foxglove.Log of a sentence."""
    from foxglove_schemas_protobuf.Log_pb2 import Log

    return _encoded(
        Log(level=Log.WARNING if is_warning else Log.INFO, message=text, name="fieldgrid"),
        time_ns,
    )


def _pose_of(at: Pose) -> Any:
    return _pose((at.east_m, at.north_m, at.up_m), float(yaw_from_heading_rad(at.heading_deg)))


def _pose(at_m: tuple[float, float, float], yaw_rad: float) -> Any:
    """foxglove.Pose of a level body; its yaw is counter-clockwise from x."""
    from foxglove_schemas_protobuf.Pose_pb2 import Pose as Message

    message = Message()
    message.position.x, message.position.y, message.position.z = at_m
    message.orientation.z, message.orientation.w = math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)
    return message


def geojson(text: str) -> EncodedMessage:
    """foxglove.GeoJSON of a text."""
    from foxglove_schemas_protobuf.GeoJSON_pb2 import GeoJSON

    return _encoded(GeoJSON(geojson=text))


def schema(name: str) -> bytes:
    """The schema of a message of this name, such as Grid: a FileDescriptorSet."""
    module = importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2")
    return _schema(getattr(module, name).DESCRIPTOR.file)


def _encoded(message: Any, time_ns: int | None = None) -> EncodedMessage:
    """The message with its schema, stamped with a time where it has one."""
    if time_ns is not None:
        message.timestamp.FromNanoseconds(time_ns)
    described = message.DESCRIPTOR
    return EncodedMessage(described.full_name, _schema(described.file), message.SerializeToString())


@cache
def _schema(file: Any) -> bytes:
    """The file that defines a message, after the files it refers to."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    files = FileDescriptorSet()
    taken: set[str] = set()

    def take(file: Any) -> None:
        if file.name in taken:
            return
        taken.add(file.name)
        for needed in file.dependencies:
            take(needed)
        file.CopyToProto(files.file.add())

    take(file)
    found: bytes = files.SerializeToString()
    return found
