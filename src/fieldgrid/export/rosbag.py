"""A map for ROS 2 and Foxglove: a bag that they open without any code of ours.

The topics are listed in `docs/exports.md`. What is of the whole map bears the time of the first
pose, so that a player shows it at once; paths and grids are latched, as Nav2 wants them.
"""

from __future__ import annotations

import heapq
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from fieldgrid.array_types import Bool, Int64
from fieldgrid.cost import CostCurve
from fieldgrid.errors import CalibrationError, ConfigError, MapError
from fieldgrid.export import foxglove_messages, ros_messages
from fieldgrid.export.features import trajectories
from fieldgrid.export.georeference import extent, georeference
from fieldgrid.export.options import CurveOptions
from fieldgrid.export.registry import Exported, Format, Holds, register
from fieldgrid.export.selection import Selection
from fieldgrid.export.tiles import MESSAGE_CELLS, Tile, Whole, cut, whole_of
from fieldgrid.export.vector import FeatureOptions, geojson_text
from fieldgrid.lattice import Bounds
from fieldgrid.mapfile import MapFile
from fieldgrid.rig import Rig
from fieldgrid.ros import BagFolderWriter, McapWriter
from fieldgrid.ros.gnss import datum_message
from fieldgrid.ros.messages import ANTENNA, BASE, text, transforms
from fieldgrid.settings import Flag, setting
from fieldgrid.trajectory import Trajectory

TILE_CELLS = 2048
"""Cells along a side of a tile of what is too large for one message."""

GRID_MAP_CELLS = 8_000_000
"""Cells of a grid map: 16 bytes of each are in the message, and 90 in memory while it is made."""

_END_NS = 2**31 * 1_000_000_000

GRID_MAP_LAYERS = ("density", "count", "variance", "persistence")


class _Stamped(NamedTuple):
    """A ROS message on its way into a bag."""

    topic: str
    message: Any
    time_ns: int
    latched: bool


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
        foxglove_messages.check_installed()
    content = _Content.of(universal, selection, options.curve())
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
        count = _write(writer, content)
    return Exported((path,), content.rows(count + len(own)), content.about(count + len(own)))


