"""A map for ROS and Foxglove: a bag that they open without any code of ours."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from fieldgrid.core import ConfigError, Flag, setting
from fieldgrid.export.cells.tiles import MESSAGE_CELLS
from fieldgrid.export.options import CurveOptions
from fieldgrid.export.registry import Exported, ExportFormat, Holds, register_export_format, require
from fieldgrid.export.robots import foxglove_messages
from fieldgrid.export.robots.bag_content import BagContent, messages
from fieldgrid.export.shapes.vector import FeatureOptions, geojson_text
from fieldgrid.maps import MapFile, Selection
from fieldgrid.recordings import BagFolderWriter, McapWriter, Ros1BagWriter


class BagOptions(CurveOptions):
    """How a bag is stored."""

    storage: Literal["sqlite3", "mcap"] = setting(
        "sqlite3", "storage of the bag", flag=Flag("--storage", "sqlite3|mcap")
    )


class McapOptions(CurveOptions):
    """What a file for Foxglove holds."""

    messages: Literal["ros2", "foxglove"] = setting(
        "ros2",
        "foxglove adds its own messages in Protocol Buffers, which readers of ROS bags refuse",
        flag=Flag("--messages", "ros2|foxglove"),
    )


def export_mcap(
    universal: MapFile,
    path: Path,
    selection: Selection,
    options: McapOptions,
    *,
    overwrite: bool,
) -> Exported:
    """Write a part of a map as one `.mcap` file, which Foxglove and readers of ROS 2 bags open.

    It holds what `export_rosbag2` writes. With messages "foxglove" also two of Foxglove's own: a
    coloured grid and the obstacles, trajectories and marks as GeoJSON. Raises ConfigError when what
    those two need is not installed, or the part is too large for them.
    """
    for_foxglove = options.messages == "foxglove"
    if for_foxglove:
        require("An MCAP file for Foxglove", "foxglove", "foxglove_schemas_protobuf")
    content = BagContent.of(universal, selection, options.curve())
    if for_foxglove and content.whole.is_large:
        raise ConfigError(
            f"A map of {content.cells} is too large for one message of Foxglove's own, which "
            f"takes {MESSAGE_CELLS / 1e6:.0f} million; leave --messages foxglove out: the ROS "
            "messages are cut into tiles. Or give --bounds or a larger --cell."
        )
    own = _foxglove(content, path, options) if for_foxglove else []
    with McapWriter(path, overwrite=overwrite) as writer:
        for topic, raw in own:
            writer.write_raw(
                topic, raw.schema_name, "protobuf", raw.schema, raw.data, content.start_ns
            )
        return _write(writer, content, path, len(own))


def _foxglove(
    content: BagContent, path: Path, options: McapOptions
) -> list[tuple[str, foxglove_messages.EncodedMessage]]:
    """Foxglove's own messages by topic."""
    selection, universal = content.selection, content.universal
    shapes = geojson_text(
        universal,
        path,
        Selection(selection.bounds, selection.cell_m, at=selection.at),
        FeatureOptions(
            features="obstacle,trajectory" + (",mark" if universal.marks() else ""),
            obstacle_above=options.obstacle_above,
        ),
    )
    grid = foxglove_messages.grid(selection.view(universal), content.start_ns)
    return [
        ("/foxglove/grid", grid),
        ("/foxglove/geojson", foxglove_messages.geojson(shapes)),
    ]


def export_rosbag2(
    universal: MapFile,
    path: Path,
    selection: Selection,
    options: BagOptions,
    *,
    overwrite: bool,
) -> Exported:
    """Write a part of a map as a ROS 2 bag, a folder that `ros2 bag play` plays to Nav2.

    /map is a nav_msgs/OccupancyGrid, by the curve of the options; /grid_map has the density, count,
    variance and persistence of each cell. There are a path and fixes of each session, the datum as
    a fix, as the transform from `earth` to `map` and as JSON. The folder appears when it is
    complete. A part of more than 25 million cells is too large for one message, and of more than
    8 million for a grid map: it comes as tiles, /map/tile_ROW_COLUMN and
    /grid_map/tile_ROW_COLUMN, of which /map/index and /grid_map/index are the lists as JSON.
    """
    content = BagContent.of(universal, selection, options.curve())
    with BagFolderWriter(path, storage=options.storage, overwrite=overwrite) as writer:
        return _write(writer, content, path)


def export_rosbag1(
    universal: MapFile,
    path: Path,
    selection: Selection,
    options: CurveOptions,
    *,
    overwrite: bool,
) -> Exported:
    """Write a part of a map as a ROS 1 bag, one `.bag` file that `rosbag play` plays.

    It holds what `export_rosbag2` writes, in the messages that ROS 1 has.
    """
    content = BagContent.of(universal, selection, options.curve())
    with Ros1BagWriter(path, overwrite=overwrite) as writer:
        return _write(writer, content, path)


def _write(
    writer: McapWriter | BagFolderWriter | Ros1BagWriter,
    content: BagContent,
    path: Path,
    count: int = 0,
) -> Exported:
    """Write the ROS messages behind the first `count` ones of another kind."""
    for one in messages(content):
        writer.write(one.topic, one.message, one.time_ns, latched=one.latched)
        count += 1
    return Exported((path,), content.rows(count), content.about(count))


register_export_format(
    ExportFormat(
        "mcap",
        (".mcap",),
        "the same as `.rosbag2` in one file",
        export_mcap,
        McapOptions,
        Holds.OCCUPANCY,
        readers="Foxglove, rosbags",
        limits="2.5·10^7 cells a message, else tiles",
    ),
    ExportFormat(
        "rosbag2",
        (".rosbag2",),
        "ROS 2 bag: grids, paths, odometry, tf",
        export_rosbag2,
        BagOptions,
        Holds.OCCUPANCY,
        folder=True,
        readers="`ros2 bag play` to Nav2, RViz",
        limits="2.5·10^7 cells a message, else tiles",
    ),
    ExportFormat(
        "rosbag1",
        (".bag",),
        "the same for ROS 1",
        export_rosbag1,
        CurveOptions,
        Holds.OCCUPANCY,
        readers="`rosbag play`, RViz of ROS 1",
        limits="2.5·10^7 cells a message, else tiles",
    ),
)
