"""What a map is as messages of Foxglove, in Protocol Buffers: a coloured grid, and shapes.

Foxglove draws grids in its 3D panel and GeoJSON in its map panel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fieldgrid.errors import ConfigError
from fieldgrid.mapfile import MapView
from fieldgrid.ros.messages import MAP


class Raw(NamedTuple):
    """A message that is serialised already, and what it is: its schema is protobuf's."""

    schema_name: str
    schema: bytes
    data: bytes


def check_installed() -> None:
    """Raise ConfigError when the schemas of Foxglove are not installed."""
    try:
        import foxglove_schemas_protobuf  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            "An MCAP file for Foxglove needs its schemas, which are not installed; run: "
            "pip install 'fieldgrid[foxglove]', or take the format rosbag2."
        ) from error


def grid(view: MapView, time_ns: int) -> Raw:
    """foxglove.Grid of the density: bright is free, dark an obstacle, transparent not observed.

    Each cell has five bytes: red, green, blue and alpha, in which it is drawn, and the density.
    """
    from foxglove_schemas_protobuf.Grid_pb2 import Grid
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField

    names = ("red", "green", "blue", "alpha", "density")
    cells = np.empty((*view.window.shape, len(names)), dtype=np.uint8)
    cells[..., :3] = (np.uint8(255) - view.density)[..., None]
    cells[..., 3] = view.observed * np.uint8(255)
    cells[..., 4] = view.density
    bounds, cell_m = view.bounds, view.lattice.cell_m
    message = Grid(
        frame_id=MAP,
        column_count=view.window.width,
        row_stride=view.window.width * len(names),
        cell_stride=len(names),
        fields=[
            PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8)
            for offset, name in enumerate(names)
        ],
        data=cells.tobytes(),
    )
    message.timestamp.FromNanoseconds(time_ns)
    message.pose.position.x, message.pose.position.y = bounds.west_m, bounds.south_m
    message.pose.orientation.w = 1.0
    message.cell_size.x = message.cell_size.y = cell_m
    return _raw(message)


def geojson(text: str) -> Raw:
    """foxglove.GeoJSON of a text."""
    from foxglove_schemas_protobuf.GeoJSON_pb2 import GeoJSON

    return _raw(GeoJSON(geojson=text))


def _raw(message: Any) -> Raw:
    """The message with its schema: the file that defines it, after the files it refers to."""
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

    take(message.DESCRIPTOR.file)
    return Raw(message.DESCRIPTOR.full_name, files.SerializeToString(), message.SerializeToString())