def _foxglove(
    content: _Content, path: Path, options: McapOptions
) -> list[tuple[str, foxglove_messages.Raw]]:
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
    view = selection.view(universal)
    return [
        ("/foxglove/grid", foxglove_messages.grid(view, content.start_ns)),
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
    content = _Content.of(universal, selection, options.curve())
    with BagFolderWriter(path, storage=options.storage, overwrite=overwrite) as writer:
        count = _write(writer, content)
    return Exported((path,), content.rows(count), content.about(count))


class _Content(NamedTuple):
    """What a bag is made of. `tiles` are those of what is too large for a message."""

    universal: MapFile
    selection: Selection
    curve: CostCurve
    whole: Whole
    tiles: tuple[Tile, ...]
    tracks: dict[str, Trajectory]
    start_ns: int

    @classmethod
    def of(cls, universal: MapFile, selection: Selection, curve: CostCurve) -> Self:
        whole = whole_of(universal, selection)
        cells = whole.window.width * whole.window.height
        tiles = cut(universal, selection, whole, TILE_CELLS) if cells > GRID_MAP_CELLS else ()
        tracks = trajectories(universal, selection)
        for name, track in tracks.items():
            if len(track) and not 0 <= int(track.time_ns[0]) <= int(track.time_ns[-1]) < _END_NS:
                raise ConfigError(
                    f"Session {name!r} has times before 1970 or after 2038, which a ROS message "
                    "cannot hold; take another format."
                )
        start_ns = _start_ns(universal, tracks)
        return cls(universal, selection, curve, whole, tuple(tiles), tracks, start_ns)

    @property
    def area(self) -> Bounds | None:
        """What paths and fixes are cut to, None for nothing."""
        return (
            None if self.selection.bounds is None else self.whole.lattice.bounds(self.whole.window)
        )

    @property
    def cells(self) -> str:
        """The size as text."""
        window = self.whole.window
        return f"{window.width} x {window.height} cells of {self.whole.lattice.cell_m:g} m"

    def about(self, messages: int) -> dict[str, Any]:
        """The same as numbers."""
        whole, datum = self.whole, self.universal.datum
        counts = {"messages": messages, "tiles": len(self.tiles)}
        return extent(whole.lattice, whole.window, datum) | counts

    def rows(self, messages: int) -> tuple[tuple[str, str], ...]:
        """What a reader is told."""
        rows = (("cells", self.cells.replace(" cells", "")), ("messages", str(messages)))
        if not self.tiles:
            return rows
        which = "/map and /grid_map" if self.whole.is_large else "/grid_map"
        tiles = f"{which}: {len(self.tiles)} tiles of up to {TILE_CELLS} a side, and an index"
        return (("too large for one message", tiles), *rows)


class _Vehicle(NamedTuple):
    """The frame of a vehicle on the ground, and its antenna where the session tells it."""

    base: str
    antenna: ros_messages.Antenna | None

    @classmethod
    def of(cls, content: _Content, session: str, names: dict[str, str]) -> Self:
        """The frames of a session; of several, each is below the name of its own."""
        above = "" if len(content.tracks) == 1 else f"{names[session]}/"
        (info,) = (one for one in content.universal.sessions() if one.name == session)
        antenna = None
        if "rig" in info.config:
            try:
                at = Rig.from_dict(info.config["rig"]).antenna
            except CalibrationError as error:
                raise MapError(
                    f"Session {session!r} does not say where its antenna was ({error}); build it "
                    "again from its recording."
                ) from error
            antenna = ros_messages.Antenna(f"{above}{ANTENNA}", at)
        return cls(f"{above}{BASE}", antenna)


def _start_ns(universal: MapFile, tracks: dict[str, Trajectory]) -> int:
    """The time of the first accepted pose, or of the first frame where there is no trajectory."""
    poses = [
        int(track.time_ns[track.accepted][0]) for track in tracks.values() if any(track.accepted)
    ]
    frames = [info.first_time_ns for info in universal.sessions() if info.first_time_ns is not None]
    return min(max(min(poses or frames, default=0), 0), _END_NS - 1)


def _write(writer: McapWriter | BagFolderWriter, content: _Content) -> int:
    """Write the ROS messages; their number."""
    count = 0
    for one in _messages(content):
        writer.write(one.topic, one.message, one.time_ns, latched=one.latched)
        count += 1
    return count


def _messages(content: _Content) -> Iterator[_Stamped]:
    """All messages in the order of their times, one in memory at a time."""
    datum, tracks, area = content.universal.datum, content.tracks, content.area
    start_ns, (lattice, window) = content.start_ns, content.whole
    names = topic_names(tracks)
    vehicles = {name: _Vehicle.of(content, name, names) for name in tracks}
    # In one message: of a latched topic, those who come later get the last one.
    placed = [ros_messages.earth_to_map(datum, start_ns)]
    placed += [
        ros_messages.antenna_on(vehicle.base, vehicle.antenna, start_ns)
        for vehicle in vehicles.values()
        if vehicle.antenna is not None
    ]
    yield _Stamped("/tf_static", transforms(*placed), start_ns, True)
    yield _Stamped("/datum", datum_message(datum, start_ns), start_ns, True)
    about = json.dumps(georeference(lattice, window, datum), ensure_ascii=False)
    yield _Stamped("/georeference", text(about), start_ns, True)
    for topic, is_large, message in (
        ("/map", content.whole.is_large, _occupancy),
        ("/grid_map", bool(content.tiles), _grid_map),
    ):
        if not is_large:
            yield _Stamped(topic, message(content, content.selection), start_ns, True)
            continue
        named = [(f"{topic}/tile_{tile.name}", tile) for tile in content.tiles]
        index = json.dumps([{"topic": name, **tile.about(lattice)} for name, tile in named])
        yield _Stamped(f"{topic}/index", text(index), start_ns, True)
        for name, tile in named:
            yield _Stamped(name, message(content, tile.selection), start_ns, True)
    for name, track in tracks.items():
        for number, rows in enumerate(_runs(track, area), 1):
            topic = f"/{names[name]}/path{'' if number == 1 else f'_{number}'}"
            yield _Stamped(topic, ros_messages.path(track, rows, start_ns), start_ns, True)
    for name, track in sorted(tracks.items(), key=lambda item: _first_ns(item[1])):
        wanted = track.accepted & _inside(track, area)
        base, antenna = vehicles[name]
        rows = np.flatnonzero(wanted & np.isfinite(track.heading_deg))
        # Both are in the order of time, and so are they together.
        yield from heapq.merge(
            (
                _Stamped(f"/{names[name]}/fix", fix, time_ns, False)
                for time_ns, fix in ros_messages.fixes(track, wanted, base, antenna)
            ),
            (
                one
                for time_ns, odometry, placed in ros_messages.driven(track, rows, base)
                for one in (
                    _Stamped("/tf", placed, time_ns, False),
                    _Stamped(f"/{names[name]}/odometry", odometry, time_ns, False),
                )
            ),
            key=lambda one: one.time_ns,
        )


def _occupancy(content: _Content, selection: Selection) -> Any:
    """The occupancy grid of a part."""
    view = selection.view(content.universal, content.universal.deciding(selection.cell_m))
    occupancy = content.curve.occupancy(*view.decision(selection.layer, content.curve.least_drop_m))
    return ros_messages.occupancy_grid(view, occupancy, content.start_ns)


def _grid_map(content: _Content, selection: Selection) -> Any:
    """The grid map of a part."""
    view = selection.view(content.universal, GRID_MAP_LAYERS)
    layers = {name: view.layer(name) for name in GRID_MAP_LAYERS}
    return ros_messages.grid_map(view, layers, content.start_ns)


def _inside(track: Trajectory, area: Bounds | None) -> Bool:
    if area is None:
        return np.ones(len(track), dtype=np.bool_)
    east, north = track.east_m, track.north_m
    in_columns = (east >= area.west_m) & (east <= area.east_m)
    return in_columns & (north >= area.south_m) & (north <= area.north_m)


def _runs(track: Trajectory, area: Bounds | None) -> Iterator[Int64]:
    """The rows of a path for each time that the drive is in the area."""
    rows = np.flatnonzero(track.accepted & np.isfinite(track.heading_deg))
    inside = _inside(track, area)[rows]
    if area is None:
        yield rows
        return
    for part in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(inside)) + 1):
        if len(part) and inside[part[0]]:
            yield rows[part]


def topic_names(sessions: dict[str, Any]) -> dict[str, str]:
    """The names of sessions as ROS allows them in topics: letters, digits, single underscores, a
    letter first; those that become alike get a number behind them."""
    found: dict[str, str] = {}
    for session in sessions:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", session).strip("_")
        plain = plain if plain[:1].isalpha() else f"session_{plain}".rstrip("_")
        name, number = plain, 2
        while name in found.values():
            name, number = f"{plain}_{number}", number + 1
        found[session] = name
    return found


def _first_ns(track: Trajectory) -> int:
    return int(track.time_ns[0]) if len(track) else 0


register(
    Format(
        "mcap",
        (".mcap",),
        "the same as `.rosbag2` in one file",
        export_mcap,
        McapOptions,
        Holds.OCCUPANCY,
        readers="Foxglove, rosbags",
        limits="2.5·10^7 cells a message, else tiles",
    ),
    Format(
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
)
